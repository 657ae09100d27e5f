"""How orders are carried out in the present mode, what a person is asked after failed grips, and the alarms
that follow from what orders came to. Part of the cell thread."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final, Protocol

from cell.alarm_table import AlarmCode, Condition
from cell.choices import Asking, Choice
from cell.cycle import run_order
from cell.logs import logger
from cell.modes import Mode, as_run
from cell.results import plain
from cell.standing import Standing
from cell.states import Event
from cell.station import Station
from cell.types import CellReport, Outcome, PickOrder, PickResult
from drivers.timing import StopToken
from drivers.types import PlcCommand, ResultCode

log = logger("cell")

_FAILING: Final = 3
"""Orders in a row without a part that make the gripper worth a look."""
_LOOKS: Final = (PlcCommand.PICK, PlcCommand.PICK_AND_PLACE, PlcCommand.VISION_ONLY)


class Publish(Protocol):
    """Changes fields of the report the PLC thread reads."""

    def __call__(self, **changes: object) -> None: ...


class Conduct:
    """Mode, questions and alarms of one cell.

    Parameters
    ----------
    station, standing
        What orders are carried out with; where figures and alarms are kept, if anywhere.
    enter, publish
        Of the loop: take an event of the state table (True when it was taken), change the report.
    """

    def __init__(
        self,
        station: Station,
        standing: Standing | None,
        enter: Callable[[Event], bool],
        publish: Publish,
    ) -> None:
        self._station = station
        self._standing = standing
        self._enter = enter
        self._publish = publish
        self._mode = Mode.PRODUCTION
        self._asking = Asking(station.operation.recovery.ask_after_failed_grips)

    @property
    def asks(self) -> bool:
        """True while a person is to choose."""
        return self._asking.order is not None

    # ------------------------------------------------------------------ orders

    def carry_out(self, order: PickOrder, asked: PickOrder | None, stop: StopToken) -> PickResult:
        """What concerns the state of the cell is done here, everything else by the cycle."""
        match order.command:
            case PlcCommand.SET_MODE:
                self.set_mode(Mode(order.max_attempts))
                return plain(order, ResultCode.OK)
            case PlcCommand.RECOVER:
                return self._chosen(order, asked, stop)
            case _:
                return run_order(self._station, self._in_mode(order), stop)

    def _in_mode(self, order: PickOrder) -> PickOrder:
        return as_run(order, self._mode, self._station.operation.modes)

    def _chosen(self, order: PickOrder, asked: PickOrder | None, stop: StopToken) -> PickResult:
        """Command 10: the answer to what was asked, under a sequence number of its own."""
        choice = Choice(order.max_attempts)
        log.info("choice_made", choice=choice.name, about=None if asked is None else asked.request_id)
        if choice is Choice.FREE_PLACES:
            self._station.places.free()
            self.alarm(Condition.PLACES_FULL, None)
            return plain(order, ResultCode.OK)
        if asked is None:
            return plain(order, ResultCode.BAD_PARAMETER, detail=int(choice))
        match choice:
            case Choice.RETRY:
                again = replace(
                    asked, request_id=order.request_id, speed_fraction=order.speed_fraction, max_attempts=1
                )
                return run_order(self._station, self._in_mode(again), stop)
            case Choice.COUNT_AS_PICKED:
                return plain(order, ResultCode.OK, outcome=Outcome.PICKED, quantity=1)
            case Choice.SKIP | Choice.STOP:
                return plain(order, ResultCode.OK)

    def ended(self, order: PickOrder, result: PickResult) -> None:
        """An order has ended without a fault: the alarms that follow, and perhaps a question."""
        asks = self._asking.ended(order, result)
        failed = f"{self._asking.in_a_row} orders in a row" if self._asking.in_a_row >= _FAILING else None
        self.alarm(Condition.GRIPS_FAIL, failed)
        if order.command in _LOOKS:
            empty = f"part {result.part_type}" if result.outcome is Outcome.BIN_EMPTY else None
            self.alarm(Condition.BIN_EMPTY, empty)
            none = f"{result.seen} seen" if result.outcome is Outcome.NOTHING_GRASPABLE else None
            self.alarm(Condition.NOTHING_GRASPABLE, none)
        if not self._station.places.any_free:
            self.alarm(Condition.PLACES_FULL, "none is free")
        if asks and self._enter(Event.ASK):
            detail = f"{result.code.name} in order {order.request_id}"
            log.warning("choice_awaited", request_id=order.request_id, code_name=result.code.name)
            self.alarm(Condition.CHOICE_AWAITED, detail)
            if self._standing is not None:
                self._standing.held(Condition.CHOICE_AWAITED, detail)
            self._publish(choice_awaited=True, operator_needed=True)

    def answered(self) -> PickOrder | None:
        """Nothing is asked any more; the order it was about. Idle again, where the cell was held for it."""
        asked = self._asking.answered()
        if asked is not None:
            self.alarm(Condition.CHOICE_AWAITED, None)
            self._publish(choice_awaited=False, operator_needed=False)
            self._enter(Event.UNHOLD)
        return asked

    # ------------------------------------------------------------------ mode and alarms

    def set_mode(self, mode: Mode) -> None:
        """From now on; kept across a restart."""
        self._mode = mode
        log.info("mode_set", mode=mode.name)
        if self._standing is not None:
            self._standing.mode(mode)
        self._publish(unit_mode=int(mode))

    def alarm(self, code: AlarmCode, detail: str | None) -> None:
        """What an alarm is about is there, with a detail, or not (None)."""
        if self._standing is not None:
            self._standing.condition(code, detail)

    def tick(self, report: CellReport) -> None:
        """What is due of figures and alarms, and what the PLC hears of it."""
        if self._standing is None:
            return
        self._standing.tick()
        seen = self._standing.seen()
        if (seen.first, seen.unacknowledged) != (report.first_alarm, report.alarm_count):
            self._publish(first_alarm=seen.first, alarm_count=seen.unacknowledged)
