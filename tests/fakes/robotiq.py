"""The simulated Robotiq gripper as a child process, with its fault port."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeAlias

Json: TypeAlias = "dict[str, Json] | list[Json] | str | float | int | bool | None"

ROOT = Path(__file__).parents[2]
END_S = 5.0


class RobotiqPeer:
    """A running gripper: where it is, and what may be done to it."""

    def __init__(self, process: subprocess.Popen[str], host: str, port: int, fault_port: int) -> None:
        self.process = process
        self.host = host
        self.port = port
        self._faults = socket.create_connection((host, fault_port), timeout=5.0)
        self._lines = self._faults.makefile("r", encoding="utf-8")

    def do(self, what: str, **values: Json) -> dict[str, Json]:
        """One request of the fault port; its status afterwards."""
        self._faults.sendall(json.dumps({"do": what, **values}).encode() + b"\n")
        answer = json.loads(self._lines.readline())
        assert "error" not in answer, answer
        return dict(answer)

    def mend(self) -> None:
        """As new: activated, open, nothing between the fingers."""
        for what, values in (
            ("speak", {}),
            ("accept", {}),
            ("power", {"on": True}),
            ("stuck", {"on": False}),
            ("thin", {"on": False}),
            ("part", {"at": None}),
            ("fault", {"code": 0}),
        ):
            self.do(what, **values)

    def close(self) -> None:
        self._lines.close()
        self._faults.close()


@contextmanager
def robotiq_peer(*arguments: str) -> Iterator[RobotiqPeer]:
    """Start ``python -m drivers.sim.robotiq`` on free ports; it has ended when the context ends."""
    command = [sys.executable, "-m", "drivers.sim.robotiq", "--port", "0", *arguments]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            first = json.loads(process.stdout.readline())
            assert first["ready"] is True
            peer = RobotiqPeer(process, first["host"], first["port"], first["fault_port"])
            try:
                yield peer
            finally:
                peer.close()
        finally:
            if process.poll() is None:
                process.terminate()
                process.wait(END_S)
