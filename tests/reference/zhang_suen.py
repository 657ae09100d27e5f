"""Two thinnings as a reader of the papers would write them: slow, one pixel at a time.

They share no code and no idea with `vision.thin`; the tests compare the two pixel for pixel.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

Picture = npt.NDArray[np.bool_]
Rule = Callable[[list[int], int], bool]


def zhang_suen(mask: Picture) -> Picture:
    """CACM 27 (1984), p. 237: conditions (a) to (d), (c') and (d')."""
    return _repeat(mask, _zhang_suen_goes)


def guo_hall(mask: Picture) -> Picture:
    """CACM 32 (1989), p. 362: algorithm A1, conditions (a) to (c)."""
    return _repeat(mask, _guo_hall_goes)


def _zhang_suen_goes(p: list[int], step: int) -> bool:
    around = p[2:10]
    rises = sum(around[k] == 0 and around[(k + 1) % 8] == 1 for k in range(8))
    if not 2 <= sum(around) <= 6 or rises != 1:
        return False
    if step == 0:
        return p[2] * p[4] * p[6] == 0 and p[4] * p[6] * p[8] == 0
    return p[2] * p[4] * p[8] == 0 and p[2] * p[6] * p[8] == 0


def _guo_hall_goes(p: list[int], step: int) -> bool:
    c = (
        ((1 - p[2]) & (p[3] | p[4]))
        + ((1 - p[4]) & (p[5] | p[6]))
        + ((1 - p[6]) & (p[7] | p[8]))
        + ((1 - p[8]) & (p[9] | p[2]))
    )
    n1 = (p[9] | p[2]) + (p[3] | p[4]) + (p[5] | p[6]) + (p[7] | p[8])
    n2 = (p[2] | p[3]) + (p[4] | p[5]) + (p[6] | p[7]) + (p[8] | p[9])
    if c != 1 or not 2 <= min(n1, n2) <= 3:
        return False
    if step == 0:
        return (p[2] | p[3] | (1 - p[5])) & p[4] == 0
    return (p[6] | p[7] | (1 - p[9])) & p[8] == 0


def _repeat(mask: Picture, goes: Rule) -> Picture:
    rows, columns = mask.shape
    padded = np.zeros((rows + 2, columns + 2), int)
    padded[1:-1, 1:-1] = mask
    changed = True
    while changed:
        changed = False
        for step in (0, 1):
            doomed = []
            for y in range(1, rows + 1):
                for x in range(1, columns + 1):
                    if padded[y, x] and goes(_neighbours(padded, y, x), step):
                        doomed.append((y, x))
            for y, x in doomed:
                padded[y, x] = 0
            changed = changed or bool(doomed)
    return padded[1:-1, 1:-1].astype(bool)


def _neighbours(padded: npt.NDArray[np.int_], y: int, x: int) -> list[int]:
    """p[2] .. p[9] clockwise from the north; p[0] unused, p[1] the pixel itself."""
    offsets = [(0, 0), (-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1)]
    return [0, *(int(padded[y + dy, x + dx]) for dy, dx in offsets)]
