"""The UR driver beside the bare library: age of state, order to motion, token to deceleration and to rest.

``python -m bench.arm [--moves 200] [--state-s 20]``

Both drive the simulated controller over its real ports. A third process reads the controller at 500 Hz and
notes when the arm begins to move, begins to brake, and stands; all processes share one monotonic clock. The
bare library is used as its manual says: asynchronous motions, stops from the thread that started them.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Protocol, cast

import numpy as np
import numpy.typing as npt

from bench import machine, tables
from drivers.robot.rtde import Connection, Kind
from drivers.robot.ur import UrRobot
from drivers.robot.ur_stream import Ageing
from drivers.settings import UrRobotSettings
from drivers.timing import MonotonicClock, StopRequested, StopToken
from drivers.types import LineMotion

Floats = npt.NDArray[np.float64]

COMMAND: Final = "python -m bench.arm"
ROOT: Final = Path(__file__).parents[1]
HOST: Final = "127.0.0.77"
START_Q: Final = (2.14, -1.92, 1.91, -1.56, -1.5708, 3.71)
TCP: Final = (0.0, 0.0, 0.165, 0.0, 0.0, 0.0)
MOTION: Final = LineMotion(speed_m_s=0.1, accel_m_s2=1.2, timeout_s=10.0)
STOP_M_S2: Final = 4.0
WAY_M: Final = 0.2
RUN_S: Final = 0.25
PAUSE_S: Final = 0.1
_STILL: Final = 1e-6
_BRAKES: Final = 0.98


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """One motion and its stop: monotonic instants at which each was asked for, and the stop's return."""

    moved_at: float
    stopped_at: float
    returned_at: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Run:
    """What one side did. ``ages_s`` (N,) of its state, sampled each ms."""

    orders: tuple[Order, ...]
    ages_s: Floats


@contextmanager
def controller() -> Iterator[None]:
    """A simulated controller at `HOST`."""
    command = [sys.executable, "-m", "drivers.sim.ur_controller", "--host", HOST]
    command += ["--start-q=" + ",".join(map(str, START_Q)), "--tcp=" + ",".join(map(str, TCP))]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            if json.loads(process.stdout.readline()).get("ready") is not True:
                raise SystemExit(f"the simulated controller does not start at {HOST}")
            yield
        finally:
            process.terminate()
            process.wait(5.0)


# --------------------------------------------------------------------------- the onlooker


def observe(path: str) -> None:
    """Write (arrival, tool speed m/s) of every frame until standard input ends."""
    connection = Connection(time.monotonic)
    connection.open(HOST, 2.0)
    recipe = connection.outputs(("target_TCP_speed",), 500.0, 2.0)
    connection.start(2.0)
    rows: list[tuple[float, float]] = []
    ended = threading.Event()

    def wait() -> None:
        sys.stdin.read()
        ended.set()

    threading.Thread(target=wait, daemon=True).start()
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    while not ended.is_set():
        for one in connection.receive(0.1):
            if one.kind == Kind.DATA:
                value = recipe.unpack(one.body)["target_TCP_speed"]
                assert isinstance(value, tuple)
                rows.append((time.monotonic(), float(np.linalg.norm(value[:3]))))
    connection.close()
    np.save(path, np.array(rows))


@contextmanager
def onlooker(path: Path) -> Iterator[None]:
    """A process that reads the controller as long as the context lasts."""
    command = [sys.executable, "-m", "bench.arm", "--observe", str(path)]
    with subprocess.Popen(
        command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            if process.stdout.readline().strip() != "ready":
                raise SystemExit("the onlooker does not start")
            yield
        finally:
            process.stdin.close()
            process.wait(20.0)


# --------------------------------------------------------------------------- the two sides


def ours(moves: int, state_s: float) -> Run:
    """The driver as the cell uses it; the token is fired by another thread."""
    clock = MonotonicClock()
    settings = UrRobotSettings(
        driver="ur",
        host=HOST,
        model="UR5e",
        tcp_m_rad=TCP,
        payload_kg=0.9,
        payload_cog_m=(0.0, 0.0, 0.05),
        tool_from="configuration",
        tool_box_min_m=(-0.8, -0.8, 0.0),
        tool_box_max_m=(0.8, 0.8, 0.9),
        stop_line_m_s2=STOP_M_S2,
    )
    robot = UrRobot("robot", settings, clock)
    robot.open()
    try:
        ageing = Ageing()
        ages: list[float] = []
        until = clock.now() + state_s
        while clock.now() < until:
            now = clock.now()
            ageing.came(robot.state().controller_time_s, now)
            ages.append(ageing.age_s(now))
            time.sleep(0.001)
        orders = [_ours_once(robot, clock, down) for down in _turns(moves)]
    finally:
        robot.close()
    return Run(orders=tuple(orders), ages_s=np.array(ages))


def _turns(moves: int) -> Iterator[bool]:
    return (number % 2 == 0 for number in range(moves))


def _ours_once(robot: UrRobot, clock: MonotonicClock, down: bool) -> Order:
    here = robot.state().tool
    target = replace(here, z=here.z + (-WAY_M if down else WAY_M))
    stop = StopToken(clock)
    fired: list[float] = []

    def fire() -> None:
        fired.append(clock.now())
        stop.stop("bench")

    firing = threading.Timer(RUN_S, fire)
    moved_at = clock.now()
    firing.start()
    try:
        robot.move_line(target, MOTION, stop)
    except StopRequested:
        returned_at = clock.now()
    else:
        raise SystemExit("a motion ended before its stop")
    firing.join()
    time.sleep(PAUSE_S)
    return Order(moved_at=moved_at, stopped_at=fired[0], returned_at=returned_at)


class _Receive(Protocol):
    """What is used of the library's receive interface."""

    def getTimestamp(self) -> float: ...
    def getActualTCPPose(self) -> list[float]: ...


class _Control(Protocol):
    """What is used of its control interface."""

    def moveL(self, pose: list[float], speed: float, acceleration: float, asynchronous: bool, /) -> bool: ...
    def stopL(self, a: float, asynchronous: bool, /) -> None: ...


class _ReceiveModule(Protocol):
    def RTDEReceiveInterface(self, hostname: str, frequency: float, /) -> _Receive: ...


class _ControlModule(Protocol):
    def RTDEControlInterface(self, hostname: str, frequency: float, /) -> _Control: ...


def bare(moves: int, state_s: float, path: str) -> None:
    """The library alone, in a process of its own that ends without its destructors."""
    import rtde_control
    import rtde_receive

    receive = cast(_ReceiveModule, rtde_receive).RTDEReceiveInterface(HOST, 125.0)
    control = cast(_ControlModule, rtde_control).RTDEControlInterface(HOST, 500.0)
    ageing = Ageing()
    ages: list[float] = []
    until = time.monotonic() + state_s
    while time.monotonic() < until:
        now = time.monotonic()
        ageing.came(receive.getTimestamp(), now)
        ages.append(ageing.age_s(now))
        time.sleep(0.001)
    rows = []
    for down in _turns(moves):
        target = list(receive.getActualTCPPose())
        target[2] += -WAY_M if down else WAY_M
        moved_at = time.monotonic()
        if not control.moveL(target, MOTION.speed_m_s, MOTION.accel_m_s2, True):
            raise SystemExit("the library refused a motion")
        time.sleep(max(0.0, moved_at + RUN_S - time.monotonic()))
        stopped_at = time.monotonic()
        control.stopL(STOP_M_S2, True)
        rows.append((moved_at, stopped_at, time.monotonic()))
        time.sleep(PAUSE_S + 0.1)
    np.savez(path, rows=np.array(rows), ages=np.array(ages))
    os._exit(0)


def bare_in_process(moves: int, state_s: float, folder: Path) -> Run:
    """Run `bare` and read what it noted."""
    path = folder / "bare.npz"
    command = [sys.executable, "-m", "bench.arm", "--bare", str(path)]
    command += ["--moves", str(moves), "--state-s", str(state_s)]
    subprocess.run(command, cwd=ROOT, check=True, timeout=120.0 + 2.0 * moves + state_s)
    with np.load(path) as noted:
        orders = tuple(
            Order(moved_at=float(m), stopped_at=float(s), returned_at=float(r)) for m, s, r in noted["rows"]
        )
        return Run(orders=orders, ages_s=np.array(noted["ages"]))


# --------------------------------------------------------------------------- what was seen


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reactions:
    """Seconds, one for each order (M,)."""

    to_motion_s: Floats
    to_braking_s: Floats
    to_rest_s: Floats
    to_return_s: Floats


def reactions(orders: Sequence[Order], seen: Floats) -> Reactions:
    """What the onlooker saw of each order; ``seen`` (N, 2) arrival and tool speed."""
    at, speed = seen[:, 0], seen[:, 1]
    rows: list[tuple[float, float, float, float]] = []
    for order in orders:
        moves = at[(at >= order.moved_at) & (speed > _STILL)]
        top = float(speed[(at >= order.moved_at) & (at < order.stopped_at)].max())
        brakes = at[(at >= order.stopped_at) & (speed < _BRAKES * top)]
        rests = at[(at >= order.stopped_at) & (speed <= _STILL)]
        rows.append(
            (
                float(moves[0]) - order.moved_at,
                float(brakes[0]) - order.stopped_at,
                float(rests[0]) - order.stopped_at,
                order.returned_at - order.stopped_at,
            )
        )
    found = np.array(rows)
    return Reactions(
        to_motion_s=found[:, 0], to_braking_s=found[:, 1], to_rest_s=found[:, 2], to_return_s=found[:, 3]
    )


def _row(what: str, side: str, seconds: Floats) -> tuple[str, ...]:
    p50, p99 = np.percentile(seconds, (50, 99))
    figures = (f"{1000 * value:.1f}" for value in (p50, p99, float(seconds.max())))
    return (what, side, str(len(seconds)), *figures)


def sheet(driver: Run, library: Run, seen: Floats) -> tables.Sheet:
    """Both sides, one below the other."""
    rows: list[tuple[str, ...]] = []
    judged = [("driver", driver, reactions(driver.orders, seen))]
    judged.append(("library alone", library, reactions(library.orders, seen)))
    rows += [_row("age of state", side, run.ages_s) for side, run, _ in judged]
    rows += [_row("order to motion", side, told.to_motion_s) for side, _, told in judged]
    rows += [_row("stop to braking", side, told.to_braking_s) for side, _, told in judged]
    rows += [_row("stop to rest", side, told.to_rest_s) for side, _, told in judged]
    rows += [_row("stop call returns", side, told.to_return_s) for side, _, told in judged]
    return tables.Sheet(
        title="UR arm: the driver beside ur-rtde alone, on the simulated controller",
        command=COMMAND,
        headings=("what", "side", "n", "p50 ms", "p99 ms", "max ms"),
        rows=tuple(rows),
        notes=(
            f"Lines at {MOTION.speed_m_s:g} m/s, braked at {STOP_M_S2:g} m/s2 after {RUN_S:g} s: braking "
            f"itself takes {1000 * MOTION.speed_m_s / STOP_M_S2:.0f} ms.",
            "Order and stop are the instants at which they were asked for: the driver's stop is a token "
            "fired by another thread, the library's a call of stopL. Motion, braking (2 % below speed) and "
            "rest are as a client at 500 Hz saw them. The driver's stop returns when the arm is seen to "
            "stand, the library's at once.",
            f"{machine.processor()}, load {machine.load()}.",
        ),
    )


def measure(moves: int, state_s: float, folder: Path) -> tables.Sheet:
    """All of it; about 0.5 s a move and side."""
    path = folder / "seen.npy"
    with controller(), onlooker(path):
        library = bare_in_process(moves, state_s, folder)
        time.sleep(0.5)  # its program ends
        _stop_program()
        driver = ours(moves, state_s)
    return sheet(driver, library, np.load(path))


def _stop_program() -> None:
    """What the library alone left running."""
    from drivers.robot.ur_dashboard import Dashboard

    with Dashboard("robot", HOST, MonotonicClock()) as panel:
        if panel.program_state()[0] != "STOPPED":
            panel.stop()
            time.sleep(0.3)


def main(argv: Sequence[str]) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog=COMMAND, description=__doc__.split("\n")[0])
    parser.add_argument("--moves", type=int, default=200)
    parser.add_argument("--state-s", type=float, default=20.0)
    parser.add_argument("--observe", help=argparse.SUPPRESS)
    parser.add_argument("--bare", help=argparse.SUPPRESS)
    options = parser.parse_args(argv)
    if options.observe:
        observe(options.observe)
        return 0
    if options.bare:
        bare(options.moves, options.state_s, options.bare)
    with tempfile.TemporaryDirectory() as folder:
        tables.show(measure(options.moves, options.state_s, Path(folder)))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
