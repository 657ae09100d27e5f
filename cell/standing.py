"""How the cell stands, in one small file: state, figures, alarms, devices. For people and the next start.

Written whole or not at all, at most every few seconds, by the cell thread; a file that cannot be written
stops nothing. What a person asks of the alarms (acknowledge, shelve) comes as files in a folder beside it,
because a shell on the machine must be able to do that without the page.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final

from cell import alarms as machine
from cell import figures as counting
from cell.alarm_table import TABLE, AlarmCode, Condition, Device, Health, alarm_of
from cell.alarms import Alarms, AlarmState, ShelvingRefused
from cell.errors import ConfigError
from cell.faults import Fault
from cell.figures import Day, Figures, FirstOut
from cell.logs import logger
from cell.modes import Mode
from cell.operation import PlannedConfig
from cell.states import State
from drivers.timing import Clock

log = logger("cell")

FILE: Final = "state.json"
REQUESTS: Final = "alarm-requests"
WRITE_S: Final = 5.0
REQUESTS_S: Final = 1.0
_MOST_REQUESTS: Final = 100

Count = Callable[[int], tuple[int, int, int]]
"""Journal rows after a number: produced, failed, the last row counted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """What the PLC is told of the alarms."""

    first: int
    unacknowledged: int


class Standing:
    """Figures and alarms of one cell, kept by the cell thread."""

    def __init__(
        self,
        folder: Path,
        clock: Clock,
        count: Count,
        planned: PlannedConfig | None,
        wall: Callable[[], float] = time.time,
    ) -> None:
        self._folder = folder
        self._clock = clock
        self._count = count
        self._planned = planned
        self._wall = wall
        self.figures = Figures(since=self._now_text())
        self._alarms: Alarms = machine.update({}, {}, clock.now())
        self._state = State.STOPPED
        self._since = clock.now()
        self._written_at = float("-inf")
        self._asked_at = float("-inf")
        self._conditions: dict[AlarmCode, str] = {}
        self._unwritable = False

    # ------------------------------------------------------------------ start

    def recall(self) -> None:
        """What the last run left; a file that cannot be understood is kept aside."""
        path = self._folder / FILE
        try:
            self.figures = figures_of(json.loads(path.read_text(encoding="utf-8"))["figures"])
        except FileNotFoundError:
            log.info("figures_begun", file=str(path))
        except (OSError, ValueError, KeyError, TypeError) as error:
            log.error(
                "figures_lost", file=str(path), detail=f"{type(error).__name__}: {error}", kept=".broken"
            )
            try:
                path.replace(path.with_suffix(".broken"))
            except OSError as second:
                log.warning("figures_not_kept", detail=str(second))
        self._count_on()
        self._since = self._clock.now()

    # ------------------------------------------------------------------ what happens

    def entered(self, state: State) -> None:
        """The cell has changed its state."""
        self._pass_time()
        self._state = state
        if state in counting.RUNNING:
            self.figures = counting.running(self.figures)

    def stopped(self, fault: Fault) -> None:
        """A fault: the first reason of this stop, unless there was one before."""
        self._reason(int(fault.code), fault.code.name, fault.detail)

    def held(self, code: AlarmCode, detail: str) -> None:
        """The cell waits for a person."""
        self._reason(int(code), code.name, detail)

    def mode(self, mode: Mode) -> None:
        """Another mode from now on."""
        self._pass_time()
        self.figures = replace(self.figures, mode=mode)
        self.condition(
            Condition.NOT_IN_PRODUCTION,
            None if mode is Mode.PRODUCTION else mode.name.lower().replace("_", " "),
        )

    def condition(self, code: AlarmCode, detail: str | None) -> None:
        """What an alarm is about is there (with a detail), or not (None)."""
        if detail is None:
            self._conditions.pop(code, None)
        else:
            self._conditions[code] = detail
        self._follow()

    def acknowledge(self) -> None:
        """The reset edge: somebody has seen all that stands."""
        self._alarms = machine.acknowledge(self._alarms)

    def seen(self) -> Seen:
        """For the PLC's registers."""
        first = machine.first_out(self._alarms)
        waiting = sum(not alarm.acknowledged for _, alarm in machine.standing(self._alarms))
        return Seen(first=0 if first is None else int(first), unacknowledged=waiting)

    # ------------------------------------------------------------------ time

    def tick(self) -> None:
        """Called often; does what is due."""
        now = self._clock.now()
        self._follow()
        if now - self._asked_at >= REQUESTS_S:
            self._asked_at = now
            self._take_requests()
        if now - self._written_at >= WRITE_S:
            self.write()

    def write(self) -> None:
        """The file as things are now; whole or not at all."""
        self._written_at = self._clock.now()
        self._pass_time()
        self._count_on()
        path = self._folder / FILE
        partial = path.with_suffix(".part")
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            with partial.open("w", encoding="utf-8") as file:
                json.dump(self.document(), file, indent=1)
                file.write("\n")
                file.flush()
                os.fsync(file.fileno())
            partial.replace(path)
        except OSError as error:
            if not self._unwritable:
                log.warning("state_not_written", file=str(path), detail=str(error))
            self._unwritable = True
        else:
            self._unwritable = False

    def document(self) -> dict[str, object]:
        """What the file holds."""
        now = self._clock.now()
        return {
            "written_at": self._now_text(),
            "state": self._state.name,
            "mode": self.figures.mode.name,
            "devices": {device.value: health.value for device, health in devices(self._alarms).items()},
            "alarms": [
                {
                    "code": int(code),
                    "name": code.name,
                    "state": alarm.state.value,
                    "priority": TABLE[code].priority.name.lower(),
                    "since_s": round(now - (now if alarm.came_at is None else alarm.came_at), 1),
                    "count": alarm.count,
                    "detail": alarm.detail,
                    "action": TABLE[code].action,
                }
                for code, alarm in (*machine.standing(self._alarms), *_shelved(self._alarms))
            ],
            "oee": self._oee(),
            "figures": asdict(self.figures) | {"mode": self.figures.mode.name},
        }

    # ------------------------------------------------------------------ within

    def _oee(self) -> dict[str, float] | None:
        if self._planned is None or not self.figures.days:
            return None
        known = counting.oee(self.figures.days[-1], self._planned.ideal_cycle_s)
        if known is None:
            return None
        return {
            "availability": round(known.availability, 4),
            "performance": round(known.performance, 4),
            "quality": round(known.quality, 4),
            "oee": round(known.oee, 4),
        }

    def _reason(self, code: int, name: str, detail: str) -> None:
        reason = FirstOut(code=code, name=name, detail=detail, at=self._now_text())
        self.figures = counting.stopped(self.figures, reason)

    def _pass_time(self) -> None:
        now = self._clock.now()
        passed_s, self._since = now - self._since, now
        planned_s = passed_s if self._is_planned() else 0.0
        self.figures = counting.advance(self.figures, self._state, passed_s, self._date(), planned_s)

    def _count_on(self) -> None:
        produced, failed, last = self._count(self.figures.counted_to)
        self.figures = counting.counted(
            self.figures, produced, failed, last, self._date(), self._is_planned()
        )

    def _follow(self) -> None:
        before = self._alarms
        self._alarms = machine.update(before, self._conditions, self._clock.now())
        for code, alarm in self._alarms.items():
            if alarm.active and not before[code].active and alarm.state is not AlarmState.SHELVED:
                log.warning("alarm_came", code=int(code), name=code.name, detail=alarm.detail)
            if before[code].active and not alarm.active:
                log.info("alarm_gone", code=int(code), name=code.name)

    def _take_requests(self) -> None:
        try:
            waiting = sorted((self._folder / REQUESTS).glob("*.json"))[:_MOST_REQUESTS]
            texts = [(path, path.read_text(encoding="utf-8")) for path in waiting]
            for path in waiting:
                path.unlink()
        except OSError as error:
            log.warning("alarm_requests_unreadable", detail=str(error))
            return
        for path, text in texts:
            try:
                self._request(json.loads(text))
            except (ValueError, KeyError, TypeError, AttributeError, ShelvingRefused) as error:
                log.warning("alarm_request_refused", request=path.name, detail=str(error))

    def _request(self, asked: dict[str, object]) -> None:
        number = asked["code"]
        code = None if number is None else alarm_of(int(str(number)))
        match asked["do"]:
            case "acknowledge":
                self._alarms = machine.acknowledge(self._alarms, code)
            case "shelve" if code is not None:
                for_s = float(str(asked["for_s"]))
                self._alarms = machine.shelve(self._alarms, code, for_s, self._clock.now())
            case "unshelve" if code is not None:
                self._alarms = machine.unshelve(self._alarms, code)
            case what:
                raise ValueError(f"nothing known to do: {what!r}")
        log.info("alarm_request_done", **{key: str(value) for key, value in asked.items()})
        self._written_at = float("-inf")

    def _now_text(self) -> str:
        return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(self._wall()))

    def _date(self) -> str:
        return time.strftime("%Y-%m-%d", time.localtime(self._wall()))

    def _is_planned(self) -> bool:
        if self._planned is None:
            return False
        return self._planned.begin <= time.strftime("%H:%M", time.localtime(self._wall())) < self._planned.end


def devices(alarms: Alarms) -> dict[Device, Health]:
    """NE 107 of each device: the worst of what is active."""
    order = list(Health)
    worst = dict.fromkeys(Device, Health.GOOD)
    for code, alarm in alarms.items():
        row = TABLE[code]
        if alarm.active and order.index(row.health) < order.index(worst[row.device]):
            worst[row.device] = row.health
    return worst


def _shelved(alarms: Alarms) -> list[tuple[AlarmCode, machine.Alarm]]:
    return [(code, alarm) for code, alarm in alarms.items() if alarm.state is AlarmState.SHELVED]


def figures_of(values: dict[str, object]) -> Figures:
    """Figures from their document. Raises `KeyError`, `ValueError` or `TypeError` for what is none."""
    fields = dict(values)
    mode = Mode[str(fields.pop("mode"))]
    first = fields.pop("first_out")
    days = fields.pop("days")
    if not isinstance(days, list) or not isinstance(first, dict | None):
        raise TypeError("days is no list, or first_out no mapping")
    return Figures(
        mode=mode,
        first_out=None if first is None else FirstOut(**first),
        days=tuple(Day(**day) for day in days),
        **fields,  # type: ignore[arg-type]  # names of its fields
    )


def read(folder: Path) -> dict[str, object]:
    """The file as a document; `ConfigError` when there is none."""
    path = folder / FILE
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ConfigError(
            path, None, "there is none yet; has the daemon run with this configuration?"
        ) from error
    except (OSError, ValueError) as error:
        raise ConfigError(path, None, f"cannot be read: {error}") from error
    if not isinstance(document, dict):
        raise ConfigError(path, None, "is not what the daemon writes")
    return document


def ask(folder: Path, request: dict[str, object]) -> None:
    """Leave a request for the daemon that writes this folder's file."""
    spool = folder / REQUESTS
    name = f"{time.time_ns()}-{os.getpid()}"
    try:
        spool.mkdir(parents=True, exist_ok=True)
        partial = spool / f"{name}.part"
        partial.write_text(json.dumps(request), encoding="utf-8")
        partial.replace(spool / f"{name}.json")
    except OSError as error:
        raise ConfigError(spool, None, f"no request can be left there: {error}") from error
