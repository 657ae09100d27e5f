"""Which hypotheses can have to do with each other at all."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vision.jit import compiled, lean
from vision.types import Floats, Ints


class Cells(NamedTuple):
    """Places in square cells of ``size`` px.

    Those of cell ``c`` are ``members[starts[c] : starts[c + 1]]``, in their order; ``cell`` (N, 2) column and
    row of each place; ``columns``, ``rows`` how many there are.
    """

    size: float
    starts: Ints
    members: Ints
    cell: Ints
    columns: int
    rows: int


@compiled
def cells_of(at: Floats, size: float) -> Cells:
    """Places (N, 2) by cells: what is within ``size`` px of a place is in its cell or in one beside it."""
    count = len(at)
    cell = np.zeros((count, 2), np.int64)
    if count > 0:
        left, top = at[:, 0].min(), at[:, 1].min()
        for k in range(count):
            cell[k, 0], cell[k, 1] = int((at[k, 0] - left) / size), int((at[k, 1] - top) / size)
    columns, rows = 1, 1
    for k in range(count):
        columns, rows = max(columns, cell[k, 0] + 1), max(rows, cell[k, 1] + 1)
    starts, members = np.zeros(columns * rows + 1, np.int64), np.empty(count, np.int64)
    for k in range(count):
        starts[cell[k, 1] * columns + cell[k, 0] + 1] += 1
    for c in range(columns * rows):
        starts[c + 1] += starts[c]
    filled = starts[:-1].copy()
    for k in range(count):
        c = cell[k, 1] * columns + cell[k, 0]
        members[filled[c]] = k
        filled[c] += 1
    return Cells(size, starts, members, cell, columns, rows)


@lean
def row_of_cells(cells: Cells, place: int, turn: int) -> tuple[int, int]:
    """Where the members of the cell of a place and of both cells beside it begin and end, in the row of cells
    above it, its own and the one below: ``turn`` 0, 1, 2."""
    column, row = cells.cell[place, 0], cells.cell[place, 1] + turn - 1
    if row < 0 or row >= cells.rows:
        return 0, 0
    first, last = max(column - 1, 0), min(column + 1, cells.columns - 1)
    return int(cells.starts[row * cells.columns + first]), int(cells.starts[row * cells.columns + last + 1])


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
