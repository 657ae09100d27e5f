"""Motions of the simulated UR arm: they last as long as their trapezoid says, keep their line, and brake."""

from __future__ import annotations

import itertools
import math

import pytest

from drivers.sim.ur_arm import RAMP_S, UrArm
from drivers.sim.ur_kinematics import MODELS, Six
from drivers.sim.ur_motion import CannotFollow, Trapezoid

DT = 0.002
START: Six = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)
TCP: Six = (0.0, 0.0, 0.165, 0.0, 0.0, 0.0)


@pytest.fixture
def arm() -> UrArm:
    return UrArm(MODELS["UR5e"], START, TCP)


def run(arm: UrArm, limit_s: float = 30.0) -> float:
    """Step until nothing is left to do; the time it took."""
    steps = 0
    while arm.motion is not None:
        arm.step(DT)
        steps += 1
        assert steps * DT < limit_s
    return steps * DT


def shifted(pose: Six, dx: float = 0.0, dy: float = 0.0, dz: float = 0.0) -> Six:
    x, y, z, rx, ry, rz = pose
    return (x + dx, y + dy, z + dz, rx, ry, rz)


@pytest.mark.parametrize(("length", "speed", "accel"), [(0.3, 0.25, 1.2), (0.01, 0.25, 1.2), (2.0, 1.0, 0.5)])
def test_a_trapezoid_goes_its_whole_way_in_its_time(length: float, speed: float, accel: float) -> None:
    profile = Trapezoid(length, speed, accel)
    if length * accel >= speed * speed:
        assert profile.duration_s == pytest.approx(length / speed + speed / accel)
    else:
        assert profile.duration_s == pytest.approx(2.0 * math.sqrt(length / accel))
    assert profile.at(profile.duration_s) == (length, 0.0)
    places = [profile.at(i * DT) for i in range(int(profile.duration_s / DT) + 2)]
    for (before, v), (after, _) in itertools.pairwise(places):
        assert 0.0 <= after - before <= speed * DT + 1e-12
        assert v <= speed + 1e-12


def test_a_line_lasts_as_long_as_its_trapezoid(arm: UrArm) -> None:
    goal = shifted(arm.pose, dz=0.1)
    arm.start(arm.line_way(goal), 0.25, 1.2)
    assert run(arm) == pytest.approx(0.1 / 0.25 + 0.25 / 1.2, abs=DT)
    assert arm.pose == pytest.approx(goal, abs=1e-9)
    assert (arm.moves_started, arm.moves_finished) == (1, 1)


def test_a_line_is_straight_keeps_its_attitude_and_its_speed(arm: UrArm) -> None:
    start, goal = arm.pose, shifted(arm.pose, dx=0.1, dy=0.15, dz=-0.1)
    arm.start(arm.line_way(goal), 0.25, 1.2)
    way = [b - a for a, b in zip(start[:3], goal[:3], strict=True)]
    length = math.sqrt(sum(v * v for v in way))
    fastest = 0.0
    while arm.motion is not None:
        arm.step(DT)
        off = [p - a for p, a in zip(arm.pose[:3], start[:3], strict=True)]
        along = sum(a * b for a, b in zip(off, way, strict=True)) / length
        aside = math.sqrt(max(0.0, sum(v * v for v in off) - along * along))
        assert aside < 1e-7
        assert arm.pose[3:] == pytest.approx(start[3:], abs=1e-7)
        fastest = max(fastest, math.sqrt(sum(v * v for v in arm.tool_speed[:3])))
    assert fastest == pytest.approx(0.25, abs=1e-6)


def test_a_turn_about_the_tool_point_leaves_the_point_where_it_is(arm: UrArm) -> None:
    x, y, z, *_ = arm.pose
    goal = arm.tool_of((0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.5))
    arm.start(arm.line_way((x, y, z, *goal[3:])), 0.25, 1.2)
    while arm.motion is not None:
        arm.step(DT)
        assert arm.pose[:3] == pytest.approx((x, y, z), abs=1e-7)
    assert arm.q[5] == pytest.approx(0.5, abs=1e-6)


def test_the_joint_with_the_longest_way_sets_the_pace(arm: UrArm) -> None:
    goal: Six = (0.8, -1.4, 1.5708, -1.5708, -1.5708, 0.1)
    arm.start(arm.joint_way(goal), 0.8, 1.0)
    assert run(arm) == pytest.approx(0.8 / 0.8 + 0.8 / 1.0, abs=DT)
    assert arm.q == goal


@pytest.mark.parametrize("decel", [0.5, 2.0, 10.0])
def test_braking_takes_v_squared_over_twice_the_deceleration(arm: UrArm, decel: float) -> None:
    arm.start(arm.line_way(shifted(arm.pose, dz=0.25)), 0.25, 1.2)
    while arm.tool_speed[2] < 0.2499:
        arm.step(DT)
    z = arm.pose[2]
    arm.brake_tool(decel)
    took_s = run(arm)
    assert took_s == pytest.approx(0.25 / decel, abs=2 * DT)
    assert arm.pose[2] - z == pytest.approx(0.25**2 / (2.0 * decel), rel=0.02, abs=1e-4)
    assert arm.moves_finished == 0


def test_braking_joints_counts_the_fastest_of_them(arm: UrArm) -> None:
    arm.start(arm.joint_way((2.0, *START[1:])), 1.0, 4.0)
    while arm.qd[0] < 0.9999:
        arm.step(DT)
    q = arm.q[0]
    arm.brake_joints(2.0)
    run(arm)
    assert arm.q[0] - q == pytest.approx(1.0 / (2.0 * 2.0), rel=0.02)


def test_a_hold_stops_on_the_way_and_goes_on_to_the_goal(arm: UrArm) -> None:
    goal = shifted(arm.pose, dz=0.2)
    arm.start(arm.line_way(goal), 0.25, 1.2)
    for _ in range(200):
        arm.step(DT)
    arm.hold(True)
    for _ in range(round(RAMP_S / DT) + 1):
        arm.step(DT)
    assert arm.resting
    rests_at = arm.q
    for _ in range(500):
        arm.step(DT)
    assert arm.q == rests_at
    arm.hold(False)
    run(arm)
    assert arm.pose == pytest.approx(goal, abs=1e-9)


def test_the_slider_stretches_the_motion(arm: UrArm) -> None:
    arm.slider = 0.5
    arm.step(DT)
    arm.start(arm.line_way(shifted(arm.pose, dz=0.1)), 0.25, 1.2)
    assert run(arm) == pytest.approx(2.0 * (0.1 / 0.25 + 0.25 / 1.2), abs=2 * DT)


def test_a_slider_moved_underway_acts_gently(arm: UrArm) -> None:
    arm.start(arm.line_way(shifted(arm.pose, dz=0.25)), 0.25, 1.2)
    for _ in range(250):
        arm.step(DT)
    arm.slider = 0.2
    speeds = []
    for _ in range(100):
        arm.step(DT)
        speeds.append(arm.tool_speed[2])
    assert all(before - after < 0.25 * DT / RAMP_S * 1.1 for before, after in itertools.pairwise(speeds))
    assert speeds[-1] == pytest.approx(0.05, abs=1e-6)


def test_a_line_out_of_reach_ends_where_the_reach_ends(arm: UrArm) -> None:
    arm.start(arm.line_way(shifted(arm.pose, dx=-0.8)), 0.5, 2.0)
    with pytest.raises(CannotFollow, match=r"reach|turn at"):
        run(arm)
    assert arm.motion is None
    assert 0.5 < math.hypot(arm.pose[0], arm.pose[1]) < 1.0


def test_a_line_through_a_singularity_is_not_gone_with_a_racing_joint(arm: UrArm) -> None:
    links = MODELS["UR5e"]
    arm = UrArm(links, (0.0, -1.2, 1.9, -0.6, -0.05, 0.0), TCP)  # the wrist is nearly stretched
    arm.start(arm.line_way(shifted(arm.pose, dy=-0.3)), 0.5, 2.0)
    with pytest.raises(CannotFollow):
        run(arm)
    assert all(abs(v) < 3.5 for v in arm.qd)


def test_a_joint_target_beyond_its_limit_is_refused(arm: UrArm) -> None:
    with pytest.raises(CannotFollow, match="limits"):
        arm.joint_way((0.0, 0.0, 3.2, 0.0, 0.0, 0.0))
    with pytest.raises(CannotFollow, match="limits"):
        arm.joint_way((math.nan, 0.0, 0.0, 0.0, 0.0, 0.0))


@pytest.mark.parametrize(("speed", "accel"), [(0.0, 1.0), (-1.0, 1.0), (1.0, 0.0), (math.nan, 1.0)])
def test_a_speed_that_is_none_is_refused(arm: UrArm, speed: float, accel: float) -> None:
    with pytest.raises(CannotFollow):
        arm.start(arm.line_way(shifted(arm.pose, dz=0.1)), speed, accel)
    assert arm.motion is None


def test_a_target_that_is_no_number_is_refused(arm: UrArm) -> None:
    with pytest.raises(CannotFollow, match="finite"):
        arm.line_way(shifted(arm.pose, dz=math.nan))


def test_a_small_way_with_a_large_turn_is_not_rushed(arm: UrArm) -> None:
    turned = arm.tool_of((0.0, -1.5708, 1.5708, -1.5708, -1.5708, 1.5))
    x, y, z, *_ = arm.pose
    arm.start(arm.line_way((x, y, z + 0.002, *turned[3:])), 0.25, 1.2)
    assert run(arm) > 1.5 / 2.0
