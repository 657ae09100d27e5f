"""Webcams through the kernel's own interface, V4L2: buffers in shared memory, a time and a number per
picture.

Between picture and caller there is nothing but the kernel's queue: how long to wait is said at each call, a
picture the camera marked as spoilt is counted and thrown away, and a camera that was pulled out says so at
once.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Final

from drivers.camera import decode, v4l2_controls
from drivers.camera.source import Counters
from drivers.camera.v4l2_device import Filled, PictureFormat, VideoDevice
from drivers.camera.v4l2_errors import explained, told_as_ours
from drivers.camera_settings import V4l2CameraSettings
from drivers.errors import CommandRejected, DeviceUnavailable, DriverError
from drivers.timing import Clock
from drivers.types import Frame

_RATE_TOLERANCE: Final = 0.01
_SHOWN_OFFERS: Final = 12
_LATE: Final = 64
"""A picture at most so many numbers back was overtaken; a longer way back the device counts anew."""

Opener = Callable[[Path], VideoDevice]


class V4l2Source:
    """One webcam; a `Source` (`drivers/camera/source.py`). ``opener`` is for tests."""

    def __init__(
        self, name: str, settings: V4l2CameraSettings, clock: Clock, opener: Opener = VideoDevice
    ) -> None:
        self._name = name
        self._settings = settings
        self._clock = clock
        self._opener = opener
        self._device: VideoDevice | None = None
        self._format: PictureFormat | None = None
        self._last_sequence: int | None = None
        self._frames = self._dropped = self._incomplete = 0

    @property
    def name(self) -> str:
        """How logs and faults call it."""
        return self._name

    def start(self) -> None:
        """Open, set everything, read it back, begin to stream; all or nothing.

        Raises
        ------
        DeviceUnavailable
            Not there, held by another program, or not permitted.
        CommandRejected
            It does not do what the settings ask.
        """
        self.stop()
        path = self._settings.device
        with told_as_ours(self._name, path, "open"):
            device = self._opener(path)
        self._device = device
        with ExitStack() as undo:
            undo.callback(self.stop)
            with told_as_ours(self._name, path, "configure"):
                self._configure(device)
            undo.pop_all()
        self._last_sequence = None

    def stop(self) -> None:
        """End the stream and let go."""
        device, self._device = self._device, None
        if device is not None:
            device.close()

    def next(self, timeout_s: float) -> Frame | None:
        """The newest complete picture that is ready, or the next to come; None when none came in time.

        Raises
        ------
        DeviceUnavailable
            Not started, pulled out, or the stream broke off.
        """
        device = self._device
        if device is None:
            raise DeviceUnavailable(self._name, "not open")
        until = self._clock.now() + timeout_s
        while True:
            try:
                ready = device.wait(until - self._clock.now())
                newest = self._newest(device) if ready else None
            except OSError as error:
                raise self._lost(error) from error
            if newest is not None:
                frame = self._frame(newest)
                if frame is not None:
                    return frame
            if self._clock.now() >= until:
                return None

    def counters(self) -> Counters:
        """What became of the pictures."""
        return Counters(frames=self._frames, dropped=self._dropped, incomplete=self._incomplete)

    def _configure(self, device: VideoDevice) -> None:
        settings, path = self._settings, self._settings.device
        if not device.identity().captures:
            raise CommandRejected(
                self._name,
                f"{path} delivers no pictures (webcams have a second node for metadata); take the name that "
                "ends in -video-index0",
            )
        self._format = self._set_format(device)
        asked = v4l2_controls.wanted(settings)
        v4l2_controls.apply(self._name, path, device, asked)
        with told_as_ours(self._name, path, "begin to stream from"):
            monotonic = device.stream(settings.buffers)
        if not monotonic:
            raise CommandRejected(
                self._name,
                f"{path} does not time its pictures by the monotonic clock, so nobody can tell how old they "
                "are",
            )
        # some cameras go back to their own settings when the stream begins
        v4l2_controls.verify(self._name, path, device, asked)

    def _set_format(self, device: VideoDevice) -> PictureFormat:
        settings, path = self._settings, self._settings.device
        with told_as_ours(self._name, path, "set the format of"):
            got = device.set_format(settings.width_px, settings.height_px, settings.format)
        if (got.width_px, got.height_px, got.letters) != (
            settings.width_px,
            settings.height_px,
            settings.format,
        ):
            raise CommandRejected(
                self._name,
                f"{path}: format: wanted {settings.format} {settings.width_px}x{settings.height_px}, it has "
                f"{got.letters} {got.width_px}x{got.height_px}; it offers {self._offers(device)}",
            )
        rate_hz = device.set_rate(settings.rate_hz)
        if abs(rate_hz - settings.rate_hz) > _RATE_TOLERANCE * settings.rate_hz:
            raise CommandRejected(
                self._name,
                f"{path}: rate_hz: wanted {settings.rate_hz:g}, it has {rate_hz:g}; it offers "
                f"{self._offers(device)}",
            )
        return got

    def _offers(self, device: VideoDevice) -> str:
        offers = device.offered()
        shown = "; ".join(offer.text() for offer in offers[:_SHOWN_OFFERS])
        more = f"; and {len(offers) - _SHOWN_OFFERS} more" if len(offers) > _SHOWN_OFFERS else ""
        return f"{shown or 'nothing it names'}{more}"

    def _newest(self, device: VideoDevice) -> Filled | None:
        """Empty the queue; its last good picture. The others count as dropped or incomplete."""
        newest: Filled | None = None
        while (filled := device.take()) is not None:
            step = 1 if self._last_sequence is None else _step(self._last_sequence, filled.sequence)
            if -_LATE < step <= 0:
                # the kernel fills buffers side by side: overtaken by a later one, and counted as lost then
                continue
            # a long way back: the numbers began anew
            self._dropped += max(0, step - 1)
            self._last_sequence = filled.sequence
            if filled.spoilt:
                self._incomplete += 1
                continue
            if newest is not None:
                self._dropped += 1
            newest = filled
        return newest

    def _frame(self, filled: Filled) -> Frame | None:
        settings = self._settings
        assert self._format is not None
        try:
            pixels = decode.pixels(
                filled.content,
                settings.format,
                settings.width_px,
                settings.height_px,
                self._format.row_bytes,
            )
        except decode.Spoilt:
            self._incomplete += 1
            return None
        self._frames += 1
        return Frame(
            camera=self._name,
            pixels=pixels,
            captured_at=filled.at - settings.worst_delay_s,
            sequence=filled.sequence,
        )

    def _lost(self, error: OSError) -> DriverError:
        told = explained(self._name, self._settings.device, "take a picture from", error)
        # whatever it is, this stream is over
        return DeviceUnavailable(self._name, told.detail)


def _step(last: int, now: int) -> int:
    """How far a picture's number of 32 bits is ahead of another's; negative: behind it."""
    return (now - last + 0x80000000 & 0xFFFFFFFF) - 0x80000000
