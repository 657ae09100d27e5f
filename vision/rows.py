"""How far the rows of the two pictures are off, told by the ends of the parts themselves.

An end is one point of space, so both pictures must show it in the same row; the lines of the parts say
nothing of that, they only turn a row error into a wrong depth. One end is read to a third of a pixel, the
median of all to a few hundredths.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vision.edges import Edges, Ids, Signposts
from vision.ends import cap_px
from vision.explain import Explanation, Frame
from vision.flank import Counts, tip_offset
from vision.jit import lean
from vision.refine import UNIT
from vision.types import Floats, Ints

LEAST_ENDS = 4
SIGNIFICANT_SIGMAS, SIGNIFICANT_PX = 4.0, 0.25
"""An offset counts when it is this many of its deviations and this many px from nothing: a good rig is not
made worse by its own noise."""
REACH_PX = 4.5
LANES = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class RowOffset:
    """``px`` by which right rows are below the left ones; ``sigma_px``; ``ends`` it was told by."""

    px: float
    sigma_px: float
    ends: int

    @property
    def significant(self) -> bool:
        """Worth correcting."""
        far = abs(self.px) > max(SIGNIFICANT_PX, SIGNIFICANT_SIGMAS * self.sigma_px)
        return self.ends >= LEAST_ENDS and far


def row_offset(found: Explanation, left: Edges, right: Edges, frame: Frame) -> RowOffset:
    """The median over all ends that both pictures show."""
    if not found.chosen:
        return RowOffset(px=0.0, sigma_px=float("inf"), ends=0)
    chosen, seen = np.array(found.chosen, np.int64), found.seen
    rows = np.full((2, len(chosen), 2), np.nan)
    for view, of in enumerate((left, right)):
        free = np.zeros(len(of.table) + 1, np.uint16)
        _end_rows(
            found.hypotheses, chosen, view, seen.count, seen.ends, seen.edge, of.posts, free,
            frame.camera, rows[view],
        )  # fmt: skip
    apart = (rows[1] - rows[0]).reshape(-1)
    apart = apart[np.isfinite(apart)]
    if len(apart) < LEAST_ENDS:
        return RowOffset(px=0.0, sigma_px=float("inf"), ends=len(apart))
    middle = float(np.median(apart))
    spread = 1.4826 * float(np.median(np.abs(apart - middle)))
    return RowOffset(px=middle, sigma_px=1.2533 * max(spread, 0.1) / np.sqrt(len(apart)), ends=len(apart))


@lean
def _end_rows(
    hypotheses: Floats, chosen: Ints, view: int, count: npt.NDArray[np.int32], ends: Floats, edge: Ids,
    posts: Signposts, free: Counts, camera: Floats, rows: Floats,
) -> None:  # fmt: skip
    """Row of every end in one view, from where its face and the line of its flanks are seen there."""
    table = posts.table
    for h in range(len(chosen)):
        k = chosen[h]
        p, unit = hypotheses[k, 1:7], hypotheses[k, UNIT]
        xa, ya, xb, yb = ends[k, view, 0], ends[k, view, 1], ends[k, view, 2], ends[k, view, 3]
        size = np.hypot(xb - xa, yb - ya)
        ux, uy = (xb - xa) / size, (yb - ya) / size
        nx, ny = -uy, ux
        aa = ab = bb = ra = rb = 0.0
        for q in range(count[k, view]):
            share = (q + 0.5) / count[k, view]
            half = 0.5 * unit * (p[2] + share * (p[5] - p[2]))
            e, f = edge[k, view, q, 1], edge[k, view, q, 0]
            if e < 0 or f < 0 or share * size < half or (1 - share) * size < half:
                continue
            # the middle between the flanks, from the axis
            miss = 0.5 * ((table[e, 0] + table[f, 0]) * nx + (table[e, 1] + table[f, 1]) * ny)
            miss -= (xa + share * (xb - xa)) * nx + (ya + share * (yb - ya)) * ny
            aa += (1 - share) ** 2
            ab += share * (1 - share)
            bb += share * share
            ra += (1 - share) * miss
            rb += share * miss
        det = aa * bb - ab * ab
        if aa + bb < 6 or det < 1e-3:
            continue
        off_a, off_b = (ra * bb - rb * ab) / det, (rb * aa - ra * ab) / det
        for end in range(2):
            ox, oy = (-ux, -uy) if end == 0 else (ux, uy)
            x, y = (xa, ya) if end == 0 else (xb, yb)
            aside = off_a if end == 0 else off_b
            width = unit * p[3 * end + 2]
            off, lanes, _ = tip_offset(posts, free, x + aside * nx, y + aside * ny, ox, oy, width, REACH_PX)
            if lanes < LANES:
                continue
            cap, _ = cap_px(p, end, view, width, camera, False)
            rows[h, end] = y + aside * ny + (off - cap) * oy
