"""Whether a whole picture became brighter or darker since the one before: exposure, gain, or the light.

Parts that come and go change some pixels by any factor; exposure and light change all of them by the same
one. So the factor counts that most pixels agree on.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from vision.quality import require_grey
from vision.types import Grey

REDUCTION = 4
DARK_GREY, BRIGHT_GREY = 10.0, 240.0
"""Nearer to black the offset of the sensor counts, nearer to white values are cut off."""
LEAST_SHARE_SEEN = 0.1
BIN = 0.02
AGREED = 0.08
"""Logarithm of the factor within which pixels agree."""
LEAST_SHARE_AGREED = 0.6
CHANGED_FACTOR = 1.25


@dataclass(frozen=True, slots=True, kw_only=True)
class LightChange:
    """Grey values became ``factor`` times what they were, for ``share`` of the pixels that can tell."""

    factor: float
    share: float

    @property
    def changed(self) -> bool:
        """Exposure or light changed, as opposed to what lies there."""
        large = max(self.factor, 1.0 / self.factor) > CHANGED_FACTOR
        return large and self.share >= LEAST_SHARE_AGREED


def light_change(previous: Grey, now: Grey) -> LightChange | None:
    """What most pixels agree on; None where too few can tell, or the sizes differ.

    Parameters
    ----------
    previous, now : (H, W) uint8
        Two pictures of one camera.
    """
    require_grey(previous)
    require_grey(now)
    if previous.shape != now.shape:
        return None
    height, width = (max(1, side // REDUCTION) for side in now.shape)
    before, after = (
        np.asarray(cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA), np.float64)
        for grey in (previous, now)
    )
    tell = (before > DARK_GREY) & (before < BRIGHT_GREY) & (after > DARK_GREY) & (after < BRIGHT_GREY)
    if np.count_nonzero(tell) < LEAST_SHARE_SEEN * tell.size:
        return None
    ratio = np.log(after[tell] / before[tell])
    counts, edges = np.histogram(ratio, bins=np.arange(-3.3, 3.3, BIN))
    # a peak, not a plateau: equal pictures agree on one bin
    window = np.bartlett(2 * int(AGREED / BIN) + 1)
    mode = float(edges[int(np.argmax(np.convolve(counts, window, "same")))] + BIN / 2)
    agreed = ratio[np.abs(ratio - mode) <= AGREED]
    return LightChange(factor=float(np.exp(np.median(agreed))), share=len(agreed) / len(ratio))
