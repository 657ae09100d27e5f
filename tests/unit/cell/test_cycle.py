"""One order from acceptance to result, with a scripted arm, hand and cameras."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from cell import cycle, frames
from cell.cycle import run_order
from cell.faults import PictureUnusable, VisionFailed
from cell.station import Stage
from cell.types import Outcome, Pick, PickOrder, PickResult
from drivers.errors import DeviceTimeout, SafetyStop
from drivers.timing import StopRequested, StopToken
from drivers.types import (
    Grip,
    JointAngles,
    NotReachable,
    PlcCommand,
    ReachLimit,
    ResultCode,
    SafetyMode,
    ToolPose,
)
from tests.data.make import STICKS
from tests.fakes.station import Bench, Point, bench, in_base, order, scene, stick
from vision import transforms
from vision.types import Candidate, Refusal, Refused, Scene

FREE = stick((-0.04, -0.45, 0.022), (0.04, -0.45, 0.022))
SECOND = stick((-0.04, -0.38, 0.022), (0.04, -0.38, 0.022))
TOO_SHORT = Refused(reason=Refusal.LENGTH, value=0.03, limit=0.004, unit="m")
REFUSED = stick((-0.04, -0.52, 0.022), (0.0, -0.52, 0.022), refusals=(TOO_SHORT,))


@dataclass(slots=True)
class Eyes:
    """Stands in for the detector: gives the written scenes in order, the last one for ever."""

    scenes: list[Scene | Exception]
    looked: int = 0
    pictures: list[bytes] = field(default_factory=list)

    def __call__(
        self, left: np.ndarray[tuple[int, int], np.dtype[np.uint8]], *_: object, **__: object
    ) -> Scene:
        self.looked += 1
        self.pictures.append(left.tobytes())
        answer = self.scenes[min(self.looked, len(self.scenes)) - 1]
        if isinstance(answer, Exception):
            raise answer
        return answer


@pytest.fixture
def see(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Eyes]:
    def use(*scenes: Scene | Exception) -> Eyes:
        eyes = Eyes(list(scenes))
        monkeypatch.setattr(cycle, "locate", eyes)
        return eyes

    return use


def ran(cell: Bench, wanted: PickOrder, stop: StopToken | None = None) -> PickResult:
    return run_order(cell.station, wanted, stop or StopToken(cell.clock))


def joints(cell: Bench) -> list[str]:
    """The named joint positions the arm was sent to."""
    names = {cell.station.workspace.watch_q_rad: "watch", cell.station.workspace.drop_q_rad: "drop"}
    return [names[t.q_rad] for t in cell.robot.targets if isinstance(t, JointAngles)]


def lines(cell: Bench) -> list[ToolPose]:
    return [t for t in cell.robot.targets if isinstance(t, ToolPose)]


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


# ------------------------------------------------------------------------------ nothing to pick


def test_an_empty_bin_is_an_outcome_of_its_own(see: Callable[..., Eyes]) -> None:
    see(scene())
    result = ran(bench().open(), order())
    assert (result.code, result.outcome) == (ResultCode.NO_PART_FOUND, Outcome.BIN_EMPTY)
    assert result.detail == int(Outcome.BIN_EMPTY)


def test_parts_that_do_not_fit_are_not_an_empty_bin(see: Callable[..., Eyes]) -> None:
    see(scene(REFUSED))
    result = ran(bench().open(), order())
    assert (result.code, result.outcome) == (ResultCode.NO_PART_FOUND, Outcome.NOTHING_GRASPABLE)
    assert result.refused == {"LENGTH": 1}
    assert result.seen == 1


def test_no_room_for_the_jaws_is_told_apart(see: Callable[..., Eyes]) -> None:
    walls: list[tuple[Point, Point]] = [
        ((-0.05, -0.45 + off, 0.025), (0.05, -0.45 + off, 0.025))
        for off in (-0.018, -0.015, -0.012, -0.009, -0.006, 0.006, 0.009, 0.012, 0.015, 0.018)
    ]
    see(scene(FREE, loose_m=walls))
    result = ran(bench().open(), order())
    assert (result.code, result.outcome) == (ResultCode.COLLISION, Outcome.NOTHING_GRASPABLE)
    assert result.refused == {"CLEARANCE": 1}


def test_out_of_the_arms_reach_is_told_apart(see: Callable[..., Eyes]) -> None:
    see(scene(FREE))
    cell = bench().open()
    cell.robot.reachable = lambda target: False  # type: ignore[method-assign]  # an arm that is too short
    result = ran(cell, order())
    assert (result.code, result.outcome) == (ResultCode.UNREACHABLE, Outcome.NOTHING_GRASPABLE)
    assert result.refused == {"REACH": 1}
    assert lines(cell) == []


def test_the_next_best_is_taken_when_the_arm_cannot_reach_the_best(see: Callable[..., Eyes]) -> None:
    see(scene(FREE, SECOND))
    cell = bench().open()
    probe = bench().open()
    ran(probe, order(command=PlcCommand.VISION_ONLY))
    best = probe.looks[0].plans[0].pick
    assert best is not None
    cell.robot.unreachable = frozenset({best.approach})
    result = ran(cell, order())
    assert result.outcome is Outcome.PICKED
    assert result.pose is not None
    assert result.pose.y == pytest.approx(-0.38)
    assert result.refused == {"REACH": 1}


FAR = NotReachable(limit=ReachLimit.TOO_FAR, value=0.9, bound=0.81, unit="m", leg=0)


def planned_best(see: Callable[..., Eyes], *parts: Candidate) -> Pick:
    """What would be picked if nothing were known against it."""
    see(scene(*parts))
    probe = bench().open()
    ran(probe, order(command=PlcCommand.VISION_ONLY))
    best = probe.looks[0].plans[0].pick
    assert best is not None
    return best


def turned(pose: ToolPose) -> ToolPose:
    """With the hand turned by half a turn about itself."""
    half = transforms.make(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
    return frames.pose_of(transforms.compose(frames.transform_of(pose), half))


@pytest.mark.parametrize("place", ["approach", "grasp", "retreat"])
@pytest.mark.parametrize(
    ("limit", "reason"),
    [
        (ReachLimit.TOO_FAR, "REACH"),
        (ReachLimit.JOINT, "JOINT"),
        (ReachLimit.ELBOW, "SINGULARITY"),
        (ReachLimit.SWING, "POSTURE"),
    ],
)
def test_a_place_known_to_be_out_of_reach_is_refused_before_the_arm_is_asked(
    see: Callable[..., Eyes], place: str, limit: ReachLimit, reason: str
) -> None:
    best = planned_best(see, FREE)
    cell = bench().open()
    told = replace(FAR, limit=limit)
    pose: ToolPose = getattr(best, place)
    cell.kinematics.against = {pose: told, turned(pose): told}
    cell.robot.reachable = lambda target: pytest.fail("the arm was asked")  # type: ignore[method-assign]
    result = ran(cell, order())
    assert (result.code, result.outcome) == (ResultCode.UNREACHABLE, Outcome.NOTHING_GRASPABLE)
    assert result.refused == {reason: 1}
    assert lines(cell) == []
    why = cell.looks[0].plans[0].refused[0]
    assert (why.value, why.limit, why.unit) == (0.9, 0.81, "m")


def test_a_hand_turned_the_other_way_round_may_still_get_there(see: Callable[..., Eyes]) -> None:
    best = planned_best(see, FREE)
    cell = bench().open()
    cell.kinematics.against = {best.grasp: replace(FAR, limit=ReachLimit.JOINT)}
    result = ran(cell, order())
    assert result.outcome is Outcome.PICKED
    assert result.refused == {}
    assert result.pose is not None
    assert result.pose.six() == pytest.approx(turned(best.grasp).six())


def test_the_way_is_judged_from_where_the_arm_stands(see: Callable[..., Eyes]) -> None:
    see(scene(FREE))
    cell = bench().open()
    ran(cell, order())
    start, way = cell.kinematics.asked[0]
    assert start.q_rad == cell.station.workspace.watch_q_rad
    pick = cell.looks[0].plans[0].pick
    assert pick is not None
    assert way == (pick.retreat, pick.approach, pick.grasp)


# ------------------------------------------------------------------------------ other commands


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
