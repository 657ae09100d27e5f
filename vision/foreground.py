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

from vision.jit import compiled
from vision.types import Floats, Grey, Mask, read_only

_BACKGROUND_WIDTHS = 12.0
"""A heap of parts without a gap is not background up to this size."""
_NOISE_SIGMAS, _PARTS_SIGMAS = 5.0, 8.0
"""In deviations of the picture's noise and grain: what counts as contrast, what parts must typically have.
Grain of wood alone comes to 5 to 7, the dimmest and most crowded parts at hand to 16."""
_LEAST_CONTRAST_GREY = 10.0
_FIFTH = 0.2
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
    counts = _histogram(contrast)
    noise = _noise_grey(counts)
    floor = max(_LEAST_CONTRAST_GREY, _NOISE_SIGMAS * noise)
    typical = _typical_contrast_grey(counts, floor)
    if typical < _PARTS_SIGMAS * noise:
        typical = 0.0
    least = max(floor, 0.25 * typical)
    near = _odd(2.0 * width_px)
    strongest = np.asarray(cv2.dilate(contrast, np.ones((near, near), np.uint8)), np.uint8)
    # where nothing stands out there is nothing to be dim or shaded either
    low = max(_LEAST_CONTRAST_GREY, _FIFTH * typical) if typical > 0 else least
    mask, ground = _over(contrast, strongest, int(min(least, 255.0)), int(min(low, 255.0)))
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
    small = _averages(smooth, max(1, rows // step), max(1, columns // step))
    square = np.ones((_odd(side / step), _odd(side / step)), np.uint8)
    opened = cv2.morphologyEx(small, cv2.MORPH_OPEN, square, borderType=cv2.BORDER_REPLICATE)
    opened = cv2.GaussianBlur(opened, (0, 0), 0.25 * side / step)
    return np.asarray(cv2.resize(opened, (columns, rows), interpolation=cv2.INTER_LINEAR), np.uint8)


def _odd(value: float) -> int:
    return 2 * max(1, round(0.5 * value)) + 1


@compiled
def _over(contrast: Grey, strongest: Grey, least: int, low: int) -> tuple[Mask, Mask]:
    """Where contrast exceeds half of the strongest next to it and ``least``; where it exceeds ``low``."""
    mask, ground = np.empty(contrast.shape, np.bool_), np.empty(contrast.shape, np.bool_)
    here, most = contrast.reshape(-1), strongest.reshape(-1)
    into, under = mask.reshape(-1), ground.reshape(-1)
    at_least, at_low = np.uint8(least), np.uint8(low)
    for k in range(here.size):
        # half, to the even number where it lies between two
        half = np.uint8((most[k] >> 1) + ((most[k] & 3) == 3))
        into[k] = (here[k] > half) & (here[k] > at_least)
        under[k] = here[k] > at_low
    return mask, ground


@compiled
def _averages(grey: Grey, rows: int, columns: int) -> Grey:
    """The picture made smaller, each pixel the mean of those whose places it takes."""
    found = np.empty((rows, columns), np.uint8)
    sums = np.empty(grey.shape[1], np.int32)
    for j in range(rows):
        top, bottom = j * grey.shape[0] // rows, (j + 1) * grey.shape[0] // rows
        sums[:] = 0
        for y in range(top, bottom):
            for x in range(grey.shape[1]):
                sums[x] += np.int32(grey[y, x])
        for i in range(columns):
            left, right = i * grey.shape[1] // columns, (i + 1) * grey.shape[1] // columns
            total = 0
            for x in range(left, right):
                total += sums[x]
            area = (bottom - top) * (right - left)
            found[j, i] = (total + area // 2) // area
    return found


@compiled
def _histogram(grey: Grey) -> Floats:
    """(256,) how many pixels have each value; four counts, as neighbours often are alike."""
    counts = np.zeros((4, 256), np.int64)
    flat = grey.reshape(-1)
    whole = flat.size - flat.size % 4
    for k in range(0, whole, 4):
        counts[0, flat[k]] += 1
        counts[1, flat[k + 1]] += 1
        counts[2, flat[k + 2]] += 1
        counts[3, flat[k + 3]] += 1
    for k in range(whole, flat.size):
        counts[0, flat[k]] += 1
    found = np.empty(256)
    for value in range(256):
        found[value] = counts[0, value] + counts[1, value] + counts[2, value] + counts[3, value]
    return found


def _typical_contrast_grey(counts: Floats, floor_grey: float) -> float:
    """Median of the contrasts above the floor, each pixel weighing its contrast squared.

    Texture may cover more of the picture than parts do; it is the weaker of the two.
    """
    level = np.arange(256, dtype=np.float64)
    weight = counts * level**2 * (level > floor_grey)
    total = float(weight.sum())
    return float(np.searchsorted(np.cumsum(weight), 0.5 * total)) if total > 0 else 0.0


def _noise_grey(counts: Floats) -> float:
    """Robust deviation of what is no part: distance of the 50th to the 75th hundredth, as of a normal law.

    Parts would have to cover a quarter of the picture before they count as noise.
    """
    share = np.cumsum(counts) / counts.sum()
    middle, upper = (float(np.searchsorted(share, q)) for q in (0.5, 0.75))
    return max((upper - middle) / 0.6745, 0.5)
