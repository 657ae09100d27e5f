"""Is this pair of pictures worth looking at? Names the camera, the flaw and its number."""

from __future__ import annotations

import math
from dataclasses import dataclass

import structlog

from cell import calibration, frames
from cell.calibration import Calibration
from cell.colours import in_colour
from cell.empty_tray import TAKE
from cell.faults import CameraMoved, PictureUnusable
from drivers.types import Frame, FramePair, Pixels
from vision import epipolar, light, quality, sharpness
from vision.empty import change
from vision.epipolar import RowResidual
from vision.light import LightChange
from vision.stereo import Rectification, rectification
from vision.types import EmptyTray, Grey, PictureFlaw, Plane, Unusable

log = structlog.get_logger()

_SIGMAS = 3.0


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


class PictureCheck:
    """Remembers the last pair: a frozen camera serves the same picture with new times, and light changes.

    Without ``standing`` it does not look whether a camera was moved. ``remarks`` on the last pair are no
    reason to refuse it: the detector does not mind another light, but somebody may have to look at lamp or
    exposure. With ``empty`` it also remarks that the reference of the empty tray does not suit any more.
    """

    def __init__(self, standing: Standing | None = None, empty: EmptyTray | None = None) -> None:
        self._standing = standing
        self._empty = empty
        self._unlike: tuple[str, ...] = ()
        self._last: dict[str, Grey] = {}
        self.remarks: tuple[str, ...] = ()

    def check(self, pair: FramePair) -> tuple[Grey, Grey]:
        """Both pictures in grey, (H, W) uint8.

        Raises
        ------
        PictureUnusable
            Black, saturated, without contrast, blurred, bit for bit the one before, or in another light. A
            new light is said once: the next pair is compared with it.
        CameraMoved
            The rows of the two pictures do not belong together any more.
        """
        self.remarks = ()
        left, right = self._check(pair.left), self._check(pair.right)
        if self._standing is not None:
            refuse_moved(self._standing.row_residual(left, right), pair.left.camera, pair.right.camera)
        if self._empty is not None:
            self._compare(pair, (left, right), self._empty)
        return left, right

    def _compare(self, pair: FramePair, greys: tuple[Grey, Grey], empty: EmptyTray) -> None:
        """Remark, and log once, that the reference of the empty tray does not suit the pictures any more."""
        unlike = tuple(
            frame.camera
            for frame, grey, reference in zip(
                (pair.left, pair.right), greys, (empty.left, empty.right), strict=True
            )
            if not change(grey, reference).usable
        )
        self.remarks += tuple(
            f"{camera}: looks so unlike the empty tray's picture that it is left out: the camera was moved, "
            f"the light changed, or the bin is too full; if it stays so, {TAKE}"
            for camera in unlike
        )
        if unlike and unlike != self._unlike:
            log.warning("empty_tray_left_out", cameras=unlike, do=TAKE)
        self._unlike = unlike

    def stand(self, standing: Standing) -> None:
        """The next pair is taken from here: cameras on the arm stand elsewhere at each look."""
        self._standing = standing

    def forget(self) -> None:
        """The next pair is compared with nothing: a camera was opened anew."""
        self._last.clear()

    def _check(self, frame: Frame) -> Grey:
        grey = frames.grey_of(frame)
        refuse_flawed(grey, frame.camera)
        last = self._last.get(frame.camera)
        if last is not None and quality.unchanged(last, grey):
            raise PictureUnusable(
                f"{frame.camera}: picture {frame.sequence} is bit for bit the same as the one before; "
                "the camera is frozen, or a recording is repeated"
            )
        self._last[frame.camera] = grey
        change = None if last is None else light.light_change(last, grey)
        if change is not None and change.changed:
            self._remark(frame, change)
        return grey

    def _remark(self, frame: Frame, change: LightChange) -> None:
        self.remarks = (
            *self.remarks,
            f"{frame.camera}: exposure or light changed: {change.share:.0%} of picture {frame.sequence} is "
            f"{change.factor:.2f} times as bright as the one before (limit {light.CHANGED_FACTOR:.2f} times)",
        )
        log.warning(
            "light_changed", camera=frame.camera, factor=round(change.factor, 2), share=round(change.share, 2)
        )


def refuse_flawed(grey: Grey, what: str) -> None:
    """Raise `PictureUnusable` for a black, saturated, flat or blurred picture."""
    flaw = quality.assess(grey) or _blurred(grey)
    if flaw is not None:
        raise PictureUnusable(
            f"{what}: picture is {flaw.flaw.value} ({flaw.value:.3g}, limit {flaw.limit:.3g})"
        )


def refuse_moved(rows: RowResidual, left: str, right: str) -> None:
    """Raise `CameraMoved` when enough places of a pair say that its rows are off."""
    if not rows.known:
        return
    doubt_px = _SIGMAS * rows.spread_px / math.sqrt(rows.points)
    if abs(rows.px) - doubt_px > epipolar.MOVED_PX:
        raise CameraMoved(
            f"{left}, {right}: rows are off by {rows.px:+.1f} px (limit {epipolar.MOVED_PX:g}; {rows.points} "
            f"of {rows.tried} places agree): a camera was moved since the calibration; fix it and calibrate "
            "anew"
        )


def _blurred(grey: Grey) -> Unusable | None:
    blur_px = sharpness.blur_px(grey)
    # NaN: nothing to tell by, as on an empty table
    if blur_px > sharpness.BLURRED_PX:
        return Unusable(flaw=PictureFlaw.BLURRED, value=blur_px, limit=sharpness.BLURRED_PX)
    return None


def require_colour(frame: Frame, part_name: str) -> Pixels:
    """(H, W, 3) BGR pixels of a frame, for a part that is told by its colour.

    Raises
    ------
    PictureUnusable
        The picture is grey.
    """
    colour = in_colour(frame.pixels)
    if colour is None:
        raise PictureUnusable(
            f"{frame.camera}: picture {frame.sequence} is grey, but part {part_name} is told by its colour; "
            "use a colour camera on the left or leave out the part's colour"
        )
    return colour
