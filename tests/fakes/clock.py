"""A clock turned by hand: time moves only when a test says so, and no wait ever takes real time."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeAlias

_Action: TypeAlias = Callable[[], None]


class FakeClock:
    """Satisfies `drivers.timing.Clock`. A wait that is not interrupted moves the time on by its length.

    ``at(t, action)`` runs ``action`` when the time passes ``t``, also in the middle of a wait: this is how
    a test fires a token, or changes a device, while the code under test is waiting.

    >>> clock = FakeClock(10.0)
    >>> clock.wait(threading.Event(), 0.5)
    False
    >>> clock.now()
    10.5
    """

    def __init__(self, now: float = 1000.0) -> None:
        self._now = now
        self._lock = threading.RLock()
        self._actions: list[tuple[float, int, _Action]] = []
        self._count = 0
        self.waits: list[float] = []

    def now(self) -> float:
        with self._lock:
            return self._now

    def turn(self, seconds: float) -> None:
        """Move the time on; planned actions run in their order, each seeing its own time."""
        if seconds < 0:
            raise ValueError(f"time does not go back: {seconds}")
        self._turn_to(self.now() + seconds, until=None)

    def at(self, when: float, action: _Action) -> None:
        """Plan an action for the moment the time reaches ``when``."""
        with self._lock:
            self._count += 1
            self._actions.append((when, self._count, action))
            self._actions.sort(key=lambda planned: planned[:2])

    def wait(self, event: threading.Event, timeout_s: float) -> bool:
        """Wait without waiting: the time moves on until the event is set or ``timeout_s`` is over."""
        with self._lock:
            self.waits.append(timeout_s)
        if event.is_set():
            return True
        self._turn_to(self.now() + max(0.0, timeout_s), until=event)
        return event.is_set()

    def _turn_to(self, end: float, until: threading.Event | None) -> None:
        while True:
            with self._lock:
                if not self._actions or self._actions[0][0] > end:
                    self._now = max(self._now, end)
                    return
                when, _, action = self._actions.pop(0)
                self._now = max(self._now, when)
            action()
            if until is not None and until.is_set():
                return
