"""What a person wants to know while turning a lens or a lamp: how sharp, how bright, how wide a part is."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from vision import quality, sharpness
from vision.thin import guo_hall
from vision.types import Grey, Unusable

_LEAST_PX: Final = 30
_LEAST_GREY: Final = 12.0
GOOD_WIDTH_PX: Final = 5.0
"""Narrower parts lose their flanks in blur and noise."""
GOOD_BLUR_PX: Final = 1.2


@dataclass(frozen=True, slots=True, kw_only=True)
class Aim:
    """Figures of one picture. ``blur_px`` and ``width_px`` are NaN where nothing is there to tell by.

    ``dark_grey``, ``middle_grey``, ``bright_grey``: the 1st, 50th and 99th hundredth; ``cut_share`` of the
    pixels are white beyond measure.
    """

    blur_px: float
    dark_grey: float
    middle_grey: float
    bright_grey: float
    cut_share: float
    width_px: float
    flaw: Unusable | None

    def text(self) -> str:
        """One line, with what is to be done about each figure."""
        words = [
            f"blur {_number(self.blur_px)} px{_hint(self.blur_px > GOOD_BLUR_PX, 'focus')}",
            f"grey {self.dark_grey:.0f} {self.middle_grey:.0f} {self.bright_grey:.0f}"
            + _hint(self.bright_grey < 110.0, "longer exposure or more light"),
            f"white {self.cut_share:.1%}{_hint(self.cut_share > 0.02, 'shorter exposure')}",
            f"part {_number(self.width_px)} px wide"
            + _hint(self.width_px < GOOD_WIDTH_PX, "nearer or longer lens"),
        ]
        if self.flaw is not None:
            words.append(f"UNUSABLE: {self.flaw.flaw.value} ({self.flaw.value:.3g})")
        return "  ".join(words)


def aim(grey: Grey, expected_width_px: float) -> Aim:
    """Figures of a picture, (H, W) uint8.

    ``expected_width_px`` is what a part should be wide, by the calibration; only what is thin at that scale
    counts as a part.
    """
    dark, middle, bright = (float(q) for q in np.percentile(grey, (1.0, 50.0, 99.0)))
    return Aim(
        blur_px=sharpness.blur_px(grey),
        dark_grey=dark,
        middle_grey=middle,
        bright_grey=bright,
        cut_share=float(np.count_nonzero(grey >= quality.SATURATED_GREY)) / grey.size,
        width_px=width_px(grey, expected_width_px),
        flaw=quality.assess(grey),
    )


def width_px(grey: Grey, expected_px: float) -> float:
    """How wide the thin bright things in a picture are at half their height, px; NaN without any.

    The median along their middles. Things over 1.7 times as wide as expected are background.
    """
    wide = 2 * round(0.85 * expected_px) + 1
    smooth = cv2.GaussianBlur(grey, (0, 0), 0.7)
    above = np.asarray(
        cv2.morphologyEx(smooth, cv2.MORPH_TOPHAT, np.ones((wide, wide), np.uint8)), np.float32
    )
    height = cv2.dilate(above, np.ones((wide, wide), np.uint8))
    least = max(_LEAST_GREY, 0.3 * float(np.quantile(above, 0.995)))
    mask = (above > 0.5 * height) & (height > least)
    middles = guo_hall(mask)
    if np.count_nonzero(middles) < _LEAST_PX:
        return math.nan
    # distances go to the middle of the nearest pixel outside: half a pixel beyond the rim
    reach = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return 2.0 * float(np.median(reach[middles])) - 1.0


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.1f}"


def _hint(wrong: bool, do: str) -> str:
    return f" ({do})" if wrong else ""
