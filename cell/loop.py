"""The cell thread: state, idle health checks, orders and events. The only owner of arm, gripper and rig."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

from cell.arm_report import at, robot_fields
from cell.channels import ABORTED_BY_PLC, LINK_LOST, SERVICE_ENDS, Channels, Ticket
from cell.choices import Choice
from cell.conduct import Conduct
from cell.errors import JournalError
from cell.faults import TABLE, Fault, FaultCode, fault_of, safety_fault
from cell.journal import Journal
from cell.logs import logger
from cell.reconnect import Reconnect
from cell.standing import Standing
from cell.states import Event, EventRefused, State, next_state
from cell.station import Stage, Station
from cell.types import CellReport, Outcome, PickOrder, PickResult
from cell.workers import Beat
from drivers.errors import DriverError
from drivers.interfaces import Device
from drivers.timing import StopRequested, StopToken
from drivers.types import Grip, PlcCommand, ResultCode

log = logger("cell")

__all__ = ["ABORTED_BY_PLC", "LINK_LOST", "SERVICE_ENDS", "CellLoop", "Channels", "Ticket", "TooManyFaults"]

_IDLE_S: Final = 0.1
_INTERNAL_LIMIT: Final = 3
_INTERNAL_WINDOW_S: Final = 600.0
_AT_REST: Final = (State.ABORTED, State.STOPPED)
_ARM_SILENT: Final = (FaultCode.ROBOT_LOST, FaultCode.ROBOT_SLOW, FaultCode.ROBOT_STALE)


class TooManyFaults(Exception):
    """Internal faults came so often that the process had better start anew."""


class CellLoop:
    """The story's frame: waits for orders, runs them, turns exceptions into faults."""

    def __init__(
        self,
        station: Station,
        devices: tuple[Device, ...],
        channels: Channels,
        journal: Journal,
        stop: StopToken,
        beat: Beat,
        standing: Standing | None = None,
    ) -> None:
        self._station = station
        self._devices = devices
        self._channels = channels
        self._journal = journal
        self._stop = stop
        self._beat = beat
        self._state = State.STOPPED
        self._report = CellReport()
        self._internal_at: list[float] = []
        self._faults = 0
        self._unwritten: PickResult | None = None
        self._standing = standing
        self._conduct = Conduct(station, standing, self._enter, self._publish)
        self._reconnect = Reconnect(station.operation.recovery, station.clock)
        # levels, because an edge may come while the state cannot follow it
        self._link_up = True
        self._hold = False

    # ------------------------------------------------------------------ the thread

    def run(self) -> None:
        """Until the token fires; then the arm is halted and devices are closed."""
        self._faults = self._journal.fault_count()
        self._publish(total_picks=self._journal.total_picked(), fault_count=self._faults)
        if self._standing is not None:
            self._standing.recall()
            self._conduct.set_mode(self._standing.figures.mode)
        try:
            self._start()
            while not self._stop.stopped:
                self._beat()
                item = self._channels.inbox.take(_IDLE_S)
                match item:
                    case Ticket():
                        self._run(item.order, item.stop)
                    case Event():
                        self._happened(item)
                    case None:
                        self._watch()
                self._conduct.tick(self._report)
        finally:
            self._end()

    def progress(self, stage: Stage) -> None:
        """A cycle entered a stage."""
        log.info("stage_begun", stage=stage.value)
        self._publish(moving=stage.moving)

    # ------------------------------------------------------------------ states

    def _enter(self, event: Event) -> bool:
        try:
            after = next_state(self._state, event)
        except EventRefused:
            log.debug("event_refused", cell_state=self._state.name, cell_event=event.name)
            return False
        log.info("state_changed", before=self._state.name, after=after.name, cell_event=event.name)
        self._state = after
        if self._standing is not None:
            self._standing.entered(after)
        self._note(lambda: self._journal.state(after, event.name))
        self._publish()
        return True

    def _publish(self, **changes: object) -> None:
        busy = self._state in (State.STARTING, State.EXECUTE, State.COMPLETE)
        self._report = replace(
            self._report, state=int(self._state), accepting=self._state is State.IDLE, busy=busy
        )
        if changes:
            self._report = replace(self._report, **changes)  # type: ignore[arg-type]  # names of its fields
        self._channels.report.put(self._report)

    def _start(self) -> None:
        """Open the devices; what cannot be opened is a fault, and a reset tries again."""
        if not self._enter(Event.RESET):
            return
        try:
            self._open_devices()
            self._refresh()
        except DriverError as error:
            self._close_devices()
            self._fault(fault_of(error))
            return
        if self._enter(Event.READY):
            self._follow_levels()

    def _follow_levels(self) -> None:
        if self._hold:
            self._enter(Event.HOLD)
        elif not self._link_up:
            self._enter(Event.LINK_LOST)

    def _open_devices(self) -> None:
        self._station.pictures.forget()
        for device in self._devices:
            self._stop.check()
            device.open()
            log.info("device_opened", device=device.name)

    def _close_devices(self) -> None:
        for device in reversed(self._devices):
            device.close()

    def _end(self) -> None:
        self._halt()
        self._station.prepared.drop()
        self._write_again()
        try:
            self._enter(Event.STOP)
        finally:
            self._close_devices()
        self._enter(Event.HALTED)
        self._publish(moving=False, robot_link=False, vision_ok=False)
        if self._standing is not None:
            self._standing.write()

    def _halt(self) -> None:
        try:
            self._station.robot.halt()
        except DriverError as error:
            log.warning("halt_failed", detail=str(error))

    # ------------------------------------------------------------------ idle

    def _watch(self) -> None:
        """Health check between orders. After a fault the PLC still sees what the arm says of itself."""
        self._write_again()
        if self._state is State.ABORTED and self._reconnect.attempt(self._devices, self._refresh):
            self._publish(vision_ok=True)
        try:
            self._refresh()
        except DriverError as error:
            if self._state in _AT_REST:
                self._publish(robot_link=False)
            else:
                self._fault(fault_of(error))

    def _refresh(self) -> None:
        state = self._station.robot.state()
        self._publish(**robot_fields(state), at_home=at(state, self._station.workspace.watch_q_rad))
        if self._state in _AT_REST:
            return
        unsafe = safety_fault(state.safety, f"{self._station.robot.name}: {state.safety.value}")
        if unsafe is not None:
            self._fault(unsafe)
            return
        if not state.program_running:
            detail = f"{self._station.robot.name}: its program was ended, at the panel or by its controller"
            self._fault(Fault(code=FaultCode.MOVE_REJECTED, detail=detail))
            return
        self._station.rig.check()
        self._publish(vision_ok=True, part_in_gripper=self._station.gripper.grip() is Grip.HOLDING)

    def _happened(self, event: Event) -> None:
        match event:
            case Event.RESET:
                self._reset()
                return
            case Event.JOURNAL_LOST:
                if self._state not in _AT_REST:
                    detail = "an order could not be journaled; it was refused and nothing moved"
                    self._fault(Fault(code=FaultCode.JOURNAL_UNWRITABLE, detail=detail))
                return
            case Event.LINK_LOST | Event.LINK_UP:
                self._link_up = event is Event.LINK_UP
                lost = None if self._link_up else "not heard"
                self._conduct.alarm(FaultCode.PLC_SILENT, lost)
            case Event.HOLD | Event.UNHOLD:
                self._hold = event is Event.HOLD
            case _:
                pass
        if self._conduct.asks and event is Event.UNHOLD:
            return  # held for another reason
        if not self._enter(event):
            return
        if event is Event.STOP:
            self._enter(Event.HALTED)
            self._conduct.answered()
        elif event is Event.UNHOLD:
            self._follow_levels()

    def _reset(self) -> None:
        """A person says the cause is gone: recover, reopen, and be idle. Nothing moves."""
        self._write_again()
        if self._unwritten is not None:
            log.warning("reset_refused", reason="the last result is not on disk yet")
            return
        if self._standing is not None:
            self._standing.acknowledge()
        match self._state:
            case State.HELD if self._conduct.asks:
                self._conduct.answered()
                self._follow_levels()
            case State.ABORTED:
                self._reconnect.over()
                self._conduct.answered()
                self._enter(Event.RESET)
                try:
                    self._station.robot.recover()
                except DriverError as error:
                    log.warning("recover_failed", detail=str(error))
                self._close_devices()
                self._enter(Event.CLEARED)
                self._conduct.alarm(FaultCode(self._report.fault_code), None)
                self._publish(fault_code=0, operator_needed=False)
                self._start()
            case State.STOPPED:
                self._close_devices()
                self._start()
            case _:
                log.debug("event_refused", cell_state=self._state.name, cell_event="RESET")

    # ------------------------------------------------------------------ orders

    def _run(self, order: PickOrder, stop: StopToken) -> None:
        asked = self._conduct.answered() if order.command is PlcCommand.RECOVER else None
        if not self._enter(Event.ORDER):
            # accepted in the instant in which the cell stopped being ready
            unwritten = self._finish(_ended(order, ResultCode.ROBOT_NOT_READY))
            if unwritten is not None and self._state not in _AT_REST:
                self._fault(unwritten)
            return
        log.info(
            "order_started", request_id=order.request_id, command=order.command.name, part=order.part_code
        )
        self._enter(Event.STARTED)
        self._publish(recipe=order.part_code, speed_percent=round(order.speed_fraction * 100), at_home=False)
        try:
            stop.check()  # stopped while it waited
            result, fault = self._conduct.carry_out(order, asked, stop), None
        except StopRequested as request:
            result, fault = _ended(order, _code_of(request.reason)), None
        except Exception as error:
            fault = fault_of(error)
            result = _ended(order, TABLE[fault.code].result)
            if fault.code in (FaultCode.INTERNAL, FaultCode.VISION_INTERNAL):
                log.error("order_failed", request_id=order.request_id, exc_info=error)
        self._publish(moving=False)
        unwritten = self._finish(result)
        fault = fault or unwritten
        if fault is not None:
            self._fault(fault)
            return
        self._enter(Event.DONE)
        self._enter(Event.REPORTED)
        if order.command is PlcCommand.RECOVER and order.max_attempts == Choice.STOP:
            self._happened(Event.STOP)
        else:
            self._conduct.ended(asked or order, result)
            self._follow_levels()
        self._watch()

    def _finish(self, result: PickResult) -> Fault | None:
        """Durable first, then out. A result that cannot be written is kept, and out as soon as it can be."""
        try:
            self._journal.finish(result)
        except JournalError as error:
            self._unwritten = result
            return fault_of(error)
        self._out(result)
        return None

    def _write_again(self) -> None:
        """A result that could not be written: until it is, the PLC's order stays open."""
        if self._unwritten is None:
            return
        try:
            self._journal.finish(self._unwritten)
        except JournalError:
            return
        result, self._unwritten = self._unwritten, None
        self._out(result)

    def _note(self, write: Callable[[], None]) -> None:
        """A row that is kept for people: losing it stops nothing."""
        try:
            write()
        except JournalError as error:
            log.warning("row_not_journaled", detail=str(error))

    def _out(self, result: PickResult) -> None:
        """Publish a durable result."""
        self._channels.results.put(result)
        log.info(
            "pick_finished",
            request_id=result.request_id,
            outcome=result.outcome.name,
            code=int(result.code),
            code_name=result.code.name,
            seen=result.seen,
            refused=result.refused,
            took_s=result.took_s,
            durations_s=result.durations_s,
        )
        if result.outcome is Outcome.PICKED:
            self._publish(total_picks=self._report.total_picks + 1)

    # ------------------------------------------------------------------ faults

    def _fault(self, fault: Fault) -> None:
        self._halt()  # first: nothing before it may fail
        row = TABLE[fault.code]
        log.error(
            "fault_raised", code=int(fault.code), name=fault.code.name, detail=fault.detail, action=row.action
        )
        self._enter(Event.FAULT)
        self._station.prepared.drop()
        self._reconnect.began(fault.code)
        self._conduct.alarm(fault.code, fault.detail)
        if self._standing is not None:
            self._standing.stopped(fault)
        self._faults += 1
        self._note(lambda: self._journal.fault(fault))
        self._publish(
            moving=False,
            fault_code=int(fault.code),
            fault_count=self._faults,
            operator_needed=True,
            vision_ok=self._report.vision_ok and fault.code // 100 not in (2, 3),
            robot_link=self._report.robot_link and fault.code not in _ARM_SILENT,
        )
        self._enter(Event.HALTED)
        if fault.code in (FaultCode.INTERNAL, FaultCode.VISION_INTERNAL):
            self._count_internal()

    def _count_internal(self) -> None:
        now = self._station.clock.now()
        self._internal_at = [at for at in self._internal_at if now - at < _INTERNAL_WINDOW_S] + [now]
        if len(self._internal_at) >= _INTERNAL_LIMIT:
            raise TooManyFaults(f"{_INTERNAL_LIMIT} internal faults in ten minutes; starting anew")


def _code_of(reason: str) -> ResultCode:
    """What the PLC is told when a token fired."""
    return ResultCode.PLC_LINK_LOST if reason == LINK_LOST else ResultCode.ABORTED


def _ended(order: PickOrder, code: ResultCode) -> PickResult:
    """An order that did not run to its end."""
    return PickResult(
        request_id=order.request_id, code=code, outcome=Outcome.ABORTED, detail=int(Outcome.ABORTED)
    )
