"""Colours of products: words for ranges, and whether a picture has colour at all.

Hue in degrees, saturation and value 0..1 of the camera's own (sRGB) pixels, as `vision.colour` measures them:
the median along the middle of a part. Hue and saturation stay when the light gets weaker, value does not, so
only the words that mean a brightness look at it. A part bleached to white by too long an exposure has no
colour left and is refused.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from drivers.types import Pixels
from vision.types import ColourRange

WORDS: Final[dict[str, ColourRange]] = {
    # Bare wood from birch to walnut. Sticks of the photorealistic scenes measure hue 26-57 and saturation
    # 0.09-0.29; white ones beside them have less (0.05 at most), yellow ones more (0.60 at least).
    "wood": ColourRange(hue_deg=(14.0, 62.0), saturation=(0.07, 0.52)),
    "red": ColourRange(hue_deg=(335.0, 14.0), saturation=(0.35, 1.0)),
    "yellow": ColourRange(hue_deg=(42.0, 72.0), saturation=(0.38, 1.0)),
    "green": ColourRange(hue_deg=(80.0, 170.0), saturation=(0.2, 1.0)),
    "blue": ColourRange(hue_deg=(185.0, 260.0), saturation=(0.25, 1.0)),
    "white": ColourRange(saturation=(0.0, 0.1), value=(0.4, 1.0)),
    "black": ColourRange(value=(0.0, 0.25)),
    # bare steel or aluminium: no colour of its own, anything between its dark and its bright side
    "metal": ColourRange(saturation=(0.0, 0.2), value=(0.12, 1.0)),
}
"""What people call a colour. Metal and white cannot be told apart by colour alone: metal takes both."""


def in_colour(pixels: Pixels) -> Pixels | None:
    """The (H, W, 3) BGR picture; None where it is grey: one channel, or three that are the same."""
    if pixels.ndim == 2:
        return None
    blue, green, red = pixels[..., 0], pixels[..., 1], pixels[..., 2]
    return None if np.array_equal(blue, green) and np.array_equal(green, red) else pixels
