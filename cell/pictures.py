"""Is this pair of pictures worth looking at? Names the camera, the flaw and its number."""

from __future__ import annotations

from cell import frames
from cell.colours import in_colour
from cell.faults import PictureUnusable
from drivers.types import Frame, FramePair, Pixels
from vision import quality
from vision.types import Grey


class PictureCheck:
    """Remembers the last pair, because a frozen camera serves the same picture with new times."""

    def __init__(self) -> None:
        self._last: dict[str, Grey] = {}

    def check(self, pair: FramePair) -> tuple[Grey, Grey]:
        """Both pictures in grey, (H, W) uint8.

        Raises
        ------
        PictureUnusable
            Black, saturated, without contrast, or bit for bit the one before.
        """
        return self._check(pair.left), self._check(pair.right)

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
        return grey


def refuse_flawed(grey: Grey, what: str) -> None:
    """Raise `PictureUnusable` for a black, saturated or flat picture."""
    flaw = quality.assess(grey)
    if flaw is not None:
        raise PictureUnusable(
            f"{what}: picture is {flaw.flaw.value} ({flaw.value:.3g}, limit {flaw.limit:.3g})"
        )


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
