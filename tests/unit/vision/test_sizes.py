"""Products of several lengths and colours in one look: which is which; one product is looked for as ever."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import numpy.typing as npt
import pytest

from tests.reference.looks import ROD, drawn, explained, frame
from tests.reference.sticks import TABLE, Stick, lying, pair, rig
from vision.default import LINE_SLACK_PX, locate_default
from vision.explain import Frame
from vision.locate import locate
from vision.proposals import lines
from vision.published import locate_published
from vision.refine import KIND, LENGTH
from vision.sizes import lead, of_one_width, pool, size_of, sizes_of, weighing_length_m
from vision.strays import strays
from vision.types import Candidate, ColourRange, PartModel, Refusal, Scene, Tuning
from vision.windows import windows

LONG = replace(ROD, code=8, name="long", length_m=0.14)
SHORT = replace(ROD, code=9, name="short", length_m=0.07)
RED = ColourRange(hue_deg=(335.0, 14.0), saturation=(0.35, 1.0))
BLUE = ColourRange(hue_deg=(185.0, 260.0), saturation=(0.25, 1.0))


def look(sticks: list[Stick], part: PartModel, *among: PartModel) -> Scene:
    left, right = pair(sticks)
    return locate(left, right, rig(), part, Tuning(), TABLE, among=among)


def nearest(candidates: tuple[Candidate, ...], stick: Stick) -> tuple[Candidate, float]:
    """The candidate closest to a stick, and the distance of the worse of its ends in m."""

    def apart(c: Candidate) -> float:
        same = max(np.linalg.norm(c.start - stick.start), np.linalg.norm(c.end - stick.end))
        turned = max(np.linalg.norm(c.start - stick.end), np.linalg.norm(c.end - stick.start))
        return float(min(same, turned))

    best = min(candidates, key=apart)
    return best, apart(best)


# ------------------------------------------------------------------------------ which is which


@pytest.mark.parametrize("turn_deg", [0, 25, 50, 75, 100, 125, 150])
def test_of_three_lengths_each_is_what_it_is(turn_deg: int) -> None:
    sticks = [
        (7, lying(-0.05, -0.035, turn_deg)),
        (8, lying(0.045, 0.0, turn_deg + 60, length_m=0.14)),
        (9, lying(-0.06, 0.045, turn_deg + 120, length_m=0.07)),
    ]

    scene = look([stick for _, stick in sticks], ROD, LONG, SHORT)

    assert len(scene.recognised) == 3
    for code, stick in sticks:
        found, off_m = nearest(scene.recognised, stick)
        assert (found.part_code, off_m < 0.003) == (code, True)


@pytest.mark.parametrize("turn_deg", [0, 20, 45, 70, 90, 115, 140, 165])
def test_a_piece_of_a_long_stick_under_others_is_never_a_short_one(turn_deg: int) -> None:
    # the ends of the long one lie under the short ones
    long = lying(0.0, 0.0, turn_deg, length_m=0.14)
    way = (long.end - long.start) / 0.14
    over = [
        lying(float(at[0]), float(at[1]), turn_deg + 70, height_m=0.006)
        for at in (long.start + 0.012 * way, long.end - 0.012 * way)
    ]

    scene = look([long, *over], ROD, LONG)

    short = [c for c in scene.recognised if c.part_code == ROD.code]
    assert all(min(nearest((c,), stick)[1] for stick in over) < 0.003 for c in short)
    mine = nearest(scene.candidates, long)
    assert (mine[0].part_code, mine[1] < 0.004) == (LONG.code, True)


def test_the_answer_does_not_depend_on_which_of_them_is_asked_for() -> None:
    sticks = [lying(-0.03, 0.0, 30), lying(0.03, 0.01, 110, length_m=0.14), lying(0.0, -0.05, 5)]

    asked = look(sticks, ROD, LONG)
    other = look(sticks, LONG, ROD)

    for stick in sticks:
        one, two = nearest(asked.recognised, stick)[0], nearest(other.recognised, stick)[0]
        assert one.part_code == two.part_code
        assert np.abs(one.centre - two.centre).max() < 1e-4


def painted(
    sticks: list[tuple[Stick, tuple[int, int, int]]],
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    """Left and right grey, and the left picture with every stick in its own BGR."""
    left, right = pair([stick for stick, _ in sticks])
    colour = np.repeat(left[..., None], 3, axis=2).astype(np.float64)
    for stick, bgr in sticks:
        alone = pair([stick])[0]
        colour[alone > 90] = alone[alone > 90, None] / 255.0 * np.array(bgr)
    return left, right, np.asarray(np.rint(colour), np.uint8)


def test_of_two_colours_and_two_lengths_each_is_what_it_is() -> None:
    red, blue = (40, 35, 250), (250, 110, 80)
    sticks = [
        (1, lying(-0.06, -0.02, 20), red),
        (2, lying(0.0, 0.03, 80), blue),
        (3, lying(0.05, -0.01, 130, length_m=0.14), blue),
    ]
    left, right, colour = painted([(stick, bgr) for _, stick, bgr in sticks])
    parts = (
        replace(ROD, code=1, colour=RED),
        replace(ROD, code=2, colour=BLUE),
        replace(LONG, code=3, colour=BLUE),
    )

    scene = locate(left, right, rig(), parts[0], Tuning(), TABLE, None, colour, parts[1:])

    assert {c.part_code for c in scene.recognised} == {1, 2, 3}
    for code, stick, _ in sticks:
        found, off_m = nearest(scene.recognised, stick)
        assert (found.part_code, off_m < 0.003) == (code, True)


def test_a_colour_of_no_product_is_refused_by_its_colour() -> None:
    left, right, colour = painted([(lying(0.0, 0.0, 40), (60, 200, 60))])
    parts = (replace(ROD, code=1, colour=RED), replace(ROD, code=2, colour=BLUE))

    scene = locate(left, right, rig(), parts[0], Tuning(), TABLE, None, colour, parts[1:])

    assert [[why.reason for why in c.refusals] for c in scene.candidates] == [[Refusal.COLOUR]]


def test_every_product_told_by_colour_needs_the_colour_picture() -> None:
    left, right = pair([lying(0.0, 0.0, 40)])

    with pytest.raises(ValueError, match="part long is told by its colour"):
        locate(left, right, rig(), ROD, Tuning(), TABLE, among=(replace(LONG, colour=RED),))


def test_the_first_answer_is_of_the_product_that_is_asked_for() -> None:
    sticks = [lying(-0.04, -0.02, 60), lying(0.04, 0.0, 100, length_m=0.14)]
    left, right = pair(sticks)
    told: list[Scene] = []

    def tell(stage: str, product: object) -> None:
        if stage == "first":
            assert isinstance(product, Scene)
            told.append(product)

    locate(left, right, rig(), LONG, Tuning(), TABLE, tell, among=(ROD,))

    (first,) = told
    assert {c.part_code for c in first.offered} == {LONG.code}


# ------------------------------------------------------------------------------ one product


def same(one: Candidate, other: Candidate) -> bool:
    """Bit for bit."""
    return all(
        np.array_equal(getattr(one, of.name), getattr(other, of.name), equal_nan=True)
        if isinstance(getattr(one, of.name), np.ndarray | float)
        else getattr(one, of.name) == getattr(other, of.name)
        for of in fields(Candidate)
    )


def test_one_product_is_proposed_as_it_was() -> None:
    of = frame()
    seen = drawn([lying(0.0, 0.0, 20), lying(0.01, 0.0, 80, height_m=0.006)], of)
    none = np.zeros((0, 4))
    left, right = (lines(side, none, of.width_px, of.length_px) for side in (seen.left, seen.right))
    slack = np.array([0.0, 0.0, LINE_SLACK_PX])
    planes = np.stack([of.low - slack, of.high + slack])

    proposed = pool(left, right, planes, sizes_of((ROD,), of))

    alone = windows(left, right, of.on, planes, ROD.length_m, of.width_px, of.length_px, of.unit)
    others = strays(left, right, of.on, planes, ROD.length_m, of.length_px, of.unit)
    assert np.array_equal(proposed, np.concatenate([alone, others]))


def test_one_product_is_weighed_by_its_own_length() -> None:
    of = frame()
    (size,) = sizes_of((ROD,), of)

    assert weighing_length_m((ROD,)) == ROD.length_m
    for field in fields(Frame):
        assert np.array_equal(getattr(size.frame, field.name), getattr(of, field.name))


def test_the_front_door_gives_what_the_methods_give() -> None:
    left, right = pair([lying(-0.02, 0.0, 20), lying(0.03, 0.0, 80, height_m=0.006)])
    published = Tuning(method="published", depth_m=(0.38, 0.41))

    for tuning, method in ((Tuning(), locate_default), (published, locate_published)):
        asked = locate(left, right, rig(), ROD, tuning, TABLE)
        alone = method(left, right, rig(), ROD, tuning, TABLE)
        assert asked.candidates
        assert len(asked.candidates) == len(alone.candidates)
        assert all(same(a, b) for a, b in zip(asked.candidates, alone.candidates, strict=True))


def test_the_published_method_refuses_several_products() -> None:
    left, right = pair([lying(0.0, 0.0, 40)])

    with pytest.raises(ValueError, match="one product a look, not 2"):
        locate(left, right, rig(), ROD, Tuning(method="published"), TABLE, among=(LONG,))


# ------------------------------------------------------------------------------ groups


def test_products_are_grouped_by_length_in_the_order_given() -> None:
    twin = replace(ROD, code=3, length_m=0.1005)

    sizes = sizes_of((ROD, LONG, twin), frame())

    assert [[part.code for part in size.parts] for size in sizes] == [[7, 3], [8]]
    assert sizes[1].frame.length_px == pytest.approx(1.4 * sizes[0].frame.length_px)


def test_a_stray_is_of_the_size_that_is_nearest() -> None:
    sizes = sizes_of((ROD, LONG), frame())

    assert size_of(-1.0, 0.115, sizes) is sizes[0]
    assert size_of(-1.0, 0.125, sizes) is sizes[1]
    assert size_of(1.0, 0.1, sizes) is sizes[1]


@pytest.mark.parametrize(
    ("lengths_m", "weighing_m"),
    [((0.1,), 0.1), ((0.1, 0.14), 0.14), ((0.06, 0.13), 0.096), ((0.03, 0.2), 0.08)],
)
def test_evidence_is_weighed_by_the_longest_within_reason(
    lengths_m: tuple[float, ...], weighing_m: float
) -> None:
    parts = tuple(replace(ROD, length_m=length) for length in lengths_m)

    assert weighing_length_m(parts) == pytest.approx(weighing_m)


def test_thick_ones_and_bent_ones_are_not_of_one_width() -> None:
    assert of_one_width(ROD, (LONG, replace(SHORT, diameter_m=0.0043)))
    assert not of_one_width(ROD, (replace(SHORT, diameter_m=0.0045),))


def test_no_stray_is_as_long_as_a_product() -> None:
    of = replace(frame(), part=LONG)
    seen = drawn([lying(0.0, 0.0, 20), lying(0.02, 0.03, 100, length_m=0.14)], of)
    none = np.zeros((0, 4))
    left, right = (lines(side, none, of.width_px, of.length_px) for side in (seen.left, seen.right))
    slack = np.array([0.0, 0.0, LINE_SLACK_PX])

    found = pool(left, right, np.stack([of.low - slack, of.high + slack]), sizes_of((LONG, ROD), of))

    assert set(found[found[:, KIND] >= 0, LENGTH]) == {0.1, 0.14}
    assert set(found[found[:, KIND] == 0, LENGTH]) == {0.14}


def test_one_product_has_no_rival_of_another_length() -> None:
    of = frame()
    found = explained(drawn([lying(0.0, 0.0, 20)], of), of)

    assert np.isinf(lead(found, sizes_of((ROD,), of))).all()
