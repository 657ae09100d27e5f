"""One picture and what it shows along a line: its mask, its contrast, and the two flanks of a part.

Lines live in rectified pixels; the picture stays raw and is read point by point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vision.lines import Line, Picture, fit_line, flanks
from vision.stereo import Rectification, Side, unrectify_points
from vision.types import Bools, Floats, Mask

OWN_WIDTHS = 0.12
"""Two flanks of one part are its width apart, to within what blur, noise and pixels do to them."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Look:
    """One picture and what is needed to read it.

    ``grey`` (H, W) float32 raw; ``mask`` (H, W) raw; ``width_px`` expected width of a part;
    ``contrast_grey`` what parts stand out by.
    """

    grey: Picture
    mask: Mask
    rect: Rectification
    side: Side
    width_px: float
    contrast_grey: float

    @property
    def slope_floor(self) -> float:
        """Least steepness of a flank, grey per px."""
        return max(3.0, 0.06 * self.contrast_grey)

    def raw_mask_at(self, raw_px: Floats) -> Bools:
        """(N,) the mask at the nearest pixel of raw points (N, 2); outside the picture False."""
        column = np.rint(raw_px[:, 0]).astype(np.int64)
        row = np.rint(raw_px[:, 1]).astype(np.int64)
        rows, columns = self.mask.shape
        inside = (column >= 0) & (row >= 0) & (column < columns) & (row < rows)
        found = self.mask[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)]
        return np.asarray(inside & found, np.bool_)

    def mask_at(self, points_px: Floats) -> Bools:
        """(N,) the mask at rectified points (N, 2)."""
        return self.raw_mask_at(unrectify_points(points_px, self.rect, self.side))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Run:
    """A line with the interval of it that is known to be part, measured from its origin."""

    line: Line
    low: float
    high: float
    width_px: float
    points: Floats
    weights: Floats

    def at(self, along: Floats) -> Floats:
        return self.line.origin + along[:, None] * self.line.direction


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evidence:
    """What the picture shows along a line: ``along`` (N,) px from its origin; ``low``, ``high`` (N,)
    offsets of the flanks in rectified px; ``has_low``, ``has_high``, ``on`` (N,) bool."""

    along: Floats
    low: Floats
    high: Floats
    has_low: Bools
    has_high: Bools
    on: Bools


def evidence(look: Look, run: Run, low: float, high: float, window_px: float) -> Evidence:
    along = np.arange(low, high + 0.5, 1.0)
    at = run.at(along)
    both = unrectify_points(np.concatenate([at, at + run.line.normal]), look.rect, look.side)
    raw, aside = both[: len(at)], both[len(at) :] - both[: len(at)]
    scale = np.linalg.norm(aside, axis=1)
    half = 0.5 * run.width_px
    found = flanks(look.grey, raw, aside / scale[:, None], half, window_px)
    on = look.raw_mask_at(raw)
    floor = look.slope_floor
    # at either end of the window the slope still rises outwards: that flank is somebody else's
    edge = window_px - 0.25
    return Evidence(
        along=along,
        low=found.low_px / scale,
        high=found.high_px / scale,
        has_low=(found.low_slope > floor) & (np.abs(found.low_px + half) < edge),
        has_high=(found.high_slope > floor) & (np.abs(found.high_px - half) < edge),
        on=on,
    )


def refine(look: Look, run: Run) -> Run | None:
    """The line again, to both flanks where both are seen and to one, half a width off, where only one is."""
    for window in (max(1.5, 0.35 * look.width_px), max(0.8, 0.16 * look.width_px)):
        seen = evidence(look, run, run.low, run.high, window)
        both = seen.has_low & seen.has_high & seen.on
        if both.sum() < 3:
            return None
        half = 0.5 * float(np.median((seen.high - seen.low)[both]))
        centre = 0.5 * (seen.low + seen.high)
        centre = np.where(both, centre, np.where(seen.has_low, seen.low + half, seen.high - half))
        used = seen.on & (seen.has_low | seen.has_high)
        points = (run.at(seen.along) + centre[:, None] * run.line.normal)[used]
        # where the width is another, one flank is somebody else's
        own = both & (np.abs(seen.high - seen.low - 2.0 * half) < OWN_WIDTHS * look.width_px)
        weights = np.where(own, 1.0, 0.25)[used]
        line = fit_line(points, weights)
        if line is None:
            return None
        t = (points - line.origin) @ line.direction
        run = Run(
            line=line,
            low=float(t.min()),
            high=float(t.max()),
            width_px=2.0 * half,
            points=points,
            weights=weights,
        )
    return run
