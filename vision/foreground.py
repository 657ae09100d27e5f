"""Grey picture to mask without a number to set: brighter than the background around it.

The background is what a square several part widths across cannot lift: a grey opening keeps tables,
large blocks, light gradients and glare, and loses everything thin. A pixel is foreground when it
stands out of that background by half of the strongest contrast next to it, so that dim and bright
places are judged each by their own light, and by clearly more than the picture's noise and texture.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from vision.types import Floats, Grey, Mask, read_only

_BACKGROUND_WIDTHS = 12.0
"""A heap of parts without a gap is not background up to this size."""
_NOISE_SIGMAS, _PARTS_SIGMAS = 5.0, 8.0
"""In deviations of the picture's noise and grain: what counts as contrast, what parts must typically have.
Grain of wood alone comes to 5 to 7, the dimmest and most crowded parts at hand to 16."""
_LEAST_CONTRAST_GREY = 10.0
_HALF, _FIFTH = 0.5, 0.2
_SMALL_SIDE = 9
"""The background is sought in a smaller picture, in which its square is about this many pixels wide."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Foreground:
    """``mask`` (H, W); ``ground`` (H, W) True where the picture may show part, if only a dim or shaded one;
    ``contrast_grey`` what parts typically stand out by; ``floor_grey`` the least
    contrast that counted; ``noise_grey`` standard deviation of the picture's texture and noise."""

    mask: Mask
    ground: Mask
    contrast_grey: float
    floor_grey: float
    noise_grey: float


def stands_out(grey: Grey, width_px: float) -> Foreground:
    """What is thin and brighter than the background around it.

    Parameters
    ----------
    grey : (H, W) uint8
    width_px : float
        Projected width of the part; sets every window of this function.

    Returns
    -------
    Foreground
    """
    smooth = np.asarray(cv2.GaussianBlur(grey, (0, 0), 0.7), np.uint8)
    background = _background(smooth, width_px)
    contrast = np.asarray(cv2.subtract(smooth, background), dtype=np.uint8)
    noise = _noise_grey(contrast)
    floor = max(_LEAST_CONTRAST_GREY, _NOISE_SIGMAS * noise)
    typical = _typical_contrast_grey(contrast, floor)
    if typical < _PARTS_SIGMAS * noise:
        typical = 0.0
    least = max(floor, 0.25 * typical)
    near = _odd(2.0 * width_px)
    strongest = np.asarray(cv2.dilate(contrast, np.ones((near, near), np.uint8)), np.uint8)
    half = np.asarray(cv2.convertScaleAbs(strongest, alpha=_HALF), np.uint8)
    mask = contrast > np.maximum(half, np.uint8(min(least, 255.0)))
    # where nothing stands out there is nothing to be dim or shaded either
    low = max(_LEAST_CONTRAST_GREY, _FIFTH * typical) if typical > 0 else least
    ground = contrast > np.uint8(min(low, 255.0))
    return Foreground(
        mask=read_only(mask),
        ground=read_only(ground),
        contrast_grey=typical,
        floor_grey=least,
        noise_grey=noise,
    )


def _background(smooth: Grey, width_px: float) -> Grey:
    """What a square of `_BACKGROUND_WIDTHS` cannot lift, from a picture made small by averaging."""
    side = _BACKGROUND_WIDTHS * width_px
    step = max(1, int(side / _SMALL_SIDE))
    rows, columns = smooth.shape
    small = cv2.resize(smooth, (max(1, columns // step), max(1, rows // step)), interpolation=cv2.INTER_AREA)
    square = np.ones((_odd(side / step), _odd(side / step)), np.uint8)
    opened = cv2.morphologyEx(small, cv2.MORPH_OPEN, square, borderType=cv2.BORDER_REPLICATE)
    opened = cv2.GaussianBlur(opened, (0, 0), 0.25 * side / step)
    return np.asarray(cv2.resize(opened, (columns, rows), interpolation=cv2.INTER_LINEAR), np.uint8)


def _odd(value: float) -> int:
    return 2 * max(1, round(0.5 * value)) + 1


def _typical_contrast_grey(contrast: Grey, floor_grey: float) -> float:
    """Median of the contrasts above the floor, each pixel weighing its contrast squared.

    Texture may cover more of the picture than parts do; it is the weaker of the two.
    """
    level = np.arange(256, dtype=np.float64)
    weight = _histogram(contrast) * level**2 * (level > floor_grey)
    total = float(weight.sum())
    return float(np.searchsorted(np.cumsum(weight), 0.5 * total)) if total > 0 else 0.0


def _noise_grey(contrast: Grey) -> float:
    """Robust deviation of what is no part: distance of the 50th to the 75th hundredth, as of a normal law.

    Parts would have to cover a quarter of the picture before they count as noise.
    """
    share = np.cumsum(_histogram(contrast)) / contrast.size
    middle, upper = (float(np.searchsorted(share, q)) for q in (0.5, 0.75))
    return max((upper - middle) / 0.6745, 0.5)


def _histogram(grey: Grey) -> Floats:
    """(256,) how many pixels have each value."""
    return np.asarray(cv2.calcHist([grey], [0], None, [256], [0, 256]), np.float64).reshape(-1)
