"""What every arm promises (docs/design.md, section 5): the arm of the simulated cell over its socket, the
UR driver over RTDE with the unmodified library in its worker, and the double."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import pytest

from drivers.errors import (
    CommandRejected,
    DeviceTimeout,
    DeviceUnavailable,
    SafetyStop,
    StaleData,
)
from drivers.interfaces import Robot
from drivers.robot.ur import UrRobot
from drivers.settings import SimRobotSettings
from drivers.sim.devices import SimRobot
from drivers.timing import MonotonicClock, StopRequested, StopToken
from drivers.types import JointAngles, JointMotion, LineMotion, SafetyMode, ToolPose
from tests.fakes.robot import FakeRobot
from tests.fakes.simcell import ROOT, SimCell, sim_cell
from tests.fakes.ur_controller import UrController, free_host, ur_controller

CLOCK = MonotonicClock()
HOME = JointAngles(q_rad=(2.14, -1.92, 1.91, -1.56, -1.5708, 3.71))
ELSEWHERE = JointAngles(q_rad=(1.9, -1.7, 1.8, -1.6, -1.5708, 3.71))
QUICK = JointMotion(speed_rad_s=2.0, accel_rad_s2=4.0, timeout_s=10.0)
LINE = LineMotion(speed_m_s=0.5, accel_m_s2=2.0, timeout_s=10.0)
CRAWL = LineMotion(speed_m_s=0.01, accel_m_s2=1.0, timeout_s=10.0)
FAR = ToolPose(x=2.0, y=0.0, z=0.3, rx=3.14159, ry=0.0, rz=0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """One implementation: an arm that works, one that is not there, and how to stop it for safety."""

    good: Callable[[], Robot]
    absent: Callable[[], Robot]
    stop_for_safety: Callable[[Robot], None]


@pytest.fixture(scope="module")
def running() -> Iterator[SimCell]:
    with sim_cell("--sticks", "0", "--speed", "4") as cell:
        yield cell


@pytest.fixture
def cell(running: SimCell) -> Iterator[SimCell]:
    yield running
    running.mend()


@pytest.fixture(scope="module")
def wire() -> Iterator[UrController]:
    with ur_controller() as controller:
        yield controller


@pytest.fixture
def controller(wire: UrController) -> Iterator[UrController]:
    yield wire
    wire.mend()


def ur(controller: UrController) -> UrRobot:
    return UrRobot("robot", controller.settings(), CLOCK)


def sim(port: int) -> SimRobot:
    return SimRobot("robot", SimRobotSettings(driver="sim", port=port), CLOCK)


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


@pytest.fixture
def stop() -> StopToken:
    return StopToken(CLOCK)


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


# ------------------------------------------------------------------ the simulated arm alone


@pytest.fixture
def arm(cell: SimCell) -> Iterator[SimRobot]:
    made = sim(cell.port)
    made.open()
    made.move_joints(HOME, QUICK, StopToken(CLOCK))
    yield made
    made.close()


def test_a_line_out_of_reach_is_rejected_and_nothing_moves(arm: SimRobot, stop: StopToken) -> None:
    before = arm.state().joints
    with pytest.raises(CommandRejected, match="cannot be followed"):
        arm.move_line(FAR, LINE, stop)
    assert arm.state().joints == before


def test_a_protective_stop_on_the_way_ends_the_motion_as_a_safety_stop(
    arm: SimRobot, cell: SimCell, stop: StopToken
) -> None:
    here = arm.state().tool
    hit = threading.Timer(0.1, lambda: cell.fault("protective_stop"))
    hit.start()
    with pytest.raises(SafetyStop):
        arm.move_line(replace(here, z=here.z + 0.08), CRAWL, stop)
    hit.join()
    assert not arm.state().moving


def test_software_does_not_clear_an_emergency_stop(arm: SimRobot, cell: SimCell, stop: StopToken) -> None:
    cell.fault("emergency_stop")
    with pytest.raises(CommandRejected, match="emergency"):
        arm.recover()
    with pytest.raises(SafetyStop):
        arm.move_joints(ELSEWHERE, QUICK, stop)


def test_a_controller_whose_clock_stands_is_stale(arm: SimRobot, cell: SimCell, stop: StopToken) -> None:
    cell.fault("robot_frozen")
    arm.state()
    stop.wait(0.3)
    with pytest.raises(StaleData):
        arm.state()


def test_a_controller_that_freezes_under_way_ends_the_move_as_stale(
    arm: SimRobot, cell: SimCell, stop: StopToken
) -> None:
    here = arm.state().tool
    freeze = threading.Timer(0.1, lambda: cell.fault("robot_frozen"))
    freeze.start()
    with pytest.raises(StaleData):
        arm.move_line(replace(here, z=here.z + 0.08), CRAWL, stop)
    freeze.join()


def test_only_one_client_moves_the_arm(arm: SimRobot, cell: SimCell) -> None:
    second = sim(cell.port)
    with pytest.raises(CommandRejected, match="another client"):
        second.open()
    second.close()


def test_a_pin_that_is_not_there_is_rejected(arm: SimRobot) -> None:
    with pytest.raises(CommandRejected):
        arm.set_output(99, True)


def test_an_input_wired_from_outside_is_read(arm: SimRobot, cell: SimCell) -> None:
    cell.ask("set_input", pin=5, on=True)
    assert arm.read_input(5)


# ------------------------------------------------------------------ the UR arm alone


@pytest.fixture
def wired(controller: UrController) -> Iterator[UrRobot]:
    made = ur(controller)
    made.open()
    made.move_joints(HOME, QUICK, StopToken(CLOCK))
    yield made
    made.close()


def test_what_nobody_should_ask_for_never_gets_to_the_library(
    wired: UrRobot, controller: UrController, stop: StopToken
) -> None:
    here = wired.state().tool
    commands = controller.status()["commands"]
    for target in (replace(here, z=math.nan), FAR, replace(here, z=-0.5)):
        with pytest.raises(CommandRejected):
            wired.move_line(target, LINE, stop)
    with pytest.raises(CommandRejected):
        wired.move_joints(JointAngles(q_rad=HOME.q_rad[:3]), QUICK, stop)  # type: ignore[arg-type]  # too few
    with pytest.raises(CommandRejected):
        wired.move_line(here, replace(LINE, speed_m_s=math.inf), stop)
    assert controller.status()["commands"] == commands


def test_an_output_follows_on_the_controller_and_a_pin_that_is_not_there_is_rejected(
    wired: UrRobot, controller: UrController
) -> None:
    for pin in (0, 9, 17):  # one of each group
        wired.set_output(pin, False)
        others = controller.status()["outputs"]
        wired.set_output(pin, True)
        assert controller.status()["outputs"] == others | 1 << pin
        wired.set_output(pin, False)
        assert controller.status()["outputs"] == others
    for pin in (-1, 18):
        with pytest.raises(CommandRejected, match="no digital output"):
            wired.set_output(pin, True)


def test_inputs_are_read_by_their_number(wired: UrRobot, controller: UrController, stop: StopToken) -> None:
    controller.do("inputs", bits=1 << 16 | 1 << 3)
    stop.wait(0.05)
    assert [pin for pin in range(18) if wired.read_input(pin)] == [3, 16]
    controller.do("inputs", bits=0)


def test_software_does_not_clear_an_emergency_stop_of_the_wire(
    wired: UrRobot, controller: UrController, stop: StopToken
) -> None:
    controller.do("emergency_stop")
    try:
        stop.wait(0.05)
        with pytest.raises(CommandRejected, match="release the emergency stop"):
            wired.recover()
        with pytest.raises(SafetyStop):
            wired.move_joints(ELSEWHERE, QUICK, stop)
    finally:
        controller.do("release")
    wired.recover()  # a person let go of the button: power and brakes are software's
    wired.move_joints(HOME, QUICK, stop)


def test_after_a_safety_stop_on_the_way_the_old_motion_is_never_taken_up_again(
    wired: UrRobot, controller: UrController, stop: StopToken
) -> None:
    here = wired.state().tool
    controller.do("protective_stop", at={"moving_s": 0.2})
    with pytest.raises(SafetyStop):
        wired.move_line(replace(here, z=here.z - 0.1), CRAWL, stop)
    stopped_at = controller.status()["tcp"]
    wired.recover()
    stop.wait(0.3)
    assert controller.status()["tcp"] == pytest.approx(stopped_at, abs=1e-5)
    assert wired.state().tool.six() == pytest.approx(stopped_at, abs=1e-5)
    assert controller.status()["counts"].get("play", 0) == 0
    wired.move_joints(HOME, QUICK, stop)


# ------------------------------------------------------------------ a client of the simulated cell that dies

DYING_CLIENT = """
import sys
from drivers.robot.ur import UrRobot
from drivers.settings import SimRobotSettings
from drivers.sim.devices import SimRobot
from drivers.timing import MonotonicClock, StopToken
from drivers.types import JointAngles, JointMotion
clock = MonotonicClock()
robot = SimRobot("robot", SimRobotSettings(driver="sim", port=int(sys.argv[1])), clock)
robot.open()
print("open", flush=True)
target = JointAngles(q_rad=(-1.0, -1.9, 1.9, -1.5, -1.5, 3.7))
robot.move_joints(target, JointMotion(speed_rad_s=0.05, accel_rad_s2=1.0, timeout_s=60.0), StopToken(clock))
"""


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGSTOP])
def test_the_arm_halts_when_its_client_dies_or_freezes(
    cell: SimCell, stop: StopToken, end: signal.Signals
) -> None:
    command = [sys.executable, "-c", DYING_CLIENT, str(cell.port)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as client:
        assert client.stdout is not None
        client.stdout.readline()
        until = CLOCK.now() + 5.0
        while not cell.ask("status").flag("arm_moving") and CLOCK.now() < until:
            stop.wait(0.02)
        assert cell.ask("status").flag("arm_moving")
        client.send_signal(end)
        stop.wait(0.3 + 0.3)
        still_moving = cell.ask("status").flag("arm_moving")
        client.kill()
        client.wait(5.0)
    assert not still_moving


def test_when_the_process_is_gone_the_arm_is_unavailable(stop: StopToken) -> None:
    with sim_cell("--sticks", "0") as doomed:
        made = sim(doomed.port)
        made.open()
        doomed.process.kill()
        doomed.process.wait(5.0)
        with pytest.raises(DeviceUnavailable):
            made.move_joints(ELSEWHERE, QUICK, stop)
        made.close()
