"""Whether the two cameras still stand as they were calibrated, at each look.

The detector tells it by the ends of the parts it finds, at no cost. Where it finds too few of them, or the
cameras are so far off that it finds none in both pictures, the pictures themselves are asked: whenever there
is something to pick all the same, else at the first such look, and then at every fifth.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from cell import calibration
from cell.calibration import Calibration
from cell.faults import CameraMoved
from vision import epipolar
from vision.epipolar import RowResidual
from vision.stereo import Rectification, rectification
from vision.types import Grey, Plane, Scene

_SIGMAS: Final = 3.0
SILENT_LOOKS: Final = 5
"""While the detector has no say and nothing to offer, the pictures are asked once in so many looks."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Standing:
    """How the cameras stood when they were calibrated, and how far off anything to be seen is."""

    rect: Rectification
    depth_m: tuple[float, float]

    @staticmethod
    def of(known: Calibration, table: Plane, height_m: tuple[float, float]) -> Standing:
        """Over a table. Raises `CalibrationError` when the camera does not look down on it."""
        near, far = calibration.depth_bounds_m(known, table, height_m)
        # the rectified viewing direction differs a little from that of the left camera
        return Standing(rect=rectification(known.stereo), depth_m=(0.9 * near, 1.1 * far))

    def row_residual(self, left: Grey, right: Grey) -> RowResidual:
        """How far the rows of the right picture are off."""
        return epipolar.row_residual(left, right, self.rect, self.depth_m)


class MovedCheck:
    """Knows for how many looks the detector has had no say. Used by the thread that searches, one at a
    time."""

    def __init__(self) -> None:
        self._silent = 0

    def check(
        self, scene: Scene, pictures: tuple[Grey, Grey], cameras: str, standing: Callable[[], Standing]
    ) -> None:
        """Raise `CameraMoved` where a whole scene, or the pair it was found in, says so.

        Parameters
        ----------
        cameras
            Their names, for the message.
        standing
            How they stood; asked for only where the pictures have to tell.
        """
        if math.isfinite(scene.rows_seen_px):
            self._silent = 0
            refuse_moved_by_parts(scene, cameras)
            return
        asked = bool(scene.offered) or self._silent % SILENT_LOOKS == 0
        self._silent += 1
        if asked:
            refuse_moved(standing().row_residual(*pictures), cameras)


def refuse_moved_by_parts(scene: Scene, cameras: str) -> None:
    """Raise `CameraMoved` when the ends of the parts say that rows are off, beyond their doubt."""
    off_px, sigma_px = scene.row_offset_px, scene.rows_sigma_px
    if abs(off_px) - _SIGMAS * sigma_px > epipolar.MOVED_PX:
        raise _moved(cameras, off_px, f"by the ends of parts, ± {sigma_px:.2f}")


def refuse_moved(rows: RowResidual, cameras: str) -> None:
    """Raise `CameraMoved` when enough places of a pair say that its rows are off."""
    if not rows.known:
        return
    doubt_px = _SIGMAS * rows.spread_px / math.sqrt(rows.points)
    if abs(rows.px) - doubt_px > epipolar.MOVED_PX:
        raise _moved(cameras, rows.px, f"{rows.points} of {rows.tried} places agree")


def _moved(cameras: str, off_px: float, told: str) -> CameraMoved:
    return CameraMoved(
        f"{cameras}: rows are off by {off_px:+.1f} px (limit {epipolar.MOVED_PX:g}; {told}): a camera was "
        "moved since the calibration; fix it and calibrate anew"
    )
