"""Where the end of a part is seen: its outline lies beyond the end of its axis, the further the steeper.

The end face is a disc across the axis, so its outline reaches ``R |cos|`` beyond its centre, cos between
axis and ray. Of a face that looks away the far rim is seen. Of one that looks towards the camera it is the
near rim where the face is as dark as the table and the far rim where it is bright; in between, both.
"""

from __future__ import annotations

import numpy as np

from vision.edges import Signposts
from vision.flank import Counts, nearest_edge
from vision.jit import inlined, lean
from vision.types import Bools, Floats

LANES = 5
LANE_WIDTHS = 0.17
"""Across an end it is looked for in so many lanes, so far apart."""
TIP_SIGMA_PX, HIDDEN_SIGMA_PX = 0.4, 4.0
CAP_AWAY, CAP_DOUBT, TOWARDS_DOUBT = 0.7, 0.2, 0.4
"""Where an end is seen, in units of ``R |cos|``. A sharp-edged face that looks away reaches to 0.87 (the mean
of ``sqrt(1 - t^2)`` over the five lanes), a rounded one to about half; the middle is taken and both are
within the doubt."""
RIM_SHARE, RIM_LANES, LEAST_RIM_PX = 0.7, 4, 0.7
"""The far rim of a face that looks towards the camera is seen where so many lanes show an edge so near to its
place, as a share of how far beyond the end that is; and that is far enough to be told from the near one."""


@lean
def cap_px(p: Floats, end: int, view: int, width: float, camera: Floats, far: bool) -> tuple[float, float]:
    """How far beyond the axis' end its outline is seen, mean over the lanes, and how doubtful that is, px.

    ``p`` (6,) x, y, d of both ends; ``width`` px there; ``camera`` (4,) focal px, baseline m, principal point
    px. Nobody knows which rim is seen of a face that looks towards the camera, unless the ``far`` one has
    been found.
    """
    focal, baseline, cx, cy = camera[0], camera[1], camera[2], camera[3]
    other = 3 - 3 * end
    z, zo = focal * baseline / p[3 * end + 2], focal * baseline / p[other + 2]
    px, py = (p[3 * end] - cx) * z / focal, (p[3 * end + 1] - cy) * z / focal
    ox, oy, oz = px - (p[other] - cx) * zo / focal, py - (p[other + 1] - cy) * zo / focal, z - zo
    px -= view * baseline
    size = np.sqrt(ox * ox + oy * oy + oz * oz) * np.sqrt(px * px + py * py + z * z)
    away = (ox * px + oy * py + oz * z) / size
    reach = 0.5 * width * abs(away)
    if away > 0 or far:
        return CAP_AWAY * reach, CAP_DOUBT * reach
    return 0.0, TOWARDS_DOUBT * reach


@inlined
def add_end(
    view: int, end: int, ox: float, oy: float, off: float, lanes: int, doubt: float, matrix: Floats,
    right: Floats,
) -> None:  # fmt: skip
    """Adds to the normal equations of the six numbers where one end is seen along the axis in one view:
    ``off`` px outwards (ox, oy) of where it should be, in so many lanes."""
    if lanes < 2:
        # a hidden end: the window says where it is, to a few pixels
        off, weight = 0.0, 0.5 / (HIDDEN_SIGMA_PX * HIDDEN_SIGMA_PX)
    else:
        weight = lanes / LANES / (TIP_SIGMA_PX * TIP_SIGMA_PX + doubt * doubt)
    row = (ox, oy, -view * ox)
    for a in range(3):
        right[3 * end + a] += weight * row[a] * off
        for b in range(3):
            matrix[3 * end + a, 3 * end + b] += weight * row[a] * row[b]


@lean
def look_at_ends(
    p: Floats, wide: float, view: int, with_rims: bool, reach: float, posts: Signposts, taken: Counts,
    camera: Floats, tips: Floats, far_rim: Bools,
) -> None:  # fmt: skip
    """The nearest free edge in each lane of both ends in one view, NaN where there is none.

    Parameters
    ----------
    p : (6,)
        x, y, d of both ends, px; ``wide`` its width over disparity.
    with_rims
        Of faces that look towards the camera the far rim is looked for first.
    reach
        How far from where an end should be seen its edge may be, px.
    tips : (2, 2, `LANES`, 2)
        Of views and ends; this view's is filled.
    far_rim : (2, 2)
        Whether it is the far rim that was found; this view's is filled.
    """
    for end in range(2):
        far_rim[view, end] = (
            with_rims and _edges_at(p, wide, view, end, True, 0.0, posts, taken, camera, tips) >= RIM_LANES
        )
        if not far_rim[view, end]:
            _edges_at(p, wide, view, end, False, reach, posts, taken, camera, tips)


@lean
def _edges_at(
    p: Floats, wide: float, view: int, end: int, far: bool, reach: float, posts: Signposts, taken: Counts,
    camera: Floats, tips: Floats,
) -> int:  # fmt: skip
    """Fills the lanes of one end; how many show an edge."""
    here, there = 3 * end, 3 - 3 * end
    x, y = p[here] - view * p[here + 2], p[here + 1]
    ox, oy = x - (p[there] - view * p[there + 2]), y - p[there + 1]
    size = np.hypot(ox, oy)
    ox, oy = ox / size, oy / size
    width = wide * p[here + 2]
    cap, _ = cap_px(p, end, view, width, camera, far)
    if far:
        if cap < LEAST_RIM_PX:
            return 0
        reach = RIM_SHARE * cap
    lanes = 0
    for lane in range(LANES):
        aside = (lane - 2) * LANE_WIDTHS * width
        e, _ = nearest_edge(
            posts, taken, x + cap * ox - oy * aside, y + cap * oy + ox * aside, -ox, -oy, reach
        )
        tips[view, end, lane] = np.nan
        if e >= 0:
            tips[view, end, lane, 0], tips[view, end, lane, 1] = posts.table[e, 0], posts.table[e, 1]
            lanes += 1
    return lanes
