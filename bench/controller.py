"""What the simulated UR controller costs, and whether it keeps time: beside the unmodified ur-rtde.

``python -m bench.controller [--host 127.0.0.7] [--repeats 5]``

The controller runs as a process of its own; ur-rtde's control and receive interfaces, 500 Hz each, are its
clients. Durations are measured here, on this side of the library; shares of a core by the system's account.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

from bench import tables

ROOT = Path(__file__).parents[1]
LOOK_S = 5.0
LINE_M, SPEED_M_S, ACCEL_M_S2 = 0.1, 0.25, 1.2
STOPS = ((0.05, 2.0), (0.1, 2.0), (0.25, 2.0), (0.25, 10.0))
"""Speed, m/s, and deceleration, m/s2."""
SETTLE_S = 0.1


@dataclass(slots=True)
class Controller:
    """A running one."""

    host: str
    fault_port: int
    process: subprocess.Popen[str]

    def number(self, key: str) -> float:
        """One figure of its status."""
        with socket.create_connection((self.host, self.fault_port), timeout=5.0) as connection:
            connection.sendall(b'{"do": "status"}\n')
            status = json.loads(connection.makefile("rb").readline())
        return float(status["counts"][key] if key in status["counts"] else status[key])

    def processor_s(self) -> float:
        """Time it has had on a core."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def shares(self, over_s: float) -> tuple[float, float, float]:
        """Share of a core, simulated seconds per real one, and real milliseconds it left out because the
        machine gave it no core for more than 0.1 s, over a stretch of real time.
        """
        skipped_ms = self.number("skipped_ms")
        began_s, began, began_at = self.number("time_s"), self.processor_s(), time.monotonic()
        time.sleep(over_s)
        now_s, passed_s = self.number("time_s"), time.monotonic() - began_at
        share = (self.processor_s() - began) / passed_s
        return share, (now_s - began_s) / passed_s, self.number("skipped_ms") - skipped_ms


@contextmanager
def controller(host: str) -> Iterator[Controller]:
    """Started, and ended in the end."""
    command = [sys.executable, "-m", "drivers.sim.ur_controller", "--host", host]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        if process.stdout is None:
            raise RuntimeError("no output of the controller")
        ready = json.loads(process.stdout.readline())
        try:
            yield Controller(host=host, fault_port=int(ready["fault_port"]), process=process)
        finally:
            process.terminate()
            process.wait(10.0)


def higher(pose: list[float], dz: float) -> list[float]:
    """The same pose further up."""
    return [pose[0], pose[1], pose[2] + dz, *pose[3:]]


def costs(ur: Controller) -> Iterator[tuple[str, str, str, str]]:
    """Rows of the table of costs: alone, with clients, with clients and a motion."""

    def row(what: str) -> tuple[str, str, str, str]:
        share, pace, skipped_ms = ur.shares(LOOK_S)
        return what, tables.percent(share), tables.number(pace, 4), tables.number(skipped_ms, 0)

    ur.shares(SETTLE_S)  # past its start
    yield row("nobody connected")
    control, receive = RTDEControlInterface(ur.host, 500.0), RTDEReceiveInterface(ur.host, 500.0)
    try:
        yield row("ur-rtde connected, arm at rest")
        start = receive.getActualTCPPose()
        control.moveL(higher(start, -0.25), 0.25 / (LOOK_S + 1.0), 1.0, True)
        yield row("ur-rtde connected, arm on a line")
        control.stopL(2.0)
    finally:
        control.disconnect()
        receive.disconnect()


def motions(ur: Controller, repeats: int) -> Iterator[tuple[str, str, str, str]]:
    """Rows of the table of motions: how long a line takes, how far a stop goes."""
    control, receive = RTDEControlInterface(ur.host, 500.0), RTDEReceiveInterface(ur.host, 500.0)
    try:
        start = receive.getActualTCPPose()

        def line_s() -> float:
            control.moveL(start, SPEED_M_S, ACCEL_M_S2)
            began_at = time.monotonic()
            control.moveL(higher(start, LINE_M), SPEED_M_S, ACCEL_M_S2)
            return time.monotonic() - began_at

        wanted_s = LINE_M / SPEED_M_S + SPEED_M_S / ACCEL_M_S2
        what = f"line of {1e3 * LINE_M:.0f} mm at {SPEED_M_S:g} m/s, {ACCEL_M_S2:g} m/s², ms"
        yield _row(what, [1e3 * line_s() for _ in range(repeats)], 1e3 * wanted_s, tables.milliseconds)
        for speed, decel in STOPS:

            def stop_mm(speed: float = speed, decel: float = decel) -> float:
                control.moveL(start, SPEED_M_S, ACCEL_M_S2)
                control.moveL(higher(start, -0.3), speed, ACCEL_M_S2, True)
                time.sleep(speed / ACCEL_M_S2 + SETTLE_S)
                before_m = ur.number("distance_m")
                control.stopL(decel)
                time.sleep(SETTLE_S)
                return 1e3 * (ur.number("distance_m") - before_m)

            what = f"stop from {speed:g} m/s with {decel:g} m/s², mm"
            wanted_mm = 1e3 * speed * speed / (2.0 * decel)
            yield _row(what, [stop_mm() for _ in range(repeats)], wanted_mm, tables.number)
    finally:
        control.disconnect()
        receive.disconnect()


def _row(
    what: str, found: list[float], wanted: float, text: Callable[[float], str]
) -> tuple[str, str, str, str]:
    return what, text(statistics.median(found)), text(max(found)), text(wanted)


def main() -> int:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--host", default="127.0.0.7")
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    command = "python -m bench.controller"
    with controller(options.host) as ur:
        tables.show(
            tables.Sheet(
                title="The simulated UR controller: what it costs",
                command=command,
                headings=("state", "% of a core", "simulated s / s", "left out, ms"),
                rows=tuple(costs(ur)),
                notes=("Left out: the machine gave the controller no core for more than 0.1 s.",),
            )
        )
        tables.show(
            tables.Sheet(
                title="The simulated UR controller: motions as ur-rtde sees them",
                command=command,
                headings=("motion", "median", "largest", "by its profile"),
                rows=tuple(motions(ur, options.repeats)),
                notes=(
                    "A stop's way counts from the order on this side of the library, a line's time from call "
                    "to return: both hold the library's round trip.",
                ),
            )
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
