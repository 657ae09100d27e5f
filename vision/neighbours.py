"""Which hypotheses can have to do with each other at all."""

from __future__ import annotations

import numpy as np

from vision.jit import compiled, lean
from vision.types import Floats, Ints


@compiled
def neighbours(ends: Floats, margin: float) -> tuple[Ints, Ints]:
    """For each hypothesis those that it can share edges with, cover, or pass through: starts and places."""
    count = len(ends)
    starts = np.zeros(count + 1, np.int64)
    meets = np.zeros((count, count), np.bool_)
    # most pairs are far apart: upright boxes tell that at a glance
    low, high = np.empty((count, 2, 2)), np.empty((count, 2, 2))
    for h in range(count):
        for view in range(2):
            for n in range(2):
                low[h, view, n] = min(ends[h, view, n], ends[h, view, n + 2])
                high[h, view, n] = max(ends[h, view, n], ends[h, view, n + 2]) + margin
    for h in range(count):
        for k in range(h):
            near = False
            for view in range(2):
                near |= (
                    (low[h, view, 0] <= high[k, view, 0])
                    & (low[k, view, 0] <= high[h, view, 0])
                    & (low[h, view, 1] <= high[k, view, 1])
                    & (low[k, view, 1] <= high[h, view, 1])
                )
            if near and _meet_in_picture(ends, h, k, margin):
                meets[h, k] = True
                meets[k, h] = True
    for h in range(count):
        starts[h + 1] = starts[h] + meets[h].sum()
    found = np.empty(starts[count], np.int64)
    for h in range(count):
        at = starts[h]
        for k in range(count):
            if meets[h, k]:
                found[at] = k
                at += 1
    return starts, found


@lean
def _meet_in_picture(ends: Floats, h: int, k: int, margin: float) -> bool:
    """Whether two hypotheses come nearer than ``margin`` in either picture, by separating axes."""
    for view in range(2):
        apart = False
        for turn in range(2):
            first, second = (h, k) if turn == 0 else (k, h)
            xa, ya = ends[first, view, 0], ends[first, view, 1]
            dx, dy = ends[first, view, 2] - xa, ends[first, view, 3] - ya
            size = np.hypot(dx, dy)
            ux, uy = dx / size, dy / size
            px, py = ends[second, view, 0] - xa, ends[second, view, 1] - ya
            qx, qy = ends[second, view, 2] - xa, ends[second, view, 3] - ya
            c0, c1 = -px * uy + py * ux, -qx * uy + qy * ux
            t0, t1 = px * ux + py * uy, qx * ux + qy * uy
            if min(c0, c1) > margin or max(c0, c1) < -margin:
                apart = True
            if min(t0, t1) > size + margin or max(t0, t1) < -margin:
                apart = True
        if not apart:
            return True
    return False
