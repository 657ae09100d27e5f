"""What both pictures show of each hypothesis, sample by sample: what the choice of a scene is made from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vision.edges import SAME_WAY, Edges, Ids, Reals, Signposts
from vision.ends import LANE_WIDTHS, LANES, cap_px
from vision.flank import Counts, nearest_edge
from vision.jit import lean
from vision.refine import UNIT
from vision.types import Floats, Ints

SAMPLE_PX = 2.5
FLANK_REACH_PX, FLANK_SIGMA_PX = 1.3, 0.8
TIP_REACH_PX, TIP_SIGMA_PX = 2.0, 1.2
CLAIM_PX = 1.5
INNER = 0.75
"""Where, in half widths from the axis, a part without a flank must still stand out of the background."""
BEYOND = 10
"""How many px beyond an end are searched for flanks that go on."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Traits:
    """Of N hypotheses in 2 views with S samples each.

    ``count`` (N, 2) samples used; ``ends`` (N, 2, 4) xa, ya, xb, yb in that view; ``width`` (N, 2) px at
    either end; ``value`` (N, 2, S, 2) strength of the flank on the low and the high side, ``edge`` its edge
    or -1; ``ground`` (N, 2, S) uint8 0 background, 1 part, 2 outside the picture; ``tip_value``,
    ``tip_edge`` (N, 2, 2, 5); ``beyond_value``, ``beyond_edge`` (N, 2, 2, 10, 2).
    """

    count: npt.NDArray[np.int32]
    ends: Floats
    width: Floats
    value: Reals
    edge: Ids
    ground: npt.NDArray[np.uint8]
    tip_value: Reals
    tip_edge: Ids
    beyond_value: Reals
    beyond_edge: Ids


def traits(hypotheses: Floats, left: Edges, right: Edges, camera: Floats, longest_px: float) -> Traits:
    """Read both pictures along hypotheses (N, `COLUMNS`), none longer than ``longest_px`` in a picture.

    ``camera`` (4,) focal px, baseline m, principal point px.
    """
    count, samples = len(hypotheses), int(longest_px / SAMPLE_PX) + 2
    found = Traits(
        count=np.zeros((count, 2), np.int32),
        ends=np.zeros((count, 2, 4)),
        width=np.zeros((count, 2)),
        value=np.zeros((count, 2, samples, 2), np.float32),
        edge=np.full((count, 2, samples, 2), -1, np.int32),
        ground=np.zeros((count, 2, samples), np.uint8),
        tip_value=np.zeros((count, 2, 2, LANES), np.float32),
        tip_edge=np.full((count, 2, 2, LANES), -1, np.int32),
        beyond_value=np.zeros((count, 2, 2, BEYOND, 2), np.float32),
        beyond_edge=np.full((count, 2, 2, BEYOND, 2), -1, np.int32),
    )
    for view, seen in ((0, left), (1, right)):
        free = np.zeros(len(seen.table) + 1, np.uint16)
        _read(hypotheses, view, camera, seen.posts, seen.ground, free,
              found.count, found.ends, found.width, found.value, found.edge, found.ground,
              found.tip_value, found.tip_edge, found.beyond_value, found.beyond_edge)  # fmt: skip
    return found


def some(of: Traits, rows: Ints) -> Traits:
    """The traits of some hypotheses."""
    return Traits(**{name: getattr(of, name)[rows] for name in Traits.__slots__})


def joined(first: Traits, second: Traits) -> Traits:
    """The traits of both, read with the same longest length."""
    return Traits(
        **{name: np.concatenate([getattr(first, name), getattr(second, name)]) for name in Traits.__slots__}
    )


@lean
def _read(
    hypotheses: Floats, view: int, camera: Floats, posts: Signposts, ground: npt.NDArray[np.uint8],
    free: Counts, count: npt.NDArray[np.int32], ends: Floats, widths: Floats, value: Reals, edge: Ids,
    inside: npt.NDArray[np.uint8], tip_value: Reals, tip_edge: Ids, beyond_value: Reals, beyond_edge: Ids,
) -> None:  # fmt: skip
    table = posts.table
    for h in range(len(hypotheses)):
        p = hypotheses[h, 1:7]
        xa, ya, xb, yb = p[0] - view * p[2], p[1], p[3] - view * p[5], p[4]
        ends[h, view, 0], ends[h, view, 1], ends[h, view, 2], ends[h, view, 3] = xa, ya, xb, yb
        size = np.hypot(xb - xa, yb - ya)
        steps = min(max(int(size / SAMPLE_PX), 1), value.shape[2])
        count[h, view] = steps
        ux, uy = (xb - xa) / max(size, 1e-6), (yb - ya) / max(size, 1e-6)
        nx, ny = -uy, ux
        unit = hypotheses[h, UNIT]
        for end in range(2):
            widths[h, end] = unit * p[3 * end + 2]
        for q in range(steps):
            share = (q + 0.5) / steps
            x, y = xa + share * (xb - xa), ya + share * (yb - ya)
            half = 0.5 * unit * (p[2] + share * (p[5] - p[2]))
            column, row = int(x + 0.5), int(y + 0.5)
            if column < 0 or row < 0 or column >= ground.shape[1] or row >= ground.shape[0]:
                inside[h, view, q] = 2
                continue
            inside[h, view, q] = ground[row, column]
            for side in range(2):
                sign = -1.0 if side == 0 else 1.0
                e, off = nearest_edge(
                    posts, free, x + sign * nx * half, y + sign * ny * half, -sign * nx, -sign * ny,
                    FLANK_REACH_PX,
                )  # fmt: skip
                edge[h, view, q, side] = e
                if e >= 0:
                    value[h, view, q, side] = table[e, 4] * np.exp(-0.5 * (off / FLANK_SIGMA_PX) ** 2)
                else:
                    # a flank that is not seen may be hidden, but what lies before it is not background
                    column = int(x + sign * nx * INNER * half + 0.5)
                    row = int(y + sign * ny * INNER * half + 0.5)
                    there = 0 <= column < ground.shape[1] and 0 <= row < ground.shape[0]
                    if there and ground[row, column] == 0:
                        inside[h, view, q] = 0
        for q in range(1, steps - 1):
            for side in range(2):
                if (
                    edge[h, view, q, side] < 0
                    and edge[h, view, q - 1, side] >= 0
                    and edge[h, view, q + 1, side] >= 0
                ):
                    edge[h, view, q, side] = edge[h, view, q - 1, side]
                    value[h, view, q, side] = min(value[h, view, q - 1, side], value[h, view, q + 1, side])
        for end in range(2):
            ox, oy = (-ux, -uy) if end == 0 else (ux, uy)
            x, y = (xa, ya) if end == 0 else (xb, yb)
            width = unit * p[3 * end + 2]
            cap, _ = cap_px(p, end, view, width, camera, False)
            for lane in range(LANES):
                aside = (lane - 2) * LANE_WIDTHS * width
                e, off = nearest_edge(
                    posts, free, x + cap * ox - oy * aside, y + cap * oy + ox * aside, -ox, -oy, TIP_REACH_PX
                )
                tip_edge[h, view, end, lane] = e
                if e >= 0:
                    tip_value[h, view, end, lane] = table[e, 4] * np.exp(-0.5 * (off / TIP_SIGMA_PX) ** 2)
            for q in range(BEYOND):
                bx, by = x + (q + 2.5) * ox, y + (q + 2.5) * oy
                for side in range(2):
                    if side == 1 and beyond_edge[h, view, end, q, 0] < 0:
                        break  # one alone counts for nothing
                    sign = -1.0 if side == 0 else 1.0
                    mx, my = -oy * sign, ox * sign
                    e, _ = nearest_edge(
                        posts, free, bx + 0.5 * width * mx, by + 0.5 * width * my, -mx, -my,
                        FLANK_REACH_PX,
                    )  # fmt: skip
                    beyond_edge[h, view, end, q, side] = e
                    if e >= 0:
                        beyond_value[h, view, end, q, side] = table[e, 4]


@lean
def claimed_edges(table: Reals, at: Ids, ends: Floats, width_a: float, width_b: float, out: Ints) -> int:
    """Edges within `CLAIM_PX` of a part's flanks, and of its ends, that look its way; returns how many."""
    xa, ya, xb, yb = ends[0], ends[1], ends[2], ends[3]
    size = np.hypot(xb - xa, yb - ya)
    ux, uy = (xb - xa) / size, (yb - ya) / size
    nx, ny = -uy, ux
    count = 0
    for side in range(2):
        sign = -1.0 if side == 0 else 1.0
        for q in range(-2, int(size) + 3):
            half = 0.5 * (width_a + (width_b - width_a) * min(max(q / size, 0.0), 1.0))
            x0, y0 = xa + q * ux + sign * half * nx, ya + q * uy + sign * half * ny
            last = -1
            for o in range(-2, 3):
                column = int(x0 + o * 0.8 * nx + 0.5)
                row = int(y0 + o * 0.8 * ny + 0.5)
                if column < 0 or row < 0 or column >= at.shape[1] or row >= at.shape[0]:
                    continue
                e = at[row, column]
                if e < 0 or e == last or count >= len(out):
                    continue
                last = e
                if -sign * (table[e, 2] * nx + table[e, 3] * ny) < SAME_WAY:
                    continue
                if abs((table[e, 0] - x0) * nx + (table[e, 1] - y0) * ny) < CLAIM_PX:
                    out[count] = e
                    count += 1
    return count
