"""How exact a camera pair will be, from its geometry alone.

A point at depth Z has the disparity d = f B / Z, so a disparity that is off by s_d shifts it in depth by
s_Z = Z^2 / (f B) s_d; a pixel is Z / f wide there, and a shift in depth moves a point aside that is not on
the axis (Rodriguez and Aggarwal, "Stochastic analysis of stereo quantization error", PAMI 12, 1990; Gallup
et al., "Variable baseline/resolution stereo", CVPR 2008). Of a thin part its middle line is matched, which is
seen to s_px across itself in each picture: in the direction of the rows that is s_px / sin(a) for a part at
an angle a to the baseline, and two pictures make s_d = sqrt(2) s_px / sin(a). A part along the baseline (a
below `LEAST_ANGLE_RAD`) is told by its ends only.

What a calibration has wrong is not in here: it shifts all parts of a place alike, and a touch test shows it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from vision.types import Floats, read_only

LINE_PX: Final = 0.03
"""How exactly the middle line of a part is seen across itself, one standard deviation, where its edges are
sharp and nothing lies over it (measured: `python -m bench.forecast`)."""
LEAST_ANGLE_RAD: Final = math.radians(15.0)
"""Flatter to the baseline than this, a part's flanks tell next to nothing of its depth."""
ENOUGH_PX: Final = 5.5
GOOD_PX: Final = 8.0
"""Pixels across a part below which the detector gets worse, and from which on it is at its best."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """Two like cameras side by side, looking the same way; pictures of ``width_px`` x ``height_px``."""

    focal_px: float
    baseline_m: float
    width_px: int
    height_px: int

    def __post_init__(self) -> None:
        if min(self.focal_px, self.baseline_m, self.width_px, self.height_px) <= 0:
            raise ValueError("focal length, baseline and picture size must be above 0")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Forecast:
    """What a pair will do at a distance.

    ``x_m``, ``y_m`` (3, 3) points of the area both cameras see, from its middle; ``depth_m``, ``lateral_m``
    (3, 3) one standard deviation there for a part at right angles to the baseline; ``view_m`` width and
    height of that area; ``part_px`` pixels across a part; ``disparity_px`` at the distance, ``pixel_m`` width
    of a pixel and ``depth_per_px_m`` depth of one whole pixel of disparity.
    """

    x_m: Floats
    y_m: Floats
    depth_m: Floats
    lateral_m: Floats
    view_m: tuple[float, float]
    part_px: float
    disparity_px: float
    pixel_m: float
    depth_per_px_m: float


def disparity_sigma_px(angle_rad: float, line_px: float = LINE_PX) -> float:
    """Standard deviation of the disparity of a part's middle line, by its angle to the baseline."""
    return math.sqrt(2.0) * line_px / max(math.sin(abs(angle_rad)), math.sin(LEAST_ANGLE_RAD))


def depth_sigma_m(pair: Pair, distance_m: float, disparity_px: float) -> float:
    """s_Z = Z^2 / (f B) s_d."""
    return distance_m**2 / (pair.focal_px * pair.baseline_m) * disparity_px


def forecast(
    pair: Pair,
    distance_m: float,
    part_m: float,
    angle_rad: float = math.pi / 2,
    line_px: float = LINE_PX,
) -> Forecast:
    """Expected errors across the area both cameras see.

    Parameters
    ----------
    pair
        The cameras.
    distance_m
        From the cameras to the parts.
    part_m
        Thickness of a part.
    angle_rad
        Between a part and the baseline, in the picture.
    line_px
        See `LINE_PX`.

    Raises
    ------
    ValueError
        A distance at which the two cameras see nothing in common.
    """
    if distance_m <= 0 or part_m <= 0:
        raise ValueError("distance and thickness must be above 0")
    pixel = distance_m / pair.focal_px
    wide, high = pair.width_px * pixel - pair.baseline_m, pair.height_px * pixel
    if wide <= 0:
        raise ValueError(
            f"at {1e3 * distance_m:.0f} mm the two pictures have nothing in common: each is "
            f"{1e3 * pair.width_px * pixel:.0f} mm wide, the baseline is {1e3 * pair.baseline_m:.0f} mm"
        )
    x, y = np.meshgrid(np.array([-0.5, 0.0, 0.5]) * wide, np.array([-0.5, 0.0, 0.5]) * high)
    sigma_d = disparity_sigma_px(angle_rad, line_px)
    depth = np.full((3, 3), depth_sigma_m(pair, distance_m, sigma_d))
    # the middle of both cameras is the origin: each picture's own error, and depth seen at a slant
    across = pixel * line_px / math.sqrt(2.0)
    lateral = np.hypot(across, depth * np.hypot(x, y) / distance_m)
    return Forecast(
        x_m=read_only(x),
        y_m=read_only(y),
        depth_m=read_only(depth),
        lateral_m=read_only(lateral),
        view_m=(wide, high),
        part_px=part_m / pixel,
        disparity_px=pair.focal_px * pair.baseline_m / distance_m,
        pixel_m=pixel,
        depth_per_px_m=depth_sigma_m(pair, distance_m, 1.0),
    )
