"""A mailbox whose waiting is time on a hand-turned clock: the cell thread's loop runs without threads."""

from __future__ import annotations

from typing import TypeVar

from cell.workers import Mailbox
from tests.fakes.clock import FakeClock

T = TypeVar("T")


class ClockedMailbox(Mailbox[T]):
    """Like `Mailbox`; an empty one moves the clock on by the time it was to wait, then looks once more."""

    def __init__(self, capacity: int, clock: FakeClock) -> None:
        super().__init__(capacity)
        self._clock = clock

    def take(self, timeout_s: float) -> T | None:
        item = super().take(0.0)
        if item is None and timeout_s > 0:
            self._clock.turn(timeout_s)
            item = super().take(0.0)
        return item
