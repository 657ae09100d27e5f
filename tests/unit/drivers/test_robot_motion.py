"""What is never asked of an arm, and when a motion counts as done."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from drivers.errors import CommandRejected, DeviceTimeout, SafetyStop
from drivers.robot.ur_codes import RUNNING, Runtime
from drivers.robot.ur_limits import Geometry, joints_missed, line_missed, refused_joints, refused_line
from drivers.robot.ur_motion import BEGIN_S, SETTLE_S, Progress, Watch
from drivers.robot.ur_stream import Snapshot
from drivers.types import JointMotion, LineMotion, SafetyMode, Six

GEOMETRY = Geometry(
    model="UR5e", tcp=(0.0, 0.0, 0.165, 0.0, 0.0, 0.0), box_min_m=(-0.8, -0.8, 0.0), box_max_m=(0.8, 0.8, 0.9)
)
POSE: Six = (0.2, -0.4, 0.2, 3.14, 0.0, 0.0)
Q: Six = (2.14, -1.92, 1.91, -1.56, -1.5708, 3.71)
LINE = LineMotion(speed_m_s=0.5, accel_m_s2=1.0, timeout_s=10.0)
JOINTS = JointMotion(speed_rad_s=1.0, accel_rad_s2=1.0, timeout_s=10.0)
NAN, INF = math.nan, math.inf


@pytest.mark.parametrize(
    ("target", "motion", "why"),
    [
        ((*POSE[:2], NAN, *POSE[3:]), LINE, "not finite"),
        ((*POSE[:5], INF), LINE, "not finite"),
        (POSE[:3], LINE, "3 numbers"),
        ((*POSE, 0.0), LINE, "7 numbers"),
        ((0.2, -0.4, -0.01, 3.14, 0.0, 0.0), LINE, "z = -0.0100 m is outside the tool box"),
        ((2.0, -0.4, 0.2, 3.14, 0.0, 0.0), LINE, "x = 2.0000 m"),
        (POSE, replace(LINE, speed_m_s=NAN), "speed_m_s"),
        (POSE, replace(LINE, speed_m_s=0.0), "speed_m_s"),
        (POSE, replace(LINE, speed_m_s=3.5), "speed_m_s"),
        (POSE, replace(LINE, accel_m_s2=-1.0), "accel_m_s2"),
        (POSE, replace(LINE, timeout_s=INF), "timeout_s"),
    ],
)
def test_a_line_nobody_should_ask_for_is_refused(target: Six, motion: LineMotion, why: str) -> None:
    told = refused_line(target, motion, GEOMETRY)
    assert told is not None
    assert why in told


@pytest.mark.parametrize(
    ("q", "motion", "why"),
    [
        ((*Q[:5], NAN), JOINTS, "not finite"),
        (Q[:5], JOINTS, "5 numbers"),
        ((7.0, *Q[1:]), JOINTS, "joint 0"),
        ((*Q[:2], 3.2, *Q[3:]), JOINTS, "joint 2"),  # the elbow turns half as far
        ((0.0, 1.5, 0.0, 0.0, 0.0, 0.0), JOINTS, "outside the tool box"),
        (Q, replace(JOINTS, speed_rad_s=4.0), "speed_rad_s"),
        (Q, replace(JOINTS, accel_rad_s2=NAN), "accel_rad_s2"),
    ],
)
def test_joints_nobody_should_ask_for_are_refused(q: Six, motion: JointMotion, why: str) -> None:
    told = refused_joints(q, motion, GEOMETRY)
    assert told is not None
    assert why in told


def test_what_is_sensible_is_not_refused() -> None:
    assert refused_line(POSE, LINE, GEOMETRY) is None
    assert refused_joints(Q, JOINTS, GEOMETRY) is None
    assert GEOMETRY.some_posture(POSE)
    assert not GEOMETRY.some_posture((0.79, -0.79, 0.6, 3.14, 0.0, 0.0))


def test_two_words_for_one_turn_are_one_turn() -> None:
    half = (*POSE[:3], math.pi, 0.0, 0.0)
    assert line_missed(half, (*POSE[:3], -math.pi, 0.0, 0.0)) is None
    assert line_missed(half, (*POSE[:2], POSE[2] + 0.002, math.pi, 0.0, 0.0)) == (
        "2.0 mm and 0.00 deg from the target"
    )
    assert joints_missed(Q, (*Q[:5], Q[5] + 0.01)) == "a joint is 0.57 deg from the target"


# --------------------------------------------------------------------------- the watch


def state(number: int, runs: bool, **changes: object) -> Snapshot:
    snapshot = Snapshot(
        controller_time_s=1.0,
        at=1.0,
        q_rad=Q,
        speeds_rad_s=(0.0,) * 6,
        wanted_speeds_rad_s=(0.1,) * 6 if runs else (0.0,) * 6,
        tool=POSE,
        robot_mode=RUNNING,
        safety=SafetyMode.NORMAL,
        runtime=Runtime.PLAYING,
        speed_fraction=1.0,
        inputs=0,
        outputs=0,
        payload_kg=0.0,
        payload_cog_m=(0.0, 0.0, 0.0),
        ready=1,
        operation=(number << 24) | (int(runs) << 15),
    )
    return replace(snapshot, **changes)  # type: ignore[arg-type]  # names of its fields


def there(_: Snapshot) -> str | None:
    return None


def short(_: Snapshot) -> str | None:
    return "5.0 mm from the target"


@pytest.mark.parametrize("before", [3, 127])
def test_a_motion_begins_goes_on_and_arrives(before: int) -> None:
    watch = Watch("robot", state(before, False), there, 10.0)
    after = (before + 1) % 128
    assert watch.look(state(before, False), 10.1) is Progress.UNDER_WAY
    assert watch.look(state(after, True), 10.2) is Progress.UNDER_WAY
    assert watch.look(state(after, False, wanted_speeds_rad_s=(0.01,) * 6), 10.3) is Progress.UNDER_WAY
    assert watch.look(state(after, False), 10.4) is Progress.ARRIVED


def test_not_running_alone_is_no_success() -> None:
    watch = Watch("robot", state(3, False), short, 10.0)
    assert watch.look(state(4, False), 10.1) is Progress.UNDER_WAY
    with pytest.raises(DeviceTimeout, match=r"ended early: 5\.0 mm"):
        watch.look(state(4, False), 10.2 + SETTLE_S)


def test_a_motion_that_does_not_begin_is_late() -> None:
    watch = Watch("robot", state(3, False), there, 10.0)
    with pytest.raises(DeviceTimeout, match="did not begin"):
        watch.look(state(3, False), 10.1 + BEGIN_S)


def test_a_motion_somebody_else_started_is_not_ours() -> None:
    watch = Watch("robot", state(3, False), there, 10.0)
    with pytest.raises(CommandRejected, match="somebody else"):
        watch.look(state(6, True), 10.1)


def test_the_safety_system_comes_before_the_program() -> None:
    watch = Watch("robot", state(3, False), there, 10.0)
    stopped = state(4, True, safety=SafetyMode.EMERGENCY_STOP, runtime=Runtime.STOPPED)
    with pytest.raises(SafetyStop):
        watch.look(stopped, 10.1)
    with pytest.raises(CommandRejected, match="ended under way"):
        watch.look(replace(stopped, safety=SafetyMode.NORMAL), 10.1)
