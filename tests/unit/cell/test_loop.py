"""The cell thread's loop, run in the test's own thread: faults, resets, holds, stops and what is shown."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from cell import cycle
from cell.faults import TABLE, FaultCode
from cell.journal import Journal
from cell.loop import ABORTED_BY_PLC, LINK_LOST, SERVICE_ENDS, CellLoop, Channels, Ticket, TooManyFaults
from cell.states import Event, State
from cell.types import CellReport, Outcome, PickResult
from cell.workers import Beat, Latest, Mailbox
from drivers.errors import (
    CommandRejected,
    DeviceTimeout,
    DeviceUnavailable,
    DriverError,
    SafetyStop,
    StaleData,
)
from drivers.timing import StopRequested, StopToken
from drivers.types import Grip, JointAngles, PlcCommand, ResultCode, SafetyMode
from tests.fakes.inbox import ClockedMailbox
from tests.fakes.station import Bench, bench, order, scene, stick
from vision.types import Scene

FREE = stick((-0.04, -0.45, 0.022), (0.04, -0.45, 0.022))


class Reports(Latest[CellReport]):
    """Keeps every report that was published."""

    def __init__(self, cell: Bench) -> None:
        super().__init__(CellReport(), cell.clock)
        self.all: list[CellReport] = []

    def put(self, value: CellReport) -> None:
        self.all.append(value)
        super().put(value)


class Results(Mailbox[PickResult]):
    """Keeps what the journal knew of the last order when each result was handed out."""

    def __init__(self, journal: Journal) -> None:
        super().__init__(8)
        self._journal = journal
        self.known: list[PickResult | None] = []

    def put(self, item: PickResult) -> None:
        self.known.append(self._journal.last()[1])
        super().put(item)


@dataclass(slots=True)
class Cell:
    """A loop over scripted doubles; what is planned happens at its time, then the service ends."""

    bench: Bench
    journal: Journal
    path: Path
    reports: Reports = field(init=False)
    results: Results = field(init=False)
    inbox: ClockedMailbox[Ticket | Event] = field(init=False)
    stop: StopToken = field(init=False)
    loop: CellLoop = field(init=False)
    began: float = field(init=False)

    def __post_init__(self) -> None:
        clock = self.bench.clock
        self.reports = Reports(self.bench)
        self.results = Results(self.journal)
        self.inbox = ClockedMailbox(64, clock)
        self.stop = StopToken(clock)
        self.began = clock.now()
        self.loop = CellLoop(
            replace(self.bench.station, progress=lambda stage: self.loop.progress(stage)),
            self.bench.devices,
            Channels(inbox=self.inbox, results=self.results, report=self.reports),
            self.journal,
            self.stop,
            Beat("cell", 6.0, clock),
        )

    def at(self, when_s: float, action: Callable[[], None]) -> None:
        self.bench.clock.at(self.began + when_s, action)

    def send(self, when_s: float, *items: Event | Ticket) -> None:
        """Put events or orders into the inbox; an order is journaled first, as the PLC thread does."""

        def put() -> None:
            for item in items:
                if isinstance(item, Ticket):
                    self.journal.accept(item.order)
                self.inbox.put(item)

        self.at(when_s, put)

    def ticket(self, **changes: object) -> Ticket:
        return Ticket(order=order(**changes), stop=self.stop.child())

    def run(self, until_s: float) -> None:
        self.at(until_s, lambda: self.stop.stop(SERVICE_ENDS))
        self.loop.run()

    @property
    def states(self) -> list[State]:
        """Published states, repetitions left out."""
        seen: list[State] = []
        for report in self.reports.all:
            if not seen or seen[-1] != report.state:
                seen.append(State(report.state))
        return seen

    def finished(self) -> list[PickResult]:
        taken = []
        while (result := self.results.take(0.0)) is not None:
            taken.append(result)
        return taken

    def rows(self, table: str, columns: str) -> list[tuple[object, ...]]:
        reader = sqlite3.connect(self.path)
        try:
            return reader.execute(f"SELECT {columns} FROM {table} ORDER BY id").fetchall()
        finally:
            reader.close()


@pytest.fixture
def cell(tmp_path: Path) -> Iterator[Cell]:
    path = tmp_path / "journal.sqlite"
    journal = Journal(path)
    journal.open()
    journal.boot()
    yield Cell(bench(pictures=8), journal, path)
    journal.close()


@pytest.fixture(autouse=True)
def one_free_part(monkeypatch: pytest.MonkeyPatch) -> None:
    def locate(*_: object, **__: object) -> Scene:
        return scene(FREE)

    monkeypatch.setattr(cycle, "locate", locate)


# ------------------------------------------------------------------------------ start and end


def test_a_start_opens_every_device_and_is_idle(cell: Cell) -> None:
    cell.at(0.25, lambda: idle.append(cell.reports.get()))
    idle: list[CellReport] = []
    cell.run(0.5)
    assert cell.states[:3] == [State.STOPPED, State.RESETTING, State.IDLE]
    (report,) = idle
    assert report.accepting
    assert report.robot_link
    assert report.vision_ok
    assert (report.busy, report.moving, report.fault_code) == (False, False, 0)


def test_the_end_halts_the_arm_closes_everything_and_accepts_nothing(cell: Cell) -> None:
    cell.run(0.5)
    assert cell.states[-2:] == [State.STOPPING, State.STOPPED]
    assert cell.bench.robot.calls[-1].what == "halt"
    assert (cell.bench.left.closed, cell.bench.robot.closed, cell.bench.gripper.closed) == (1, 1, 1)
    last = cell.reports.get()
    assert (last.accepting, last.busy, last.moving) == (False, False, False)
    assert (last.robot_link, last.vision_ok) == (False, False)


@pytest.mark.parametrize(
    ("device", "code"),
    [("left", 201), ("robot", 401), ("gripper", 501)],
)
def test_a_device_that_cannot_be_opened_is_a_fault_and_a_reset_tries_again(
    cell: Cell, device: str, code: int
) -> None:
    double = getattr(cell.bench, device)
    double.open_error = DeviceUnavailable(double.name, "unplugged")
    seen: list[CellReport] = []
    cell.at(0.25, lambda: seen.append(cell.reports.get()))
    cell.at(0.3, lambda: setattr(double, "open_error", None))
    cell.send(0.35, Event.RESET)
    cell.at(0.55, lambda: seen.append(cell.reports.get()))
    cell.run(0.6)
    assert (seen[0].state, seen[0].fault_code) == (State.ABORTED, code)
    assert not seen[0].accepting
    assert seen[0].operator_needed
    assert (seen[1].state, seen[1].fault_code) == (State.IDLE, 0)
    assert cell.bench.robot.targets == []


def test_what_was_opened_before_the_one_that_failed_is_closed_again(cell: Cell) -> None:
    cell.bench.gripper.open_error = DeviceUnavailable("gripper", "unplugged")
    cell.at(0.2, lambda: closed.append((cell.bench.left.closed, cell.bench.robot.closed)))
    closed: list[tuple[int, int]] = []
    cell.run(0.3)
    assert closed == [(1, 1)]


# ------------------------------------------------------------------------------ orders


def test_an_order_runs_and_its_result_is_journaled_before_it_is_handed_out(cell: Cell) -> None:
    cell.send(0.2, cell.ticket())
    cell.run(2.0)
    (result,) = cell.finished()
    assert (result.request_id, result.code, result.outcome) == (7, ResultCode.OK, Outcome.PICKED)
    assert cell.results.known == [result]
    assert State.EXECUTE in cell.states
    assert cell.reports.get().total_picks == 1


def test_while_an_order_runs_the_plc_sees_busy_and_moving(cell: Cell) -> None:
    cell.send(0.2, cell.ticket(speed_fraction=0.5))
    seen: list[CellReport] = []
    cell.at(0.25, lambda: seen.append(cell.reports.get()))
    cell.at(1.5, lambda: seen.append(cell.reports.get()))
    cell.run(2.0)
    running, after = seen
    assert (running.busy, running.moving, running.accepting) == (True, True, False)
    assert (running.recipe, running.speed_percent) == (1, 50)
    assert (after.busy, after.moving, after.accepting) == (False, False, True)


def test_picks_are_counted_across_restarts(cell: Cell) -> None:
    cell.journal.accept(order(request_id=1))
    cell.journal.finish(PickResult(request_id=1, code=ResultCode.OK, outcome=Outcome.PICKED))
    cell.send(0.2, cell.ticket(request_id=2))
    cell.run(2.0)
    assert cell.reports.all[0].total_picks == 1
    assert cell.reports.get().total_picks == 2


def test_an_order_that_finds_the_cell_no_longer_ready_ends_without_motion(cell: Cell) -> None:
    cell.send(0.2, Event.HOLD, cell.ticket())
    cell.run(0.6)
    (result,) = cell.finished()
    assert (result.code, result.outcome) == (ResultCode.ROBOT_NOT_READY, Outcome.ABORTED)
    assert cell.bench.robot.targets == []
    assert cell.journal.last()[1] == result


@pytest.mark.parametrize(
    ("reason", "code"),
    [
        (LINK_LOST, ResultCode.PLC_LINK_LOST),
        (ABORTED_BY_PLC, ResultCode.ABORTED),
    ],
)
def test_a_running_order_that_is_stopped_halts_the_arm_and_says_why(
    cell: Cell, reason: str, code: ResultCode
) -> None:
    ticket = cell.ticket()
    cell.send(0.2, ticket)
    cell.at(0.25, lambda: ticket.stop.stop(reason))
    cell.run(1.0)
    (result,) = cell.finished()
    assert (result.code, result.outcome) == (code, Outcome.ABORTED)
    assert [call.what for call in cell.bench.robot.calls] == ["move_joints", "halt", "halt"]  # and at the end
    assert not cell.reports.get().moving


def test_an_order_stopped_while_it_waited_never_moves(cell: Cell) -> None:
    first, second = cell.ticket(request_id=1, command=PlcCommand.HOME), cell.ticket(request_id=2)
    cell.send(0.2, first, second)
    cell.at(0.25, lambda: second.stop.stop(LINK_LOST))
    cell.run(1.0)
    codes = {result.request_id: result.code for result in cell.finished()}
    assert codes == {1: ResultCode.OK, 2: ResultCode.PLC_LINK_LOST}
    assert len(cell.bench.robot.targets) == 1


def test_the_end_of_the_service_stops_a_running_order_and_journals_its_result(cell: Cell) -> None:
    cell.send(0.2, cell.ticket())
    cell.run(0.25)
    (result,) = cell.finished()
    assert (result.code, result.outcome) == (ResultCode.ABORTED, Outcome.ABORTED)
    assert cell.journal.last()[1] == result
    assert [call.what for call in cell.bench.robot.calls] == ["move_joints", "halt", "halt"]


# ------------------------------------------------------------------------------ faults and resets

KINDS: list[type[DriverError]] = [DeviceUnavailable, DeviceTimeout, StaleData, CommandRejected]
CODES = {
    "camera": dict(zip(KINDS, (201, 202, 203, 201), strict=True)),
    "robot": dict(zip(KINDS, (401, 402, 403, 421), strict=True)),
    "gripper": dict(zip(KINDS, (501, 501, 502, 501), strict=True)),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("device", CODES)
def test_every_failure_of_a_device_aborts_and_a_reset_leads_back_without_motion(
    cell: Cell, device: str, kind: type[DriverError]
) -> None:
    match device:
        case "camera":
            cell.bench.left.answers.insert(0, kind("camera.left", "broken"))
        case "robot":
            cell.bench.robot.faults = {1: kind("robot", "broken")}
        case _:
            cell.bench.gripper.grasps = [kind("gripper", "broken")]
    code = CODES[device][kind]
    cell.send(0.2, cell.ticket())
    seen: list[tuple[CellReport, int]] = []
    cell.at(1.4, lambda: seen.append((cell.reports.get(), cell.bench.robot.moves)))
    cell.send(1.5, Event.RESET)
    cell.at(1.8, lambda: seen.append((cell.reports.get(), cell.bench.robot.moves)))
    cell.run(2.0)

    (aborted, moves_then), (idle, moves_now) = seen
    assert (aborted.state, aborted.fault_code) == (State.ABORTED, code)
    assert (aborted.accepting, aborted.moving, aborted.operator_needed) == (False, False, True)
    assert (idle.state, idle.fault_code, idle.accepting) == (State.IDLE, 0, True)
    assert moves_now == moves_then
    (result,) = cell.finished()
    assert result.code is TABLE[FaultCode(code)].result
    assert result.outcome is Outcome.ABORTED
    assert cell.rows("faults", "code") == [(code,)]


@pytest.mark.parametrize(
    ("mode", "code", "bit"),
    [
        (SafetyMode.PROTECTIVE_STOP, 411, "protective_stop"),
        (SafetyMode.SAFEGUARD_STOP, 412, "safeguard_stop"),
        (SafetyMode.EMERGENCY_STOP, 413, "emergency_stop"),
    ],
)
def test_a_safety_stop_in_a_motion_shows_its_bit_and_keeps_the_link(
    cell: Cell, mode: SafetyMode, code: int, bit: str
) -> None:
    cell.bench.robot.faults = {2: SafetyStop("robot", mode)}
    cell.send(0.2, cell.ticket())
    seen: list[CellReport] = []
    cell.at(1.0, lambda: seen.append(cell.reports.get()))
    cell.run(1.1)
    (report,) = seen
    assert (report.state, report.fault_code) == (State.ABORTED, code)
    assert getattr(report, bit)
    assert report.robot_link
    assert cell.bench.robot.moves == 3


def test_a_safety_stop_while_idle_is_a_fault_and_only_one(cell: Cell) -> None:
    cell.at(0.3, lambda: setattr(cell.bench.robot, "safety", SafetyMode.EMERGENCY_STOP))
    seen: list[CellReport] = []
    cell.at(1.5, lambda: seen.append(cell.reports.get()))
    cell.run(1.6)
    assert (seen[0].state, seen[0].fault_code, seen[0].fault_count) == (State.ABORTED, 413, 1)
    assert seen[0].emergency_stop


def test_a_program_that_was_ended_at_the_panel_is_a_fault_before_the_next_order(cell: Cell) -> None:
    cell.at(0.3, lambda: setattr(cell.bench.robot, "program", False))
    cell.send(0.8, Event.RESET)
    seen: list[CellReport] = []
    for when_s in (0.7, 1.2):
        cell.at(when_s, lambda: seen.append(cell.reports.get()))
    cell.run(1.3)
    assert [(one.state, one.fault_code) for one in seen] == [(State.ABORTED, 421), (State.IDLE, 0)]
    assert cell.bench.robot.targets == []


def test_a_reset_while_the_cause_is_still_there_ends_aborted_again(cell: Cell) -> None:
    cell.bench.robot.recover = lambda: None  # type: ignore[method-assign]  # a stop software cannot clear
    cell.at(0.3, lambda: setattr(cell.bench.robot, "safety", SafetyMode.EMERGENCY_STOP))
    cell.send(0.6, Event.RESET)
    seen: list[CellReport] = []
    cell.at(1.0, lambda: seen.append(cell.reports.get()))
    cell.run(1.1)
    assert (seen[0].state, seen[0].fault_code, seen[0].fault_count) == (State.ABORTED, 413, 2)
    assert cell.bench.robot.targets == []


def test_an_arm_that_falls_silent_while_idle_is_a_fault(cell: Cell) -> None:
    cell.at(0.3, lambda: setattr(cell.bench.robot, "state_error", StaleData("robot", "its clock stands")))
    seen: list[CellReport] = []
    cell.at(0.8, lambda: seen.append(cell.reports.get()))
    cell.run(0.9)
    assert (seen[0].state, seen[0].fault_code) == (State.ABORTED, 403)
    assert not seen[0].robot_link


def test_the_link_to_the_arm_is_shown_again_before_anybody_resets(cell: Cell) -> None:
    cell.at(0.3, lambda: setattr(cell.bench.robot, "state_error", StaleData("robot", "its clock stands")))
    cell.at(0.6, lambda: setattr(cell.bench.robot, "state_error", None))
    seen: list[CellReport] = []
    cell.at(0.9, lambda: seen.append(cell.reports.get()))
    cell.run(1.0)
    assert (seen[0].state, seen[0].fault_code, seen[0].robot_link) == (State.ABORTED, 403, True)


def test_a_fault_halts_the_arm_even_when_the_journal_cannot_be_written(cell: Cell) -> None:
    cell.bench.robot.faults = {0: DeviceTimeout("robot", "slow")}

    def full(*_: object) -> None:
        raise sqlite3.OperationalError("database or disk is full")

    cell.send(0.2, cell.ticket())
    cell.at(0.19, lambda: setattr(cell.journal, "finish", full))
    with pytest.raises(sqlite3.OperationalError, match="disk is full"):
        cell.run(1.0)
    assert cell.bench.robot.calls[-1].what == "halt"
    assert cell.bench.robot.closed == 1


def test_no_order_begins_between_a_fault_and_the_reset(cell: Cell) -> None:
    cell.bench.gripper.grasps = [StaleData("gripper", "no answer")]
    cell.send(0.2, cell.ticket(request_id=1))
    cell.send(1.0, cell.ticket(request_id=2))
    moves: list[int] = []
    cell.at(0.99, lambda: moves.append(cell.bench.robot.moves))
    cell.run(2.0)
    assert [(r.request_id, r.code) for r in cell.finished()] == [
        (1, ResultCode.GRIP_FAILED),
        (2, ResultCode.ROBOT_NOT_READY),
    ]
    assert moves == [cell.bench.robot.moves]


def test_after_a_reset_the_next_order_runs(cell: Cell) -> None:
    cell.bench.gripper.grasps = [StaleData("gripper", "no answer"), Grip.HOLDING]
    cell.send(0.2, cell.ticket(request_id=1))
    cell.send(1.0, Event.RESET)
    cell.send(1.3, cell.ticket(request_id=2))
    cell.run(3.0)
    assert [r.code for r in cell.finished()] == [ResultCode.GRIP_FAILED, ResultCode.OK]


def test_cameras_opened_anew_may_serve_the_picture_they_served_last(cell: Cell) -> None:
    first = cell.bench.left.answers[0]
    cell.bench.left.answers.insert(1, first)
    cell.bench.gripper.grasps = [StaleData("gripper", "no answer"), Grip.HOLDING]
    cell.send(0.2, cell.ticket(request_id=1))
    cell.send(1.0, Event.RESET)
    cell.send(1.3, cell.ticket(request_id=2))
    cell.run(3.0)
    assert [r.code for r in cell.finished()] == [ResultCode.GRIP_FAILED, ResultCode.OK]


def test_a_reset_that_nobody_needs_changes_nothing(cell: Cell) -> None:
    cell.send(0.3, Event.RESET)
    cell.run(0.6)
    assert cell.states == [State.STOPPED, State.RESETTING, State.IDLE, State.STOPPING, State.STOPPED]
    assert cell.bench.robot.opened == 1


def test_three_internal_faults_in_ten_minutes_end_the_worker(
    cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> Scene:
        raise KeyError("a bug")

    monkeypatch.setattr(cycle, "locate", broken)
    for n in range(3):
        cell.send(1.0 + 2 * n, cell.ticket(request_id=n + 1))
        cell.send(2.0 + 2 * n, Event.RESET)
    with pytest.raises(TooManyFaults):
        cell.run(60.0)
    assert [r.code for r in cell.finished()] == [ResultCode.INTERNAL] * 3
    assert cell.bench.clock.now() - cell.began < 6.0
    assert cell.bench.robot.closed >= 1


def test_three_internal_faults_over_a_day_do_not(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> Scene:
        raise KeyError("a bug")

    monkeypatch.setattr(cycle, "locate", broken)
    monkeypatch.setattr(cell.inbox, "take", _patient(cell))
    for n in range(4):
        cell.send(1.0 + 400 * n, cell.ticket(request_id=n + 1))
        cell.send(2.0 + 400 * n, Event.RESET)
    cell.run(1300.0)
    assert [r.code for r in cell.finished()] == [ResultCode.INTERNAL] * 4


def _patient(cell: Cell) -> Callable[[float], Ticket | Event | None]:
    """`take` with waits of two seconds, because a day in tenths of a second is a long test."""

    def take(_timeout_s: float) -> Ticket | Event | None:
        return ClockedMailbox.take(cell.inbox, 2.0)

    return take


# ------------------------------------------------------------------------------ link, hold, stop


def test_without_the_plc_the_cell_is_suspended_and_comes_back_by_itself(cell: Cell) -> None:
    cell.send(0.2, Event.LINK_LOST)
    cell.send(0.5, Event.LINK_UP)
    cell.run(0.8)
    assert cell.states[2:5] == [State.IDLE, State.SUSPENDED, State.IDLE]


def test_a_link_that_is_lost_during_an_order_suspends_after_it(cell: Cell) -> None:
    cell.send(0.2, cell.ticket())
    cell.send(0.25, Event.LINK_LOST)
    seen: list[CellReport] = []
    cell.at(2.0, lambda: seen.append(cell.reports.get()))
    cell.run(2.1)
    assert seen[0].state == State.SUSPENDED
    assert not seen[0].accepting


def test_a_hold_during_an_order_takes_effect_after_it(cell: Cell) -> None:
    cell.send(0.2, cell.ticket())
    cell.send(0.25, Event.HOLD)
    cell.send(2.0, Event.UNHOLD)
    seen: list[CellReport] = []
    cell.at(1.9, lambda: seen.append(cell.reports.get()))
    cell.at(2.2, lambda: seen.append(cell.reports.get()))
    cell.run(2.3)
    assert [r.code for r in cell.finished()] == [ResultCode.OK]
    assert [r.state for r in seen] == [State.HELD, State.IDLE]


def test_a_hold_given_during_a_fault_holds_after_the_reset(cell: Cell) -> None:
    cell.at(0.2, lambda: setattr(cell.bench.robot, "safety", SafetyMode.PROTECTIVE_STOP))
    cell.send(0.5, Event.HOLD)
    cell.send(0.7, Event.RESET)
    seen: list[CellReport] = []
    cell.at(1.0, lambda: seen.append(cell.reports.get()))
    cell.run(1.1)
    assert seen[0].state == State.HELD


def test_the_end_of_a_hold_without_a_plc_is_suspended_not_idle(cell: Cell) -> None:
    cell.send(0.2, Event.HOLD)
    cell.send(0.3, Event.LINK_LOST)
    cell.send(0.5, Event.UNHOLD)
    seen: list[CellReport] = []
    cell.at(0.8, lambda: seen.append(cell.reports.get()))
    cell.run(0.9)
    assert seen[0].state == State.SUSPENDED


def test_an_abort_stops_until_a_reset(cell: Cell) -> None:
    cell.send(0.2, Event.STOP)
    cell.send(0.6, Event.RESET)
    seen: list[CellReport] = []
    cell.at(0.5, lambda: seen.append(cell.reports.get()))
    cell.at(0.9, lambda: seen.append(cell.reports.get()))
    cell.run(1.0)
    assert [r.state for r in seen] == [State.STOPPED, State.IDLE]
    assert cell.bench.robot.targets == []


def test_at_home_is_where_the_arm_stands_and_not_what_was_ordered(cell: Cell) -> None:
    watch = cell.bench.station.workspace.watch_q_rad
    seen: list[bool] = []
    for when in (0.25, 0.6, 0.9):
        cell.at(when, lambda: seen.append(cell.reports.get().at_home))
    cell.send(0.3, cell.ticket(command=PlcCommand.HOME))
    away = JointAngles(q_rad=(*watch[:5], watch[5] + 0.2))
    cell.at(0.7, lambda: setattr(cell.bench.robot, "joints", away))  # somebody moved it by hand
    cell.run(1.0)
    assert seen == [False, True, False]


def test_a_part_in_the_hand_is_shown(cell: Cell) -> None:
    cell.send(0.2, cell.ticket(command=PlcCommand.PICK))
    cell.run(2.0)
    assert cell.reports.get().part_in_gripper


def test_states_are_journaled_with_their_events(cell: Cell) -> None:
    cell.run(0.3)
    assert cell.rows("states", "state, event") == [
        ("RESETTING", "RESET"),
        ("IDLE", "READY"),
        ("STOPPING", "STOP"),
        ("STOPPED", "HALTED"),
    ]


def test_a_stop_before_the_devices_are_open_ends_at_once(cell: Cell) -> None:
    cell.stop.stop(SERVICE_ENDS)
    with pytest.raises(StopRequested):
        cell.loop.run()
    assert cell.bench.robot.opened == 0
