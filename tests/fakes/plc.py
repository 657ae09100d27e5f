"""Scripted double of a PLC: plays answers and exceptions in order and keeps what the cell sent."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import replace

from drivers.errors import DriverError
from drivers.timing import Clock
from drivers.types import QUIET, PlcCommand, PlcInputs, PlcOutputs

IDLE = replace(
    QUIET, heartbeat=1, enable=True, cmd_code=int(PlcCommand.PICK_AND_PLACE), recipe=1, max_attempts=1
)
"""A PLC that is enabled and wants nothing; `dataclasses.replace` makes the others."""


class FakePlc:
    """Satisfies `drivers.interfaces.Plc`.

    Every exchange takes the next item of the script: a record is answered (with ``read_at`` of the clock),
    an exception is raised. After the script the last record goes on, its heartbeat counting.
    """

    def __init__(
        self, clock: Clock, script: Iterable[PlcInputs | DriverError] = (), name: str = "plc"
    ) -> None:
        self._clock = clock
        self._name = name
        self._script: deque[PlcInputs | DriverError] = deque(script)
        self._last = IDLE
        self.sent: list[PlcOutputs] = []
        self.calls: list[str] = []
        self.is_open = False
        self.open_error: DriverError | None = None

    @property
    def name(self) -> str:
        return self._name

    def open(self) -> None:
        self.calls.append("open")
        if self.open_error is not None:
            raise self.open_error
        self.is_open = True

    def close(self) -> None:
        self.calls.append("close")
        self.is_open = False

    def then(self, *items: PlcInputs | DriverError) -> None:
        """Add to the end of the script."""
        self._script.extend(items)

    def exchange(self, outputs: PlcOutputs) -> PlcInputs:
        self.calls.append("exchange")
        self.sent.append(outputs)
        if self._script:
            item = self._script.popleft()
            if isinstance(item, DriverError):
                raise item
            self._last = item
        else:
            self._last = replace(self._last, heartbeat=(self._last.heartbeat + 1) % 65536)
        return replace(self._last, read_at=self._clock.now())
