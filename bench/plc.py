"""How long an order of the PLC takes to be accepted, and to move the arm, stage by stage, in both roles.

``python -m bench.plc [--picks 20] [--crc]``

The daemon is a process of its own on the simulated cell, the bench is its PLC and scans every 10 ms. Every
order comes while the arm stands at home. Instants: the PLC's own, the daemon's log (wall clock, one
machine), and the arm's count of motions, asked for every 2 ms by an onlooker.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Final, Literal, Protocol, TypeAlias

import yaml

from bench import machine, tables
from drivers.plc_map import next_sequence
from drivers.sim.devices import Link
from drivers.sim.plc import RegisterServer
from drivers.sim.plc_client import CellRegisters
from drivers.sim.plc_program import PlcProgram, Task
from drivers.timing import MonotonicClock
from drivers.types import PlcCommand, PlcInputs, PlcOutputs

COMMAND: Final = "python -m bench.plc"
ROOT: Final = Path(__file__).parents[1]
DEMO: Final = ROOT / "configs" / "demo"
SCAN_S: Final = 0.01
WATCH_S: Final = 0.002
LIMIT_S: Final = 60.0
SPEED: Final = 4.0
STICKS: Final = 12
CLOCK: Final = MonotonicClock()

Role: TypeAlias = Literal["server", "client"]
"""The PLC's."""

STAGES: Final = (
    ("PLC edge to order journaled", "edge", "order_accepted"),
    ("journaled to accepted seen", "order_accepted", "seen"),
    ("= PLC edge to accepted", "edge", "seen"),
    ("journaled to cell at work", "order_accepted", "order_started"),
    ("at work to first motion sent", "order_started", "clear"),
    ("sent to arm's count of motions", "clear", "moved"),
    ("= PLC edge to first motion", "edge", "moved"),
    ("motion to look", "moved", "look"),
    ("look (rendered pictures)", "look", "find"),
    ("find (first certain)", "find", "plan"),
    ("plan", "plan", "fetch"),
    ("sent to arm's count of motions ", "fetch", "fetching"),
    ("= PLC edge to motion to part", "edge", "fetching"),
)


class Plc(Protocol):
    """A PLC of the bench, whichever role it has."""

    def swap(self, command: PlcInputs) -> PlcOutputs:
        """Show this command block; the status block as it is now."""
        ...

    def change_seen(self, accepted: Callable[[PlcOutputs], bool]) -> float | None:
        """When the status block was first so, where that is known better than by scanning."""
        ...


class PollingPlc:
    """The client."""

    def __init__(self, port: int) -> None:
        self._cell = CellRegisters("127.0.0.1", port)

    def swap(self, command: PlcInputs) -> PlcOutputs:
        return self._cell.swap(command)

    def change_seen(self, accepted: Callable[[PlcOutputs], bool]) -> float | None:
        del accepted  # it only knows what it has polled
        return None

    def close(self) -> None:
        self._cell.close()


class _Program(PlcProgram):
    """Keeps each status block with its instant; the bench writes the command block."""

    def __init__(self) -> None:
        super().__init__(Task(orders=None))
        self.written: list[tuple[float, PlcOutputs]] = []

    def cell_wrote(self, status: PlcOutputs, now: float) -> None:
        self.written.append((now, status))
        del self.written[:-200]


class ServingPlc:
    """The server, in a thread."""

    def __init__(self) -> None:
        self._program = _Program()
        self._listening = threading.Event()
        self._end = threading.Event()
        self.port = 0
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), name="bench-plc")
        self._thread.start()
        self._listening.wait(10.0)

    async def _serve(self) -> None:
        server = RegisterServer(self._program, CLOCK, host="127.0.0.1", port=0)
        self.port = await server.listen()
        self._listening.set()
        while not self._end.is_set():
            await asyncio.sleep(SCAN_S)
        await server.close()

    def swap(self, command: PlcInputs) -> PlcOutputs:
        self._program.command = command
        written = self._program.written[-1:]
        return written[0][1] if written else PlcOutputs(map_version=0)

    def change_seen(self, accepted: Callable[[PlcOutputs], bool]) -> float | None:
        return next((at for at, status in list(self._program.written) if accepted(status)), None)

    def close(self) -> None:
        self._end.set()
        self._thread.join(5.0)


class Orders:
    """The PLC's program: a heartbeat, and one order after the other."""

    def __init__(self, plc: Plc, crc: bool) -> None:
        self._plc = plc
        self.command = replace(PlcProgram(Task(orders=None)).command, max_attempts=3, crc_used=crc)
        self.status = PlcOutputs(map_version=0)

    def scan(self) -> None:
        beat = (self.command.heartbeat + 1) & 0xFFFF
        self.command = replace(self.command, heartbeat=beat)
        self.status = self._plc.swap(self.command)

    def until(self, so: Callable[[PlcOutputs], bool], what: str) -> float:
        """Scan until the status is so; the instant at which it was seen."""
        ends_at = CLOCK.now() + LIMIT_S
        while True:
            self.scan()
            now = CLOCK.now()
            if so(self.status):
                return now
            if now > ends_at:
                raise TimeoutError(f"not within {LIMIT_S:g} s: {what}; the cell shows {self.status}")
            time.sleep(SCAN_S)

    def enable(self) -> None:
        self.until(lambda s: s.plc_link_ok, "link")
        self.command = replace(self.command, enable=True)
        self.until(lambda s: s.ready, "ready")

    def order(self, command: PlcCommand) -> tuple[float, float, PlcOutputs]:
        """Instants of the edge and of "accepted", and the result."""
        self.until(lambda s: s.ready, "ready")
        sequence = next_sequence(self.command.cmd_seq)
        self.command = replace(self.command, cmd_code=int(command), recipe=1, cmd_seq=sequence)
        edge_at = CLOCK.now()
        seen_at = self.until(lambda s: s.accepted_seq == sequence, "accepted")
        exact = self._plc.change_seen(lambda s: s.accepted_seq == sequence)
        if self.status.ack_code:
            raise RuntimeError(f"order {sequence} refused with {self.status.ack_code}")
        self.until(lambda s: s.result_valid and s.result_seq == sequence, "result")
        result = self.status
        self.command = replace(self.command, result_ack_seq=sequence)
        self.until(lambda s: not s.result_valid, "result dropped")
        return edge_at, seen_at if exact is None else exact, result


class Onlooker:
    """Notes when the arm's count of motions rises."""

    def __init__(self, port: int) -> None:
        self._link = Link("onlooker", "127.0.0.1", port, CLOCK)
        self._link.open()
        self.rises: list[float] = []
        self._add = 0
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="onlooker")
        self._thread.start()

    def add(self, count: int) -> None:
        """More sticks into the tray."""
        self._add = count

    def _run(self) -> None:
        last = self._link.ask("status", {}, 5.0).whole("motions")
        while not self._end.wait(WATCH_S):
            count = self._link.ask("status", {}, 5.0).whole("motions")
            if count != last:
                self.rises.append(CLOCK.now())
                last = count
            if self._add:
                self._link.ask("add_sticks", {"count": self._add}, 5.0)
                self._add = 0

    def close(self) -> None:
        self._end.set()
        self._thread.join(5.0)
        self._link.close()


@dataclass(slots=True)
class Daemon:
    """``mikado run`` with its log."""

    process: subprocess.Popen[bytes]
    log: Path

    def events(self, since: float, until: float) -> dict[str, float]:
        """First instant of each event and stage between two monotonic instants."""
        wall = time.time() - CLOCK.now()
        found: dict[str, float] = {}
        for line in self.log.read_text(encoding="utf-8").splitlines():
            entry = json.loads(line)
            at = datetime.fromisoformat(entry["timestamp"]).timestamp() - wall
            if since - 0.001 <= at <= until:
                name = entry["stage"] if entry["event"] == "stage_begun" else entry["event"]
                found.setdefault(str(name), at)
        return found


@contextmanager
def simulated_cell() -> Iterator[int]:
    """The simulated cell; its port."""
    command = [sys.executable, "-m", "drivers.sim.cell", "--world", str(DEMO / "world.yaml"), "--port", "0"]
    command += ["--speed", str(SPEED), "--seed", "7", "--sticks", str(STICKS)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield int(json.loads(process.stdout.readline())["port"])
        finally:
            process.terminate()
            process.wait(5.0)


@contextmanager
def daemon(folder: Path, cell_port: int, plc: dict[str, object]) -> Iterator[Daemon]:
    """A daemon on this cell, with this PLC section."""
    data = yaml.safe_load((DEMO / "cell.yaml").read_text(encoding="utf-8"))
    for section in (data["cameras"]["left"], data["cameras"]["right"], data["robot"], data["gripper"]):
        section["port"] = cell_port
    data["plc"] = plc
    data["files"] = {"calibration": str(DEMO / "calibration.json"), "journal": str(folder / "journal.sqlite")}
    config, log = folder / "cell.yaml", folder / "daemon.log"
    config.write_text(yaml.safe_dump(data), encoding="utf-8")
    with log.open("wb") as out:
        process = subprocess.Popen(
            [sys.executable, "-m", "cell", "run", str(config), "--json"], cwd=ROOT, stdout=out, stderr=out
        )
    try:
        yield Daemon(process=process, log=log)
    finally:
        process.terminate()
        process.wait(10.0)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def measure(role: Role, picks: int, crc: bool) -> list[dict[str, float]]:
    """Instants of each order, by name."""
    with tempfile.TemporaryDirectory() as name, simulated_cell() as cell_port:
        folder = Path(name)
        plc: PollingPlc | ServingPlc
        section: dict[str, object]
        if role == "client":
            port = _free_port()
            plc = PollingPlc(port)
            section = {"driver": "modbus_server", "bind": "127.0.0.1", "port": port, "peers": ["127.0.0.1"]}
        else:
            plc = ServingPlc()
            section = {"driver": "modbus", "host": "127.0.0.1", "port": plc.port}
        onlooker = Onlooker(cell_port)
        try:
            with daemon(folder, cell_port, section) as running:
                _wait_for_log(running, "state_changed")
                return _orders(Orders(plc, crc), running, onlooker, picks)
        finally:
            onlooker.close()
            plc.close()


def _wait_for_log(running: Daemon, event: str) -> None:
    ends_at = CLOCK.now() + LIMIT_S
    while f'"{event}"' not in running.log.read_text(encoding="utf-8"):
        if CLOCK.now() > ends_at or running.process.poll() is not None:
            raise RuntimeError(running.log.read_text(encoding="utf-8"))
        time.sleep(0.05)


def _orders(plc: Orders, running: Daemon, onlooker: Onlooker, picks: int) -> list[dict[str, float]]:
    found: list[dict[str, float]] = []
    left = STICKS
    plc.enable()
    while len(found) < picks:
        if left < 5:
            onlooker.add(STICKS - left)
            left = STICKS
        plc.order(PlcCommand.HOME)
        edge_at, seen_at, result = plc.order(PlcCommand.PICK_AND_PLACE)
        left -= result.quantity
        ended_at = CLOCK.now()
        instants = {**running.events(edge_at, ended_at), "edge": edge_at, "seen": seen_at}
        for name, since in (("moved", edge_at), ("fetching", instants.get("fetch", math.inf))):
            moved = [at for at in onlooker.rises if since <= at <= ended_at]
            if moved:
                instants[name] = moved[0]
        found.append(instants)
    return found


def _quantile(values: Sequence[float], share: float) -> float:
    ordered = sorted(values)
    return ordered[max(0, math.ceil(share * len(ordered)) - 1)] if ordered else math.nan


def sheet(picks: int, crc: bool) -> tables.Sheet:
    """Both roles side by side."""
    roles: tuple[tuple[Role, str], ...] = (("server", "cell polls"), ("client", "PLC polls"))
    before = machine.load()
    measured = {role: measure(role, picks, crc) for role, _ in roles}
    rows = []
    for title, begin, end in STAGES:
        cells = [title]
        for role, _ in roles:
            spans = [1000.0 * (o[end] - o[begin]) for o in measured[role] if begin in o and end in o]
            cells += [
                str(len(spans)),
                tables.milliseconds(_quantile(spans, 0.5)),
                tables.milliseconds(_quantile(spans, 0.99)),
            ]
        rows.append(tuple(cells))
    return tables.Sheet(
        title="An order of the PLC, ms",
        command=f"{COMMAND} --picks {picks}" + " --crc" * crc,
        headings=("stage", *(f"{name}{what}" for _, name in roles for what in (" n", " p50", " p99"))),
        rows=tuple(rows),
        notes=(
            f"PLC scan {1000 * SCAN_S:g} ms, the cell's exchange every 50 ms. An order counts when two "
            "exchanges show the same, with a check word (--crc) at the first. The simulated eyes render "
            f"their pictures, most of the look; motions run {SPEED:g} times as fast, commands do not.",
            f"{machine.processor()}, load {before} before and {machine.load()} after.",
        ),
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table."""
    options = argparse.ArgumentParser(prog=COMMAND, description=__doc__)
    options.add_argument("--picks", type=int, default=20, help="orders per role")
    options.add_argument("--crc", action="store_true", help="orders carry a check word")
    arguments = options.parse_args(argv)
    tables.show(sheet(arguments.picks, arguments.crc))
    return 0


if __name__ == "__main__":
    sys.exit(main())
