"""Looking an edge up where a part's flank or end should be."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vision.edges import SAME_WAY, Signposts, way_of
from vision.jit import inlined, lean

Counts = npt.NDArray[np.uint16]

PROBE_PX = 0.7


@inlined
def nearest_edge(
    posts: Signposts, taken: Counts, x: float, y: float, nx: float, ny: float, reach: float
) -> tuple[int, float]:
    """The free edge nearest to (x, y) along the unit direction (nx, ny), which it must look towards.

    Returns
    -------
    int, float
        Index, -1 if there is none within ``reach`` px; its offset along the direction.
    """
    table = posts.table
    way = way_of(nx, ny)
    best, best_off = -1, 0.0
    nearest = reach
    last = -1
    steps = int(reach / PROBE_PX) + 1
    for step in range(2 * steps + 1):
        # from the middle outwards: 0, 1, -1, 2, -2, ...
        half = (step + 1) // 2
        off = half * PROBE_PX if step % 2 == 1 else -half * PROBE_PX
        if best >= 0 and abs(off) > nearest + PROBE_PX:
            break
        u, v = x + off * nx + 0.5, y + off * ny + 0.5
        if u < 0 or v < 0 or u >= posts.sign.shape[1] or v >= posts.sign.shape[0]:
            continue
        edge = posts.edge[posts.sign[int(v), int(u)], way] - 1
        if edge < 0:
            if step == 0:
                break
            continue
        if edge == last or taken[edge] > 0:
            continue
        last = edge
        if table[edge, 2] * nx + table[edge, 3] * ny < SAME_WAY:
            continue
        along = (table[edge, 0] - x) * nx + (table[edge, 1] - y) * ny
        if abs(along) <= nearest:
            nearest = abs(along)
            best, best_off = edge, along
        if step == 0:
            # what the signpost right here names is the nearest, unless it is somebody's or looks elsewhere
            break
    return best, best_off


@lean
def tip_offset(
    posts: Signposts, taken: Counts, x: float, y: float, ux: float, uy: float, width: float, reach: float
) -> tuple[float, int, float]:
    """How far beyond (x, y), in the outward direction (ux, uy), the end face of a part is seen.

    Five lanes across the part are read.

    Returns
    -------
    float, int, float
        Mean offset, number of lanes that showed an edge, mean strength over all five.
    """
    total, strength, count = 0.0, 0.0, 0
    for lane in range(-2, 3):
        aside = lane * width * 0.17
        edge, off = nearest_edge(posts, taken, x - uy * aside, y + ux * aside, -ux, -uy, reach)
        if edge >= 0:
            total -= off
            strength += posts.table[edge, 4]
            count += 1
    return (total / count if count > 0 else 0.0), count, strength / 5.0
