"""What every arm promises (docs/design.md, section 5): the arm of the simulated cell over its socket, the
UR driver over RTDE with the unmodified library in its worker, and the double."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import pytest

from drivers.errors import (
    DeviceTimeout,
    DeviceUnavailable,
    SafetyStop,
)
from drivers.interfaces import Robot
from drivers.robot.ur import UrRobot
from drivers.timing import StopRequested, StopToken
from drivers.types import SafetyMode, ToolPose
from tests.contract.arms import CLOCK, CRAWL, ELSEWHERE, FAR, HOME, LINE, QUICK, sim, ur
from tests.fakes.robot import FakeRobot
from tests.fakes.simcell import SimCell
from tests.fakes.ur_controller import UrController, free_host


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """One implementation: an arm that works, one that is not there, and how to stop it for safety."""

    good: Callable[[], Robot]
    absent: Callable[[], Robot]
    stop_for_safety: Callable[[Robot], None]


def _protective(robot: Robot) -> None:
    assert isinstance(robot, FakeRobot)
    robot.safety = SafetyMode.PROTECTIVE_STOP


def scripted(move_s: float = 0.2, open_error: Exception | None = None) -> FakeRobot:
    robot = FakeRobot("robot", CLOCK, move_s=move_s, unreachable=(FAR,))
    robot.open_error = open_error
    return robot


@pytest.fixture(params=["sim", "ur", "scripted"])
def kind(request: pytest.FixtureRequest, cell: SimCell, controller: UrController) -> Kind:
    if request.param == "ur":
        nobody = controller.settings(host=free_host())
        return Kind(
            good=lambda: ur(controller),
            absent=lambda: UrRobot("robot", nobody, CLOCK),
            stop_for_safety=lambda _: controller.do("protective_stop"),
        )
    if request.param == "sim":
        return Kind(
            good=lambda: sim(cell.port),
            absent=lambda: sim(9),
            stop_for_safety=lambda _: cell.fault("protective_stop"),
        )
    return Kind(
        good=scripted,
        absent=lambda: scripted(open_error=DeviceUnavailable("robot", "not there")),
        stop_for_safety=_protective,
    )


@pytest.fixture
def robot(kind: Kind) -> Iterator[Robot]:
    made = kind.good()
    made.open()
    yield made
    made.close()


def test_an_arm_that_was_not_opened_or_was_closed_is_unavailable(kind: Kind) -> None:
    made = kind.good()
    with pytest.raises(DeviceUnavailable):
        made.state()
    made.close()
    made.open()
    made.close()
    made.close()
    with pytest.raises(DeviceUnavailable):
        made.state()


def test_an_absent_arm_fails_at_open(kind: Kind) -> None:
    with pytest.raises(DeviceUnavailable):
        kind.absent().open()


def test_a_joint_move_returns_when_the_arm_is_there_and_stands(robot: Robot, stop: StopToken) -> None:
    for target in (ELSEWHERE, HOME):
        robot.move_joints(target, QUICK, stop)
        state = robot.state()
        assert state.joints.q_rad == pytest.approx(target.q_rad, abs=1e-6)
        assert not state.moving


def test_a_line_ends_at_its_target(robot: Robot, stop: StopToken) -> None:
    robot.move_joints(HOME, QUICK, stop)
    here = robot.state().tool
    target = replace(here, z=here.z - 0.05, x=here.x + 0.02)
    robot.move_line(target, LINE, stop)
    assert robot.state().tool.six() == pytest.approx(target.six(), abs=2e-5)


def test_a_fired_token_halts_the_arm_before_the_call_raises(robot: Robot, stop: StopToken) -> None:
    here = robot.state().tool
    target = replace(here, z=here.z + 0.08)
    firing = threading.Timer(0.08, lambda: stop.stop("changed our mind"))
    firing.start()
    started_at = CLOCK.now()
    with pytest.raises(StopRequested, match="changed our mind"):
        robot.move_line(target, CRAWL, stop)
    firing.join()
    state = robot.state()
    assert not state.moving
    assert state.tool.z < target.z - 0.01
    assert CLOCK.now() - started_at < 1.5


def test_a_token_fired_before_means_no_motion_at_all(robot: Robot, stop: StopToken) -> None:
    before = robot.state().tool
    stop.stop("never mind")
    with pytest.raises(StopRequested):
        robot.move_line(replace(before, z=before.z + 0.02), LINE, stop)
    assert robot.state().tool == before


def test_a_move_that_takes_too_long_is_halted_and_times_out(robot: Robot, stop: StopToken) -> None:
    here = robot.state().tool
    target = replace(here, z=here.z + 0.08)
    with pytest.raises(DeviceTimeout):
        robot.move_line(target, replace(CRAWL, timeout_s=0.1), stop)
    state = robot.state()
    assert not state.moving
    assert state.tool.z < target.z - 0.01


def test_a_safety_stop_is_told_as_such_until_recovered(kind: Kind, robot: Robot, stop: StopToken) -> None:
    kind.stop_for_safety(robot)
    with pytest.raises(SafetyStop) as caught:
        robot.move_joints(ELSEWHERE, QUICK, stop)
    assert caught.value.mode is SafetyMode.PROTECTIVE_STOP
    assert robot.state().safety is SafetyMode.PROTECTIVE_STOP
    robot.recover()
    robot.move_joints(HOME, QUICK, stop)
    assert robot.state().safety is SafetyMode.NORMAL


def test_reach_is_judged_without_moving(robot: Robot) -> None:
    before = robot.state().joints
    assert robot.reachable(ToolPose(x=0.0, y=-0.45, z=0.05, rx=3.14159, ry=0.0, rz=0.0))
    assert not robot.reachable(FAR)
    assert robot.state().joints == before


def test_digital_pins_can_be_used(robot: Robot) -> None:
    robot.set_output(3, True)
    assert robot.read_input(2) is False
