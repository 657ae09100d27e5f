"""The driver's process dies or freezes in the middle of a motion: the arm soon stands, by itself."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.robot.ur import UrRobot
from drivers.timing import MonotonicClock, StopToken
from drivers.types import JointAngles, JointMotion
from tests.fakes.ur_controller import ROOT, START_Q, UrController, ur_controller

CLOCK = MonotonicClock()
STANDS_S = {signal.SIGKILL: 0.3, signal.SIGSTOP: 0.4}
"""A frozen driver is noticed by its lease, which is 0.2 s long."""
DRIVER = """
import sys
from drivers.robot.ur import UrRobot
from drivers.settings import UrRobotSettings
from drivers.timing import MonotonicClock, StopToken
from drivers.types import LineMotion
from dataclasses import replace
clock = MonotonicClock()
robot = UrRobot("robot", UrRobotSettings.model_validate_json(sys.argv[1]), clock)
robot.open()
print(robot.worker_pid, flush=True)
here = robot.state().tool
motion = LineMotion(speed_m_s=0.25, accel_m_s2=1.2, timeout_s=20.0)
robot.move_line(replace(here, z=here.z - 0.25), motion, StopToken(clock))
"""


@pytest.fixture
def controller() -> Iterator[UrController]:
    with ur_controller() as running:
        yield running


def _gone(pid: int, within_s: float) -> bool:
    ends_at = time.monotonic() + within_s
    while Path(f"/proc/{pid}").exists():
        if time.monotonic() > ends_at:
            return False
        time.sleep(0.01)
    return True


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "frozen"])
def test_the_arm_stands_when_its_driver_is_gone(controller: UrController, end: signal.Signals) -> None:
    settings = controller.settings()
    command = [sys.executable, "-c", DRIVER, settings.model_dump_json()]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as driver:
        try:
            assert driver.stdout is not None
            worker = int(next(line for line in driver.stdout if line.strip().isdigit()))
            ends_at = time.monotonic() + 10.0
            while controller.number("tool_speed_m_s") < 0.24:  # at full speed
                assert time.monotonic() < ends_at
                time.sleep(0.01)
            driver.send_signal(end)
            began_at = time.monotonic()
            while controller.moving:
                assert time.monotonic() - began_at < 2.0
                time.sleep(0.004)
            stood_s = time.monotonic() - began_at
            started = controller.number("moves_started")
            assert stood_s < STANDS_S[end]
            # the worker ends by itself, with nobody left to end it
            assert _gone(worker, 2.0) or _is_zombie(worker)
        finally:
            driver.kill()
            driver.wait(5.0)
    assert controller.status()["runtime"] == "STOPPED"
    print(f"{end.name}: the arm stood after {stood_s:.3f} s")  # noqa: T201 - a figure for whoever runs it with -s

    # a second driver starts afresh, and nothing has moved until it is told to
    robot = UrRobot("robot", settings, CLOCK)
    robot.open()
    try:
        assert controller.number("moves_started") == started
        motion = JointMotion(speed_rad_s=1.0, accel_rad_s2=2.0, timeout_s=10.0)
        robot.move_joints(JointAngles(q_rad=START_Q), motion, StopToken(CLOCK))
    finally:
        robot.close()


def _is_zombie(pid: int) -> bool:
    """A frozen parent cannot wait for its child; what matters is that it does not run."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def test_the_worker_ends_though_it_hangs_in_the_library_and_nobody_is_left_to_kill_it(
    controller: UrController,
) -> None:
    """The library's constructor holds the interpreter and waits for ever; the kernel's timer ends it."""
    code = (
        "import sys\n"
        "from drivers.robot import ur_worker\n"
        "ur_worker._START_GUARD_S = 1.0\n"
        "ur_worker.main(sys.argv[1:])\n"
    )
    controller.do("freeze", what="rtde")
    began_at = time.monotonic()
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with (
        ours,
        theirs,
        subprocess.Popen(
            [sys.executable, "-c", code, controller.host, "500", "65", str(theirs.fileno()), "0"],
            cwd=ROOT,
            stdin=subprocess.DEVNULL,
            pass_fds=[theirs.fileno()],
            stderr=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        ) as worker,
    ):
        try:
            assert worker.wait(5.0) == -signal.SIGALRM
        finally:
            worker.kill()
    assert time.monotonic() - began_at < 4.0
