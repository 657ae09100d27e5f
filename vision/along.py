"""What one picture shows along lines: flanks and ends, gathered from the edges near each, and the evidence
of a window of a line."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vision.edges import Reals
from vision.jit import compiled, inlined
from vision.types import Floats, Ints

FLANK_SIGMA_PX, FLANK_PX = 0.8, 2.0
FLANK_TURN, TIP_TURN = float(np.sin(np.deg2rad(18.5))), float(np.cos(np.deg2rad(23.5)))
"""An edge is of a line's flank where its direction has no greater share along the line, of an end where
it has no smaller one."""
TILE = 8
BEYOND_WEIGHT = 0.5
"""What evidence costs that goes on beyond a window, per px."""
NOTHING = -1e9


@compiled
def _by_tile(table: Reals, rows: int, columns: int) -> tuple[Reals, Ints]:
    """Edges sorted by the square of `TILE` px they lie in, row by row of squares; where each begins."""
    starts = np.zeros(rows * columns + 1, np.int64)
    tile = np.empty(len(table), np.int64)
    for e in range(len(table)):
        column = min(max(int(table[e, 0]) // TILE, 0), columns - 1)
        row = min(max(int(table[e, 1]) // TILE, 0), rows - 1)
        tile[e] = row * columns + column
        starts[tile[e] + 1] += 1
    for k in range(rows * columns):
        starts[k + 1] += starts[k]
    place = starts[:-1].copy()
    found = np.empty((len(table), 5), np.float32)
    for e in range(len(table)):
        k = place[tile[e]]
        place[tile[e]] += 1
        for n in range(5):
            found[k, n] = table[e, n]
    return found, starts


@compiled
def along(
    table: Reals, ground: npt.NDArray[np.uint8], lines_of: Floats, width: float, reach: int
) -> tuple[Floats, Reals]:
    """Evidence along every line, gathered from the edges of fitting direction.

    A place without part in it counts -1.5, one without flanks -0.15, one flank +0.3, both +1.35.
    """
    count = len(lines_of)
    size = 2 * reach + 1
    total = np.zeros((count, size + 1))
    tips = np.zeros((count, size, 2), np.float32)
    low, high = np.zeros(size), np.zeros(size)
    rows, columns = ground.shape[0] // TILE + 1, ground.shape[1] // TILE + 1
    sorted_edges, starts = _by_tile(table, rows, columns)
    half = 0.5 * width
    aside = half + FLANK_PX
    per_tip, per_sigma = 1.0 / max(0.8 * width, 1.0), 1.0 / FLANK_SIGMA_PX
    kept = np.empty(len(table) + 1, np.int64)
    for line in range(count):
        ox, oy, ux, uy = lines_of[line, 0], lines_of[line, 1], lines_of[line, 2], lines_of[line, 3]
        low[:] = 0.0
        high[:] = 0.0
        far = reach + 2.0
        # the upright rectangle round the line, and in each row of squares what the line's band covers
        left, right = ox - far * abs(ux) - aside, ox + far * abs(ux) + aside
        top, bottom = oy - far * uy - aside, oy + far * uy + aside
        lean, wide = ux / max(uy, 1e-6), aside / max(uy, 1e-6)
        for row in range(max(0, int(top) // TILE), min(rows - 1, int(bottom) // TILE) + 1):
            a, b = ox + (row * TILE - oy) * lean, ox + ((row + 1) * TILE - oy) * lean
            first = int(max(left, min(a, b) - wide, 0.0)) // TILE
            last = int(max(0.0, min(right, max(a, b) + wide, columns * TILE - 1.0))) // TILE
            # a sieve without branches: no pattern tells which edges of the squares are of this line
            fitting = 0
            for e in range(starts[row * columns + first], starts[row * columns + max(first, last + 1)]):
                x, y = sorted_edges[e, 0] - ox, sorted_edges[e, 1] - oy
                off = y * ux - x * uy
                forward = abs(sorted_edges[e, 2] * ux + sorted_edges[e, 3] * uy)
                looks = sorted_edges[e, 3] * ux - sorted_edges[e, 2] * uy
                # the bright side of a flank is the line's side
                flank = (forward < FLANK_TURN) & (abs(abs(off) - half) <= FLANK_PX) & (looks * off <= 0.0)
                tip = (forward > TIP_TURN) & (abs(off) <= 0.4 * width)
                kept[fitting] = e
                fitting += int(flank | tip)
            for k in range(fitting):
                e = kept[k]
                x, y = sorted_edges[e, 0] - ox, sorted_edges[e, 1] - oy
                off = y * ux - x * uy
                forward = sorted_edges[e, 2] * ux + sorted_edges[e, 3] * uy
                centre = x * ux + y * uy + reach
                if abs(forward) < FLANK_TURN:
                    place = int(centre + 0.5)
                    if place < 0 or place >= size:
                        continue
                    miss = (abs(off) - half) * per_sigma
                    value = sorted_edges[e, 4] * np.exp(-0.5 * miss * miss)
                    if off > 0:
                        high[place] = max(high[place], value)
                    else:
                        low[place] = max(low[place], value)
                else:
                    end = 0 if forward > 0 else 1
                    # an end face of width w gives about w edges
                    for place in range(max(0, int(centre) - 1), min(size, int(centre) + 3)):
                        off_t = place - centre
                        tips[line, place, end] += sorted_edges[e, 4] * np.exp(-0.5 * off_t * off_t) * per_tip
        for q in range(1, size - 1):
            if low[q] == 0.0 and low[q - 1] > 0.0 and low[q + 1] > 0.0:
                low[q] = min(low[q - 1], low[q + 1])
            if high[q] == 0.0 and high[q - 1] > 0.0 and high[q + 1] > 0.0:
                high[q] = min(high[q - 1], high[q + 1])
        for q in range(size):
            column, row = int(ox + (q - reach) * ux + 0.5), int(oy + (q - reach) * uy + 0.5)
            if column < 0 or row < 0 or column >= ground.shape[1] or row >= ground.shape[0]:
                value = -1.0
            elif ground[row, column] == 0:
                value = -1.5
            else:
                value = -0.15 + 0.45 * (low[q] + high[q]) + 0.6 * min(low[q], high[q])
            total[line, q + 1] = total[line, q] + value
            tips[line, q, 0] = min(tips[line, q, 0], 1.0)
            tips[line, q, 1] = min(tips[line, q, 1], 1.0)
    return total, tips


@inlined
def window_value(
    total: Floats, tips: Reals, line: int, reach: int, a: float, b: float, tip: float, beyond: int
) -> float:
    """Evidence between two places of a line, with its ends, less what goes on beyond them."""
    i, j = int(a + reach + 0.5), int(b + reach + 0.5)
    if i < beyond or j >= 2 * reach - beyond or j <= i:
        return NOTHING
    value = total[line, j] - total[line, i] + tip * (tips[line, i, 0] + tips[line, j, 1])
    before = total[line, i - 2] - total[line, i - beyond]
    after = total[line, j + beyond] - total[line, j + 2]
    return float(value - BEYOND_WEIGHT * (max(0.0, before) + max(0.0, after)))
