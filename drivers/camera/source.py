"""What a camera driver is to the thread that owns it: start, the next frame, stop.

A `Source` knows one device and nothing of losing and finding it again; that is told once, for every kind of
camera, by the thread that owns the source. All methods are called from that one thread; only `counters` may
be read from another.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from drivers.types import Frame


@dataclass(frozen=True, slots=True, kw_only=True)
class Counters:
    """What became of the frames of one source since it was made; stopping and starting do not reset it.

    ``frames`` were handed on. ``dropped`` were exposed and never reached us (gaps in the device's numbers).
    ``incomplete`` reached us spoilt (missing packets, an error flag, no picture that can be decoded) and
    were thrown away. ``resent`` packets were asked for again and came.
    """

    frames: int = 0
    dropped: int = 0
    incomplete: int = 0
    resent: int = 0


class Source(Protocol):
    """One camera that streams. Constructing does nothing."""

    @property
    def name(self) -> str:
        """How logs and faults call it: ``camera.left``."""
        ...

    def start(self) -> None:
        """Open, configure, read everything back and verify it, begin to stream; all or nothing.

        May be called again after `stop`, on a device that was away in between.

        Raises
        ------
        DriverError
            `DeviceUnavailable` when it is not there or is held by somebody else; `CommandRejected` when it
            does not do what the settings ask, naming the control, what was wanted, what it has, its range.
        """
        ...

    def next(self, timeout_s: float) -> Frame | None:
        """The next complete frame, in the order of exposure; None when none came in time.

        ``captured_at`` is on our monotonic clock and never later than the exposure. Frames that nobody
        fetched may be skipped (and are counted as dropped), never handed out twice.

        Raises
        ------
        DeviceUnavailable
            The device is gone: only `stop` and `start` can help.
        """
        ...

    def stop(self) -> None:
        """End the stream and let go of the device. May come twice or without `start`; never raises."""
        ...

    def counters(self) -> Counters:
        """What became of the frames so far."""
        ...
