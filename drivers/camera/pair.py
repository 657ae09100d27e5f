"""Two cameras as one rig that looks at one instant."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from drivers.errors import DeviceTimeout, StaleData
from drivers.interfaces import Camera
from drivers.timing import Clock
from drivers.types import Frame, FramePair, Pixels

_ONE_INSTANT_S: Final = 0.001
"""Pairs closer than this show one instant, however their cameras run: 1 mm at 1 m/s."""
_BLOCK_PX: Final = 8
_MOVED_GREY: Final = 12.0
"""The mean of a block changes by noise and flicker of light less than this, and by a part's edge more."""


def moved(before: Pixels, after: Pixels) -> float:
    """How much the block of a picture that changed most changed, in grey levels of 255; same sizes."""
    return float(np.abs(_blocks(after) - _blocks(before)).max(initial=0.0))


def _blocks(pixels: Pixels) -> npt.NDArray[np.float64]:
    grey = pixels if pixels.ndim == 2 else np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY))
    height, width = (max(1, side // _BLOCK_PX) for side in grey.shape)
    means = cv2.resize(grey.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(means, dtype=np.float64)


class TwoCameraRig:
    """Two cameras whose pictures must not be further apart than ``max_skew_s``.

    ``free_running``: nothing makes them expose together. Their pairs are good for parts that stand still, and
    that they do is looked at: the camera that exposed first is asked for one more frame, after the other's.
    """

    def __init__(
        self, left: Camera, right: Camera, max_skew_s: float, clock: Clock, *, free_running: bool = False
    ) -> None:
        self._left = left
        self._right = right
        self._max_skew_s = max_skew_s
        self._clock = clock
        self._free_running = free_running

    @property
    def name(self) -> str:
        """How logs and faults call it."""
        return "rig"

    def open(self) -> None:
        """Open both; if the second fails, the first is closed again."""
        self._left.open()
        with ExitStack() as undo:
            undo.callback(self._left.close)
            self._right.open()
            undo.pop_all()

    def close(self) -> None:
        """Close both."""
        self._right.close()
        self._left.close()

    def check(self) -> None:
        """`DeviceUnavailable` when one of them is known to be lost."""
        self._left.check()
        self._right.check()

    def grab_pair(self, *, newer_than: float, timeout_s: float) -> FramePair:
        """Two frames exposed after ``newer_than``, at most ``max_skew_s`` apart.

        While they are further apart, the older one is taken anew. When the time is over it raises `StaleData`
        if two pictures came but never close enough, or of a scene that did not stand still, else
        `DeviceTimeout`.
        """
        until = self._clock.now() + timeout_s

        def left_s() -> float:
            remaining = until - self._clock.now()
            if remaining <= 0.0:
                raise DeviceTimeout(self.name, f"no pair within {timeout_s:.2f} s")
            return remaining

        left = self._left.grab(newer_than=newer_than, timeout_s=left_s())
        right = self._right.grab(newer_than=newer_than, timeout_s=left_s())
        while True:
            pair = FramePair(left=left, right=right)
            if pair.skew_s <= self._max_skew_s:
                if not self._free_running or pair.skew_s <= _ONE_INSTANT_S:
                    return pair
                again, change = self._again(pair, left_s())
                if change <= _MOVED_GREY:
                    return pair
                if until - self._clock.now() < 2.0 * pair.skew_s:
                    raise StaleData(
                        self.name,
                        f"the scene moved between two pictures {pair.skew_s:.3f} s apart (by {change:.0f} "
                        f"grey levels, {_MOVED_GREY:.0f} allowed); these cameras run freely and are for "
                        "parts that stand still",
                    )
                left = self._left.grab(newer_than=again.captured_at, timeout_s=left_s())
                right = self._right.grab(newer_than=again.captured_at, timeout_s=left_s())
                continue
            if self._clock.now() >= until:
                raise StaleData(
                    self.name, f"pictures {pair.skew_s:.3f} s apart, {self._max_skew_s:.3f} s allowed"
                )
            # the older of the two is what keeps them apart
            if left.captured_at < right.captured_at:
                left = self._left.grab(newer_than=left.captured_at, timeout_s=left_s())
            else:
                right = self._right.grab(newer_than=right.captured_at, timeout_s=left_s())

    def _again(self, pair: FramePair, timeout_s: float) -> tuple[Frame, float]:
        """One more frame of the camera that exposed first, and how much it changed meanwhile."""
        first, last, camera = (
            (pair.left, pair.right, self._left)
            if pair.left.captured_at < pair.right.captured_at
            else (pair.right, pair.left, self._right)
        )
        again = camera.grab(newer_than=last.captured_at, timeout_s=timeout_s)
        return again, moved(first.pixels, again.pixels)
