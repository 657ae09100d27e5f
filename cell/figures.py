"""What a cell has done: time by mode and state, parts and failures, why it stopped first. Pure.

Counters never go back: they are counted from the journal, which is durable before anybody is told, by the
number of the last row that was counted. OEE after ISO 22400-2: availability is the planned time without the
time the cell was down, performance is ideal time by running time, quality good parts by all that were tried.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

from cell.modes import Mode
from cell.states import State

DAYS_KEPT: Final = 31
RUNNING: Final = frozenset({State.STARTING, State.EXECUTE, State.COMPLETING, State.COMPLETE})
DOWN: Final = frozenset(
    {
        State.STOPPING,
        State.STOPPED,
        State.ABORTING,
        State.ABORTED,
        State.CLEARING,
        State.RESETTING,
        State.HOLDING,
        State.HELD,
    }
)
"""Idle and suspended are not the cell's fault: nobody ordered anything."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FirstOut:
    """The first reason of a stop; what follows from it does not replace it."""

    code: int
    name: str
    detail: str
    at: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Day:
    """Figures of one day within its planned time."""

    date: str
    planned_s: float = 0.0
    down_s: float = 0.0
    running_s: float = 0.0
    produced: int = 0
    failed: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Oee:
    """Overall equipment effectiveness and its factors, 0..1 (performance may exceed 1)."""

    availability: float
    performance: float
    quality: float

    @property
    def oee(self) -> float:
        """The product of the three."""
        return self.availability * self.performance * self.quality


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """All of it. ``seconds`` by names of mode and state; ``counted_to`` the last journal row counted."""

    since: str
    mode: Mode = Mode.PRODUCTION
    seconds: dict[str, dict[str, float]] = field(default_factory=dict)
    produced: int = 0
    failed: int = 0
    counted_to: int = 0
    first_out: FirstOut | None = None
    stopped: bool = False
    days: tuple[Day, ...] = ()


def advance(figures: Figures, state: State, passed_s: float, date: str, planned_s: float) -> Figures:
    """Time has passed in a state of the present mode; ``planned_s`` of it were planned production time."""
    mode = figures.mode.name
    states = figures.seconds.get(mode, {})
    seconds = {
        **figures.seconds,
        mode: {**states, state.name: states.get(state.name, 0.0) + max(0.0, passed_s)},
    }
    figures = replace(figures, seconds=seconds)
    if planned_s <= 0.0 or figures.mode is not Mode.PRODUCTION:
        return figures
    today = _day(figures, date)
    changed = replace(
        today,
        planned_s=today.planned_s + planned_s,
        down_s=today.down_s + (planned_s if state in DOWN else 0.0),
        running_s=today.running_s + (planned_s if state in RUNNING else 0.0),
    )
    return _with(figures, changed)


def counted(figures: Figures, produced: int, failed: int, last: int, date: str, planned: bool) -> Figures:
    """Rows of the journal up to ``last`` have been counted on top."""
    figures = replace(
        figures, produced=figures.produced + produced, failed=figures.failed + failed, counted_to=last
    )
    if not planned or not (produced or failed) or figures.mode is not Mode.PRODUCTION:
        return figures
    today = _day(figures, date)
    return _with(figures, replace(today, produced=today.produced + produced, failed=today.failed + failed))


def stopped(figures: Figures, reason: FirstOut) -> Figures:
    """The cell stands; only the first reason since it last ran is kept."""
    return figures if figures.stopped else replace(figures, first_out=reason, stopped=True)


def running(figures: Figures) -> Figures:
    """The cell works again; the reason of the last stop stays readable until the next one."""
    return replace(figures, stopped=False) if figures.stopped else figures


def oee(day: Day, ideal_cycle_s: float) -> Oee | None:
    """None while nothing was planned or tried: a figure about nothing would be made up."""
    tried = day.produced + day.failed
    if day.planned_s <= 0.0 or day.running_s <= 0.0 or tried == 0:
        return None
    return Oee(
        availability=max(0.0, 1.0 - day.down_s / day.planned_s),
        performance=ideal_cycle_s * tried / day.running_s,
        quality=day.produced / tried,
    )


def _day(figures: Figures, date: str) -> Day:
    return next((day for day in figures.days if day.date == date), Day(date=date))


def _with(figures: Figures, changed: Day) -> Figures:
    others = [day for day in figures.days if day.date != changed.date]
    days = sorted([*others, changed], key=lambda day: day.date)[-DAYS_KEPT:]
    return replace(figures, days=tuple(days))
