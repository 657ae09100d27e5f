"""The cell thread's loop in trouble: every fault of a device, resets, and faults of our own."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable

import pytest

from cell import cycle
from cell.faults import TABLE, FaultCode
from cell.loop import Ticket, TooManyFaults
from cell.states import Event, State
from cell.types import CellReport, Outcome
from drivers.errors import (
    CommandRejected,
    DeviceTimeout,
    DeviceUnavailable,
    DriverError,
    SafetyStop,
    StaleData,
)
from drivers.types import Grip, ResultCode, SafetyMode
from tests.fakes.inbox import ClockedMailbox
from tests.unit.cell.looped import Cell
from vision.types import Scene

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
