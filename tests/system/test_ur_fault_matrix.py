"""Every fault of a UR arm over the wire, while it rests, on its way down, and with a part in the hand.

Each time: the reaction is bounded, the fault has its code, the arm stands, nothing moves without a new order
(the controller's own counters), an output that holds a part stays on, no process is left behind, and a reset
leads back where one may. The figures are printed at the end.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from cell.faults import FaultCode, fault_of
from drivers.errors import DriverError, SafetyStop
from drivers.robot.ur import UrRobot
from drivers.timing import MonotonicClock, StopToken
from drivers.types import JointAngles, JointMotion, LineMotion, SafetyMode
from tests.fakes.ur_controller import START_Q, Json, UrController, ur_controller

CLOCK = MonotonicClock()
HOME = JointAngles(q_rad=START_Q)
QUICK = JointMotion(speed_rad_s=2.0, accel_rad_s2=4.0, timeout_s=10.0)
DOWN = LineMotion(speed_m_s=0.1, accel_m_s2=0.5, timeout_s=2.5)
DEPTH_M = 0.15
GRIPPER = 0
UNDER_WAY_S = 0.3
STANDS_S = 0.6
"""From the fault until the arm stands, at most: 0.25 s to notice silence, the watchdog, the deceleration."""
TOLD_S = 1.5
QUIET_S = 0.4
ALL: list[Json] = [29999, 30001, 30002, 30003, 30004]
IDLE, APPROACH, CARRYING = "idle", "approach", "carrying"


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """What is done to the controller or the worker, and which code must come of it.

    ``idle`` None: nothing is wrong as long as the arm rests. ``undo`` is what a person or time does before
    the reset. Where the fault leaves the motion alone it ends by its time limit, so ``stands_s`` is longer.
    """

    name: str
    do: Callable[[UrController, UrRobot], None]
    code: FaultCode
    idle: FaultCode | None
    undo: Callable[[UrController], None] = lambda controller: controller.mend()
    stands_s: float = STANDS_S
    told_s: float = TOLD_S


def _cut(how: str) -> Callable[[UrController, UrRobot], None]:
    return lambda controller, _: controller.do("cut", ports=[30004], how=how)


def _gone(controller: UrController, _: UrRobot) -> None:
    controller.do("refuse", ports=ALL)
    controller.do("cut", ports=ALL, how="rst")


def _freeze(what: str) -> Callable[[UrController, UrRobot], None]:
    return lambda controller, _: controller.do("freeze", what=what)


def _simply(doing: str, /, **values: object) -> Callable[[UrController, UrRobot], None]:
    return lambda controller, _: controller.do(doing, **values)


def _signal(number: signal.Signals) -> Callable[[UrController, UrRobot], None]:
    def do(_: UrController, robot: UrRobot) -> None:
        pid = robot.worker_pid
        assert pid is not None
        os.kill(pid, number)

    return do


def _released(controller: UrController) -> None:
    controller.do("release")
    controller.mend()


C = FaultCode
FAULTS = (
    Fault(name="RTDE cut, RST", do=_cut("rst"), code=C.ROBOT_LOST, idle=C.ROBOT_LOST),
    Fault(name="RTDE cut, FIN", do=_cut("fin"), code=C.ROBOT_LOST, idle=C.ROBOT_LOST),
    Fault(name="controller gone", do=_gone, code=C.ROBOT_LOST, idle=C.ROBOT_LOST),
    Fault(name="RTDE frozen", do=_freeze("rtde"), code=C.ROBOT_STALE, idle=C.ROBOT_STALE),
    Fault(name="all frozen", do=_freeze("all"), code=C.ROBOT_STALE, idle=C.ROBOT_STALE),
    Fault(name="its clock stands", do=_freeze("clock"), code=C.ROBOT_STALE, idle=C.ROBOT_STALE),
    Fault(name="half a frame", do=_simply("half_frame"), code=C.ROBOT_STALE, idle=C.ROBOT_STALE),
    Fault(
        name="RTDE 1 s late", do=_simply("delay", what="rtde", s=1.0), code=C.ROBOT_STALE, idle=C.ROBOT_STALE
    ),
    Fault(
        name="protective stop", do=_simply("protective_stop"), code=C.PROTECTIVE_STOP, idle=C.PROTECTIVE_STOP
    ),
    Fault(
        name="safeguard stop",
        do=_simply("safeguard"),
        code=C.SAFEGUARD_STOP,
        idle=C.SAFEGUARD_STOP,
        undo=_released,
    ),
    Fault(
        name="emergency stop",
        do=_simply("emergency_stop"),
        code=C.EMERGENCY_STOP,
        idle=C.EMERGENCY_STOP,
        undo=_released,
    ),
    Fault(name="program killed", do=_simply("kill_program"), code=C.MOVE_REJECTED, idle=C.MOVE_REJECTED),
    Fault(name="worker SIGSEGV", do=_signal(signal.SIGSEGV), code=C.ROBOT_LOST, idle=C.ROBOT_LOST),
    Fault(name="worker hangs", do=_signal(signal.SIGSTOP), code=C.MOVE_REJECTED, idle=C.MOVE_REJECTED),
    Fault(
        name="slow motion",
        do=_simply("slow", factor=0.02),
        code=C.ROBOT_SLOW,
        idle=None,
        stands_s=3.5,
        told_s=3.5,
    ),
    Fault(
        name="speed slider 0",
        do=_simply("speed_slider", fraction=0.0),
        code=C.ROBOT_SLOW,
        idle=None,
        stands_s=3.5,
        told_s=3.5,
    ),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """One row of what is printed."""

    fault: str
    when: str
    code: str
    told_s: float
    stood_s: float
    back_s: float


@pytest.fixture(scope="module")
def figures(request: pytest.FixtureRequest) -> Iterator[list[Figures]]:
    rows: list[Figures] = []
    yield rows
    reporter = request.config.pluginmanager.get_plugin("terminalreporter")
    if reporter is None:
        return
    reporter.write_line("")
    reporter.write_line(f"{'fault':<18} {'when':<9} {'code':<16} {'told':>7} {'stands':>7} {'back':>7}   s")
    for row in rows:
        reporter.write_line(
            f"{row.fault:<18} {row.when:<9} {row.code:<16} {row.told_s:7.3f} {row.stood_s:7.3f} "
            f"{row.back_s:7.2f}"
        )


@pytest.fixture(scope="module")
def controller() -> Iterator[UrController]:
    with ur_controller() as running:
        yield running


@pytest.fixture
def robot(controller: UrController) -> Iterator[UrRobot]:
    controller.mend()
    made = UrRobot("robot", controller.settings(), CLOCK)
    made.open()
    try:
        made.move_joints(HOME, QUICK, StopToken(CLOCK))
        yield made
    finally:
        made.close()


class _Arm(threading.Thread):
    """Watches the controller's own word on its arm, from the fault on, over the fault port."""

    def __init__(self, controller: UrController) -> None:
        super().__init__()
        self.controller = controller
        self.began_at = time.monotonic()
        self.stood_at: float | None = None

    def run(self) -> None:
        before_m = -1.0
        while time.monotonic() - self.began_at < 5.0:
            status = self.controller.status()
            # where its clock stands, speeds keep their last value and the arm stands all the same
            if status["moving"] is not True or status["distance_m"] == before_m:
                self.stood_at = time.monotonic()
                return
            moved_m = status["distance_m"]
            assert isinstance(moved_m, int | float)
            before_m = moved_m
            time.sleep(0.01)

    @property
    def stood_s(self) -> float:
        self.join()
        assert self.stood_at is not None, "the arm never stood"
        return self.stood_at - self.began_at


def children() -> dict[int, str]:
    """Our child processes and their states; Z is a zombie."""
    found: dict[int, str] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == os.getpid():
            found[int(stat.parent.name)] = fields[0]
    return found


def reset(robot: UrRobot) -> None:
    """What the cell's loop does on a reset edge."""
    try:
        robot.recover()
    finally:
        robot.close()
    robot.open()


def _nothing_moves(controller: UrController) -> None:
    before = controller.number("moves_started"), controller.number("distance_m")
    time.sleep(QUIET_S)
    assert (controller.number("moves_started"), controller.number("distance_m")) == before


def _back(controller: UrController, robot: UrRobot, fault: Fault, started: float) -> float:
    """Undo, reset, and see that nothing moves until the next order, which works."""
    fault.undo(controller)
    began_at = time.monotonic()
    reset(robot)
    took_s = time.monotonic() - began_at
    assert controller.number("moves_started") == started
    assert robot.state().safety is SafetyMode.NORMAL
    robot.move_joints(HOME, QUICK, StopToken(CLOCK))
    assert robot.state().joints.q_rad == pytest.approx(START_Q, abs=1e-3)
    assert controller.number("moves_started") == started + 1
    return took_s


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_at_rest(fault: Fault, controller: UrController, robot: UrRobot, figures: list[Figures]) -> None:
    started = controller.number("moves_started")
    fault.do(controller, robot)
    began_at = time.monotonic()
    code = _idle_code(robot, began_at + TOLD_S)
    told_s = time.monotonic() - began_at
    assert code is fault.idle
    assert not controller.moving
    _nothing_moves(controller)
    back_s = _back(controller, robot, fault, started)
    name = "-" if code is None else code.name
    figures.append(Figures(fault=fault.name, when=IDLE, code=name, told_s=told_s, stood_s=0.0, back_s=back_s))
    assert "Z" not in children().values()


def _idle_code(robot: UrRobot, until: float) -> FaultCode | None:
    """What the cell's health check would make a fault of; None when all is well until the time is over."""
    while time.monotonic() < until:
        try:
            state = robot.state()
        except DriverError as error:
            return fault_of(error).code
        if state.safety is not SafetyMode.NORMAL:
            return fault_of(SafetyStop("robot", state.safety)).code
        if not state.program_running:
            return FaultCode.MOVE_REJECTED
        time.sleep(0.02)
    return None


@pytest.mark.parametrize("when", [APPROACH, CARRYING])
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_under_way(
    fault: Fault, when: str, controller: UrController, robot: UrRobot, figures: list[Figures]
) -> None:
    robot.set_output(GRIPPER, when == CARRYING)
    started = controller.number("moves_started")
    here = robot.state().tool
    target = replace(here, z=here.z - DEPTH_M)
    arms: list[_Arm] = []

    def strike() -> None:
        assert controller.moving
        fault.do(controller, robot)
        arms.append(_Arm(controller))
        arms[0].start()

    striking = threading.Timer(UNDER_WAY_S, strike)
    striking.start()
    with pytest.raises(DriverError) as caught:
        robot.move_line(target, DOWN, StopToken(CLOCK))
    told_at = time.monotonic()
    striking.join()
    stood_s = arms[0].stood_s
    assert fault_of(caught.value).code is fault.code, str(caught.value)
    assert stood_s < fault.stands_s
    assert told_at - arms[0].began_at < fault.told_s
    status = controller.status()
    tool = status["tcp"]
    assert isinstance(tool, list)
    assert isinstance(tool[2], float)
    assert tool[2] > target.z + 0.01, "the arm went on"
    assert status["moves_started"] == started + 1
    _nothing_moves(controller)
    outputs = controller.status()["outputs"]
    assert isinstance(outputs, int)
    assert bool(outputs >> GRIPPER & 1) is (when == CARRYING)
    back_s = _back(controller, robot, fault, started + 1)
    figures.append(
        Figures(
            fault=fault.name,
            when=when,
            code=fault_of(caught.value).code.name,
            told_s=told_at - arms[0].began_at,
            stood_s=stood_s,
            back_s=back_s,
        )
    )
    assert "Z" not in children().values()
