"""A simulated UR controller on the wire, a process of its own.

    python -m drivers.sim.ur_controller --host 127.0.0.2 --model UR5e --fault-port 0

serves the ports of a real one on its loopback address: dashboard 29999, primary, secondary and real-time
30001 to 30003, RTDE 30004; and a fault port (`drivers.sim.ur_faults`). The first line on standard output
says it is ready; SIGTERM ends it, and the last line is what it counted. With ``--world-port`` its arm is the
arm of the simulated cell (`drivers.sim.ur_link`).

Only the standard library. One thread: sockets never block, the core is stepped between them.
"""

from __future__ import annotations

import argparse
import gc
import json
import math
import os
import re
import signal
import socket
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

from drivers.sim import arguments
from drivers.sim.ur_core import Core, Setup
from drivers.sim.ur_dashboard import Dashboard
from drivers.sim.ur_faults import Faults, status_values
from drivers.sim.ur_kinematics import MODELS, Six, six
from drivers.sim.ur_link import LinkDown, WorldLink, start_posture
from drivers.sim.ur_ports import Port, Ports
from drivers.sim.ur_program import STEP_S
from drivers.sim.ur_session import Owners
from drivers.sim.ur_talks import DASHBOARD, PRIMARY, REAL_TIME, RTDE, SECONDARY, Streams, make_ports

ENDING = (signal.SIGTERM, signal.SIGINT)
LONGEST_CATCH_UP_S = 1.0
"""After a standstill of the process at most this much real time is made up for; the rest never was."""
EXCUSED_S = 0.004
"""Longer standstills of this process do not count against its clients: a real controller has none."""
PRIORITY = 2
"""Of real time, where it may be had: a real controller has it. Above the driver's worker, which waits."""
FAULT = "fault"
WORLD_MODEL = "UR5e"


@dataclass(slots=True)
class Pacing:
    """Simulated steps by real time."""

    scale: float
    began_at: float
    steps: int = 0
    stride: int = 1  # steps from one waking to the next
    skipped_s: float = 0.0

    def owed(self, now: float) -> int:
        """Steps to do now."""
        owed = int((now - self.began_at) * self.scale / STEP_S) - self.steps
        most = max(1, int(LONGEST_CATCH_UP_S * self.scale / STEP_S))
        if owed > most:
            late_s = (owed - most) * STEP_S / self.scale
            self.skipped_s += late_s
            self.began_at += late_s
            owed = most
        self.steps += owed
        return owed

    def next_at(self) -> float:
        """When the next step is due."""
        return self.began_at + (self.steps + self.stride) * STEP_S / self.scale


class Machine:
    """Core, ports and faults of one controller, stepped by real time."""

    def __init__(
        self, setup: Setup, host: str, fault_port: int, seed: int, world: tuple[str, int] | None
    ) -> None:
        self.core = Core(setup)
        self.ports = Ports(host, seed)
        self.owners = Owners()
        self.streams = Streams(self.core, self.ports)
        self.standing = False  # the controller's own clock stands still
        made = make_ports(self.core, self.owners, Dashboard(self.core))
        self.faults = Faults(self.core, self.ports, self.owners, self)
        self.link = None if world is None else WorldLink(self.core, self.ports, *world)
        for port in (*made, Port(FAULT, fault_port, self.faults.talk)):
            self.ports.open(port)

    @property
    def fault_port(self) -> int:
        """The number of the fault port."""
        return self.ports.by_name[FAULT].number

    @property
    def world(self) -> str:
        """Whether the simulated cell is there."""
        if self.link is None:
            return "none"
        return "up" if self.link.up else "down"

    def close(self) -> None:
        """Ports and link."""
        if self.link is not None:
            self.link.close()
        self.ports.close()

    def run(self, ending: socket.socket) -> None:
        """Until somebody writes to ``ending``."""
        ended: list[bool] = []
        self.ports.watch(ending, lambda: ended.append(True))
        scale = self.core.setup.time_scale
        fast = scale > 1.0
        pacing = Pacing(scale, time.monotonic(), stride=max(1, round(scale)))
        while not ended:
            self.ports.serve(pacing.next_at() - time.monotonic(), time.monotonic)
            owed = pacing.owed(time.monotonic())
            late_s = (owed - pacing.stride) * STEP_S - EXCUSED_S
            if late_s > 0.0:
                self.core.was_late(late_s)
            for left in range(owed - 1, -1, -1):
                if not self.standing:
                    self.core.step()
                if left == 0 or not fast:
                    self.streams.step(time.monotonic())
            if owed:
                self.core.counts["skipped_ms"] = round(1e3 * pacing.skipped_s)
                self.ports.flush(time.monotonic())
                if self.link is not None:
                    self.link.step(time.monotonic())


def _version(text: str) -> tuple[int, int, int]:
    if re.fullmatch(r"\d{1,2}\.\d{1,2}\.\d{1,2}", text) is None:
        raise argparse.ArgumentTypeError(f"{text!r} is not a PolyScope version such as 5.15.0")
    major, minor, bugfix = map(int, text.split("."))
    return (major, minor, bugfix)


def _six(text: str) -> Six:
    try:
        values = [float(part) for part in text.split(",")]
        found = six(values)
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} is not six numbers with commas between") from error
    if not all(map(math.isfinite, found)):
        raise argparse.ArgumentTypeError(f"{text!r} has a number that is not finite")
    return found


def _options(argv: Sequence[str]) -> argparse.Namespace:
    parser = arguments.Parser(prog="python -m drivers.sim.ur_controller", description=__doc__.split("\n")[0])
    default = Setup()
    parser.add_argument("--host", default="127.0.0.2", help="one loopback address for each controller")
    parser.add_argument("--model", choices=sorted(MODELS), default=default.model)
    parser.add_argument("--polyscope", type=_version, default=default.polyscope, metavar="5.15.0")
    parser.add_argument("--serial", default=default.serial)
    parser.add_argument("--start-q", type=_six, default=default.start_q, metavar="Q1,...,Q6", help="rad")
    parser.add_argument("--tcp", type=_six, default=default.tcp, metavar="X,Y,Z,RX,RY,RZ")
    parser.add_argument("--payload", type=arguments.not_negative, default=default.payload_kg, help="kg")
    parser.add_argument("--fault-port", type=arguments.port, default=0, help="0: any free one")
    parser.add_argument(
        "--time-scale", type=arguments.positive, default=1.0, help="simulated seconds per real one"
    )
    parser.add_argument("--world-host", default="127.0.0.1", help="of the simulated cell")
    parser.add_argument("--world-port", type=arguments.port, help="its port: the arm is the cell's")
    parser.add_argument("--seed", type=arguments.count, default=0, help="of jitter")
    options = parser.parse_args(argv)
    if options.world_port is not None and options.model != WORLD_MODEL:
        parser.error(f"the simulated cell draws a {WORLD_MODEL}, it cannot be driven by a {options.model}")
    return options


def _ending_signals() -> socket.socket:
    """A socket that can be read once the process was asked to end."""
    reader, writer = socket.socketpair()
    reader.setblocking(False)
    writer.setblocking(False)
    for number in ENDING:
        signal.signal(number, lambda *_: None)
    signal.set_wakeup_fd(writer.detach())
    return reader


def _say(values: object) -> None:
    with suppress(BrokenPipeError):  # whoever started it may be gone already
        sys.stdout.write(json.dumps(values) + "\n")
        sys.stdout.flush()


def main(argv: Sequence[str]) -> int:
    """Exit codes: 0 asked to end, 2 wrong arguments or an address that is not free."""
    options = _options(argv)
    world = None if options.world_port is None else (options.world_host, options.world_port)
    try:
        start_q = options.start_q if world is None else start_posture(*world)
    except LinkDown as error:
        sys.stderr.write(f"simulated UR controller: {error}\n")
        return arguments.EXIT_USAGE
    setup = Setup(
        model=options.model,
        polyscope=options.polyscope,
        serial=options.serial,
        start_q=start_q,
        tcp=options.tcp,
        payload_kg=options.payload,
        time_scale=options.time_scale,
    )
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(PRIORITY))
    ending = _ending_signals()
    for number in (DASHBOARD, PRIMARY, SECONDARY, REAL_TIME, RTDE, options.fault_port):
        refused = arguments.refusal(options.host, number)
        if refused is not None:
            sys.stderr.write(f"simulated UR controller: {refused}\n")
            return arguments.EXIT_USAGE
    machine = Machine(setup, options.host, options.fault_port, options.seed, world)
    gc.collect()
    gc.freeze()  # nothing made so far is looked through again
    _say({"ready": True, "host": options.host, "fault_port": machine.fault_port})
    try:
        machine.run(ending)
    finally:
        machine.close()
        ending.close()
    _say({"ended": True, **status_values(machine.core)})
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
