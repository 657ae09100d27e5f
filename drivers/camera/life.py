"""A camera that may be lost and come back: one thread owns its source, and tells nobody else about it than by
a state and the newest frame.

CONNECTED: streams, but has not shown enough good frames yet. READY. SUSPECT: no frame for some periods, which
may pass. LOST: silent for too long, or gone; the source is stopped. BACKOFF: a pause before it is started
again with its whole configuration. A frame is handed out in READY and SUSPECT only.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Final

import structlog

from drivers.camera.source import Counters, Source
from drivers.errors import DeviceTimeout, DeviceUnavailable, DriverError
from drivers.timing import Clock, MonotonicClock
from drivers.types import Frame

log = structlog.get_logger()

_POLL_S: Final = 0.1
"""A wait for a frame is looked up from this often: to close, and to call a silent camera suspect."""
_CLOSE_S: Final = 12.0
"""A dead GigE camera blocks its owner for 2.5 s a register; a few are written when it is let go."""


class CameraState(Enum):
    """Where a camera is in its life. Values are what a person reads."""

    CLOSED = "closed"
    CONNECTED = "connected"
    READY = "ready"
    SUSPECT = "suspect"
    LOST = "lost"
    BACKOFF = "backoff"


@dataclass(frozen=True, slots=True, kw_only=True)
class Life:
    """How long is too long. ``open_s``: from open to READY; ``backoff_s``: first and longest pause."""

    period_s: float
    lost_s: float = 1.0
    good_frames: int = 3
    open_s: float = 10.0
    backoff_s: tuple[float, float] = (0.2, 5.0)
    idle_s: float = 0.5

    @property
    def suspect_s(self) -> float:
        """Three periods without a frame are no accident."""
        return min(3.0 * self.period_s, self.lost_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class Status:
    """One camera at one instant. ``reason``: why it is not ready; ``losses`` since it was opened."""

    state: CameraState
    reason: str
    losses: int
    counters: Counters


class Bell:
    """Cameras that are triggered by software together: whoever wants a frame rings for all of them."""

    def __init__(self) -> None:
        self._ears: list[threading.Event] = []

    def ear(self) -> threading.Event:
        """An event that is set each time somebody rings."""
        ear = threading.Event()
        self._ears.append(ear)
        return ear

    def ring(self) -> None:
        """Wake all owners, which trigger their cameras."""
        for ear in self._ears:
            ear.set()


class OwnedCamera:
    """A `Camera` over a `Source`.

    Parameters
    ----------
    trigger
        For a camera that exposes on our word: called by the owner thread when somebody wants a frame, and
        every ``life.idle_s`` to see that it is still there. None: frames come by themselves.
    bell
        What wakes the owners of cameras that are triggered together; None: this one alone.
    """

    def __init__(
        self,
        source: Source,
        life: Life,
        clock: Clock,
        trigger: Callable[[], None] | None = None,
        bell: Bell | None = None,
    ) -> None:
        self._source = source
        self._life = life
        self._clock = clock
        self._trigger = trigger
        self._bell = Bell() if bell is None else bell
        self._ear = self._bell.ear()
        self._lock = threading.Lock()
        self._news = threading.Event()
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None
        self._state = CameraState.CLOSED
        self._reason = "not open"
        self._error: DriverError | None = None
        self._newest: Frame | None = None
        self._losses = 0
        self._alive_at = 0.0

    @property
    def name(self) -> str:
        """How logs and faults call it."""
        return self._source.name

    # ------------------------------------------------------------------ the user's side

    def open(self) -> None:
        """Start the owner and wait until the camera is ready.

        Raises
        ------
        DriverError
            What the source raised; `DeviceTimeout` when it streams but gives too few good frames.
        """
        if self._thread is not None:
            return
        self._ending, self._newest, self._losses, self._error = threading.Event(), None, 0, None
        self._set(CameraState.CONNECTED, "being opened")
        self._thread = threading.Thread(
            target=self._own, args=(self._ending,), name=f"owner of {self.name}", daemon=True
        )
        self._thread.start()
        until = self._clock.now() + self._life.open_s
        while self.status().state is not CameraState.READY:
            with self._lock:
                self._news.clear()
                error = self._error
            if error is None and self._clock.now() >= until:
                error = DeviceTimeout(
                    self.name,
                    f"no {self._life.good_frames} good frames within {self._life.open_s:.0f} s of opening; "
                    f"{_told(self._source.counters())}",
                )
            if error is not None:
                self.close()
                raise error
            self._clock.wait(self._news, min(_POLL_S, until - self._clock.now()))

    def close(self) -> None:
        """End the owner, which lets go of the device."""
        thread, self._thread = self._thread, None
        self._ending.set()
        self._ear.set()
        if thread is not None:
            thread.join(_CLOSE_S)
            if thread.is_alive():
                log.warning("camera_owner_hangs", camera=self.name, waited_s=_CLOSE_S)
        self._set(CameraState.CLOSED, "not open")
        with self._lock:
            self._newest = None

    def check(self) -> None:
        """Does not wait; `DeviceUnavailable` when the camera was lost or is being found again."""
        with self._lock:
            state, reason = self._state, self._reason
        if state not in (CameraState.READY, CameraState.SUSPECT):
            raise DeviceUnavailable(self.name, reason if state is CameraState.CLOSED else f"lost: {reason}")
        silent_s = self._clock.now() - self._alive_at
        if silent_s > self._life.lost_s + self._life.idle_s:
            # its owner hangs in a call, and cannot say so itself
            raise DeviceUnavailable(self.name, f"its driver has not moved for {silent_s:.1f} s")

    def grab(self, *, newer_than: float, timeout_s: float) -> Frame:
        """The newest frame exposed after ``newer_than``.

        Raises
        ------
        DeviceUnavailable
            Lost, also while waiting, or not open; at once.
        DeviceTimeout
            No such frame in time.
        """
        until = self._clock.now() + timeout_s
        rung_at = float("-inf")
        while True:
            self.check()
            with self._lock:
                self._news.clear()
                frame = self._newest
            if frame is not None and frame.captured_at > newer_than:
                return frame
            now = self._clock.now()
            if now >= until or newer_than >= until:
                raise DeviceTimeout(
                    self.name, f"no frame exposed after {newer_than:.3f} s within {timeout_s:.2f} s"
                )
            rung_at = self._ring(frame, newer_than, now, rung_at)
            self._clock.wait(self._news, min(_POLL_S, until - now, max(newer_than - now, 0.001) + _POLL_S))

    def _ring(self, frame: Frame | None, newer_than: float, now: float, rung_at: float) -> float:
        """Ask for an exposure, once the wanted instant is over; again only when the answer was too old."""
        if self._trigger is None or now <= newer_than:
            return rung_at
        answered = frame is not None and frame.captured_at >= rung_at
        if rung_at > newer_than and not answered and now - rung_at < self._life.lost_s:
            return rung_at
        self._bell.ring()
        return now

    def status(self) -> Status:
        """For whoever shows it; any thread."""
        with self._lock:
            return Status(
                state=self._state, reason=self._reason, losses=self._losses, counters=self._source.counters()
            )

    # ------------------------------------------------------------------ the owner

    def _set(self, state: CameraState, reason: str = "") -> None:
        with self._lock:
            before, self._state, self._reason = self._state, state, reason
            self._news.set()
        if state is not before and state in (CameraState.READY, CameraState.SUSPECT, CameraState.LOST):
            told = {"reason": reason} if reason else {}
            # on a busy machine a frame is late now and then, for a moment: not worth reading each time
            passing = CameraState.SUSPECT in (state, before) and state is not CameraState.LOST
            tell = log.debug if passing else log.info
            tell("camera_state_changed", camera=self.name, state=state.value, **told)

    def _own(self, ending: threading.Event) -> None:
        try:
            self._live(ending)
        except BaseException as error:
            log.error("camera_owner_failed", camera=self.name, exc_info=error)
            with self._lock:
                self._error = DeviceUnavailable(self.name, f"its driver failed: {error!r}")
            self._set(CameraState.LOST, f"its driver failed: {error!r}")

    def _live(self, ending: threading.Event) -> None:
        clock = MonotonicClock()  # the cell's clock takes waits for progress of the cell's thread
        first, longest = self._life.backoff_s
        pause_s = first
        while not ending.is_set():
            try:
                self._source.start()
                self._set(CameraState.CONNECTED, "being opened")
                self._stream(ending, clock)
            except DriverError as error:
                with self._lock:
                    if self._state in (CameraState.READY, CameraState.SUSPECT):
                        self._losses += 1
                        pause_s = first
                    self._error = error.with_traceback(None)  # whose frames would keep the dead camera
                    self._error.__cause__ = None
                self._set(CameraState.LOST, error.detail)
            self._source.stop()
            if not ending.is_set():
                with self._lock:
                    reason = self._reason
                self._set(CameraState.BACKOFF, reason)
                clock.wait(ending, pause_s)
                pause_s = min(2.0 * pause_s, longest)

    def _stream(self, ending: threading.Event, clock: Clock) -> None:
        """Frames into the slot until asked to end; `DeviceUnavailable` after too long a silence."""
        good = 0
        heard_at = asked_at = clock.now()
        answered = True
        while not ending.is_set():
            self._alive_at = clock.now()
            if self._trigger is not None:
                clock.wait(
                    self._ear, self._life.idle_s if answered and good >= self._life.good_frames else 0.0
                )
                self._ear.clear()
                if ending.is_set():
                    return
                now = clock.now()
                if answered:  # silence counts from the question on
                    heard_at = now
                if answered or now - asked_at >= self._life.lost_s / 2.0:
                    asked_at = now
                    self._trigger()
            frame = self._source.next(min(_POLL_S, self._life.suspect_s))
            now = clock.now()
            answered = frame is not None
            if frame is not None:
                heard_at = now
                good += 1
                if good >= self._life.good_frames:
                    self._take(frame)
                continue
            silent_s = now - heard_at
            if silent_s >= self._life.lost_s:
                raise DeviceUnavailable(self.name, f"no frame for {silent_s:.1f} s")
            if silent_s >= self._life.suspect_s and self._state is CameraState.READY:
                self._set(CameraState.SUSPECT, f"no frame for {silent_s:.1f} s")

    def _take(self, frame: Frame) -> None:
        with self._lock:
            self._newest = frame
            ready = self._state is CameraState.READY
            self._error = None
            self._news.set()
        if not ready:
            self._set(CameraState.READY)


def _told(counters: Counters) -> str:
    return (
        f"{counters.frames} frames, {counters.incomplete} incomplete, {counters.dropped} dropped, "
        f"{counters.resent} packets sent again"
    )
