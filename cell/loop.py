"""The cell thread: state, idle health checks, orders and events. The only owner of arm, gripper and rig."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from cell.cycle import run_order
from cell.faults import TABLE, Fault, FaultCode, fault_of, safety_fault
from cell.journal import Journal
from cell.logs import logger
from cell.states import Event, EventRefused, State, next_state
from cell.station import Stage, Station
from cell.types import CellReport, Outcome, PickOrder, PickResult
from cell.workers import Beat, Latest, Mailbox
from drivers.errors import DriverError
from drivers.interfaces import Device
from drivers.timing import StopRequested, StopToken
from drivers.types import Grip, ResultCode, RobotState, SafetyMode, Six

log = logger("cell")

ABORTED_BY_PLC: Final = "abort by the PLC"
LINK_LOST: Final = "PLC link lost"
SERVICE_ENDS: Final = "service ends"

_IDLE_S: Final = 0.1
_INTERNAL_LIMIT: Final = 3
_INTERNAL_WINDOW_S: Final = 600.0
_AT_HOME_RAD: Final = 0.01
_AT_REST: Final = (State.ABORTED, State.STOPPED)
_ARM_SILENT: Final = (FaultCode.ROBOT_LOST, FaultCode.ROBOT_SLOW, FaultCode.ROBOT_STALE)


class TooManyFaults(Exception):
    """Internal faults came so often that the process had better start anew."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ticket:
    """An accepted order with the token that stops it, which its sender keeps."""

    order: PickOrder
    stop: StopToken


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Channels:
    """What the cell thread shares with the PLC thread.

    ``inbox`` orders and events in; ``results`` results out; ``report`` what it says of itself.
    """

    inbox: Mailbox[Ticket | Event]
    results: Mailbox[PickResult]
    report: Latest[CellReport]


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
        # levels, because an edge may come while the state cannot follow it
        self._link_up = True
        self._hold = False

    # ------------------------------------------------------------------ the thread

    def run(self) -> None:
        """Until the token fires; then the arm is halted and devices are closed."""
        self._faults = self._journal.fault_count()
        self._publish(total_picks=self._journal.total_picked(), fault_count=self._faults)
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
        self._journal.state(after, event.name)
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
        try:
            self._enter(Event.STOP)
        finally:
            self._close_devices()
        self._enter(Event.HALTED)
        self._publish(moving=False, robot_link=False, vision_ok=False)

    def _halt(self) -> None:
        try:
            self._station.robot.halt()
        except DriverError as error:
            log.warning("halt_failed", detail=str(error))

    # ------------------------------------------------------------------ idle

    def _watch(self) -> None:
        """Health check between orders. After a fault the PLC still sees what the arm says of itself."""
        try:
            self._refresh()
        except DriverError as error:
            if self._state in _AT_REST:
                self._publish(robot_link=False)
            else:
                self._fault(fault_of(error))

    def _refresh(self) -> None:
        state = self._station.robot.state()
        self._publish(**_robot_fields(state), at_home=_at(state, self._station.workspace.watch_q_rad))
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
            case Event.LINK_LOST | Event.LINK_UP:
                self._link_up = event is Event.LINK_UP
            case Event.HOLD | Event.UNHOLD:
                self._hold = event is Event.HOLD
            case _:
                pass
        if not self._enter(event):
            return
        if event is Event.STOP:
            self._enter(Event.HALTED)
        elif event is Event.UNHOLD:
            self._follow_levels()

    def _reset(self) -> None:
        """A person says the cause is gone: recover, reopen, and be idle. Nothing moves."""
        match self._state:
            case State.ABORTED:
                self._enter(Event.RESET)
                try:
                    self._station.robot.recover()
                except DriverError as error:
                    log.warning("recover_failed", detail=str(error))
                self._close_devices()
                self._enter(Event.CLEARED)
                self._publish(fault_code=0, operator_needed=False)
                self._start()
            case State.STOPPED:
                self._close_devices()
                self._start()
            case _:
                log.debug("event_refused", cell_state=self._state.name, cell_event="RESET")

    # ------------------------------------------------------------------ orders

    def _run(self, order: PickOrder, stop: StopToken) -> None:
        if not self._enter(Event.ORDER):
            # accepted in the instant in which the cell stopped being ready
            self._finish(_ended(order, ResultCode.ROBOT_NOT_READY))
            return
        log.info(
            "order_started", request_id=order.request_id, command=order.command.name, part=order.part_code
        )
        self._enter(Event.STARTED)
        self._publish(recipe=order.part_code, speed_percent=round(order.speed_fraction * 100), at_home=False)
        try:
            stop.check()  # stopped while it waited
            result, fault = run_order(self._station, order, stop), None
        except StopRequested as request:
            result, fault = _ended(order, _code_of(request.reason)), None
        except Exception as error:
            fault = fault_of(error)
            result = _ended(order, TABLE[fault.code].result)
            if fault.code in (FaultCode.INTERNAL, FaultCode.VISION_INTERNAL):
                log.error("order_failed", request_id=order.request_id, exc_info=error)
        self._publish(moving=False)
        self._finish(result)
        if fault is not None:
            self._fault(fault)
            return
        self._enter(Event.DONE)
        self._enter(Event.REPORTED)
        self._watch()

    def _finish(self, result: PickResult) -> None:
        """Durable first, then out."""
        self._journal.finish(result)
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
        self._faults += 1
        self._journal.fault(fault)
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


_UR_SAFETY: Final[dict[SafetyMode, int]] = {
    SafetyMode.UNKNOWN: 0,
    SafetyMode.NORMAL: 1,
    SafetyMode.REDUCED: 2,
    SafetyMode.PROTECTIVE_STOP: 3,
    SafetyMode.SAFEGUARD_STOP: 5,
    SafetyMode.EMERGENCY_STOP: 7,
}
"""The arm maker's numbers, which PLC programs for this arm already know."""


def _robot_fields(state: RobotState) -> dict[str, object]:
    """What the report takes from the arm's state."""
    return {
        "robot_link": True,
        "program_running": state.program_running,
        "remote_control": state.powered,  # the arm takes our commands
        "emergency_stop": state.safety is SafetyMode.EMERGENCY_STOP,
        "protective_stop": state.safety is SafetyMode.PROTECTIVE_STOP,
        "safeguard_stop": state.safety is SafetyMode.SAFEGUARD_STOP,
        "safety_mode": _UR_SAFETY[state.safety],
    }


def _at(state: RobotState, q_rad: Six) -> bool:
    """True when the arm stands still at these joint angles."""
    near = all(abs(q - wanted) < _AT_HOME_RAD for q, wanted in zip(state.joints.q_rad, q_rad, strict=True))
    return near and not state.moving


def _code_of(reason: str) -> ResultCode:
    """What the PLC is told when a token fired."""
    return ResultCode.PLC_LINK_LOST if reason == LINK_LOST else ResultCode.ABORTED


def _ended(order: PickOrder, code: ResultCode) -> PickResult:
    """An order that did not run to its end."""
    return PickResult(
        request_id=order.request_id, code=code, outcome=Outcome.ABORTED, detail=int(Outcome.ABORTED)
    )
