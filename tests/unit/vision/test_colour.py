"""Colours of parts: what is read from a drawn stick, what counts in a range, which product that makes it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from tests.reference.looks import ROD, drawn, explained, frame
from tests.reference.sticks import lying
from vision.colour import LEAST_SATURATION, among_colours, colour_of, hue_saturation_value, refusals
from vision.types import ColourRange, Floats, Refusal

FRAME = frame()
PICTURES = drawn([lying(0.01, 0.0, 35)], FRAME)
FOUND = explained(PICTURES, FRAME)
RED = ColourRange(hue_deg=(335.0, 14.0), saturation=(0.35, 1.0))
BLUE = ColourRange(hue_deg=(185.0, 260.0), saturation=(0.25, 1.0))
WHITE = ColourRange(saturation=(0.0, 0.1), value=(0.4, 1.0))
ONLY_HUE = ColourRange(hue_deg=(185.0, 260.0))


def bgr(*values: float) -> Floats:
    return np.array(values, np.float64) / 255.0


def seen(picture: npt.NDArray[np.uint8]) -> Floats:
    k = FOUND.chosen[0]
    found = colour_of(FOUND.hypotheses[k], FOUND, k, picture, FRAME)
    assert found is not None
    return found


def painted(part_bgr: tuple[int, int, int]) -> npt.NDArray[np.uint8]:
    """The left picture, the stick in one colour, the table black."""
    picture = np.zeros((*PICTURES.greys[0].shape, 3), np.uint8)
    picture[PICTURES.greys[0] > 90] = part_bgr
    return picture


@pytest.mark.parametrize(
    ("colour", "hsv"),
    [
        ((0, 0, 1), (0, 1, 1)),
        ((0, 1, 0), (120, 1, 1)),
        ((1, 0, 0), (240, 1, 1)),
        ((0.5, 0.25, 0.5), (300, 0.5, 0.5)),
        ((0.3, 0.3, 0.3), (0, 0, 0.3)),
    ],
)
def test_hue_saturation_and_value(colour: tuple[float, ...], hsv: tuple[float, ...]) -> None:
    assert hue_saturation_value(np.array(colour, np.float64)) == pytest.approx(hsv)


def test_a_stick_has_the_colour_it_is_painted_in() -> None:
    assert seen(painted((40, 35, 200))) == pytest.approx(bgr(40, 35, 200))


def test_a_pale_part_is_refused_for_being_pale_and_not_by_its_hue() -> None:
    # white with a touch of blue: its hue is inside the range of blue, in other light it would be any
    (refused,) = refusals(bgr(215, 205, 204), BLUE)

    assert (refused.reason, refused.unit, refused.limit) == (Refusal.COLOUR, "1", 0.25)
    assert refused.value == pytest.approx(11 / 215)


def test_grey_has_no_hue_to_be_judged_by() -> None:
    (refused,) = refusals(bgr(205, 203, 202), ONLY_HUE)

    assert (refused.unit, refused.limit) == ("1", LEAST_SATURATION)
    assert refusals(bgr(205, 150, 140), ONLY_HUE) == []


def test_a_hue_out_of_range_comes_with_the_nearer_end_in_plain_numbers() -> None:
    (refused,) = refusals(bgr(40, 200, 35), RED)

    assert refused.unit == "rad"
    assert np.degrees(refused.value) == pytest.approx(122, abs=1)
    assert np.degrees(refused.limit) == pytest.approx(14)
    assert type(refused.value) is float
    assert type(refused.limit) is float


def test_what_counts_is_not_refused() -> None:
    assert refusals(bgr(40, 35, 200), RED) == []
    assert refusals(bgr(236, 238, 240), WHITE) == []


def test_a_highlight_does_not_bleach_the_colour() -> None:
    picture = painted((200, 90, 60))
    lit = (PICTURES.greys[0] > 90) & (np.arange(640) % 5 < 3)[None]  # three columns of five are burnt out
    picture[lit] = 255

    assert seen(picture) == pytest.approx(bgr(200, 90, 60))


def test_a_part_that_is_white_to_the_end_of_the_scale_is_white() -> None:
    assert refusals(seen(painted((255, 255, 255))), WHITE) == []


def test_the_colour_says_which_product_of_one_size_a_part_is() -> None:
    red, blue = replace(ROD, code=1, colour=RED), replace(ROD, code=2, colour=BLUE)

    assert among_colours(bgr(200, 90, 60), (red, blue)) == (blue, ())
    assert among_colours(bgr(40, 35, 200), (red, blue)) == (red, ())


def test_a_colour_of_none_is_refused_against_the_first() -> None:
    red, blue = replace(ROD, code=1, colour=RED), replace(ROD, code=2, colour=BLUE)

    part, why = among_colours(bgr(60, 200, 60), (blue, red))

    assert part.code == 2
    assert [refused.reason for refused in why] == [Refusal.COLOUR]


def test_a_colour_of_two_is_ambiguous() -> None:
    metal = replace(ROD, code=3, colour=ColourRange(saturation=(0.0, 0.2), value=(0.12, 1.0)))

    part, why = among_colours(bgr(236, 238, 240), (replace(ROD, code=1, colour=WHITE), metal))

    assert part.code == 1
    assert [(refused.reason, refused.value, refused.limit) for refused in why] == [(Refusal.AMBIGUOUS, 2, 1)]
