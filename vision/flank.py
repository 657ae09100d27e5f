"""Looking an edge up where a part's flank or end should be."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vision.edges import Ids, Reals
from vision.jit import compiled

Counts = npt.NDArray[np.uint16]

SAME_WAY = 0.88
"""Least cosine between an edge's direction and the expected one."""
PROBE_PX = 0.7
ASKEW = 0.15
"""Sine of the angle to rows and columns above which an edge steps aside often."""


@compiled
def nearest_edge(
    table: Reals,
    at: Ids,
    taken: Counts,
    x: float,
    y: float,
    nx: float,
    ny: float,
    reach: float,
) -> tuple[int, float]:
    """The free edge nearest to (x, y) along the unit direction (nx, ny), which it must look towards.

    Returns
    -------
    int, float
        Index, -1 if there is none within ``reach`` px; its offset along the direction.
    """
    best, best_off = -1, 0.0
    nearest = reach
    last = -1
    askew = min(abs(nx), abs(ny)) > ASKEW
    steps = int(reach / PROBE_PX) + 1
    for step in range(2 * steps + 1):
        # from the middle outwards: 0, 1, -1, 2, -2, ...
        half = (step + 1) // 2
        off = half * PROBE_PX if step % 2 == 1 else -half * PROBE_PX
        if best >= 0 and abs(off) > nearest + PROBE_PX:
            break
        u, v = x + off * nx + 0.5, y + off * ny + 0.5
        column, row = int(u), int(v)
        if column < 1 or row < 1 or column >= at.shape[1] - 1 or row >= at.shape[0] - 1:
            continue
        edge = at[row, column]
        if edge < 0 and askew:
            # an edge that runs askew passes between two pixels that meet at a corner only
            du, dv = u - column - 0.5, v - row - 0.5
            if abs(du) > abs(dv):
                column += 1 if du > 0 else -1
            else:
                row += 1 if dv > 0 else -1
            edge = at[row, column]
        if edge < 0 or edge == last or taken[edge] > 0:
            continue
        last = edge
        if table[edge, 2] * nx + table[edge, 3] * ny < SAME_WAY:
            continue
        along = (table[edge, 0] - x) * nx + (table[edge, 1] - y) * ny
        if abs(along) <= nearest:
            nearest = abs(along)
            best = edge
            best_off = along
    return best, best_off


@compiled
def tip_offset(
    table: Reals,
    at: Ids,
    taken: Counts,
    x: float,
    y: float,
    ux: float,
    uy: float,
    width: float,
    reach: float,
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
        edge, off = nearest_edge(table, at, taken, x - uy * aside, y + ux * aside, -ux, -uy, reach)
        if edge >= 0:
            total -= off
            strength += table[edge, 4]
            count += 1
    return (total / count if count > 0 else 0.0), count, strength / 5.0
