"""The detector's front door: the method is a setting, everything else is the same."""

from __future__ import annotations

from typing import assert_never

from vision.colour import Colour
from vision.published import Observer, locate_published
from vision.together import locate_together
from vision.types import Grey, PartModel, Plane, Scene, StereoModel, Tuning


def locate(
    left_grey: Grey,
    right_grey: Grey,
    stereo_model: StereoModel,
    part: PartModel,
    tuning: Tuning,
    table: Plane | None = None,
    observe: Observer | None = None,
    colour_left: Colour | None = None,
    among: tuple[PartModel, ...] = (),
) -> Scene:
    """Find parts in a stereo pair with the method ``tuning.method`` names.

    Parameters
    ----------
    left_grey, right_grey : (H, W) uint8
        Raw pictures of the two calibrated cameras.
    stereo_model, part, tuning
        See their records.
    table
        The plane the parts lie on, left camera frame; needed when ``tuning.depth_m`` is not given.
    observe
        Gets every product with the name of its stage. Stage times are its business: this package
        knows no clock, and leaves ``Scene.durations_s`` empty.
    colour_left : (H, W, 3) uint8 BGR
        The left picture in colour; needed for parts that are told by it.
    among
        Other products that may lie there. One look answers for all of them: every candidate says which
        product it is. The published method knows one product only.

    Returns
    -------
    Scene
        Candidates best first, the refused ones after the offered ones, and every intermediate product.

    Raises
    ------
    ValueError
        Pictures of a wrong type or size, neither a depth range nor a table, a product told by its colour
        without a colour picture, or several products for the published method.
    """
    match tuning.method:
        case "published":
            if among:
                raise ValueError(
                    f"the published method knows one product a look, not {1 + len(among)}; "
                    "use the default method or look for one"
                )
            return locate_published(left_grey, right_grey, stereo_model, part, tuning, table, observe)
        case "default":
            return locate_together(
                left_grey, right_grey, stereo_model, (part, *among), tuning, table, observe, colour_left
            )
        case _:
            assert_never(tuning.method)
