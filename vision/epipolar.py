"""Whether two cameras still stand as they were calibrated: in rectified pictures a point is in the same row.

Distinct places of the left picture (corners) are looked for in the right one, around the row they belong to.
A camera that was knocked shows them all in another row; a wrong match shows in any.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from vision.quality import require_grey
from vision.stereo import Rectification, disparity_bounds_px, rectify_pictures
from vision.types import Floats, Grey

CORNERS = 80
CORNER_APART_PX = 12
CORNER_QUALITY = 0.02
HALF_PX = 10
"""Half the side of the patch that is looked for."""
ROWS_PX = 12
"""A camera that is off by more shows nothing alike; then there are no parts either."""
ALIKE = 0.8
CLEARLY = 0.05
"""The best place is this much more alike than the best place elsewhere."""
LEAST_POINTS = 10
AGREED_PX = 1.0
LEAST_SHARE_AGREED = 0.5
MOVED_PX = 1.5
"""Well above what one look of a good rig shows, and where the detector's own correction becomes doubtful."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RowResidual:
    """Right rows are ``px`` below the left ones, by ``points`` that agree out of ``tried``; ``spread_px``
    is their standard deviation about it."""

    px: float
    spread_px: float
    points: int
    tried: int

    @property
    def known(self) -> bool:
        """Enough points agree to believe it."""
        return self.points >= LEAST_POINTS and self.points >= LEAST_SHARE_AGREED * self.tried


def row_residual(left: Grey, right: Grey, rect: Rectification, depth_m: tuple[float, float]) -> RowResidual:
    """The row difference that most corners agree on.

    Parameters
    ----------
    left, right : (H, W) uint8
        Raw pictures of one instant.
    depth_m
        Least and greatest distance, in the rectified viewing direction, at which something may be seen.
    """
    require_grey(left, "left picture")
    require_grey(right, "right picture")
    ideal_left, ideal_right = rectify_pictures(left, right, rect)
    shift = float(rect.left_centre_px[0] - rect.right_centre_px[0])
    near, far = (bound + shift for bound in disparity_bounds_px(depth_m, rect)[::-1])
    return in_rows(ideal_left, ideal_right, (far, near))


def in_rows(left: Grey, right: Grey, columns_px: tuple[float, float]) -> RowResidual:
    """As `row_residual`, of rectified pictures; ``columns_px`` the least and greatest difference in columns,
    left minus right. Black is where a raw picture shows nothing."""
    # the rim of what a raw picture shows is no thing that both see
    shown = cv2.erode((left > 0).astype(np.uint8), np.ones((2 * HALF_PX + 3,) * 2, np.uint8))
    found = cv2.goodFeaturesToTrack(left, CORNERS, CORNER_QUALITY, CORNER_APART_PX, mask=shown)
    corners = [] if found is None else np.asarray(found, np.float64).reshape(-1, 2).round().astype(int)
    rows = [row for u, v in corners if (row := _row_of(left, right, int(u), int(v), columns_px)) is not None]
    if not rows:
        return RowResidual(px=0.0, spread_px=math.inf, points=0, tried=0)
    off = np.array(rows)
    middle = _most_agreed(off)
    agreed = off[np.abs(off - middle) <= AGREED_PX]
    return RowResidual(
        px=float(np.median(agreed)), spread_px=float(agreed.std()), points=len(agreed), tried=len(off)
    )


def _row_of(left: Grey, right: Grey, u: int, v: int, columns_px: tuple[float, float]) -> float | None:
    """How many rows lower the right picture shows a corner; None where it is not found or not clearly."""
    height, width = right.shape
    top, bottom = v - HALF_PX - ROWS_PX, v + HALF_PX + ROWS_PX + 1
    first = math.floor(u - columns_px[1]) - HALF_PX
    last = math.ceil(u - columns_px[0]) + HALF_PX + 1
    first, last = max(0, first), min(width, last)
    if (
        u < HALF_PX
        or u + HALF_PX >= left.shape[1]
        or top < 0
        or bottom > height
        or last - first < 3 * HALF_PX
    ):
        return None
    patch = left[v - HALF_PX : v + HALF_PX + 1, u - HALF_PX : u + HALF_PX + 1]
    alike = cv2.matchTemplate(right[top:bottom, first:last], patch, cv2.TM_CCOEFF_NORMED)
    _, best, _, (x, y) = cv2.minMaxLoc(alike)
    if best < ALIKE or y in (0, alike.shape[0] - 1):
        return None
    around = alike.copy()
    around[max(0, y - 3) : y + 4, max(0, x - 3) : x + 4] = -1.0
    if float(around.max()) > best - CLEARLY:
        return None
    above, below = float(alike[y - 1, x]), float(alike[y + 1, x])
    bend = above - 2.0 * best + below
    part = 0.5 * (above - below) / bend if bend < 0.0 else 0.0
    return y + part - ROWS_PX


def _most_agreed(off: Floats) -> float:
    near = np.abs(off[:, None] - off[None, :]) <= AGREED_PX
    return float(off[int(near.sum(axis=1).argmax())])
