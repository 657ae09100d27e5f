"""Every command but the pick itself: looking alone, dry runs, placing, the gripper, home; what is refused."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from cell.types import Outcome
from drivers.types import (
    Grip,
    PlcCommand,
    ResultCode,
)
from tests.fakes.station import bench, order, scene
from tests.unit.cell.scripted import FREE, REFUSED, SECOND, Eyes, joints, lines, ran


def test_looking_alone_touches_nothing(see: Callable[..., Eyes]) -> None:
    see(scene(FREE, SECOND, REFUSED))
    cell = bench().open()
    result = ran(cell, order(command=PlcCommand.VISION_ONLY))
    assert (result.code, result.outcome) == (ResultCode.OK, Outcome.NONE)
    assert (result.quantity, result.seen) == (2, 3)
    assert joints(cell) == ["watch"]
    assert lines(cell) == []
    assert cell.gripper.calls == []


@pytest.mark.parametrize("command", [PlcCommand.PICK, PlcCommand.PICK_AND_PLACE])
def test_a_dry_run_goes_there_and_never_grips(see: Callable[..., Eyes], command: PlcCommand) -> None:
    see(scene(FREE))
    cell = bench().open()
    result = ran(cell, order(command=command, dry_run=True))
    assert (result.code, result.outcome) == (ResultCode.OK, Outcome.NONE)
    assert cell.gripper.calls == []
    pick = cell.looks[0].plans[0].pick
    assert pick is not None
    assert lines(cell) == [pick.retreat, pick.approach, pick.retreat]


def test_a_dry_run_does_not_close_the_gripper_on_its_own_command_either() -> None:
    cell = bench().open()
    result = ran(cell, order(command=PlcCommand.GRIPPER_CLOSE, dry_run=True))
    assert (result.code, result.detail) == (ResultCode.OK, 0)
    assert cell.gripper.calls == []


def test_a_place_lets_go_over_the_drop_place() -> None:
    cell = bench().open()
    cell.gripper.held = Grip.HOLDING
    result = ran(cell, order(command=PlcCommand.PLACE))
    assert (result.code, result.quantity) == (ResultCode.OK, 1)
    assert result.outcome is not Outcome.PICKED  # the PICK before has been counted
    assert joints(cell) == ["drop"]
    assert cell.gripper.held is Grip.OPEN


@pytest.mark.parametrize("held", [Grip.OPEN, Grip.CLOSED_EMPTY, Grip.UNKNOWN])
def test_a_place_with_nothing_in_the_hand_does_not_move(held: Grip) -> None:
    cell = bench().open()
    cell.gripper.held = held
    result = ran(cell, order(command=PlcCommand.PLACE))
    assert (result.code, result.outcome) == (ResultCode.PART_LOST, Outcome.MISSED)
    assert cell.robot.calls == []


def test_a_place_that_arrives_with_an_empty_hand_says_so() -> None:
    cell = bench().open()
    cell.gripper.held = Grip.HOLDING
    cell.clock.at(cell.clock.now() + 0.05, lambda: setattr(cell.gripper, "held", Grip.OPEN))
    result = ran(cell, order(command=PlcCommand.PLACE))
    assert (result.code, result.outcome, result.quantity) == (ResultCode.PART_LOST, Outcome.MISSED, 0)


@pytest.mark.parametrize(("answer", "detail"), [(Grip.HOLDING, 1), (Grip.CLOSED_EMPTY, 0), (Grip.UNKNOWN, 0)])
def test_closing_the_gripper_says_whether_it_holds(answer: Grip, detail: int) -> None:
    cell = bench().open()
    cell.gripper.grasps = [answer]
    result = ran(cell, order(command=PlcCommand.GRIPPER_CLOSE))
    assert (result.code, result.detail) == (ResultCode.OK, detail)
    assert cell.robot.calls == []


def test_opening_the_gripper_and_a_ping_do_not_move_the_arm() -> None:
    cell = bench().open()
    assert ran(cell, order(command=PlcCommand.GRIPPER_OPEN)).code is ResultCode.OK
    assert ran(cell, order(command=PlcCommand.PING)).code is ResultCode.OK
    assert cell.gripper.calls == ["release"]
    assert cell.robot.calls == []


def test_home_is_the_watch_position() -> None:
    cell = bench().open()
    assert ran(cell, order(command=PlcCommand.HOME)).code is ResultCode.OK
    assert joints(cell) == ["watch"]


@pytest.mark.parametrize("command", [PlcCommand.RETRACT, PlcCommand.LOAD_RECIPE, PlcCommand.RECOVER])
def test_what_is_not_offered_is_refused_without_motion(command: PlcCommand) -> None:
    cell = bench().open()
    assert ran(cell, order(command=command)).code is ResultCode.UNKNOWN_COMMAND
    assert cell.robot.calls == []


def test_an_unknown_part_is_refused_with_its_number_and_without_motion() -> None:
    cell = bench().open()
    result = ran(cell, order(part_code=9))
    assert (result.code, result.detail) == (ResultCode.BAD_PARAMETER, 9)
    assert cell.robot.calls == []


def test_part_zero_is_a_question_where_there_are_two_parts() -> None:
    cell = bench().open()
    assert ran(cell, order(part_code=0)).code is ResultCode.BAD_PARAMETER
