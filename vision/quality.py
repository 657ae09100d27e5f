"""Whether a picture is fit to look for parts in, and if not, what is wrong with it and by how much.

The limits lie well between what was measured on both sides: the darkest usable picture at hand (a few per
cent of the usual light) still has its brightest hundredth at 119 and 105 grey values between the 1st and 99th
hundredth, an empty table has 28 of them, white paper fills 7 % of a good picture; a covered lens gives the
sensor's noise around black, an overexposed picture is white to 99.9 %.
A picture of nothing but table is usable: "empty" is an answer, not a flaw.
"""

from __future__ import annotations

import cv2
import numpy as np

from vision.types import Floats, Grey, PictureFlaw, Unusable

BLACK_LEVEL = 16.0
"""A picture whose brightest hundredth is darker than this shows nothing; video black itself is 16."""
SATURATED_GREY = 250
SATURATED_SHARE = 0.5
"""White paper or a reflection may fill a tenth of a good picture; half of it leaves nothing to find."""
FLAT_SPREAD = 12.0
"""Grey values between the 1st and 99th hundredth; noise of 2.5 values around one grey makes 11.6."""


def assess(grey: Grey) -> Unusable | None:
    """The flaw that makes a picture useless, or None.

    Parameters
    ----------
    grey : (H, W) uint8

    Raises
    ------
    ValueError
        Not a grey 8-bit picture with at least one pixel.
    """
    require_grey(grey)
    counts = grey_counts(grey)
    saturated = float(counts[SATURATED_GREY:].sum()) / grey.size
    if saturated > SATURATED_SHARE:
        return Unusable(flaw=PictureFlaw.SATURATED, value=saturated, limit=SATURATED_SHARE)
    dark, bright = hundredths(counts, (1.0, 99.0))
    if bright < BLACK_LEVEL:
        return Unusable(flaw=PictureFlaw.BLACK, value=bright, limit=BLACK_LEVEL)
    if bright - dark < FLAT_SPREAD:
        return Unusable(flaw=PictureFlaw.FLAT, value=bright - dark, limit=FLAT_SPREAD)
    return None


def grey_counts(grey: Grey) -> Floats:
    """(256,) how many pixels have each grey value."""
    counts = cv2.calcHist([grey], [0], None, [256], [0.0, 256.0])
    return np.asarray(counts, np.float64).reshape(-1)


def hundredths(counts: Floats, shares: tuple[float, ...]) -> tuple[float, ...]:
    """Percentiles as numpy's, from the counts (256,) of grey values instead of sorted pixels.

    >>> hundredths(np.bincount([3, 3, 5], minlength=256).astype(float), (50.0, 75.0))
    (3.0, 4.0)
    """
    below = np.cumsum(counts)
    told = []
    for share in shares:
        place = share / 100.0 * (below[-1] - 1.0)
        first, after = np.searchsorted(below, (np.floor(place), np.ceil(place)), side="right")
        told.append(float(first + (place - np.floor(place)) * (after - first)))
    return tuple(told)


def unchanged(previous: Grey, now: Grey) -> Unusable | None:
    """The flaw UNCHANGING if a picture is bit for bit the one before it, or None.

    The noise of a living sensor changes some pixel in every exposure; equal pictures mean a repeated buffer.
    Pictures of two sizes are different pictures.
    """
    require_grey(previous)
    require_grey(now)
    if previous.shape != now.shape:
        return None
    if not np.array_equal(previous, now):
        return None
    return Unusable(flaw=PictureFlaw.UNCHANGING, value=0.0, limit=1.0)


def require_grey(grey: Grey, name: str = "picture") -> None:
    """Raise ValueError unless ``grey`` is (H, W) uint8 with at least one pixel."""
    if grey.dtype != np.uint8:
        raise ValueError(f"{name}: grey values must be uint8, not {grey.dtype}")
    if grey.ndim != 2 or grey.size == 0:
        raise ValueError(f"{name}: a grey picture is (H, W), not {grey.shape}")
