"""Directed edges of one picture: where grey rises steepest, to sub-pixel, and towards which side.

An edge knows its bright side. Two parts that touch are one blob in a mask; their edges, which look away
from each other, still tell them apart. Edges are found in raw pixels, where grey is untouched, and kept in
canvas pixels, with a map that names the edge at a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from vision.canvas import GRID_PX, Canvas
from vision.jit import compiled, inlined, lean, steady
from vision.types import Floats, Grey, Mask, read_only

Reals = npt.NDArray[np.float32]
Ids = npt.NDArray[np.int32]

SMOOTHING_PX = 0.7
LEAST_SHARE, FULL_SHARE = 0.03, 0.16
"""Grey per px, as shares of the contrast of parts: the faintest edge that counts, one that counts fully."""
LEAST_SLOPE_GREY = 1.2
"""Per px; below this sensor noise makes edges everywhere."""
NEAR_MASK_PX = 3
_REACH = 3
_KERNEL: Reals = np.asarray(
    cv2.getGaussianKernel(2 * _REACH + 1, SMOOTHING_PX, cv2.CV_32F)[:, 0].copy(), np.float32
)
X, Y, UX, UY, STRENGTH = 0, 1, 2, 3, 4
WAYS = 8
"""Directions that edges are looked up in, from along the rows on, towards higher rows."""
_BETWEEN = tuple(float(np.tan(np.pi / WAYS * (2 * n + 1))) for n in range(WAYS // 4))
SAME_WAY = 0.88
"""Least cosine between an edge's direction and the expected one."""
POSTED_PX = 3
"""How far from an edge, along its direction and against it, the way to it is posted."""
ASKEW, ASIDE_PX = 0.15, 0.7
"""Sine of the angle to rows and columns above which an edge is posted this far to its sides too."""


class Signposts(NamedTuple):
    """Which edge is the nearest to a place along a direction in which the edge looks too.

    ``table`` (N, 5) the edges; ``sign`` (H, W) the signpost at a canvas pixel, 0 where no edge is within
    `POSTED_PX`; ``edge`` (M, `WAYS`) one more than the edge that it names for a way, 0 none.
    """

    table: Reals
    sign: Ids
    edge: Ids


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Edges:
    """``table`` (N, 5): x, y, unit direction to the bright side, strength 0..1; ``at`` (H, W) which edge
    lies in a canvas pixel, -1 none; ``posts`` where to look edges up; ``ground`` (H, W) uint8, 0 where the
    canvas shows background."""

    table: Reals
    at: Ids
    posts: Signposts
    ground: npt.NDArray[np.uint8]


def edges(
    grey: Grey,
    mask: Mask,
    ground: Mask,
    contrast_grey: float,
    on: Canvas,
    side: int,
    row_shift_px: float = 0.0,
) -> Edges:
    """The edges in and near a mask.

    Parameters
    ----------
    grey, mask, ground : (H, W) raw
        See `vision.foreground.Foreground`.
    contrast_grey
        What parts stand out by.
    side
        0 left, 1 right.
    row_shift_px
        Added to the rows of this picture: what the calibration is off by.
    """
    # closed for writing like any other table: to compiled functions a writable one is another type
    table = read_only(np.zeros((0, 5), np.float32))
    at = np.full((on.height_px, on.width_px), -1, np.int32)
    drawn = np.zeros((on.height_px, on.width_px), np.uint8)
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0 or contrast_grey <= 0:
        return Edges(table=table, at=at, posts=signposts(table, at), ground=drawn)
    border = NEAR_MASK_PX + 4
    top, bottom = max(0, int(rows[0]) - border), min(grey.shape[0], int(rows[-1]) + border + 1)
    first, last = max(0, int(columns[0]) - border), min(grey.shape[1], int(columns[-1]) + border + 1)
    window = steady(grey[top:bottom, first:last])
    inside = np.ascontiguousarray(mask[top:bottom, first:last]).view(np.uint8)
    side_px = 2 * NEAR_MASK_PX + 1
    near = np.asarray(cv2.dilate(inside, np.ones((side_px, side_px), np.uint8)), np.uint8)
    least = max(LEAST_SLOPE_GREY, LEAST_SHARE * contrast_grey)
    found, count = _extract(
        window, near, _KERNEL, least, max(1.0, FULL_SHARE * contrast_grey),
        on.from_raw[side], float(first), float(top), row_shift_px, at,
    )  # fmt: skip
    around = steady(ground[top:bottom, first:last]).view(np.uint8)
    _draw_ground(around, on.from_raw[side], first, top, row_shift_px, drawn)
    # distortion may tear the mask by one pixel
    whole = np.asarray(cv2.dilate(drawn, np.ones((3, 3), np.uint8)), np.uint8)
    table = read_only(found[:count].copy())
    return Edges(table=table, at=at, posts=signposts(table, at), ground=whole)


def signposts(table: Reals, at: Ids) -> Signposts:
    """The signposts to edges (N, 5) that are named in a canvas (H, W): an edge that nobody can claim is not
    to be found either."""
    sign = np.zeros(at.shape, np.int32)
    # of each edge three pixels per ring and side
    edge = np.zeros((3 * (2 * POSTED_PX + 1) * len(table) + 1, WAYS), np.int32)
    _post(table, at, sign, edge)
    return Signposts(table=table, sign=sign, edge=edge)


@lean
def _smooth(grey: Grey, y: int, kernel: Reals, column: Reals, into: Reals) -> None:
    """One row of the picture under a Gaussian, mirrored at its border; ``column`` is scratch, `_REACH` wider
    on both sides."""
    rows, columns = grey.shape
    column[:] = 0.0
    for k in range(-_REACH, _REACH + 1):
        row = abs(y + k)
        row = min(row, 2 * (rows - 1) - row) if rows > _REACH else min(row, rows - 1)
        share = kernel[k + _REACH]
        line = grey[row]
        for x in range(columns):
            column[x + _REACH] += share * np.float32(line[x])
    for k in range(1, _REACH + 1):
        column[_REACH - k] = column[_REACH + min(k, columns - 1)]
        column[_REACH + columns - 1 + k] = column[_REACH + columns - 1 - min(k, columns - 1)]
    k0, k1, k2, k3 = kernel[_REACH], kernel[_REACH + 1], kernel[_REACH + 2], kernel[_REACH + 3]
    for x in range(columns):
        into[x] = (
            k0 * column[x + 3]
            + k1 * (column[x + 2] + column[x + 4])
            + k2 * (column[x + 1] + column[x + 5])
            + k3 * (column[x] + column[x + 6])
        )


@lean
def _slopes(above: Reals, here: Reals, below: Reals, gx: Reals, gy: Reals, slope: Reals) -> None:
    """Gradient of one row of grey by Sobel's masks, per px, and its size; the two border columns are 0."""
    eighth, two = np.float32(0.125), np.float32(2.0)
    for x in range(1, len(here) - 1):
        across = (above[x + 1] + two * here[x + 1] + below[x + 1]) - (
            above[x - 1] + two * here[x - 1] + below[x - 1]
        )
        down = (below[x - 1] + two * below[x] + below[x + 1]) - (above[x - 1] + two * above[x] + above[x + 1])
        gx[x] = eighth * across
        gy[x] = eighth * down
        slope[x] = eighth * np.sqrt(across * across + down * down)


@compiled
def _extract(
    grey: Grey,
    near_mask: npt.NDArray[np.uint8],
    kernel: Reals,
    least: float,
    full: float,
    grid: Floats,
    left: float,
    top: float,
    row_shift: float,
    at: Ids,
) -> tuple[Reals, int]:
    """Non-maximum suppression along the gradient, parabola through three slopes, then onto the canvas.

    Row by row: only the last three smooth rows and the last three rows of slopes are kept.
    """
    rows, columns = grey.shape
    found = np.empty((rows * columns // 3 + 1, 5), np.float32)
    count = 0
    column_sums = np.empty(columns + 2 * _REACH, np.float32)
    smooth, gx, gy = np.zeros((3, 3, columns), np.float32)
    slope = np.zeros((3, columns), np.float32)
    for ahead_y in range(rows):
        _smooth(grey, ahead_y, kernel, column_sums, smooth[ahead_y % 3])
        if ahead_y < 2:
            continue
        now = (ahead_y - 1) % 3
        _slopes(smooth[(ahead_y - 2) % 3], smooth[now], smooth[ahead_y % 3], gx[now], gy[now], slope[now])
        y = ahead_y - 2
        if y < 2:
            continue
        near, own_x, own_y = near_mask[y], gx[y % 3], gy[y % 3]
        own, above, below = slope[y % 3], slope[(y - 1) % 3], slope[(y + 1) % 3]
        for x in range(2, columns - 2):
            if near[x] == 0:
                continue
            here = own[x]
            if here < least:
                continue
            ux = own_x[x] / here
            uy = own_y[x] / here
            # the rows the direction leads to, and where it comes from
            ahead_row, behind_row = (below, above) if uy >= 0.0 else (above, below)
            px, fy = x + ux, abs(uy)
            i = int(px)
            fx = px - i
            ahead = (own[i] * (1 - fx) + own[i + 1] * fx) * (1 - fy) + (
                ahead_row[i] * (1 - fx) + ahead_row[i + 1] * fx
            ) * fy
            if here < ahead:
                continue
            px = x - ux
            i = int(px)
            fx = px - i
            behind = (own[i] * (1 - fx) + own[i + 1] * fx) * (1 - fy) + (
                behind_row[i] * (1 - fx) + behind_row[i + 1] * fx
            ) * fy
            if here <= behind:
                continue
            bend = behind - 2 * here + ahead
            off = min(max(0.5 * (behind - ahead) / bend, -0.5), 0.5) if bend < -1e-6 else 0.0
            ex, ey = left + x + off * ux, top + y + off * uy
            # bilinear within the grid's cell: where the place and its direction lie on the canvas
            qx, qy = ex / GRID_PX, ey / GRID_PX
            i = min(max(int(qx), 0), grid.shape[1] - 2)
            j = min(max(int(qy), 0), grid.shape[0] - 2)
            fx, fy = qx - i, qy - j
            ax, ay, bx, by = grid[j, i, 0], grid[j, i, 1], grid[j, i + 1, 0], grid[j, i + 1, 1]
            px, py = grid[j + 1, i, 0], grid[j + 1, i, 1]
            sx, sy = grid[j + 1, i + 1, 0], grid[j + 1, i + 1, 1]
            cx = (ax * (1 - fx) + bx * fx) * (1 - fy) + (px * (1 - fx) + sx * fx) * fy
            cy = (ay * (1 - fx) + by * fx) * (1 - fy) + (py * (1 - fx) + sy * fx) * fy
            dx = ux * ((bx - ax) * (1 - fy) + (sx - px) * fy) + uy * ((px - ax) * (1 - fx) + (sx - bx) * fx)
            dy = ux * ((by - ay) * (1 - fy) + (sy - py) * fy) + uy * ((py - ay) * (1 - fx) + (sy - by) * fx)
            size = np.sqrt(dx * dx + dy * dy)
            cy += row_shift
            column, row = int(cx + 0.5), int(cy + 0.5)
            if column < 0 or row < 0 or column >= at.shape[1] or row >= at.shape[0] or count >= len(found):
                continue
            strength = min(1.0, here / full)
            other = at[row, column]
            # two edges in one pixel: the stronger is named
            if other < 0 or found[other, 4] < strength:
                at[row, column] = count
            found[count, 0] = cx
            found[count, 1] = cy
            found[count, 2] = dx / size
            found[count, 3] = dy / size
            found[count, 4] = strength
            count += 1
    return found, count


@inlined
def way_of(ux: float, uy: float) -> int:
    """Which of the `WAYS` a unit direction is nearest to."""
    along, across = abs(ux), abs(uy)
    way = 0
    for tangent in _BETWEEN:
        way += int(across > tangent * along)
    if ux < 0:
        way = WAYS // 2 - way
    return (WAYS - way if uy < 0 else way) & (WAYS - 1)


@compiled
def _post(table: Reals, at: Ids, sign: Ids, edge: Ids) -> None:
    """Fills signposts: from far to near, so that the nearest edge stays."""
    high, wide = sign.shape
    # within this of a way, an edge looks the same way as some direction of that way
    within = 0.5 + np.arccos(SAME_WAY) / (2 * np.pi / WAYS)
    first, last = np.empty(len(table), np.int8), np.empty(len(table), np.int8)
    named = np.empty(len(table), np.int32)
    many = 0
    for e in range(len(table)):
        if at[int(table[e, 1] + 0.5), int(table[e, 0] + 0.5)] != e:
            continue
        named[many] = e
        many += 1
        turn = np.arctan2(table[e, 3], table[e, 2]) * (WAYS / (2 * np.pi))
        first[e], last[e] = int(np.ceil(turn - within)), int(np.floor(turn + within)) + 1
    half = np.float32(0.5)
    count = 0
    for ring in range(POSTED_PX, -1, -1):
        # beside the way to an edge, and then the ways themselves
        for aside in range(1, -1, -1):
            for turn in range(4 if aside and ring else 2 if aside or ring else 1):
                off = np.float32(ring if turn % 2 else -ring)
                if aside and not ring:
                    off = np.float32(0.0)
                across = np.float32(0.0)
                if aside:
                    across = np.float32(ASIDE_PX if (turn // 2 if ring else turn) else -ASIDE_PX)
                for place in range(many):
                    e = named[place]
                    ux, uy = table[e, 2], table[e, 3]
                    # lines of edges that run askew leave gaps between pixels that meet at a corner only
                    if aside and min(abs(ux), abs(uy)) < ASKEW:
                        continue
                    column = int(table[e, 0] + off * ux - across * uy + half)
                    row = int(table[e, 1] + off * uy + across * ux + half)
                    if column < 0 or row < 0 or column >= wide or row >= high:
                        continue
                    here = sign[row, column]
                    if here == 0:
                        count += 1
                        here = np.int32(count)
                        sign[row, column] = here
                    for way in range(first[e], last[e]):
                        edge[here, way & (WAYS - 1)] = e + 1


@lean
def _draw_ground(
    inside: npt.NDArray[np.uint8],
    grid: Floats,
    left: int,
    top: int,
    row_shift: float,
    ground: npt.NDArray[np.uint8],
) -> None:
    """Marks the canvas pixel of every mask pixel.

    Along a row of the picture the way to the canvas is straight within each cell of the grid.
    """
    rows, columns = inside.shape
    high, wide = ground.shape
    for y in range(rows):
        gy = (top + y) / GRID_PX
        j = min(max(int(gy), 0), grid.shape[0] - 2)
        fy = gy - j
        x = 0
        while x < columns:
            i = min((left + x) // GRID_PX, grid.shape[1] - 2)
            stop = min(columns, (i + 1) * GRID_PX - left) if i < grid.shape[1] - 2 else columns
            ax = (1 - fy) * grid[j, i, 0] + fy * grid[j + 1, i, 0]
            ay = (1 - fy) * grid[j, i, 1] + fy * grid[j + 1, i, 1]
            bx = ((1 - fy) * grid[j, i + 1, 0] + fy * grid[j + 1, i + 1, 0] - ax) / GRID_PX
            by = ((1 - fy) * grid[j, i + 1, 1] + fy * grid[j + 1, i + 1, 1] - ay) / GRID_PX
            ax, ay = ax + 0.5, ay + row_shift + 0.5
            begin = left - i * GRID_PX
            for k in range(x, stop):
                if inside[y, k] != 0:
                    column, row = int(ax + (begin + k) * bx), int(ay + (begin + k) * by)
                    if 0 <= row < high and 0 <= column < wide:
                        ground[row, column] = 1
            x = stop
