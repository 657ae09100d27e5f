"""The simulated UR controller as a child process, with a client of its fault port."""

from __future__ import annotations

import json
import os
import random
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

ROOT = Path(__file__).parents[2]
PORTS = (29999, 30001, 30002, 30003, 30004)
START_S = 20.0
END_S = 5.0
Json: TypeAlias = "dict[str, Json] | list[Json] | str | float | int | bool | None"


def free_host() -> str:
    """A loopback address on which nobody has a controller's ports."""
    numbers = random.Random(os.getpid() ^ time.monotonic_ns())
    while True:
        host = f"127.{numbers.randint(1, 200)}.{numbers.randint(0, 255)}.{numbers.randint(1, 254)}"
        try:
            for port in PORTS:
                with socket.socket() as probe:
                    probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                    probe.bind((host, port))
        except OSError:
            continue
        return host


class UrController:
    """A running controller."""

    def __init__(self, process: subprocess.Popen[str], host: str, fault_port: int) -> None:
        self.process, self.host, self.fault_port = process, host, fault_port
        self._socket = socket.create_connection((host, fault_port), timeout=5.0)
        self._lines = self._socket.makefile("rb")

    def ask(self, do: str, **values: Any) -> dict[str, Any]:
        """One request of the fault port; its answer, refusals included."""
        self._socket.sendall(json.dumps({"do": do, **values}).encode() + b"\n")
        answer = json.loads(self._lines.readline())
        assert isinstance(answer, dict)
        return answer

    def do(self, do: str, **values: Any) -> None:
        """One request of the fault port that must be carried out."""
        answer = self.ask(do, **values)
        assert answer.get("ok") is True, answer

    def status(self) -> dict[str, Any]:
        """Everything it says of itself."""
        return self.ask("status")

    def wait(self, within_s: float = 5.0, **wanted: Json) -> dict[str, Any]:
        """Its status once these values are there; the test fails when they do not come."""
        ends_at = time.monotonic() + within_s
        while True:
            status = self.status()
            if all(status[key] == value for key, value in wanted.items()):
                return status
            assert time.monotonic() < ends_at, f"not within {within_s:g} s: {wanted}; it is {status}"
            time.sleep(0.005)

    def end(self) -> dict[str, Any]:
        """Ask it to end; the last line it prints."""
        self.process.terminate()
        assert self.process.stdout is not None
        last: dict[str, Any] = json.loads(self.process.stdout.read().splitlines()[-1])
        assert self.process.wait(END_S) == 0
        return last

    def close(self) -> None:
        """The fault port's connection."""
        self._lines.close()
        self._socket.close()


@contextmanager
def ur_controller(*arguments: str, host: str | None = None) -> Iterator[UrController]:
    """Start ``python -m drivers.sim.ur_controller``; it has ended when the context ends."""
    where = free_host() if host is None else host
    command = [sys.executable, "-m", "drivers.sim.ur_controller", "--host", where, *arguments]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            first = json.loads(process.stdout.readline())
            assert first["ready"] is True
            controller = UrController(process, where, int(first["fault_port"]))
            try:
                yield controller
            finally:
                controller.close()
        finally:
            if process.poll() is None:
                process.terminate()
                try:
                    process.wait(END_S)
                except subprocess.TimeoutExpired:
                    process.kill()
                    raise
