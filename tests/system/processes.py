"""The daemon as a process of its own, a PLC the test moves by hand, and what a service manager hears.

The simulated cell as a process is in `tests.fakes.simcell`. Time is real here, because processes run side by
side; every wait ends by an event or by its limit.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

import yaml

from drivers.plc_map import next_sequence
from drivers.sim.plc import RegisterServer
from drivers.sim.plc_program import PlcProgram, Task
from drivers.timing import MonotonicClock
from drivers.types import PlcCommand, PlcInputs, PlcOutputs, ResultCode

Json: TypeAlias = "dict[str, Json] | list[Json] | str | float | int | bool | None"
Line: TypeAlias = dict[str, "Json"]

ROOT = Path(__file__).parents[2]
DEMO = ROOT / "configs" / "demo" / "cell.yaml"
SPEED = "8"
START_S = 30.0
POLL_S = 0.01
CLOCK = MonotonicClock()


def until(condition: Callable[[], bool], within_s: float, what: str) -> None:
    """Wait for a condition; the test fails when the time is over."""
    ends_at = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < ends_at, f"not within {within_s:g} s: {what}"
        time.sleep(POLL_S)


def write_config(
    folder: Path, sim_port: int, plc_port: int, *, overlays: bool = False, plc: Line | None = None
) -> Path:
    """The demo's configuration with these ports, its journal in ``folder``; ``plc`` instead of its own
    section."""
    data = yaml.safe_load(DEMO.read_text(encoding="utf-8"))
    for section in (data["cameras"]["left"], data["cameras"]["right"], data["robot"], data["gripper"]):
        section["port"] = sim_port
    data["plc"] = plc or data["plc"]
    data["plc"]["port"] = plc_port
    data["files"] = {"calibration": str(DEMO.parent / "calibration.json"), "journal": "journal.sqlite"}
    if overlays:
        data["files"]["overlays"] = "overlays"
    path = folder / "cell.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return path


# --------------------------------------------------------------------------- the daemon


class Daemon:
    """``python -m cell run CONFIG --json`` (or another command line) with its log as lines."""

    def __init__(self, config: Path, *, notify: Path | None = None, command: list[str] | None = None) -> None:
        environment = {k: v for k, v in os.environ.items() if k != "NOTIFY_SOCKET"}
        if notify is not None:
            environment["NOTIFY_SOCKET"] = str(notify)
        number = len(list(config.parent.glob("daemon-*.log"))) + 1
        self.log = config.parent / f"daemon-{number}.log"
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                [sys.executable, *(command or ["-m", "cell", "run", str(config), "--json"])],
                cwd=ROOT,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
            )
        self._seen = 0

    @property
    def pid(self) -> int:
        return self.process.pid

    def lines(self) -> list[Line]:
        """Every whole line so far; what is not JSON fails the test."""
        text = self.log.read_bytes()
        whole = text[: text.rfind(b"\n") + 1].decode()
        return [json.loads(line) for line in whole.splitlines()]

    def events(self, name: str) -> list[Line]:
        return [line for line in self.lines() if line["event"] == name]

    def wait_for(self, event: str, within_s: float = 20.0, **fields: Json) -> Line:
        """The next line, after the one waited for before, with this event and these fields."""
        ends_at = time.monotonic() + within_s
        while True:
            over = self.process.poll() is not None
            lines = self.lines()
            for number in range(self._seen, len(lines)):
                line = lines[number]
                if line["event"] == event and all(line.get(k) == v for k, v in fields.items()):
                    self._seen = number + 1
                    return line
            told = "\n".join(str(line) for line in lines[-12:])
            assert not over, f"the daemon ended ({self.process.returncode}) before {event} {fields}:\n{told}"
            assert time.monotonic() < ends_at, f"no {event} {fields} within {within_s:g} s:\n{told}"
            time.sleep(POLL_S)

    def started(self) -> Daemon:
        """After its devices are open and it has heard what the PLC says, or cannot hear it."""
        self.wait_for("state_changed", START_S, after="IDLE")
        return self

    def signal(self, number: int) -> None:
        self.process.send_signal(number)

    def kill(self) -> None:
        """As a power cut: no handler runs."""
        self.process.kill()
        self.process.wait(5.0)

    def terminate(self, within_s: float = 5.0) -> tuple[int, float]:
        """SIGTERM; exit code and how long the end took."""
        began_at = time.monotonic()
        self.process.terminate()
        code = self.process.wait(within_s)
        return code, time.monotonic() - began_at

    def cpu_fraction(self, over_s: float) -> float:
        """Share of one core used in the next ``over_s`` seconds."""

        def ticks() -> int:
            fields = Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()
            return int(fields[11]) + int(fields[12])

        before, began_at = ticks(), time.monotonic()
        time.sleep(over_s)
        used_s = (ticks() - before) / os.sysconf("SC_CLK_TCK")
        return used_s / (time.monotonic() - began_at)

    def end(self) -> None:
        """Whatever state it is in, it is gone afterwards."""
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait(5.0)


@contextmanager
def daemon(config: Path, *, notify: Path | None = None, command: list[str] | None = None) -> Iterator[Daemon]:
    """A daemon that has ended when the context ends."""
    running = Daemon(config, notify=notify, command=command)
    try:
        yield running
    finally:
        running.end()


# --------------------------------------------------------------------------- the PLC


class _HandProgram(PlcProgram):
    """No step chain: it counts its heartbeat, and everything else is the test's."""

    def __init__(self) -> None:
        super().__init__(Task(orders=None))
        self.lock = threading.Lock()
        self.writes: list[PlcOutputs] = []
        self.before_write: Callable[[PlcOutputs], bool] = lambda status: True
        self.standing = False

    def scan(self, now: float) -> None:
        if self.standing:
            return
        with self.lock:
            self.command = replace(self.command, heartbeat=(self.command.heartbeat + 1) & 0xFFFF)

    def cell_wrote(self, status: PlcOutputs, now: float) -> None:
        with self.lock:
            if not self.before_write(status):
                return
            self.writes.append(status)
            super().cell_wrote(status, now)


@dataclass(slots=True)
class HandPlc:
    """A Modbus TCP server with map v1 whose command block the test writes; every rule is checked."""

    port: int
    program: _HandProgram
    sequence: int = 0

    @property
    def status(self) -> PlcOutputs:
        with self.program.lock:
            return self.program.rules.status

    @property
    def violations(self) -> list[str]:
        with self.program.lock:
            return list(self.program.violations)

    def change(self, **fields: bool | int) -> None:
        """Write fields of the command block, all in one scan."""
        with self.program.lock:
            self.program.command = _changed(self.program.command, fields)

    def wait(self, condition: Callable[[PlcOutputs], bool], what: str, within_s: float = 15.0) -> PlcOutputs:
        """Wait until the cell's last written status is so."""
        ends_at = time.monotonic() + within_s
        while not condition(self.status):
            assert time.monotonic() < ends_at, (
                f"not within {within_s:g} s: {what}; the cell shows {self.status}"
            )
            time.sleep(POLL_S)
        return self.status

    @contextmanager
    def standing(self) -> Iterator[None]:
        """The program stands while the server still answers."""
        self.program.standing = True
        try:
            yield
        finally:
            self.program.standing = False

    def enable(self) -> None:
        """Low and high again, as after every loss of the link; returns when the cell is ready."""
        self.change(enable=False)
        seen = len(self.program.writes)
        until(lambda: len(self.program.writes) > seen + 1, 30.0, "the cell reads that enable is low")
        self.wait(lambda s: s.plc_link_ok and not s.ready, "link up while disabled")
        self.change(enable=True)
        self.wait(lambda s: s.ready, "ready")

    def reset(self) -> None:
        """A rising edge of the reset bit, each level long enough to be read."""
        for level in (False, True):
            self.change(reset_fault=level)
            seen = len(self.program.writes)
            until(lambda seen=seen: len(self.program.writes) > seen + 1, 10.0, "the cell reads the reset bit")  # type: ignore[misc]

    def order(self, command: PlcCommand = PlcCommand.PICK_AND_PLACE, attempts: int = 3) -> int:
        """Payload first, then the next sequence number; does not wait."""
        self.sequence = next_sequence(self.sequence)
        self.change(cmd_code=int(command), max_attempts=attempts)
        with self.program.lock:
            self.program.rules.ordered(self.sequence)
        self.change(cmd_seq=self.sequence)
        return self.sequence

    def result(self, sequence: int, within_s: float = 20.0) -> PlcOutputs:
        """Wait for the result of this order, take it and see it dropped."""

        def answered(status: PlcOutputs) -> bool:
            refused = status.accepted_seq == sequence and status.ack_code != 0
            assert not refused, f"order {sequence} was refused with {status.ack_code}"
            return status.result_valid and status.result_seq == sequence

        got = self.wait(answered, f"result of {sequence}", within_s)
        with self.program.lock:
            self.program.rules.acknowledged(sequence)
        self.change(result_ack_seq=sequence)
        self.wait(lambda s: not s.result_valid, f"result of {sequence} dropped")
        with self.program.lock:
            self.program.rules.closed()
        return got

    def run(self, command: PlcCommand = PlcCommand.PICK_AND_PLACE, attempts: int = 3) -> PlcOutputs:
        """One whole order."""
        return self.result(self.order(command, attempts))

    def empty(self, most_orders: int) -> list[ResultCode]:
        """Order picks until the cell reports an empty bin; the codes of all results."""
        codes = []
        for _ in range(most_orders):
            self.wait(lambda s: s.ready, "ready")
            got = self.run()
            codes.append(ResultCode(got.result_code))
            if got.result_code == ResultCode.NO_PART_FOUND and got.result_detail == 2:
                return codes
        raise AssertionError(f"not empty after {most_orders} orders: {codes}")


def _changed(command: PlcInputs, fields: dict[str, bool | int]) -> PlcInputs:
    return replace(command, **fields)  # type: ignore[arg-type]  # names of its fields


@contextmanager
def hand_plc(port: int = 0) -> Iterator[HandPlc]:
    """A PLC in a thread of the test; it has stopped listening when the context ends."""
    program = _HandProgram()
    server = RegisterServer(program, CLOCK, host="127.0.0.1", port=port)
    listening = threading.Event()
    ended = threading.Event()
    taken: list[int] = []

    async def serve() -> None:
        taken.append(await server.listen())
        listening.set()
        while not ended.is_set():
            program.scan(CLOCK.now())
            await asyncio.sleep(0.02)
        await server.close()

    thread = threading.Thread(target=lambda: asyncio.run(serve()), name="hand-plc")
    thread.start()
    try:
        assert listening.wait(10.0), "the PLC of the test does not listen"
        yield HandPlc(port=taken[0], program=program)
    finally:
        ended.set()
        thread.join(10.0)


# --------------------------------------------------------------------------- journal and service manager


@dataclass(frozen=True, slots=True, kw_only=True)
class OrderRow:
    """One order in the journal."""

    seq: int
    finished: bool
    code: int | None


def orders(folder: Path) -> list[OrderRow]:
    """The journal's orders, oldest first, read as another process reads it."""
    with closing(sqlite3.connect(f"file:{folder / 'journal.sqlite'}?mode=ro", uri=True)) as connection:
        rows = connection.execute("SELECT seq, finished_at IS NOT NULL, code FROM orders ORDER BY id")
        return [OrderRow(seq=int(seq), finished=bool(done), code=code) for seq, done, code in rows]


class NotifySocket:
    """The service manager's end of ``$NOTIFY_SOCKET``."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(path))
        self.messages: list[tuple[float, str]] = []

    def listen(self, seconds: float, end: str | None = None) -> list[str]:
        """What comes in the next ``seconds``, or until a message has the line ``end``."""
        ends_at = time.monotonic() + seconds
        got: list[str] = []
        while (left_s := ends_at - time.monotonic()) > 0:
            self._socket.settimeout(left_s)
            try:
                text = self._socket.recv(4096).decode()
            except TimeoutError:
                break
            self.messages.append((time.monotonic(), text))
            got += text.splitlines()
            if end is not None and end in got:
                return got
        assert end is None, f"no {end} within {seconds:g} s; heard {got}"
        return got

    def drain(self) -> list[str]:
        """What has come already."""
        got: list[str] = []
        self._socket.settimeout(0.0)
        while True:
            try:
                got += self._socket.recv(4096).decode().splitlines()
            except BlockingIOError:
                return got

    def close(self) -> None:
        self._socket.close()


@contextmanager
def notify_socket(path: Path) -> Iterator[NotifySocket]:
    """A bound socket, closed when the context ends."""
    manager = NotifySocket(path)
    try:
        yield manager
    finally:
        manager.close()


def freeze(process: subprocess.Popen[str]) -> None:
    """SIGSTOP, and wait until the kernel has really stopped it."""
    process.send_signal(signal.SIGSTOP)
    stat = Path(f"/proc/{process.pid}/stat")
    until(lambda: stat.read_text().rpartition(")")[2].split()[0] == "T", 2.0, "stopped")
