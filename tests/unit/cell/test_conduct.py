"""Choices after failed grips, modes, devices that come back, places, looks ahead: the loop over doubles."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from cell import cycle
from cell.choices import Choice
from cell.cycle import run_order
from cell.journal import Journal
from cell.modes import Mode
from cell.operation import (
    GridConfig,
    ModesConfig,
    OperationConfig,
    RecoveryConfig,
    StrategyConfig,
)
from cell.pattern import Places
from cell.standing import Standing
from cell.states import Event, State
from cell.types import CellReport, Outcome
from drivers.errors import DeviceTimeout, DeviceUnavailable
from drivers.timing import StopToken
from drivers.types import Grip, JointAngles, PlcCommand, ResultCode, ToolPose
from tests.fakes.station import Bench, bench, order, scene
from tests.unit.cell.looped import Cell
from tests.unit.cell.scripted import FREE
from vision.types import Scene

CLEAR = (0.5, -1.5, 1.5, -1.5, -1.5, 0.0)
ASKING = OperationConfig(recovery=RecoveryConfig(ask_after_failed_grips=2))


@pytest.fixture(autouse=True)
def one_free_part(monkeypatch: pytest.MonkeyPatch) -> None:
    def locate(*_: object, **__: object) -> Scene:
        return scene(FREE)

    monkeypatch.setattr(cycle, "locate", locate)


def with_operation(made: Bench, operation: OperationConfig) -> Bench:
    made.station = replace(made.station, operation=operation, places=Places(operation.grid))
    return made


def cell_of(journal: Journal, path: Path, operation: OperationConfig) -> Cell:
    return Cell(with_operation(bench(pictures=12), operation), journal, path / "journal.sqlite")


# ------------------------------------------------------------------------------ choices


@pytest.fixture
def asked(journal: Journal, tmp_path: Path) -> Cell:
    """Two orders have brought nothing; at 2.9 s the cell is held."""
    cell = cell_of(journal, tmp_path, ASKING)
    cell.bench.gripper.grasps = [Grip.CLOSED_EMPTY, Grip.CLOSED_EMPTY]
    cell.send(0.2, cell.ticket(request_id=1))
    cell.send(1.5, cell.ticket(request_id=2))
    return cell


def test_after_two_failed_grips_the_cell_is_held_and_asks(asked: Cell) -> None:
    seen: list[CellReport] = []
    asked.at(2.9, lambda: seen.append(asked.reports.get()))
    asked.run(3.0)
    (report,) = seen
    assert report.state == State.HELD
    assert report.choice_awaited
    assert report.operator_needed
    assert not report.accepting
    assert [r.code for r in asked.finished()] == [ResultCode.GRIP_FAILED] * 2


@pytest.mark.parametrize(
    ("chosen", "code", "outcome", "picked"),
    [
        (Choice.RETRY, ResultCode.OK, Outcome.PICKED, 1),
        (Choice.SKIP, ResultCode.OK, Outcome.NONE, 0),
        (Choice.COUNT_AS_PICKED, ResultCode.OK, Outcome.PICKED, 1),
    ],
)
def test_a_choice_ends_under_its_own_number_and_the_cell_is_ready(
    asked: Cell, chosen: Choice, code: ResultCode, outcome: Outcome, picked: int
) -> None:
    moves: list[int] = []
    seen: list[CellReport] = []
    asked.at(2.9, lambda: moves.append(asked.bench.robot.moves))
    asked.send(3.0, asked.ticket(request_id=3, command=PlcCommand.RECOVER, max_attempts=int(chosen)))
    asked.at(4.8, lambda: moves.append(asked.bench.robot.moves))
    asked.at(4.9, lambda: seen.append(asked.reports.get()))
    asked.run(5.0)
    last = asked.finished()[-1]
    assert (last.request_id, last.code, last.outcome) == (3, code, outcome)
    (report,) = seen
    assert (report.state, report.choice_awaited, report.operator_needed) == (State.IDLE, False, False)
    assert report.total_picks == picked
    assert (moves[1] > moves[0]) is (chosen is Choice.RETRY)


def test_the_choice_to_stop_stops(asked: Cell) -> None:
    seen: list[CellReport] = []
    asked.send(3.0, asked.ticket(request_id=3, command=PlcCommand.RECOVER, max_attempts=int(Choice.STOP)))
    asked.at(3.9, lambda: seen.append(asked.reports.get()))
    asked.run(4.0)
    assert seen[0].state == State.STOPPED


def test_a_reset_is_the_choice_to_skip(asked: Cell) -> None:
    seen: list[CellReport] = []
    asked.send(3.0, Event.RESET)
    asked.at(3.5, lambda: seen.append(asked.reports.get()))
    asked.run(3.6)
    assert (seen[0].state, seen[0].choice_awaited) == (State.IDLE, False)
    assert len(asked.finished()) == 2


def test_a_hold_that_ends_does_not_answer_the_question(asked: Cell) -> None:
    seen: list[CellReport] = []
    asked.send(3.0, Event.HOLD, Event.UNHOLD)
    asked.at(3.5, lambda: seen.append(asked.reports.get()))
    asked.run(3.6)
    assert (seen[0].state, seen[0].choice_awaited) == (State.HELD, True)


def test_a_choice_nobody_asked_for_is_a_bad_parameter(journal: Journal, tmp_path: Path) -> None:
    cell = cell_of(journal, tmp_path, ASKING)
    cell.send(0.2, cell.ticket(request_id=1, command=PlcCommand.RECOVER, max_attempts=int(Choice.RETRY)))
    cell.run(1.0)
    assert [r.code for r in cell.finished()] == [ResultCode.BAD_PARAMETER]
    assert cell.bench.robot.targets == []


def test_without_a_policy_failed_grips_are_only_reported(journal: Journal, tmp_path: Path) -> None:
    cell = cell_of(journal, tmp_path, OperationConfig())
    cell.bench.gripper.grasps = [Grip.CLOSED_EMPTY] * 4
    for number in range(1, 5):
        cell.send(0.2 + 1.5 * number, cell.ticket(request_id=number))
    cell.run(9.0)
    assert State.HELD not in cell.states
    assert len(cell.finished()) == 4


# ------------------------------------------------------------------------------ modes


def test_a_mode_is_set_by_an_order_shown_and_kept_across_a_restart(journal: Journal, tmp_path: Path) -> None:
    cell = cell_of(journal, tmp_path, OperationConfig())
    kept = Standing(tmp_path, cell.bench.clock, journal.counted_after, None)
    cell.loop._standing = kept
    cell.loop._conduct._standing = kept
    cell.send(0.2, cell.ticket(request_id=1, command=PlcCommand.SET_MODE, max_attempts=int(Mode.DRY_RUN)))
    cell.send(1.0, cell.ticket(request_id=2))
    cell.run(3.0)
    assert [r.code for r in cell.finished()] == [ResultCode.OK, ResultCode.OK]
    assert cell.reports.get().unit_mode == Mode.DRY_RUN
    assert "grasp" not in cell.bench.gripper.calls
    again = Standing(tmp_path, cell.bench.clock, journal.counted_after, None)
    again.recall()
    assert again.figures.mode is Mode.DRY_RUN


def test_maintenance_is_slow(journal: Journal, tmp_path: Path) -> None:
    slow = OperationConfig(modes=ModesConfig(maintenance_speed_percent=10))
    cell = cell_of(journal, tmp_path, slow)
    cell.send(0.2, cell.ticket(request_id=1, command=PlcCommand.SET_MODE, max_attempts=2))
    cell.send(1.0, cell.ticket(request_id=2))
    asked_for: list[float] = []
    travel = cell.bench.robot.move_joints

    def watched(target: JointAngles, motion: object, stop: StopToken) -> None:
        asked_for.append(motion.speed_rad_s)  # type: ignore[attr-defined]
        travel(target, motion, stop)  # type: ignore[arg-type]

    cell.bench.robot.move_joints = watched  # type: ignore[method-assign]
    cell.run(3.0)
    full = cell.bench.station.motion.joints.speed_rad_s
    assert asked_for
    assert max(asked_for) == pytest.approx(0.1 * full)


def test_a_dry_run_hovers_at_the_configured_height() -> None:
    made = with_operation(bench(), OperationConfig(modes=ModesConfig(hover_height_m=0.03))).open()
    result = run_order(made.station, order(dry_run=True), StopToken(made.clock))
    assert (result.code, result.outcome) == (ResultCode.OK, Outcome.NONE)
    pick = made.looks[0].plans[0].pick
    assert pick is not None
    lines = [t for t in made.robot.targets if isinstance(t, ToolPose)]
    assert lines[1].z == pytest.approx(pick.grasp.z + 0.03)
    assert made.gripper.calls == []


# ------------------------------------------------------------------------------ devices that come back


def test_a_camera_that_comes_back_is_shown_and_the_fault_stays_until_the_reset(
    journal: Journal, tmp_path: Path
) -> None:
    cell = cell_of(journal, tmp_path, OperationConfig(recovery=RecoveryConfig(reconnect_first_s=1.0)))
    eye = cell.bench.left
    eye.open_error = DeviceUnavailable(eye.name, "unplugged")
    cell.at(1.5, lambda: setattr(eye, "open_error", None))
    seen: list[CellReport] = []
    for when in (1.4, 4.8, 6.0):
        cell.at(when, lambda: seen.append(cell.reports.get()))
    cell.send(5.0, Event.RESET)
    cell.run(6.1)
    lost, back, reset = seen
    assert (lost.state, lost.fault_code, lost.vision_ok) == (State.ABORTED, 201, False)
    assert (back.state, back.fault_code, back.vision_ok) == (State.ABORTED, 201, True)
    assert (reset.state, reset.fault_code) == (State.IDLE, 0)
    assert cell.bench.robot.targets == []


# ------------------------------------------------------------------------------ places


def test_parts_go_into_the_pattern_until_it_is_full() -> None:
    grid = GridConfig(columns=2, column_pitch_m=(0.03, 0.0))
    made = with_operation(bench(pictures=4), OperationConfig(grid=grid)).open()
    codes = [run_order(made.station, order(request_id=n), StopToken(made.clock)).code for n in (1, 2, 3)]
    assert codes == [ResultCode.OK, ResultCode.OK, ResultCode.PLACE_BLOCKED]
    places = [
        after
        for before, after in zip(made.robot.targets, made.robot.targets[1:], strict=False)
        if isinstance(before, JointAngles)
        and before.q_rad == made.station.workspace.drop_q_rad
        and isinstance(after, ToolPose)
    ]
    assert len(places) == 1  # the first place is the drop position itself
    made.station.places.free()
    assert run_order(made.station, order(request_id=4), StopToken(made.clock)).code is ResultCode.OK


def test_a_full_pattern_grips_nothing() -> None:
    grid = GridConfig(columns=2, column_pitch_m=(0.03, 0.0))
    made = with_operation(bench(), OperationConfig(grid=grid)).open()
    made.station.places.take()
    made.station.places.take()
    made.gripper.held = Grip.HOLDING
    for command in (PlcCommand.PICK_AND_PLACE, PlcCommand.PLACE, PlcCommand.PICK):
        result = run_order(made.station, order(command=command), StopToken(made.clock))
        assert result.code is ResultCode.PLACE_BLOCKED
    assert made.robot.targets == []
    assert made.gripper.held is Grip.HOLDING


# ------------------------------------------------------------------------------ looks ahead

AHEAD = OperationConfig(
    strategy=StrategyConfig(look_while_placing=True, clear_q_rad=CLEAR, prepared_max_age_s=5.0)
)


def ahead() -> Bench:
    return with_operation(bench(pictures=6), AHEAD).open()


def watches(made: Bench) -> int:
    """How often the arm went out of the way to look."""
    watch = made.station.workspace.watch_q_rad
    return sum(isinstance(t, JointAngles) and t.q_rad == watch for t in made.robot.targets)


def test_the_next_order_uses_the_picture_taken_on_the_way_to_the_place() -> None:
    made = ahead()
    for number in (1, 2, 3):
        assert run_order(made.station, order(request_id=number), StopToken(made.clock)).code is ResultCode.OK
    assert watches(made) == 1
    made.station.prepared.drop()


def test_the_picture_is_exposed_after_the_arm_has_left_the_view() -> None:
    made = ahead()
    at_clear: list[float] = []
    move = made.robot.move_joints

    def watched(target: JointAngles, motion: object, stop: StopToken) -> None:
        move(target, motion, stop)  # type: ignore[arg-type]
        if target.q_rad == CLEAR:
            at_clear.append(made.clock.now())

    made.robot.move_joints = watched  # type: ignore[method-assign]
    run_order(made.station, order(request_id=1), StopToken(made.clock))
    run_order(made.station, order(request_id=2), StopToken(made.clock))
    pair = made.looks[1].pair
    assert pair.left.captured_at > at_clear[0]
    assert pair.right.captured_at > at_clear[0]
    made.station.prepared.drop()


@pytest.mark.parametrize("why", ["too old", "another part", "another source", "lost part", "a homing"])
def test_a_look_ahead_that_may_be_wrong_is_not_used(why: str) -> None:
    made = ahead()
    stop = StopToken(made.clock)
    run_order(made.station, order(request_id=1), stop)
    following = order(request_id=2)
    match why:
        case "too old":
            made.clock.turn(5.1)
        case "another part":
            following = order(request_id=2, part_code=made.station.parts[1].code)
        case "another source":
            following = order(request_id=2, source_id=9)
        case "a homing":
            run_order(made.station, order(request_id=7, command=PlcCommand.HOME), stop)
            made.robot.calls.clear()
        case "lost part":
            release = made.gripper.grip
            grips = iter([Grip.OPEN, Grip.HOLDING, Grip.OPEN])
            made.gripper.grip = lambda: next(grips, Grip.OPEN)  # type: ignore[method-assign]
            assert run_order(made.station, order(request_id=5), stop).code is ResultCode.PART_LOST
            made.gripper.grip = release  # type: ignore[method-assign]
    before = watches(made)
    run_order(made.station, following, stop)
    assert watches(made) == before + 1
    made.station.prepared.drop()


def test_a_camera_that_fails_on_the_way_does_not_fail_the_order_with_the_part_in_the_hand() -> None:
    made = ahead()
    stop = StopToken(made.clock)
    grab = made.left.grab
    calls = iter([False, True, False])

    def sometimes(*, newer_than: float, timeout_s: float) -> object:
        if next(calls):
            raise DeviceTimeout("camera.left", "no frame")
        return grab(newer_than=newer_than, timeout_s=timeout_s)

    made.left.grab = sometimes  # type: ignore[assignment]
    assert run_order(made.station, order(request_id=1), stop).code is ResultCode.OK
    made.left.grab = grab  # type: ignore[method-assign]
    assert run_order(made.station, order(request_id=2), stop).code is ResultCode.OK
    assert watches(made) == 2
    made.station.prepared.drop()
