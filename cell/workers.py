"""Threads of the daemon and what passes between them: one writer each, frozen records only."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from drivers.timing import Clock, StopRequested, StopToken

T = TypeVar("T")


class Latest(Generic[T]):
    """The newest value of something, with the time of writing. One writer, any number of readers."""

    def __init__(self, value: T, clock: Clock) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._value = value
        self._written_at = clock.now()

    def put(self, value: T) -> None:
        """Replace the value."""
        with self._lock:
            self._value = value
            self._written_at = self._clock.now()

    def get(self) -> T:
        """The newest value, however old."""
        with self._lock:
            return self._value

    def age_s(self) -> float:
        """Seconds since the last `put`."""
        with self._lock:
            return self._clock.now() - self._written_at


class MailboxFull(Exception):
    """A bounded mailbox refused an item."""


class Mailbox(Generic[T]):
    """A bounded queue that refuses when full; nothing is dropped in silence."""

    def __init__(self, capacity: int) -> None:
        self._queue: queue.Queue[T] = queue.Queue(maxsize=capacity)

    def put(self, item: T) -> None:
        """Add one; `MailboxFull` when there is no room."""
        try:
            self._queue.put_nowait(item)
        except queue.Full:
            raise MailboxFull(f"no room for {item!r}") from None

    def take(self, timeout_s: float) -> T | None:
        """The oldest item; None when none came in time."""
        try:
            return self._queue.get(timeout=timeout_s) if timeout_s > 0 else self._queue.get_nowait()
        except queue.Empty:
            return None


class Beat:
    """A worker's sign of life. The main thread feeds the service watchdog only while all are fresh."""

    def __init__(self, name: str, limit_s: float, clock: Clock) -> None:
        self.name = name
        self.limit_s = limit_s
        self._clock = clock
        self._at = clock.now()

    def __call__(self) -> None:
        self._at = self._clock.now()

    def age_s(self) -> float:
        """Seconds since the last sign."""
        return self._clock.now() - self._at

    @property
    def fresh(self) -> bool:
        """True while the worker makes progress."""
        return self.age_s() <= self.limit_s


class BeatingClock:
    """A clock whose waits count as progress: a thread that polls a motion through it is alive."""

    def __init__(self, clock: Clock, beat: Beat) -> None:
        self._clock = clock
        self._beat = beat

    def now(self) -> float:
        return self._clock.now()

    def wait(self, event: threading.Event, timeout_s: float) -> bool:
        self._beat()
        return self._clock.wait(event, timeout_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class Worker:
    """One thread: its body runs until its token fires."""

    name: str
    body: Callable[[], None]
    stop: StopToken
    beat: Beat


class WorkerGroup:
    """Starts workers together; the first that fails is kept, and `failed` tells the main thread."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._threads: list[tuple[Worker, threading.Thread]] = []
        self._failures: queue.Queue[tuple[str, BaseException]] = queue.Queue()

    def start(self, worker: Worker) -> None:
        """Run the worker in a thread of its own."""
        thread = threading.Thread(target=self._run, args=(worker,), name=worker.name, daemon=True)
        self._threads.append((worker, thread))
        thread.start()

    def _run(self, worker: Worker) -> None:
        try:
            worker.body()
        except StopRequested:
            pass
        except BaseException as error:  # noqa: BLE001 - the one place where a worker's end is caught
            self._failures.put((worker.name, error))
            return
        if not worker.stop.stopped:
            self._failures.put((worker.name, RuntimeError("ended without being asked to")))

    def failure(self) -> tuple[str, BaseException] | None:
        """The first worker that ended by an exception, with it; None while all is well."""
        try:
            return self._failures.get_nowait()
        except queue.Empty:
            return None

    def stalled(self) -> list[Beat]:
        """Beats of workers that make no progress."""
        return [
            worker.beat for worker, thread in self._threads if thread.is_alive() and not worker.beat.fresh
        ]

    def end(self, name: str, reason: str, timeout_s: float) -> bool:
        """Fire the worker's token and join it; False when it did not end in time."""
        for worker, thread in self._threads:
            if worker.name == name:
                worker.stop.stop(reason)
                thread.join(timeout_s)
                return not thread.is_alive()
        raise KeyError(name)
