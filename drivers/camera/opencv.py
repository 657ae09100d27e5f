"""A webcam through OpenCV's VideoCapture, for cameras that do not get on with our own capture.

It verifies what OpenCV tells. What it cannot know: whether a picture was spoilt on the way or numbers are
missing (it counts neither), whether the power line frequency and the rate in the dark are set.
"""

from __future__ import annotations

from contextlib import ExitStack
from typing import Final

import cv2
import numpy as np

from drivers.camera.source import Counters
from drivers.camera.v4l2_device import VideoDevice
from drivers.camera.v4l2_errors import told_as_ours
from drivers.camera_settings import V4l2CameraSettings
from drivers.errors import CommandRejected, DeviceUnavailable
from drivers.timing import Clock
from drivers.types import Frame

_OLDEST_S: Final = 60.0
"""A time further back than this, or in the future, is of another clock."""


class OpencvSource:
    """One webcam; a `Source` (`drivers/camera/source.py`)."""

    def __init__(self, name: str, settings: V4l2CameraSettings, clock: Clock) -> None:
        self._name = name
        self._settings = settings
        self._clock = clock
        self._capture: cv2.VideoCapture | None = None
        self._frames = 0

    @property
    def name(self) -> str:
        """How logs and faults call it."""
        return self._name

    def start(self) -> None:
        """Open, set what OpenCV can set, read it back.

        Raises
        ------
        DeviceUnavailable
            Not there, held by another program, or not permitted.
        CommandRejected
            It does not do what the settings ask.
        """
        self.stop()
        settings, path = self._settings, self._settings.device
        if settings.format == "GREY":
            raise CommandRejected(self._name, "format GREY: OpenCV has no way to it; use `capture: ioctl`")
        with told_as_ours(self._name, path, "open"):
            VideoDevice(path).close()  # OpenCV does not say why it cannot open
        capture = cv2.VideoCapture(str(path), cv2.CAP_V4L2)
        self._capture = capture
        with ExitStack() as undo:
            undo.callback(self.stop)
            if not capture.isOpened():
                raise DeviceUnavailable(
                    self._name,
                    f"OpenCV cannot open {path}: it delivers no pictures or another program has it",
                )
            self._configure(capture)
            undo.pop_all()

    def stop(self) -> None:
        """Let go."""
        capture, self._capture = self._capture, None
        if capture is not None:
            capture.release()

    def next(self, timeout_s: float) -> Frame | None:
        """The newest picture that is ready, or the next to come; None when none came in time.

        Raises
        ------
        DeviceUnavailable
            Not started, or gone.
        """
        capture = self._capture
        if capture is None:
            raise DeviceUnavailable(self._name, "not open")
        try:
            # grab alone waits as long as it likes
            ready, _ = cv2.VideoCapture.waitAny([capture], int(max(0.0, timeout_s) * 1e9))
        except cv2.error as error:
            raise self._gone() from error
        if not ready:
            if not self._settings.device.exists():
                raise self._gone()
            return None
        done = capture.grab()
        # what waited in the queue meanwhile is older; only the newest is decoded
        for _ in range(self._settings.buffers):
            if not done or not cv2.VideoCapture.waitAny([capture], 1)[0]:
                break
            done = capture.grab()
        got, decoded = capture.retrieve() if done else (False, None)
        if not got or decoded is None:
            raise self._gone()
        captured_at = float(capture.get(cv2.CAP_PROP_POS_MSEC)) * 1e-3
        now = self._clock.now()
        if not now - _OLDEST_S < captured_at <= now:
            raise CommandRejected(
                self._name,
                f"{self._settings.device} does not time its pictures by the monotonic clock "
                f"({captured_at:.3f} s, now {now:.3f} s), so nobody can tell how old they are",
            )
        pixels = np.asarray(decoded, np.uint8)
        pixels.setflags(write=False)
        self._frames += 1
        return Frame(
            camera=self._name,
            pixels=pixels,
            captured_at=captured_at - self._settings.worst_delay_s,
            sequence=self._frames,
        )

    def counters(self) -> Counters:
        """What became of the pictures, as far as OpenCV lets on: lost and spoilt ones do not show."""
        return Counters(frames=self._frames)

    def _configure(self, capture: cv2.VideoCapture) -> None:
        settings = self._settings
        code = cv2.VideoWriter.fourcc(*settings.format)
        asked: list[tuple[str, int, float]] = [
            ("format", cv2.CAP_PROP_FOURCC, code),
            ("width_px", cv2.CAP_PROP_FRAME_WIDTH, settings.width_px),
            ("height_px", cv2.CAP_PROP_FRAME_HEIGHT, settings.height_px),
            ("rate_hz", cv2.CAP_PROP_FPS, settings.rate_hz),
            ("automatic exposure", cv2.CAP_PROP_AUTO_EXPOSURE, 1),
            ("exposure_us / 100", cv2.CAP_PROP_EXPOSURE, settings.exposure_us // 100),
        ]
        if settings.gain is not None:
            asked.append(("gain", cv2.CAP_PROP_GAIN, settings.gain))
        if settings.white_balance_k is not None:
            asked.append(("automatic white balance", cv2.CAP_PROP_AUTO_WB, 0))
            asked.append(("white_balance_k", cv2.CAP_PROP_WB_TEMPERATURE, settings.white_balance_k))
        if settings.focus is not None:
            asked.append(("automatic focus", cv2.CAP_PROP_AUTOFOCUS, 0))
            asked.append(("focus", cv2.CAP_PROP_FOCUS, settings.focus))
        for _, what, value in asked:
            capture.set(what, value)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, settings.buffers)
        for key, what, value in asked:
            has = capture.get(what)
            if abs(has - value) > 0.01 * max(1.0, abs(value)):
                raise CommandRejected(
                    self._name,
                    f"{settings.device}: {key}: wanted {value:g}, it has {has:g}; `capture: ioctl` tells its "
                    "range",
                )

    def _gone(self) -> DeviceUnavailable:
        return DeviceUnavailable(
            self._name,
            f"{self._settings.device} gives no pictures any more: it was unplugged, or does not answer",
        )
