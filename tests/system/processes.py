"""The daemon as a process of its own, its journal, and what a service manager hears.

The simulated cell as a process is in `tests.fakes.simcell`, a PLC moved by hand in `tests.system.handplc`.
Time is real here, because processes run side by side; every wait ends by an event or by its limit.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import yaml

Json: TypeAlias = "dict[str, Json] | list[Json] | str | float | int | bool | None"
Line: TypeAlias = dict[str, "Json"]

ROOT = Path(__file__).parents[2]
DEMO = ROOT / "configs" / "demo" / "cell.yaml"
SPEED = "8"
START_S = 30.0
POLL_S = 0.01


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
