"""A camera's own clock on ours: from when each frame says it was taken, and when it came.

A frame comes later than it was taken by a delay that varies, and never by less than a certain least. So the
points (taken, come) lie above a line, which is the one clock seen from the other: it is found as the
line below all points that lies nearest to them, an edge of their lower convex hull (S. Moon, P. Skelly,
D. Towsley, "Estimation and removal of clock skew from network delay measurements", INFOCOM 1999).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

MOST_DRIFT: Final = 500e-6
"""Quartz is ten times better; a line steeper than this is no clock but a network that got slower."""
LEAST_SPAN_S: Final = 20.0
"""Below this the delays' scatter says more than the drift: the clocks count as equally fast."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockFit:
    """``our_s = origin_ours_s + rate * (device_s - origin_device_s)``, with the least delay included."""

    origin_device_s: float
    origin_ours_s: float
    rate: float

    def ours(self, device_s: float) -> float:
        """An instant of the device on our clock."""
        return self.origin_ours_s + self.rate * (device_s - self.origin_device_s)


def fit(device_s: Floats, ours_s: Floats) -> ClockFit:
    """The device's clock on ours.

    Parameters
    ----------
    device_s, ours_s : (N,) float, N >= 1
        When frames were taken by the device's clock, strictly rising, and when they came by ours; seconds.

    Examples
    --------
    >>> line = fit(np.array([0.0, 1.0, 2.0]), np.array([100.3, 101.1, 102.2]))
    >>> round(line.ours(2.0), 6), line.rate
    (102.1, 1.0)
    """
    x0, y0 = float(device_s[0]), float(ours_s[0])
    x, y = device_s - x0, ours_s - y0
    rate = 1.0
    if float(x[-1]) >= LEAST_SPAN_S:
        hull = _lower_hull(x, y)
        # the edge over the mean of all x minimises the sum of distances of the points from the line
        middle = float(x.mean())
        edge = next(i for i in range(1, len(hull)) if x[hull[i]] >= middle)
        a, b = hull[edge - 1], hull[edge]
        steep = float((y[b] - y[a]) / (x[b] - x[a]))
        rate = min(max(steep, 1.0 - MOST_DRIFT), 1.0 + MOST_DRIFT)
    offset = float((y - rate * x).min())
    return ClockFit(origin_device_s=x0, origin_ours_s=y0 + offset, rate=rate)


def _lower_hull(x: Floats, y: Floats) -> list[int]:
    """Indices of the lower convex hull of points with rising x (Andrew's monotone chain)."""
    hull: list[int] = []
    for i in range(len(x)):
        while len(hull) > 1:
            a, b = hull[-2], hull[-1]
            if (x[b] - x[a]) * (y[i] - y[a]) <= (y[b] - y[a]) * (x[i] - x[a]):
                hull.pop()
            else:
                break
        hull.append(i)
    return hull


class DeviceClock:
    """Follows a device's clock: of each second the quickest frame is kept, for some minutes."""

    def __init__(self, *, seconds: int = 300) -> None:
        self._kept: deque[tuple[float, float]] = deque(maxlen=seconds)
        self._fit: ClockFit | None = None

    def add(self, device_s: float, ours_s: float) -> ClockFit:
        """One more frame; the fit with it. A clock that goes back was started anew, and so is this."""
        if self._kept and device_s <= self._kept[-1][0] - 1.0:
            self._kept.clear()
        if self._kept and int(self._kept[-1][0]) == int(device_s):
            if ours_s - device_s < self._kept[-1][1] - self._kept[-1][0]:
                self._kept[-1] = (device_s, ours_s)
                self._fit = None
        elif not self._kept or device_s > self._kept[-1][0]:
            self._kept.append((device_s, ours_s))
            self._fit = None
        if self._fit is None:
            points = np.array(self._kept, dtype=np.float64)
            self._fit = fit(points[:, 0], points[:, 1])
        return self._fit


_LAST_ID: Final = 0xFFFF


def missed(before: int, now: int) -> int:
    """How many frames lie between two frame numbers of a GigE Vision camera.

    Numbers of 16 bits go from 65535 to 1: 0 is no number. Cameras that count in 64 bits do not come back to
    the start within our lives. A number that did not move forward means the stream was started anew: nothing
    is known, 0.

    >>> missed(7, 8), missed(7, 10), missed(65535, 1), missed(65534, 2)
    (0, 2, 0, 2)
    """
    if now > before:
        return now - before - 1
    wrapped = before <= _LAST_ID and before - now > _LAST_ID // 2
    return _LAST_ID - before + now - 1 if wrapped else 0
