"""Pieces and holes of a binary picture, counted from its 2x2 quads (Gray 1971), 8-connected foreground."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import ndimage


def euler_number(mask: npt.NDArray[np.bool_]) -> int:
    """Pieces minus holes: (Q1 - Q3 - 2 Qd) / 4 over all 2x2 quads of the framed picture."""
    framed = np.pad(mask, 1).astype(int)
    a, b, c, d = framed[:-1, :-1], framed[:-1, 1:], framed[1:, :-1], framed[1:, 1:]
    total = a + b + c + d
    diagonal = (total == 2) & (a == d)
    return int((total == 1).sum() - (total == 3).sum() - 2 * diagonal.sum()) // 4


def pieces(mask: npt.NDArray[np.bool_]) -> int:
    """Number of 8-connected pieces."""
    _, count = ndimage.label(mask, structure=np.ones((3, 3), int))
    return int(count)
