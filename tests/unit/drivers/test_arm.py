"""The simulated arm: published kinematics, an inverse that inverts, motions that keep line and profile."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.sim.arm import Arm, MotionEnd, Refused, forward, inverse_kinematics
from drivers.sim.geometry import pose_matrix, rotation_of, rotvec_of, tool_pose
from drivers.sim.layout import ArmLayout
from drivers.types import JointAngles, SafetyMode, ToolPose

START = (2.14, -1.92, 1.91, -1.56, -1.5708, 3.71)
TCP = pose_matrix((0.0, 0.0, 0.165, 0.0, 0.0, 0.0))
DOWN = ToolPose(x=0.0, y=-0.45, z=0.1, rx=np.pi, ry=0.0, rz=0.0)
DT = 0.004


@pytest.fixture
def arm() -> Arm:
    return Arm(ArmLayout(start_q_rad=START, tcp_m_rad=(0.0, 0.0, 0.165, 0.0, 0.0, 0.0)))


def run(arm: Arm, limit_s: float = 60.0) -> float:
    """Step until the arm rests; the time it took."""
    took = 0.0
    while arm.moving:
        arm.step(DT)
        took += DT
        assert took < limit_s
    return took


def test_stretched_out_the_flange_is_where_the_published_lengths_put_it() -> None:
    flange = forward(np.zeros(6), np.eye(4))
    assert flange[:3, 3] == pytest.approx([-0.425 - 0.3922, -0.1333 - 0.0996, 0.1625 - 0.0997], abs=1e-9)


def test_pointing_up_the_wrist_is_above_the_shoulder() -> None:
    flange = forward(np.array([0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0, 0.0]), np.eye(4))
    assert flange[:3, 3] == pytest.approx([0.0, -0.1333 - 0.0996, 0.1625 + 0.425 + 0.3922 + 0.0997], abs=1e-9)


def test_inverse_kinematics_finds_a_posture_that_gives_the_pose_back() -> None:
    rng = np.random.default_rng(2)
    found = 0
    for _ in range(60):
        q = np.array(START) + rng.uniform(-0.5, 0.5, 6)
        goal = forward(q, TCP)
        solved = inverse_kinematics(goal, np.array(START), TCP)
        if solved is not None:
            found += 1
            assert np.abs(forward(solved, TCP) - goal).max() < 1e-5
    assert found >= 58


def test_inverse_kinematics_is_deterministic() -> None:
    goal = pose_matrix(DOWN.six())
    first, second = (inverse_kinematics(goal, np.array(START), TCP) for _ in range(2))
    assert first is not None
    assert second is not None
    assert np.array_equal(first, second)


def test_a_line_stays_on_the_line_and_turns_evenly(arm: Arm) -> None:
    start = arm.base_from_tool()
    target = ToolPose(x=0.05, y=-0.42, z=0.08, rx=2.2, ry=2.2, rz=0.0)
    arm.start_line(target, 0.25, 1.0)
    way = np.array(target.six()[:3]) - start[:3, 3]
    along_before = -1.0
    while arm.moving:
        arm.step(DT)
        gone = arm.base_from_tool()[:3, 3] - start[:3, 3]
        along = float(gone @ way / (way @ way))
        assert np.linalg.norm(gone - along * way) < 2e-4
        assert along >= along_before - 1e-6
        along_before = along
    assert arm.motion_state is MotionEnd.DONE
    difference = pose_matrix(target.six())[:3, :3] @ arm.base_from_tool()[:3, :3].T
    assert np.linalg.norm(rotvec_of(difference)) < 1e-5
    assert arm.base_from_tool()[:3, 3] == pytest.approx(target.six()[:3], abs=1e-5)


def test_speed_and_acceleration_of_a_line_are_kept(arm: Arm) -> None:
    here = tool_pose(arm.base_from_tool())
    target = ToolPose(x=here.x, y=here.y, z=here.z - 0.15, rx=here.rx, ry=here.ry, rz=here.rz)
    arm.start_line(target, 0.2, 0.8)
    places = [arm.base_from_tool()[2, 3]]
    while arm.moving:
        arm.step(DT)
        places.append(arm.base_from_tool()[2, 3])
    speed = np.abs(np.diff(places)) / DT
    assert speed.max() == pytest.approx(0.2, rel=0.02)
    assert np.abs(np.diff(speed)[:-1]).max() / DT < 0.8 * 1.3
    assert len(speed) * DT == pytest.approx(0.15 / 0.2 + 0.2 / 0.8, abs=2 * DT)


def test_a_joint_move_takes_the_time_of_its_longest_joint(arm: Arm) -> None:
    goal = (START[0] - 1.0, START[1] + 0.2, *START[2:])
    arm.start_joints(JointAngles(q_rad=goal), 0.5, 1.0)
    assert run(arm) == pytest.approx(1.0 / 0.5 + 0.5 / 1.0, abs=2 * DT)
    assert arm.joints() == pytest.approx(goal, abs=1e-9)


def test_a_halt_brings_it_to_rest_on_its_way_within_the_stop_time(arm: Arm) -> None:
    here = arm.base_from_tool()[:3, 3].copy()
    arm.start_line(DOWN, 0.2, 2.0)
    for _ in range(100):
        arm.step(DT)
    before = arm.base_from_tool()[:3, 3].copy()
    arm.halt()
    assert run(arm) <= 0.15 + 2 * DT
    assert arm.motion_state is MotionEnd.HALTED
    way = np.array(DOWN.six()[:3]) - here
    beyond = arm.base_from_tool()[:3, 3] - before
    assert 0.0 < np.linalg.norm(beyond) < 0.2 * 0.15
    assert np.linalg.norm(np.cross(beyond, way / np.linalg.norm(way))) < 2e-4


def test_a_safety_stop_stands_still_at_once_and_refuses_until_cleared(arm: Arm) -> None:
    arm.start_line(DOWN, 0.2, 2.0)
    arm.step(0.5)
    arm.stop_for_safety(SafetyMode.PROTECTIVE_STOP)
    before = arm.q.copy()
    arm.step(1.0)
    assert np.array_equal(arm.q, before)
    assert arm.motion_state is MotionEnd.SAFETY
    with pytest.raises(Refused, match="PROTECTIVE_STOP"):
        arm.start_line(DOWN, 0.2, 2.0)


def test_a_second_motion_is_refused_while_one_is_under_way(arm: Arm) -> None:
    arm.start_line(DOWN, 0.2, 2.0)
    with pytest.raises(Refused, match="still moving"):
        arm.start_line(DOWN, 0.2, 2.0)


@pytest.mark.parametrize("target", [(1.5, 0.0, 0.2), (0.0, 0.0, 1.5), (0.02, 0.02, 0.1)])
def test_what_lies_out_of_reach_is_not_reachable(arm: Arm, target: tuple[float, float, float]) -> None:
    x, y, z = target
    pose = ToolPose(x=x, y=y, z=z, rx=np.pi, ry=0.0, rz=0.0)
    assert not arm.reachable(pose)
    with pytest.raises(Refused):
        arm.start_line(pose, 0.2, 1.0)
    assert not arm.moving


def test_joint_limits_are_refused(arm: Arm) -> None:
    with pytest.raises(Refused, match="joint limits"):
        arm.start_joints(JointAngles(q_rad=(7.0, *START[1:])), 1.0, 1.0)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, np.pi - 1e-7, np.pi])
def test_rotation_vectors_survive_the_way_to_a_matrix_and_back(angle: float) -> None:
    axis = np.array([0.36, -0.48, 0.8])
    there = rotation_of(axis * angle)
    back = rotvec_of(there)
    assert min(np.abs(back - axis * angle).max(), np.abs(back + axis * angle).max()) < 1e-6
