"""The real simulated cell as a child process, with the onlooker's side of its port."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from drivers.sim.devices import Link
from drivers.sim.protocol import Json, Message
from drivers.timing import MonotonicClock

ROOT = Path(__file__).parents[2]
WORLD = ROOT / "configs" / "demo" / "world.yaml"
END_S = 5.0


class SimCell:
    """A running cell: its port, and what an onlooker may ask and upset."""

    def __init__(self, process: subprocess.Popen[str], port: int) -> None:
        self.process = process
        self.port = port
        self._link = Link("onlooker", "127.0.0.1", port, MonotonicClock())
        self._link.open()

    def ask(self, operation: str, **values: Json) -> Message:
        return self._link.ask(operation, values, 5.0)

    def fault(self, name: str, **values: Json) -> None:
        self.ask("fault", name=name, **values)

    def mend(self) -> None:
        """Take every fault back."""
        for name in ("safety_ok", "camera_ok", "robot_ok"):
            self.fault(name)

    def count(self, name: str) -> int:
        return self.ask("status").whole(name)

    def close(self) -> None:
        self._link.close()


@contextmanager
def sim_cell(*arguments: str, world: Path = WORLD) -> Iterator[SimCell]:
    """Start ``python -m drivers.sim.cell`` on a free port; it has ended when the context ends."""
    command = [sys.executable, "-m", "drivers.sim.cell", "--world", str(world), "--port", "0", *arguments]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            first = json.loads(process.stdout.readline())
            assert first["event"] == "listening"
            cell = SimCell(process, int(first["port"]))
            try:
                yield cell
            finally:
                cell.close()
        finally:
            if process.poll() is None:
                process.terminate()
                process.wait(END_S)
