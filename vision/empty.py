"""What belongs to the empty tray: pixels that look as they did in pictures of it.

Edges of the tray, screws and bars are thin and bright as parts are. Where a picture is within noise of the
reference taken of the empty tray, nothing was put there, and nothing is looked for. Whatever lies over such a
place changes it; a part is therefore never taken for the tray unless it is as bright as what it covers, and
then only where it covers it. Exposure may differ by a factor, places by a pixel. A reference that most of the
picture contradicts is worse than none and is left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from vision.foreground import Foreground
from vision.light import LEAST_SHARE_AGREED, LightChange, light_change
from vision.types import EmptyTray, Grey, Mask, read_only

SMOOTHING_PX = 0.7
MOVED_PX = 1
"""Edges of the tray may be this far from where they were."""
BORDER_PX = 1
LEAST_GREY = 6.0
"""Below the least contrast of parts: on plain ground whatever stands out is also changed."""
NOISE_SIGMAS = 5.0
Reals = npt.NDArray[np.float32]

LEAST_FACTOR, LARGEST_FACTOR = 0.4, 2.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Change:
    """One picture beside that of the empty tray. ``mask`` (H, W) where something was put; ``light`` how much
    brighter the picture is, None where too little can tell; ``usable`` False where most of the picture
    contradicts the reference, which then says nothing (``mask`` is True everywhere)."""

    mask: Mask
    light: LightChange | None
    usable: bool


def change(grey: Grey, empty: Grey) -> Change:
    """Where a picture differs from that of the empty tray by more than noise, light and a pixel.

    Parameters
    ----------
    grey, empty : (H, W) uint8
        Of one camera that has not moved in between.
    """
    light = light_change(empty, grey)
    if light is None or light.share < LEAST_SHARE_AGREED or not LEAST_FACTOR < light.factor < LARGEST_FACTOR:
        return Change(mask=read_only(np.ones(grey.shape, np.bool_)), light=light, usable=False)
    expected = _smooth(np.minimum(empty.astype(np.float32) * np.float32(light.factor), 255.0))
    now = _smooth(grey.astype(np.float32))
    side = 2 * MOVED_PX + 1
    square = np.ones((side, side), np.uint8)
    above = now - np.asarray(cv2.dilate(expected, square), np.float32)
    below = np.asarray(cv2.erode(expected, square), np.float32) - now
    off = np.abs(now - expected)
    # half of the picture is tray: the median of the differences is its noise
    noise = float(np.median(off)) / 0.6745
    limit = max(LEAST_GREY, NOISE_SIGMAS * noise)
    return Change(mask=read_only(np.maximum(above, below) > limit), light=light, usable=True)


def put_there(found: Foreground, grey: Grey, empty: Grey | None, width_px: float) -> Foreground:
    """The foreground without what belongs to the empty tray; as it was where there is no reference.

    What was put there keeps its borders, and gaps in it up to two part widths are closed: a part that crosses
    something as bright as itself stays in one piece.
    """
    if empty is None:
        return found
    kept = near_changes(grey, empty, width_px)
    return replace(found, mask=read_only(found.mask & kept), ground=read_only(found.ground & kept))


def near_changes(grey: Grey, empty: Grey, near_px: float) -> Mask:
    """(H, W) where something was put, with its borders; gaps up to twice ``near_px`` wide are closed."""
    side = 2 * max(1, round(near_px)) + 1
    here = change(grey, empty).mask.view(np.uint8)
    closed = cv2.morphologyEx(here, cv2.MORPH_CLOSE, np.ones((side, side), np.uint8))
    border = 2 * BORDER_PX + 1
    return np.asarray(cv2.dilate(closed, np.ones((border, border), np.uint8)) > 0, np.bool_)


def side_of(empty: EmptyTray | None, side: int) -> Grey | None:
    """The reference of the left (0) or the right (1) camera."""
    if empty is None:
        return None
    return empty.left if side == 0 else empty.right


def _smooth(grey: Reals) -> Reals:
    return np.asarray(cv2.GaussianBlur(grey, (0, 0), SMOOTHING_PX), np.float32)
