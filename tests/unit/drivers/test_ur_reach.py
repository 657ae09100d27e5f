"""Whether a way of straight lines can be gone: the reason and its number, before the arm is asked."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from drivers.robot.ur_limits import matrix_of, six_of
from drivers.robot.ur_postures import MODELS, Floats, joint_frames, postures
from drivers.robot.ur_reach import UrKinematics, _line
from drivers.settings import UrReachSettings, UrRobotSettings
from drivers.types import JointAngles, LineMotion, NotReachable, ReachLimit, Six, ToolPose

WATCH = JointAngles(q_rad=(2.14, -1.92, 1.91, -1.56, -1.5708, 3.71))
TCP: Six = (0.0, 0.0, 0.165, 0.0, 0.0, 0.0)
OVER = ToolPose(x=0.0, y=-0.45, z=0.15, rx=math.pi, ry=0.0, rz=0.0)
DOWN = replace(OVER, z=0.03)


WIDE = (-0.75, -1.25, -0.5)
NARROW = (-0.75, -0.75, -0.1)


def arm(
    model: str = "UR5e", tcp: Six = TCP, box_min: tuple[float, float, float] = WIDE, **reach: object
) -> UrKinematics:
    settings = UrRobotSettings.model_validate(
        {
            "driver": "ur",
            "host": "127.0.0.2",
            "model": model,
            "tcp_m_rad": tcp,
            "payload_kg": 1.0,
            "payload_cog_m": (0.0, 0.0, 0.05),
            "tool_box_min_m": box_min,
            "tool_box_max_m": (0.75, 0.75, 0.8),
            "reach": reach,
        }
    )
    return UrKinematics(settings)


def against(kinematics: UrKinematics, *way: ToolPose, start: JointAngles = WATCH) -> NotReachable:
    told = kinematics.refused(start, way)
    assert told is not None
    return told


def tool_of(q: JointAngles, model: str = "UR5e") -> ToolPose:
    frames: Floats = joint_frames(MODELS[model], np.array(q.q_rad))
    return ToolPose.of(six_of(frames[6] @ matrix_of(TCP)))


def test_over_the_bin_down_and_up_nothing_stands_against_it() -> None:
    assert arm().refused(WATCH, (OVER, DOWN, OVER)) is None


def test_too_far_says_how_long_the_arm_would_have_to_be() -> None:
    told = against(arm(), replace(OVER, y=-1.2))
    assert (told.limit, told.unit, told.leg) == (ReachLimit.TOO_FAR, "m", 0)
    assert told.value > told.bound
    # straight, both links are 0.8172 m; the margin of the real arm's calibration is off that
    assert told.bound == pytest.approx(0.8172 - 0.003)


def test_the_reach_is_shorter_by_what_the_calibration_may_take() -> None:
    """A place the nominal arm just reaches is not promised."""
    reach = MODELS["UR5e"].stretched_m
    frames = joint_frames(MODELS["UR5e"], np.array([0.0, -0.9, 0.0, -0.6, -math.pi / 2, 0.0]))
    assert float(np.linalg.norm(frames[3, :3, 3] - frames[1, :3, 3])) == pytest.approx(reach)
    for calibration_m, short in ((0.001, 0.001), (0.01, 0.01)):
        told = against(arm(calibration_m=calibration_m, elbow_margin_rad=0.0), replace(OVER, y=-1.2))
        assert told.bound == pytest.approx(reach - short)


def test_outside_the_tools_box_is_told_with_how_far_before_anything_else() -> None:
    told = against(arm(box_min=(-0.7, -0.4, 0.0)), OVER)
    assert (told.limit, told.unit, told.leg) == (ReachLimit.BOX, "m", 0)
    assert told.value == pytest.approx(0.05)


def test_too_near_the_base_is_told_apart() -> None:
    told = against(arm(), OVER, replace(OVER, x=0.0, y=-0.08))
    assert told.limit in (ReachLimit.TOO_NEAR, ReachLimit.SHOULDER)
    assert told.leg == 1


def test_an_elbow_nearly_straight_is_too_far_though_the_arm_could_just_do_it() -> None:
    q = (0.0, -0.9, 0.0, -0.6, -math.pi / 2, 0.0)
    bent = JointAngles(q_rad=(q[0], q[1] - 0.1, 0.2, q[3] - 0.1, q[4], q[5]))
    straighter = JointAngles(q_rad=(q[0], q[1] - 0.025, 0.05, q[3] - 0.025, q[4], q[5]))
    told = against(arm(elbow_margin_rad=0.1, calibration_m=0.0), tool_of(straighter), start=bent)
    assert told.limit is ReachLimit.TOO_FAR
    assert told.bound < told.value < MODELS["UR5e"].stretched_m
    assert arm(elbow_margin_rad=0.04, calibration_m=0.0).refused(bent, (tool_of(straighter),)) is None


def test_an_arm_that_stands_too_straight_already_is_told_with_its_angle() -> None:
    straight = JointAngles(q_rad=(0.0, -0.9, 0.05, -0.6, -math.pi / 2, 0.0))
    told = against(arm(), tool_of(WATCH), start=straight)
    assert told.limit is ReachLimit.ELBOW
    assert told.value == pytest.approx(0.05)


def test_a_straight_wrist_is_refused_with_its_angle() -> None:
    start = JointAngles(q_rad=(0.3, -1.5, 1.6, -1.6, -0.4, 0.2))
    end = JointAngles(q_rad=(0.3, -1.5, 1.6, -1.6, -0.05, 0.2))
    told = against(arm(), tool_of(end), start=start)
    assert told.limit is ReachLimit.WRIST
    assert told.bound == 0.1
    assert told.value < 0.1


def test_a_joint_beyond_its_limit_is_named() -> None:
    limits = (2.0, 2.0, 2.0, 2.0, 2.0, 4.0)
    kinematics = arm(joint_limits_rad=limits)
    told = against(kinematics, OVER)
    assert (told.limit, told.joint) == (ReachLimit.JOINT, 0)  # the start itself: joint 0 at 2.14
    assert told.value == pytest.approx(2.14)
    assert told.bound == pytest.approx(1.95)


def test_a_hand_that_was_turned_too_often_meets_its_limit_on_the_way() -> None:
    wound = JointAngles(q_rad=(*WATCH.q_rad[:5], 6.0))
    turned = ToolPose.of(six_of(matrix_of(tool_of(wound).six()) @ matrix_of((0.0, 0.0, 0.0, 0.0, 0.0, 1.0))))
    told = against(arm(), turned, start=wound)
    assert (told.limit, told.joint) == (ReachLimit.JOINT, 5)
    assert told.value > 2 * math.pi - 0.05


def test_a_line_through_the_base_would_change_the_posture() -> None:
    """Both ends can be reached, the line between them cannot be driven."""
    high = ToolPose(x=0.0, y=-0.45, z=0.5, rx=math.pi, ry=0.0, rz=0.0)
    across = replace(high, y=0.45)
    kinematics = arm()
    assert kinematics.refused(WATCH, (high,)) is None
    told = against(kinematics, high, across)
    assert told.leg == 1
    assert told.limit in (ReachLimit.TOO_NEAR, ReachLimit.SHOULDER, ReachLimit.SWING)


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.6, 0.0, 0.8), (0.0, -0.6, 0.8)])
@pytest.mark.parametrize("angle", [0.0, 1e-7, 1.0, 3.1, math.pi - 1e-7, math.pi])
def test_a_line_turns_evenly_and_ends_in_its_pose(axis: tuple[float, float, float], angle: float) -> None:
    """Half a turn too, whose axis cannot be read off the skew part of its matrix."""
    start = matrix_of(tool_of(WATCH).six())
    x, y, z = axis
    end = start @ matrix_of((0.1, 0.0, 0.05, angle * x, angle * y, angle * z))
    line = _line(start, end)
    assert line[-1] == pytest.approx(end, abs=1e-6)
    before = np.vstack([start[None], line[:-1]])
    between = np.swapaxes(before[:, :3, :3], 1, 2) @ line[:, :3, :3]
    turned = np.arccos(np.clip((np.trace(between, axis1=1, axis2=2) - 1.0) / 2.0, -1.0, 1.0))
    assert turned == pytest.approx(np.full(len(line), angle / len(line)), abs=1e-6)
    assert float(turned.max()) <= 0.1 + 1e-9


@pytest.mark.parametrize("model", ["UR3e", "UR5e", "UR10e"])
def test_what_is_allowed_can_be_followed_by_the_joints(model: str) -> None:
    """Every allowed way, sampled finely, is joined up and ends where it should."""
    rng = np.random.default_rng(3)
    kinematics = arm(model, box_min=NARROW)
    size = MODELS[model].stretched_m
    start = JointAngles(q_rad=(0.2, -1.6, 1.7, -1.67, -math.pi / 2, 0.1))
    allowed = 0
    for _ in range(80):
        radius, bearing = rng.uniform(0.2, 1.3) * size, rng.uniform(-1.2, 1.2)
        x, y = -radius * math.cos(bearing), -radius * math.sin(bearing)
        pose = ToolPose(x=x, y=y, z=float(rng.uniform(0.0, 0.4)), rx=math.pi, ry=0.0, rz=0.0)
        if kinematics.refused(start, (pose,)) is not None:
            continue
        allowed += 1
        line = _fine(tool_of(start, model), pose) @ np.linalg.inv(matrix_of(TCP))
        found = postures(MODELS[model], line)
        # the joints themselves are nobody else's business
        q, problem = kinematics._follow(np.array(start.q_rad), found, range(len(line)), 0)
        assert problem is None
        steps = np.abs(np.diff(np.vstack([start.q_rad, q]), axis=0)).max()
        assert float(steps) < 0.15
        end = joint_frames(MODELS[model], q[-1])[6] @ matrix_of(TCP)
        assert end == pytest.approx(matrix_of(pose.six()), abs=1e-9)
    assert allowed > 10


def _fine(start: ToolPose, end: ToolPose) -> Floats:
    a, b = matrix_of(start.six()), matrix_of(end.six())
    turn = np.array(six_of(a.T @ b)[3:])
    poses = []
    for share in np.linspace(0.005, 1.0, 200):
        pose = np.eye(4)
        rx, ry, rz = (float(v) for v in turn * share)
        pose[:3, :3] = a[:3, :3] @ matrix_of((0.0, 0.0, 0.0, rx, ry, rz))[:3, :3]
        pose[:3, 3] = a[:3, 3] + share * (b[:3, 3] - a[:3, 3])
        poses.append(pose)
    return np.array(poses)


def test_margins_have_sensible_defaults() -> None:
    assert UrReachSettings() == UrReachSettings(
        joint_margin_rad=0.05,
        wrist_margin_rad=0.1,
        elbow_margin_rad=0.1,
        shoulder_margin_m=0.03,
        calibration_m=0.003,
    )


def test_a_line_on_which_the_hand_turns_a_lot_is_slowed_to_what_the_joints_can_do() -> None:
    start = tool_of(WATCH)
    turned = ToolPose.of(six_of(matrix_of(start.six()) @ matrix_of((0.0, 0.05, 0.0, 0.0, 0.0, -2.5))))
    motion = LineMotion(speed_m_s=0.6, accel_m_s2=1.2, timeout_s=15.0)
    paced = arm().paced(WATCH, turned, motion)
    # joint 6 turns 2.5 rad on 0.05 m: at 0.6 m/s that would be 30 rad/s, ten times what it can
    assert paced.speed_m_s * 2.5 / 0.05 <= 0.75 * math.pi
    assert paced.accel_m_s2 * 2.5 / 0.05 <= 8.1
    assert paced.speed_m_s > 0.03


def test_a_line_that_the_joints_can_follow_keeps_its_pace() -> None:
    motion = LineMotion(speed_m_s=0.15, accel_m_s2=0.6, timeout_s=10.0)
    start = tool_of(WATCH)
    assert arm().paced(WATCH, replace(start, z=start.z - 0.1), motion) == motion
