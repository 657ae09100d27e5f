"""The simulated UR controller as a child process, with a client of its fault port."""

from __future__ import annotations

import itertools
import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeAlias

from drivers.settings import UrRobotSettings

Json: TypeAlias = "dict[str, Json] | list[Json] | str | float | int | bool | None"

ROOT = Path(__file__).parents[2]
TCP = (0.0, 0.0, 0.165, 0.0, 0.0, 0.0)
START_Q = (2.14, -1.92, 1.91, -1.56, -1.5708, 3.71)
END_S = 5.0
_NUMBERS = itertools.count(1)


def free_host() -> str:
    """A loopback address that no other test of this machine uses: ports of a controller are fixed."""
    pid = os.getpid()
    return f"127.{1 + (pid >> 8) % 250}.{pid & 0xFF}.{next(_NUMBERS) % 250 + 1}"


class UrController:
    """A running controller: its address, and what its fault port may be asked."""

    def __init__(self, process: subprocess.Popen[str], host: str, fault_port: int) -> None:
        self.process = process
        self.host = host
        self._socket = socket.create_connection((host, fault_port), timeout=5.0)
        self._lines = self._socket.makefile("rb")

    def ask(self, **request: Json) -> dict[str, Json]:
        """One request of the fault port; what it refuses fails the test."""
        self._socket.sendall(json.dumps(request).encode() + b"\n")
        answer = json.loads(self._lines.readline())
        assert isinstance(answer, dict)
        assert "error" not in answer, f"{request}: {answer}"
        return answer

    def do(self, doing: str, /, **more: Json) -> None:
        """Upset something."""
        self.ask(do=doing, **more)

    def status(self) -> dict[str, Json]:
        """Everything worth knowing."""
        return self.ask(do="status")

    def number(self, key: str) -> float:
        """One figure of the status."""
        value = self.status()[key]
        assert isinstance(value, int | float)
        return float(value)

    @property
    def moving(self) -> bool:
        """Whether its arm moves, as the arm itself knows."""
        return self.status()["moving"] is True

    def mend(self) -> None:
        """Take every fault back; what the arm was stopped for is a person's to clear."""
        self.do("thaw", what="all")
        self.do("thaw", what="clock")
        self.do("accept", ports=[29999, 30001, 30002, 30003, 30004])
        for wire in ("rtde", "dashboard"):
            self.do("delay", what=wire, s=0)
            self.do("jitter", what=wire, s=0)
        self.do("script", how="normal")
        self.do("registers", taken="none")
        self.do("slow", factor=1.0)
        self.do("speed_slider", fraction=1.0)
        self.do("remote", on=True)
        self.do("version", polyscope="5.15.0")

    def close(self) -> None:
        self._lines.close()
        self._socket.close()

    def settings(self, **changes: object) -> UrRobotSettings:
        """Settings of a driver for it."""
        values: dict[str, object] = {
            "driver": "ur",
            "host": self.host,
            "model": "UR5e",
            "tcp_m_rad": TCP,
            "payload_kg": 0.9,
            "payload_cog_m": (0.0, 0.0, 0.05),
            "tool_from": "configuration",
            "tool_box_min_m": (-0.8, -0.8, 0.0),
            "tool_box_max_m": (0.8, 0.8, 0.9),
        }
        return UrRobotSettings.model_validate(values | changes)


def command_of(host: str, *arguments: str) -> list[str]:
    """How a controller is started."""
    start = ["--start-q=" + ",".join(map(str, START_Q)), "--tcp=" + ",".join(map(str, TCP))]
    return [sys.executable, "-m", "drivers.sim.ur_controller", "--host", host, *start, *arguments]


@contextmanager
def ur_controller(*arguments: str, host: str | None = None) -> Iterator[UrController]:
    """Start ``python -m drivers.sim.ur_controller``; it has ended when the context ends."""
    command = command_of(host or free_host(), *arguments)
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            first = json.loads(process.stdout.readline())
            assert first["ready"] is True
            controller = UrController(process, first["host"], int(first["fault_port"]))
            try:
                yield controller
            finally:
                controller.close()
        finally:
            if process.poll() is None:
                process.terminate()
                process.wait(END_S)
