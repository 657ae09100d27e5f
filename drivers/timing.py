"""Time and stopping: the only clock and the only way to wait."""

from __future__ import annotations

import threading
import time
from typing import Protocol


class Clock(Protocol):
    """Monotonic seconds. Tests hand in one that they turn by hand."""

    def now(self) -> float: ...

    def wait(self, event: threading.Event, timeout_s: float) -> bool:
        """Wait for the event or the time; True when the event came."""
        ...


class MonotonicClock:
    """The machine's monotonic clock, shared by all its processes."""

    def now(self) -> float:
        return time.monotonic()

    def wait(self, event: threading.Event, timeout_s: float) -> bool:
        return event.wait(max(0.0, timeout_s))


class StopRequested(Exception):
    """Somebody asked to stop; control flow, never logged as an error."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


class StopToken:
    """The only way to wait, and the only way to reach a running call from another thread.

    >>> token = StopToken(MonotonicClock())
    >>> token.wait(0.0)
    >>> token.stop("asked to end")
    >>> token.stopped
    True
    """

    def __init__(self, clock: Clock, parent: StopToken | None = None) -> None:
        self._clock = clock
        self._event = threading.Event()
        self._lock = threading.Lock()
        self._reason: str | None = None
        self._children: list[StopToken] = []
        if parent is not None:
            parent._adopt(self)

    def _adopt(self, child: StopToken) -> None:
        with self._lock:
            self._children = [c for c in self._children if not c.stopped]
            self._children.append(child)
            reason = self._reason
        if reason is not None:
            child.stop(reason)

    @property
    def clock(self) -> Clock:
        """The clock this token waits on."""
        return self._clock

    @property
    def stopped(self) -> bool:
        """True once somebody called `stop`."""
        return self._event.is_set()

    @property
    def reason(self) -> str | None:
        """What was given to the first `stop`, None before."""
        return self._reason

    def stop(self, reason: str) -> None:
        """Fire; the first reason stays. Children fire too, parents do not."""
        with self._lock:
            if self._reason is None:
                self._reason = reason
            children, self._children = self._children, []
        self._event.set()
        for child in children:
            child.stop(reason)

    def check(self) -> None:
        """Raise `StopRequested` if fired."""
        if self._event.is_set():
            raise StopRequested(self._reason or "stopped")

    def wait(self, seconds: float) -> None:
        """Sleep; raises `StopRequested` at once when fired, now or meanwhile."""
        if self._clock.wait(self._event, seconds):
            self.check()

    def child(self) -> StopToken:
        """A narrower token: fires with this one, and can be fired alone."""
        return StopToken(self._clock, parent=self)
