"""Is this pair of pictures worth looking at? Names the camera, the flaw and its number."""

from __future__ import annotations

import structlog

from cell import frames
from cell.colours import in_colour
from cell.empty_tray import TAKE
from cell.faults import PictureUnusable
from drivers.types import Frame, FramePair, Pixels
from vision import light, quality, sharpness
from vision.empty import change
from vision.light import LightChange
from vision.types import EmptyTray, Grey, PictureFlaw, Unusable

log = structlog.get_logger()


class PictureCheck:
    """Remembers the last pair: a frozen camera serves the same picture with new times, and light changes.

    ``remarks`` on the last pair are no reason to refuse it: the detector does not mind another light, but
    somebody may have to look at lamp or exposure. With ``empty`` it also remarks that the reference of the
    empty tray does not suit any more. Whether a camera was moved, `cell.moved` tells.
    """

    def __init__(self, empty: EmptyTray | None = None) -> None:
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
        """
        self.remarks = ()
        left, right = self._check(pair.left), self._check(pair.right)
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
