"""What colour a part has in the left picture, and which colours count as a product's.

Hue says little of a pale part and nothing of a grey one, so how strong a colour is is judged before which
colour it is. Where a channel is at its end the colour is not what was there: such samples are left out.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from vision.canvas import points_through_grid
from vision.explain import Explanation, Frame
from vision.types import ColourRange, Floats, PartModel, Refusal, Refused

SAMPLES = 40
INNER = 0.5
"""Colour is read within this share of the half width; further out light and neighbours mix in."""
LANES = (-1.0, -0.5, 0.0, 0.5, 1.0)
CLIPPED_GREY = 254
LEAST_UNCLIPPED = 0.2
"""With fewer samples below the end of the scale than this share, what is bleached is the part itself."""
LEAST_SATURATION = 0.06
"""Below this the three channels differ by no more than noise and the white balance: there is no hue."""

Colour = npt.NDArray[np.uint8]
"""(H, W, 3) uint8 BGR."""


def colour_of(part: Floats, found: Explanation, k: int, colour: Colour, frame: Frame) -> Floats | None:
    """(3,) blue, green, red 0..1: the median over the samples of the left picture where both flanks are seen.

    Parameters
    ----------
    part : (COLUMNS,)
        Where the part was measured.
    k
        Its place in the explanation.

    Returns
    -------
    (3,) float or None
        None where it lies outside the picture.
    """
    steps = int(found.state.samples[k, 0])
    own = np.flatnonzero((found.state.value[k, 0, :steps] > 0).all(axis=1))
    if len(own) == 0:
        own = np.arange(steps)
    share = (own[:: max(1, len(own) // SAMPLES)] + 0.5) / steps
    a, b = part[1:3], part[4:6]
    way = (b - a) / np.linalg.norm(b - a)
    normal = np.array([-way[1], way[0]])
    half = INNER * 0.5 * frame.unit * (part[3] + share * (part[6] - part[3]))
    lanes = [a + share[:, None] * (b - a) + (lane * half)[:, None] * normal for lane in LANES]
    at = np.rint(points_through_grid(frame.on.to_raw[0], np.concatenate(lanes))).astype(np.int64)
    rows, columns = colour.shape[:2]
    at = at[(at[:, 0] >= 0) & (at[:, 0] < columns) & (at[:, 1] >= 0) & (at[:, 1] < rows)]
    if len(at) == 0:
        return None
    samples = colour[at[:, 1], at[:, 0]]
    whole = samples.max(axis=1) < CLIPPED_GREY
    if np.count_nonzero(whole) >= LEAST_UNCLIPPED * len(samples):
        samples = samples[whole]
    return np.asarray(np.median(samples.astype(np.float64), axis=0) / 255.0, np.float64)


def refusals(seen_bgr: Floats, wanted: ColourRange) -> list[Refused]:
    """Why a colour (3,) blue, green, red 0..1 does not count: the first of saturation, value and hue that
    is out of its range; empty where it counts."""
    hue, saturation, value = hue_saturation_value(seen_bgr)
    for number, (least, most) in ((saturation, wanted.saturation), (value, wanted.value)):
        if not least <= number <= most:
            limit = least if number < least else most
            return [Refused(reason=Refusal.COLOUR, value=number, limit=limit, unit="1")]
    low, high = wanted.hue_deg
    if (low, high) == (0.0, 360.0):
        return []
    if saturation < LEAST_SATURATION:
        return [Refused(reason=Refusal.COLOUR, value=saturation, limit=LEAST_SATURATION, unit="1")]
    if low <= hue <= high if low <= high else hue >= low or hue <= high:
        return []
    limit = low if _turn(hue, low) < _turn(hue, high) else high
    return [
        Refused(reason=Refusal.COLOUR, value=math.radians(hue), limit=math.radians(limit), unit="rad"),
    ]


def among_colours(
    seen_bgr: Floats | None, parts: tuple[PartModel, ...]
) -> tuple[PartModel, tuple[Refused, ...]]:
    """Which of several products of one size a part is, by its colour, and what speaks against it.

    A product without a colour takes every colour. Where none counts the first is refused; where several do,
    nobody can tell: the first of them is refused as ambiguous, with how many they are.
    """
    judged = [
        (part, [] if part.colour is None or seen_bgr is None else refusals(seen_bgr, part.colour))
        for part in parts
    ]
    counting = [part for part, why in judged if not why]
    if len(counting) == 1:
        return counting[0], ()
    if counting:
        several = Refused(reason=Refusal.AMBIGUOUS, value=float(len(counting)), limit=1.0, unit="1")
        return counting[0], (several,)
    return judged[0][0], tuple(judged[0][1])


def _turn(one_deg: float, other_deg: float) -> float:
    """Degrees from one hue to another, the shorter way round."""
    return abs((one_deg - other_deg + 180) % 360 - 180)


def hue_saturation_value(bgr: Floats) -> tuple[float, float, float]:
    """Hue in degrees, saturation and value 0..1, of blue, green, red 0..1 (Smith 1978)."""
    blue, green, red = (float(v) for v in bgr)
    most, least = max(blue, green, red), min(blue, green, red)
    spread = most - least
    if spread <= 0:
        return 0.0, 0.0, most
    if most == red:
        sector = ((green - blue) / spread) % 6
    elif most == green:
        sector = (blue - red) / spread + 2
    else:
        sector = (red - green) / spread + 4
    return 60.0 * sector, spread / most, most
