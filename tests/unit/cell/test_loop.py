"""The cell thread's loop, run in the test's own thread: orders, holds, stops, its end, and what is shown."""

from __future__ import annotations

import pytest

from cell.loop import ABORTED_BY_PLC, LINK_LOST, SERVICE_ENDS
from cell.states import Event, State
from cell.types import CellReport, Outcome, PickResult
from drivers.errors import (
    DeviceUnavailable,
)
from drivers.timing import StopRequested
from drivers.types import JointAngles, PlcCommand, ResultCode, SafetyMode
from tests.fakes.station import order
from tests.unit.cell.looped import Cell

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
