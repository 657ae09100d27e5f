"""A source as a camera without a thread of its own: who asks for a picture waits for the device himself.

For commissioning and tests. Between two calls nobody empties the device's queue; pictures that waited there
are older than asked for and are passed over.
"""

from __future__ import annotations

from drivers.camera.source import Counters, Source
from drivers.errors import DeviceTimeout
from drivers.timing import Clock
from drivers.types import Frame


class DirectCamera:
    """A `Camera` on a `Source`."""

    def __init__(self, source: Source, clock: Clock) -> None:
        self._source = source
        self._clock = clock

    @property
    def name(self) -> str:
        """How logs and faults call it."""
        return self._source.name

    def open(self) -> None:
        """Start the source."""
        self._source.start()

    def close(self) -> None:
        """Stop the source."""
        self._source.stop()

    def grab(self, *, newer_than: float, timeout_s: float) -> Frame:
        """The first picture exposed after ``newer_than``.

        Raises
        ------
        DeviceUnavailable
            Not open, or gone; `open` again.
        DeviceTimeout
            None came in time.
        """
        until = self._clock.now() + timeout_s
        while True:
            frame = self._source.next(max(0.0, until - self._clock.now()))
            if frame is not None and frame.captured_at > newer_than:
                return frame
            if self._clock.now() >= until:
                raise DeviceTimeout(
                    self.name, f"no picture exposed after {newer_than:.3f} s within {timeout_s:.2f} s"
                )

    def counters(self) -> Counters:
        """What became of the source's pictures."""
        return self._source.counters()
