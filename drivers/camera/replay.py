"""A folder of recorded pictures as a camera.

The pictures come in the natural order of their names (``left2`` before ``left10``). When they were really
taken is not known, so each counts as exposed right after the instant it is asked for; that way two eyes asked
for the same instant agree on it, and the pictures of one pair stay together.
"""

from __future__ import annotations

import math
import re
import threading
from pathlib import Path

import cv2
import numpy as np

from drivers.camera_settings import ReplayCameraSettings
from drivers.errors import CommandRejected, DeviceTimeout, DeviceUnavailable
from drivers.timing import Clock
from drivers.types import Frame, Pixels


def natural(name: str) -> tuple[tuple[int, int | str], ...]:
    """Sort key under which digits count as numbers.

    >>> sorted(["left10.png", "left2.png"], key=natural)
    ['left2.png', 'left10.png']
    """
    parts = re.split(r"(\d+)", name)
    return tuple((0, int(part)) if part.isdigit() else (1, part.lower()) for part in parts if part)


class ReplayCamera:
    """Plays back the pictures of one eye."""

    def __init__(self, name: str, settings: ReplayCameraSettings, clock: Clock) -> None:
        self._name = name
        self._settings = settings
        self._clock = clock
        self._files: tuple[Path, ...] = ()
        self._next = 0
        self._sequence = 0

    @property
    def name(self) -> str:
        """How logs and faults call it."""
        return self._name

    def open(self) -> None:
        """List the pictures; `DeviceUnavailable` when the folder is not there or none matches."""
        folder, pattern = self._settings.folder, self._settings.pattern
        if not folder.is_dir():
            raise DeviceUnavailable(self._name, f"{folder} is not a folder")
        try:
            files = sorted(
                (path for path in folder.glob(pattern) if path.is_file()),
                key=lambda path: natural(str(path.relative_to(folder))),
            )
        except (OSError, ValueError, NotImplementedError) as error:
            raise DeviceUnavailable(self._name, f"cannot list {pattern!r} in {folder}: {error}") from error
        if not files:
            raise DeviceUnavailable(self._name, f"no picture in {folder} matches {pattern!r}")
        self._files, self._next = tuple(files), 0

    def close(self) -> None:
        """Forget the list."""
        self._files, self._next = (), 0

    def check(self) -> None:
        """A folder is not lost; `DeviceUnavailable` when it is not open."""
        if not self._files:
            raise DeviceUnavailable(self._name, "not open")

    def grab(self, *, newer_than: float, timeout_s: float) -> Frame:
        """The next picture.

        Raises
        ------
        DeviceUnavailable
            Not open, or the file cannot be read as a picture.
        DeviceTimeout
            There is no further picture, or ``newer_than`` lies more than ``timeout_s`` ahead.
        CommandRejected
            The picture has another size than the settings.
        """
        if not self._files:
            raise DeviceUnavailable(self._name, "not open")
        if self._next >= len(self._files):
            if not self._settings.repeat:
                raise DeviceTimeout(self._name, f"all {len(self._files)} pictures were played")
            self._next = 0
        if newer_than - self._clock.now() > timeout_s:
            raise DeviceTimeout(
                self._name, f"no picture newer than {newer_than:.3f} s within {timeout_s:.2f} s"
            )
        exposed_at = math.nextafter(newer_than, math.inf) if math.isfinite(newer_than) else self._clock.now()
        self._clock.wait(threading.Event(), exposed_at - self._clock.now())
        path = self._files[self._next]
        pixels = self._read(path)
        self._next += 1
        self._sequence += 1
        return Frame(camera=self._name, pixels=pixels, captured_at=exposed_at, sequence=self._sequence)

    def _read(self, path: Path) -> Pixels:
        try:
            content = np.frombuffer(path.read_bytes(), dtype=np.uint8)
            decoded = cv2.imdecode(content, cv2.IMREAD_COLOR) if content.size else None
        except (OSError, cv2.error) as error:
            raise DeviceUnavailable(self._name, f"{path} cannot be read: {error}") from error
        if decoded is None:
            raise DeviceUnavailable(self._name, f"{path} is not a picture that can be read")
        height, width = decoded.shape[:2]
        if (width, height) != (self._settings.width_px, self._settings.height_px):
            raise CommandRejected(
                self._name,
                f"{path} is {width}x{height}, the settings say "
                f"{self._settings.width_px}x{self._settings.height_px}",
            )
        pixels = np.asarray(decoded, dtype=np.uint8)
        pixels.setflags(write=False)
        return pixels
