"""Two cameras as one rig that looks at one instant."""

from __future__ import annotations

from drivers.errors import DeviceTimeout, StaleData
from drivers.interfaces import Camera
from drivers.timing import Clock
from drivers.types import FramePair


class TwoCameraRig:
    """Two cameras whose pictures must not be further apart than ``max_skew_s``."""

    def __init__(self, left: Camera, right: Camera, max_skew_s: float, clock: Clock) -> None:
        self._left = left
        self._right = right
        self._max_skew_s = max_skew_s
        self._clock = clock

    @property
    def name(self) -> str:
        """How logs and faults call it."""
        return "rig"

    def open(self) -> None:
        """Open both; if the second fails, the first is closed again."""
        self._left.open()
        try:
            self._right.open()
        except BaseException:
            self._left.close()
            raise

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
        if two pictures came but never close enough, else `DeviceTimeout`.
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
                return pair
            if self._clock.now() >= until:
                raise StaleData(
                    self.name, f"pictures {pair.skew_s:.3f} s apart, {self._max_skew_s:.3f} s allowed"
                )
            # the older of the two is what keeps them apart
            if left.captured_at < right.captured_at:
                left = self._left.grab(newer_than=left.captured_at, timeout_s=left_s())
            else:
                right = self._right.grab(newer_than=right.captured_at, timeout_s=left_s())
