"""Grey to mask with one band for the whole picture (section 3.1), and a proposal for that band.

The paper chooses the band from the histogram's shape, by hand. `propose_band` does it for parts that are
brighter than the ground they lie on, which is how thin parts are lit in practice.
"""

from __future__ import annotations

import numpy as np

from vision.quality import require_grey
from vision.types import Floats, Grey, Mask

BRIGHT_SHARE = 0.002
"""Share of the picture that is part if there is one at all: 600 pixels at 640 x 480, most of a thin stick."""
SMOOTH_GREY = 5
GROUND_SPREADS = 6.0
"""The band starts at least this many ground spreads above the ground, so that an empty table stays empty."""
WHITE = 255


def in_band(grey: Grey, band: tuple[int, int]) -> Mask:
    """Pixels whose grey value is in [min, max], both included.

    Raises
    ------
    ValueError
        Not a grey 8-bit picture, or a band that is not 0 <= min <= max <= 255.

    Examples
    --------
    >>> in_band(np.array([[10, 200, 255]], np.uint8), (186, 254))
    array([[False,  True, False]])
    """
    require_grey(grey)
    low, high = band
    if not 0 <= low <= high <= WHITE:
        raise ValueError(f"a band is 0 <= min <= max <= 255, not {band}")
    return np.asarray((grey >= low) & (grey <= high), dtype=np.bool_)


def propose_band(grey: Grey) -> tuple[int, int]:
    """A band [min, 255] from the histogram's shape, for bright parts on darker ground.

    The ground is the highest peak of the smoothed histogram; its spread is measured on its dark flank, which
    no part disturbs, as the distance to 16 % of the values below the peak. The parts are the bright tail: the
    grey value that only `BRIGHT_SHARE` of the picture exceeds. The band starts half-way between the two,
    because a blurred outline lies where the grey is half-way; other things of middling brightness
    (a grey block, the shine of the ground) then stay out as long as they are darker than half. It never
    starts nearer to the ground than `GROUND_SPREADS` spreads, so a picture without parts gives an empty mask.
    """
    require_grey(grey)
    counts = np.bincount(grey.ravel(), minlength=WHITE + 1).astype(np.float64)
    ground = _main_peak(counts)
    flank = np.cumsum(counts[: ground + 1])
    spread = max(1.0, ground - float(np.searchsorted(flank, 0.32 * flank[-1])))
    from_above = np.cumsum(counts[::-1]) / grey.size
    bright = WHITE - int(np.searchsorted(from_above, BRIGHT_SHARE))
    start = max(ground + (bright - ground) / 2.0, ground + GROUND_SPREADS * spread)
    return int(min(round(start), WHITE)), WHITE


def _main_peak(counts: Floats) -> int:
    """Grey value of the highest peak of the histogram (256,), smoothed as one empty value is no valley."""
    kernel = np.ones(SMOOTH_GREY) / SMOOTH_GREY
    return int(np.argmax(np.convolve(counts, kernel, mode="same")))
