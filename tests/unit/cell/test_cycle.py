"""One pick from acceptance to result, with a scripted arm, hand and cameras."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from cell.faults import PictureUnusable, VisionFailed
from cell.station import Stage
from cell.types import Outcome
from drivers.errors import DeviceTimeout, SafetyStop
from drivers.timing import StopRequested, StopToken
from drivers.types import (
    Grip,
    JointAngles,
    PlcCommand,
    ResultCode,
    SafetyMode,
    ToolPose,
)
from tests.data.make import STICKS
from tests.fakes.station import bench, in_base, order, scene
from tests.unit.cell.scripted import FREE, SECOND, Eyes, joints, lines, ran

# ------------------------------------------------------------------------------ the real detector


def test_a_real_picture_pair_gives_a_grasp_on_a_drawn_stick() -> None:
    cell = bench().open()
    result = ran(cell, order())
    assert (result.code, result.outcome) == (ResultCode.OK, Outcome.PICKED)
    assert result.seen == len(STICKS)
    assert result.pose is not None
    # the grasp lies on a stick, within 2 mm in plan, and the jaws close across it
    across = []
    for x, y, heading, _ in STICKS:
        to = np.array([result.pose.x - x, result.pose.y - y])
        along = to @ [math.cos(heading), math.sin(heading)]
        side = abs(to @ [-math.sin(heading), math.cos(heading)])
        across.append((side, abs(along), heading))
    side, along, heading = min(across)
    assert side < 0.001
    assert along < 0.020
    assert set(result.durations_s) >= {"clear", "look", "find", "plan", "fetch", "place"}
    assert any(name.startswith("find.") for name in result.durations_s)


# ------------------------------------------------------------------------------ pick and place


def test_a_pick_and_place_ends_over_the_drop_place_with_an_open_hand(see: Callable[..., Eyes]) -> None:
    see(scene(FREE))
    cell = bench().open()
    result = ran(cell, order())
    assert (result.code, result.outcome, result.quantity) == (ResultCode.OK, Outcome.PICKED, 1)
    assert joints(cell) == ["watch", "drop"]
    assert cell.gripper.held is Grip.OPEN
    assert cell.gripper.calls == ["release", "grasp", "release"]
    planned = cell.looks[0].plans[0].pick
    assert planned is not None
    assert result.pose == planned.grasp


def test_the_way_down_and_up_is_straight_above_the_grasp(see: Callable[..., Eyes]) -> None:
    see(scene(FREE))
    cell = bench().open()
    ran(cell, order())
    pick = cell.looks[0].plans[0].pick
    assert pick is not None
    assert lines(cell) == [pick.retreat, pick.approach, pick.grasp, pick.retreat]


def test_stages_are_told_in_the_order_of_the_story(see: Callable[..., Eyes]) -> None:
    see(scene(FREE))
    cell = bench().open()
    ran(cell, order())
    assert cell.stages == [Stage.CLEAR, Stage.LOOK, Stage.FIND, Stage.PLAN, Stage.FETCH, Stage.PLACE]


def test_a_pick_keeps_holding_and_stays_above_the_bin(see: Callable[..., Eyes]) -> None:
    see(scene(FREE))
    cell = bench().open()
    result = ran(cell, order(command=PlcCommand.PICK))
    assert (result.code, result.outcome) == (ResultCode.OK, Outcome.PICKED)
    assert cell.gripper.held is Grip.HOLDING
    assert joints(cell) == ["watch"]


def test_the_order_slows_every_motion() -> None:
    cell = bench()
    motion = cell.station.motion
    half = 0.5
    assert cell.station.travel(half).speed_m_s == motion.travel.speed_m_s / 2
    assert cell.station.approach(half).speed_m_s == motion.approach.speed_m_s / 2
    assert cell.station.joint_motion(half).speed_rad_s == motion.joints.speed_rad_s / 2
    assert cell.station.travel(half).timeout_s == motion.travel.timeout_s * 2


def test_a_tool_left_among_the_parts_is_lifted_straight_up_first(see: Callable[..., Eyes]) -> None:
    see(scene(FREE))
    cell = bench().open()
    cell.robot.tool = ToolPose(x=0.05, y=-0.4, z=0.03, rx=3.14159, ry=0.0, rz=0.0)
    ran(cell, order(command=PlcCommand.HOME))
    first, second = cell.robot.targets
    assert first == ToolPose(x=0.05, y=-0.4, z=0.150, rx=3.14159, ry=0.0, rz=0.0)
    assert isinstance(second, JointAngles)


def test_before_a_look_too_the_tool_leaves_the_parts_straight_up(see: Callable[..., Eyes]) -> None:
    see(scene(FREE))
    cell = bench().open()
    cell.robot.tool = ToolPose(x=0.05, y=-0.4, z=0.03, rx=3.14159, ry=0.0, rz=0.0)
    ran(cell, order(command=PlcCommand.VISION_ONLY))
    lifted, watch = cell.robot.targets
    assert lifted == ToolPose(x=0.05, y=-0.4, z=0.150, rx=3.14159, ry=0.0, rz=0.0)
    assert isinstance(watch, JointAngles)


def test_a_part_that_was_missed_is_tried_after_the_others(see: Callable[..., Eyes]) -> None:
    see(scene(FREE, SECOND))
    cell = bench(pictures=2).open()
    cell.gripper.grasps = [Grip.CLOSED_EMPTY, Grip.HOLDING]
    result = ran(cell, order(max_attempts=2))
    assert result.outcome is Outcome.PICKED
    assert [pose.y for pose in lines(cell)[::4]] == pytest.approx([-0.45, -0.38])


# ------------------------------------------------------------------------------ pictures in time


def test_a_late_frame_is_not_used_for_a_pick(see: Callable[..., Eyes]) -> None:
    eyes = see(scene(FREE))
    cell = bench().open()
    cell.left.age_s = 0.05  # exposed while the arm was still moving
    with pytest.raises(DeviceTimeout, match="only an old picture"):
        ran(cell, order())
    assert eyes.looked == 0
    assert cell.gripper.calls == []


def test_pictures_are_asked_for_from_the_instant_the_arm_stopped(see: Callable[..., Eyes]) -> None:
    see(scene(FREE))
    cell = bench().open()
    cell.robot.move_s = 2.5
    began = cell.clock.now()
    ran(cell, order(command=PlcCommand.VISION_ONLY))
    assert [call.newer_than for call in cell.left.calls] == [began + 2.5]
    assert [call.newer_than for call in cell.right.calls] == [began + 2.5]


@pytest.mark.parametrize("flaw", [0, 255])
def test_an_unusable_picture_ends_the_order_before_the_detector(see: Callable[..., Eyes], flaw: int) -> None:
    eyes = see(scene(FREE))
    cell = bench().open()
    cell.right.answers[0] = np.full((360, 480), flaw, dtype=np.uint8)
    with pytest.raises(PictureUnusable, match=r"camera\.right"):
        ran(cell, order())
    assert eyes.looked == 0


@pytest.mark.parametrize(
    "error", [ValueError("shape"), ZeroDivisionError("0"), IndexError("3"), RuntimeError("r")]
)
def test_a_detector_that_raises_is_a_failure_of_vision(see: Callable[..., Eyes], error: Exception) -> None:
    see(error)
    cell = bench().open()
    with pytest.raises(VisionFailed, match=type(error).__name__):
        ran(cell, order())
    assert lines(cell) == []


# ------------------------------------------------------------------------------ misses


def test_a_missed_grip_is_tried_again_with_a_fresh_look(see: Callable[..., Eyes]) -> None:
    eyes = see(scene(FREE))
    cell = bench(pictures=2).open()
    cell.gripper.grasps = [Grip.CLOSED_EMPTY, Grip.HOLDING]
    result = ran(cell, order(max_attempts=3))
    assert (result.code, result.outcome) == (ResultCode.OK, Outcome.PICKED)
    assert eyes.looked == 2
    assert eyes.pictures[0] != eyes.pictures[1]
    assert joints(cell) == ["watch", "watch", "drop"]


@pytest.mark.parametrize("attempts", [1, 2, 3])
def test_misses_end_after_the_ordered_number_of_attempts(see: Callable[..., Eyes], attempts: int) -> None:
    eyes = see(scene(FREE))
    cell = bench(pictures=5).open()
    cell.gripper.grasps = [Grip.CLOSED_EMPTY] * 5
    result = ran(cell, order(max_attempts=attempts))
    assert (result.code, result.outcome) == (ResultCode.GRIP_FAILED, Outcome.MISSED)
    assert result.detail == int(Outcome.MISSED)
    assert eyes.looked == attempts
    assert cell.gripper.held is Grip.OPEN


def test_a_grip_nobody_is_sure_of_is_no_grip(see: Callable[..., Eyes]) -> None:
    see(scene(FREE))
    cell = bench().open()
    cell.gripper.grasps = [Grip.UNKNOWN]
    result = ran(cell, order())
    assert (result.code, result.outcome) == (ResultCode.GRIP_FAILED, Outcome.MISSED)
    assert "drop" not in joints(cell)


def test_a_part_that_slips_on_the_way_up_is_lost(see: Callable[..., Eyes]) -> None:
    see(scene(FREE))
    cell = bench().open()
    cell.clock.at(cell.clock.now() + 0.55, lambda: setattr(cell.gripper, "held", Grip.CLOSED_EMPTY))
    result = ran(cell, order())
    assert (result.code, result.outcome) == (ResultCode.PART_LOST, Outcome.MISSED)
    assert cell.gripper.held is Grip.OPEN
    assert "drop" not in joints(cell)


def test_a_part_that_is_lost_on_the_way_to_the_drop_place_is_not_counted(see: Callable[..., Eyes]) -> None:
    see(scene(FREE))
    cell = bench().open()
    # a tenth of a second for each of six motions, half as much for each of two grips; in the last motion
    cell.clock.at(cell.clock.now() + 0.65, lambda: setattr(cell.gripper, "held", Grip.CLOSED_EMPTY))
    result = ran(cell, order())
    assert joints(cell) == ["watch", "drop"]
    assert (result.code, result.outcome, result.quantity) == (ResultCode.PART_LOST, Outcome.MISSED, 0)


def test_a_part_left_in_the_hand_is_placed_before_the_next_is_looked_for(see: Callable[..., Eyes]) -> None:
    see(scene(FREE))
    cell = bench().open()
    cell.gripper.held = Grip.HOLDING
    result = ran(cell, order())
    assert joints(cell) == ["drop", "watch", "drop"]
    assert cell.gripper.calls == ["release", "release", "grasp", "release"]
    assert result.quantity == 1


# ------------------------------------------------------------------------------ stopping and faults


@pytest.mark.parametrize("after_s", [0.05, 0.15, 0.25, 0.35, 0.42, 0.50, 0.60, 0.70])
def test_a_stop_at_any_moment_leaves_no_motion(see: Callable[..., Eyes], after_s: float) -> None:
    see(scene(FREE))
    cell = bench().open()
    stop = StopToken(cell.clock)
    cell.clock.at(cell.clock.now() + after_s, lambda: stop.stop("abort"))
    with pytest.raises(StopRequested, match="abort"):
        ran(cell, order(), stop)
    moves = [call.what for call in cell.robot.calls]
    assert not cell.robot.state().moving
    if "halt" in moves:  # stopped in a motion, not in a grip
        assert moves.index("halt") == len(moves) - 1


def test_a_stop_before_the_first_motion_moves_nothing(see: Callable[..., Eyes]) -> None:
    see(scene(FREE))
    cell = bench().open()
    stop = StopToken(cell.clock)
    stop.stop("abort")
    with pytest.raises(StopRequested):
        ran(cell, order(), stop)
    assert cell.robot.tool == bench().robot.tool
    assert not cell.gripper.calls


@pytest.mark.parametrize("move", range(6))
def test_a_safety_stop_in_any_motion_ends_the_order_there(see: Callable[..., Eyes], move: int) -> None:
    see(scene(FREE))
    cell = bench().open()
    cell.robot.faults = {move: SafetyStop("robot", SafetyMode.PROTECTIVE_STOP)}
    with pytest.raises(SafetyStop):
        ran(cell, order(max_attempts=3))
    assert cell.robot.moves == move + 1


def test_the_grasp_is_where_the_detector_saw_the_part(see: Callable[..., Eyes]) -> None:
    see(scene(FREE))
    result = ran(bench().open(), order())
    assert result.pose is not None
    np.testing.assert_allclose([result.pose.x, result.pose.y], in_base(FREE.centre)[:2], atol=1e-9)
    assert result.confidence == FREE.score
