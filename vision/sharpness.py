"""How blurred a picture is, in pixels, told by its own edges.

An edge seen through a Gaussian blur of sigma s has a steepest slope in proportion to 1 / s, and two blurs add
as squares. So the slope of the same edge after two known further blurs gives s, whatever the contrast is (the
re-blur of Zhuo and Sim, "Defocus map estimation from a single image", 2011, between two scales so that noise
counts little).
"""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt

from vision.quality import require_grey
from vision.types import Grey

FINE_PX, COARSE_PX = 1.0, 2.0
SLOPE_OVER = 1.0 / 3.0
"""A difference between neighbours two apart blurs as well: the variance of a box two pixels wide."""
STEEPEST_SHARE = 0.005
"""Only the steepest slopes: an edge that is soft by itself (a shadow) says nothing of the lens."""
LEAST_SLOPE = 4.0
"""Grey values per pixel after the fine blur; sensor noise stays below."""
LEAST_EDGE_PX = 60
BLURRED_PX = 2.2
"""What a blur of 2.5 to 3 px shows as, for the flanks of a thin part are near each other; a part of 6 to 9 px
has no flanks of its own by then. The detector loses parts from a blur of 1.5 px on (docs/benchmarks.md)."""


def blur_px(grey: Grey) -> float:
    """Standard deviation of the blur of the sharpest edges, px; NaN where there are no edges to tell by.

    Parameters
    ----------
    grey : (H, W) uint8
    """
    require_grey(grey)
    picture = grey.astype(np.float32)
    fine, coarse = (_slope(cv2.GaussianBlur(picture, (0, 0), s)) for s in (FINE_PX, COARSE_PX))
    bound = max(LEAST_SLOPE, _quantile(fine, 1.0 - STEEPEST_SHARE))
    on_edge = fine >= bound
    if np.count_nonzero(on_edge) < LEAST_EDGE_PX:
        return math.nan
    ratio = float(np.median(fine[on_edge] / np.maximum(coarse[on_edge], 1e-3)))
    if ratio <= 1.0:
        return math.inf
    fine_squared, coarse_squared = FINE_PX**2 + SLOPE_OVER, COARSE_PX**2 + SLOPE_OVER
    squared = (coarse_squared - ratio**2 * fine_squared) / (ratio**2 - 1.0)
    return math.sqrt(max(0.0, squared))


def _quantile(values: npt.NDArray[np.float32], share: float) -> float:
    """As `numpy.quantile`, which looks for both neighbours at a time and takes five times as long."""
    place = share * (values.size - 1)
    low = int(place)
    parted = np.partition(values.reshape(-1), low)
    lower = float(parted[low])
    upper = float(parted[low + 1 :].min(initial=math.inf)) if low + 1 < values.size else lower
    return lower + (place - low) * (upper - lower)


def _slope(picture: npt.ArrayLike) -> npt.NDArray[np.float32]:
    picture = np.asarray(picture, np.float32)
    dx = cv2.Sobel(picture, cv2.CV_32F, 1, 0, scale=0.125)
    dy = cv2.Sobel(picture, cv2.CV_32F, 0, 1, scale=0.125)
    return np.asarray(cv2.magnitude(dx, dy), np.float32)
