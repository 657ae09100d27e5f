"""The arm of the simulated cell alone: what only it can be asked, and a client of it that dies."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace

import pytest

from drivers.errors import (
    CommandRejected,
    DeviceUnavailable,
    SafetyStop,
    StaleData,
)
from drivers.sim.robot import SimRobot
from drivers.timing import StopToken
from tests.contract.arms import CLOCK, CRAWL, ELSEWHERE, FAR, HOME, LINE, QUICK, sim
from tests.fakes.simcell import ROOT, SimCell, sim_cell


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


# ------------------------------------------------------------------ a client of the simulated cell that dies

DYING_CLIENT = """
import sys
from drivers.robot.ur import UrRobot
from drivers.settings import SimRobotSettings
from drivers.sim.robot import SimRobot
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
