"""Alarms after ISA-18.2 (IEC 62682) as a pure state machine: what comes, goes, is acknowledged and shelved.

An alarm comes when its condition has been there for its on-delay, and goes when it has been away for its
off-delay, so that a loose contact is one alarm and not a hundred. It is unacknowledged until a person has
seen it, whether the condition is still there or not. A shelved alarm is not shown until its time is over, and
no alarm can be shelved for longer than a shift.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from typing import Final

from cell.alarm_table import CODES, TABLE, AlarmCode, Priority

SHELVED_MOST_S: Final = 8 * 3600.0


class AlarmState(Enum):
    """Where an alarm stands."""

    NORMAL = "normal"
    UNACKNOWLEDGED = "unacknowledged"
    ACKNOWLEDGED = "acknowledged"
    RETURNED = "returned, unacknowledged"
    SHELVED = "shelved"


@dataclass(frozen=True, slots=True, kw_only=True)
class Alarm:
    """One alarm. ``present``: its condition, ``changed_at`` since when; ``active`` after the delays.

    ``came_at`` when it last became active; ``count`` how often it has. Instants are seconds of one clock.
    """

    present: bool = False
    changed_at: float = 0.0
    active: bool = False
    acknowledged: bool = True
    came_at: float | None = None
    count: int = 0
    shelved_until: float | None = None
    detail: str = ""

    @property
    def state(self) -> AlarmState:
        """What of it is shown."""
        if self.shelved_until is not None:
            return AlarmState.SHELVED
        if self.active:
            return AlarmState.ACKNOWLEDGED if self.acknowledged else AlarmState.UNACKNOWLEDGED
        return AlarmState.NORMAL if self.acknowledged else AlarmState.RETURNED


Alarms = Mapping[AlarmCode, Alarm]


class ShelvingRefused(Exception):
    """Too long, or not an alarm that may be shelved."""


def update(alarms: Alarms, present: Mapping[AlarmCode, str], now: float) -> Alarms:
    """The conditions as they are now, with a detail each; everything else about time follows from ``now``."""
    return {code: _step(code, alarms.get(code, Alarm()), present.get(code), now) for code in CODES}


def _step(code: AlarmCode, alarm: Alarm, detail: str | None, now: float) -> Alarm:
    if alarm.shelved_until is not None and now >= alarm.shelved_until:
        alarm = replace(alarm, shelved_until=None)
    here = detail is not None
    if here is not alarm.present:
        alarm = replace(alarm, present=here, changed_at=now)
    if detail is not None:
        alarm = replace(alarm, detail=detail)
    row = TABLE[code]
    lasted_s = now - alarm.changed_at
    if alarm.present and not alarm.active and lasted_s >= row.on_delay_s:
        return replace(alarm, active=True, acknowledged=False, came_at=now, count=alarm.count + 1)
    if not alarm.present and alarm.active and lasted_s >= row.off_delay_s:
        return replace(alarm, active=False)
    return alarm


def acknowledge(alarms: Alarms, code: AlarmCode | None = None) -> Alarms:
    """A person has seen it; None: all of them. A shelved one is left as it is."""
    return {
        each: replace(alarm, acknowledged=True)
        if code in (None, each) and alarm.shelved_until is None
        else alarm
        for each, alarm in alarms.items()
    }


def shelve(alarms: Alarms, code: AlarmCode, for_s: float, now: float) -> Alarms:
    """Not shown for a while.

    Raises
    ------
    ShelvingRefused
        Longer than `SHELVED_MOST_S`, or an alarm about which a person must do something.
    """
    if not 0.0 < for_s <= SHELVED_MOST_S:
        raise ShelvingRefused(
            f"{for_s:.0f} s: an alarm may be shelved for {SHELVED_MOST_S / 3600:.0f} h at most"
        )
    if TABLE[code].priority is Priority.HIGH:
        raise ShelvingRefused(f"{int(code)} {code.name} is of high priority and cannot be shelved")
    return {**alarms, code: replace(alarms.get(code, Alarm()), shelved_until=now + for_s)}


def unshelve(alarms: Alarms, code: AlarmCode) -> Alarms:
    """Shown again."""
    return {**alarms, code: replace(alarms.get(code, Alarm()), shelved_until=None)}


def standing(alarms: Alarms) -> tuple[tuple[AlarmCode, Alarm], ...]:
    """What is shown: all but normal and shelved ones; the most urgent first, of those the oldest."""
    shown = [
        (code, alarm)
        for code, alarm in alarms.items()
        if alarm.state not in (AlarmState.NORMAL, AlarmState.SHELVED)
    ]
    return tuple(sorted(shown, key=lambda item: (TABLE[item[0]].priority.value, item[1].came_at or 0.0)))


def first_out(alarms: Alarms) -> AlarmCode | None:
    """The oldest of those that are active: in a chain of them, the one that began it."""
    active = [(code, alarm) for code, alarm in standing(alarms) if alarm.active]
    return min(active, key=lambda item: item[1].came_at or 0.0)[0] if active else None
