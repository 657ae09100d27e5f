"""The demo's processes: started, listened to, ended."""

from __future__ import annotations

import json
import os
import selectors
import signal
import socket
import subprocess
import sys
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Final, TypeAlias

from cell.errors import UsageError
from drivers.timing import MonotonicClock

Json: TypeAlias = "dict[str, Json] | list[Json] | str | float | int | bool | None"
Line: TypeAlias = dict[str, "Json"]

START_S: Final = 30.0
END_S: Final = 6.0
UR_PORTS: Final = (29999, 30001, 30002, 30003, 30004)


@dataclass(slots=True)
class Child:
    """A process whose standard output is JSON lines, kept whole in a log file."""

    name: str
    process: subprocess.Popen[bytes]
    log: IO[bytes]
    rest: bytes = b""
    over: bool = False

    def read(self) -> list[Line]:
        """The lines that have come; what is not JSON is only kept in the log."""
        assert self.process.stdout is not None
        data = os.read(self.process.stdout.fileno(), 65536)
        if not data:
            self.over = True
        self.log.write(data)
        self.log.flush()
        *whole, self.rest = (self.rest + data).split(b"\n")
        lines: list[Line] = []
        for text in whole:
            try:
                line = json.loads(text)
            except ValueError:
                continue
            if isinstance(line, dict):
                lines.append(line)
        return lines

    def end(self, timeout_s: float) -> int | None:
        """SIGTERM and wait; None when it had to be killed."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        try:
            self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            return None
        return self.process.returncode


class Children:
    """The processes of one demo, and where their words are kept."""

    def __init__(self, out: Path, clock: MonotonicClock, asked: threading.Event) -> None:
        self._out = out
        self._clock = clock
        self._asked = asked
        self._all: list[Child] = []

    def start(self, name: str, module: list[str], *, merge: bool = False) -> Child:
        """Start a module of this installation; ``merge``: what it complains about goes with its words."""
        log = (self._out / f"{name}.log").open("wb")
        process = subprocess.Popen(
            [sys.executable, "-m", *module],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT if merge else log,
        )
        child = Child(name=name, process=process, log=log)
        self._all.append(child)
        return child

    def first_line(self, child: Child) -> Line:
        """What a simulated device says when it is ready: where it listens."""
        until = self._clock.now() + START_S
        with selectors.DefaultSelector() as selector:
            assert child.process.stdout is not None
            selector.register(child.process.stdout, selectors.EVENT_READ)
            while self._clock.now() < until and not child.over and not self._asked.is_set():
                if selector.select(0.2):
                    for line in child.read():
                        if line.get("event") == "listening" or line.get("ready") is True:
                            return line
        if self._asked.is_set():
            raise UsageError("asked to end before the demo had begun")
        raise UsageError(f"the {child.name} process did not start; see {child.log.name}")

    def port(self, child: Child) -> int:
        """The port it says it listens on."""
        port = self.first_line(child).get("port")
        if not isinstance(port, int):
            raise UsageError(f"the {child.name} process did not tell its port; see {child.log.name}")
        return port

    def end(self) -> None:
        """End whatever still runs, the latest first."""
        for child in reversed(self._all):
            child.end(END_S)
            child.log.close()


def free_loopback(ports: tuple[int, ...] = UR_PORTS) -> str:
    """A loopback address on which nobody uses any of these ports: a UR controller's cannot be chosen.

    127.0.0.1 is left out: ur-rtde does not ask there whether the arm is in remote control.
    """
    for last in range(2, 255):
        host = f"127.0.0.{last}"
        try:
            for port in ports:
                with socket.socket() as probe:
                    probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                    probe.bind((host, port))
                    probe.listen()
        except OSError:
            continue
        return host
    raise UsageError("no loopback address 127.0.0.2 to 127.0.0.254 is free for a UR controller's ports")


def free_port() -> int:
    """A port of 127.0.0.1 nobody listens on now, for a process that cannot choose one itself."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
