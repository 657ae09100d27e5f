"""Gates, order and score of measured parts: drawn sticks, changed by hand where a gate should close."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.reference.looks import ROD, drawn, explained, frame
from tests.reference.sticks import TABLE, lying
from vision.crossings import crossed
from vision.explain import Explanation
from vision.offer import (
    BOW_WIDTHS,
    GOES_ON,
    LEAST_BOTH,
    MOST_ROW_OFFSET_PX,
    OUTSIDE_SHARE,
    VAGUE_DIAMETERS,
    WIDTH_SHARE,
    Offered,
    _barely_seen,
    candidates,
    unexplained,
)
from vision.polish import Measured, polish
from vision.refine import KIND, UNIT
from vision.types import Candidate, ColourRange, PartModel, Refusal, Refused, Tuning

FRAME = frame()
UPPER = lying(0.0, 0.0, 20, height_m=0.006)
LOWER = lying(0.0, 0.0, 100, height_m=0.002)
ASIDE = lying(0.06, 0.03, 60)
STICKS = [LOWER, UPPER, ASIDE]
PICTURES = drawn(STICKS, FRAME)
FOUND = explained(PICTURES, FRAME)
MEASURED = polish(FOUND, PICTURES.left, PICTURES.right, PICTURES.greys, 0.0, FRAME)
ALONE = drawn([ASIDE], FRAME)
ONE = explained(ALONE, FRAME)
ONE_MEASURED = polish(ONE, ALONE.left, ALONE.right, ALONE.greys, 0.0, FRAME)


def offer(
    measured: Measured = ONE_MEASURED,
    found: Explanation = ONE,
    tuning: Tuning | None = None,
    colour: npt.NDArray[np.uint8] | None = None,
    row_offset_px: float = 0.0,
    part: PartModel = ROD,
) -> Offered:
    of = replace(FRAME, part=part)
    over = crossed(measured.parts, measured.covariance, found.chosen, found.state, of)
    return candidates(measured, found, over, of, tuning or Tuning(), TABLE, colour, row_offset_px)


def only(offered: Offered) -> Refused:
    """The one refusal of the one candidate."""
    (candidate,) = offered.candidates
    (refused,) = candidate.refusals
    return refused


def reasons(candidate: Candidate) -> list[Refusal]:
    return [refused.reason for refused in candidate.refusals]


def test_a_stick_in_the_open_is_offered_with_its_place_and_its_doubt() -> None:
    (candidate,) = offer().candidates

    assert candidate.offered
    assert np.linalg.norm(candidate.centre - 0.5 * (ASIDE.start + ASIDE.end)) < 0.0006
    assert candidate.length_m == pytest.approx(0.1, abs=0.0005)
    assert candidate.axis == pytest.approx((candidate.end - candidate.start) / candidate.length_m)
    assert 0.0001 < candidate.sigma_m < 0.002
    assert 0.001 < candidate.sigma_rad < 0.03
    assert candidate.score > 0.9


def test_the_upper_comes_first_the_lower_is_crossed_and_last() -> None:
    offered = offer(MEASURED, FOUND)

    assert [reasons(c) for c in offered.candidates] == [[], [], [Refusal.CROSSED]]
    assert np.linalg.norm(offered.candidates[2].centre - 0.5 * (LOWER.start + LOWER.end)) < 0.002
    refused = offered.candidates[2].refusals[0]
    assert (refused.value, refused.limit) == (1.0, 0.0)
    assert offered.candidates[2].recognised


def test_a_crossing_names_both_and_its_point_and_gap() -> None:
    offered = offer(MEASURED, FOUND)

    (crossing,) = offered.crossings
    above, below = offered.candidates[crossing.above], offered.candidates[crossing.below]
    assert above.offered
    assert reasons(below) == [Refusal.CROSSED]
    assert crossing.point == pytest.approx([0.0, 0.0, 0.394], abs=0.002)
    assert crossing.gap_m == pytest.approx(0.0, abs=0.0015)
    assert crossing.sure > 2


@pytest.mark.parametrize(("length_m", "limit_m"), [(0.106, 0.104), (0.094, 0.096)])
def test_another_length_is_refused_by_what_its_ends_say(length_m: float, limit_m: float) -> None:
    refused = only(offer(replace(ONE_MEASURED, free_length_m=np.array([length_m]))))

    assert (refused.reason, refused.unit) == (Refusal.LENGTH, "m")
    assert refused.value == length_m
    assert refused.limit == pytest.approx(limit_m)


def test_what_goes_on_beyond_an_unseen_end_is_too_long() -> None:
    refused = only(offer(replace(ONE_MEASURED, goes_on=np.array([GOES_ON + 0.1]))))

    assert refused.reason is Refusal.LENGTH
    assert refused.value > refused.limit == pytest.approx(0.104)


def test_a_stray_is_refused_by_its_length_though_it_is_nearly_right() -> None:
    parts = ONE_MEASURED.parts.copy()
    parts[:, KIND] = -1.0

    refused = only(offer(replace(ONE_MEASURED, parts=parts)))

    assert refused.reason is Refusal.LENGTH
    assert refused.value == pytest.approx(0.1, abs=0.001)


@pytest.mark.parametrize(("times", "limit"), [(0.6, WIDTH_SHARE[0]), (1.4, WIDTH_SHARE[1])])
def test_another_width_is_refused_in_metres(times: float, limit: float) -> None:
    hypotheses = ONE.hypotheses.copy()
    hypotheses[:, UNIT] = times * FRAME.unit

    refused = only(offer(found=replace(ONE, hypotheses=hypotheses)))

    assert (refused.reason, refused.unit) == (Refusal.WIDTH, "m")
    assert refused.value == pytest.approx(times * 0.004)
    assert refused.limit == pytest.approx(limit * 0.004)


def test_a_thread_whose_flanks_are_never_seen_together_is_refused() -> None:
    value = ONE.seen.value.copy()
    value[..., 1] = 0.0

    refused = only(offer(found=replace(ONE, seen=replace(ONE.seen, value=value))))

    assert refused == Refused(reason=Refusal.FLANKS, value=0.0, limit=LEAST_BOTH, unit="1")


def test_faint_edges_in_the_grain_beside_one_edge_are_no_second_flank() -> None:
    value = ONE.seen.value.copy()
    value[..., 1] = np.minimum(value[..., 1], 0.2)

    refused = only(offer(found=replace(ONE, seen=replace(ONE.seen, value=value))))

    assert refused == Refused(reason=Refusal.FLANKS, value=0.0, limit=LEAST_BOTH, unit="1")


def test_a_part_that_leaves_the_picture_is_refused() -> None:
    ground = ONE.seen.ground.copy()
    steps = int(ONE.seen.count[ONE.chosen[0], 0])
    ground[ONE.chosen[0], 0, : steps // 10] = 2

    refused = only(offer(found=replace(ONE, seen=replace(ONE.seen, ground=ground))))

    assert refused.reason is Refusal.EDGE
    assert refused.value == pytest.approx(0.1, abs=0.02)
    assert refused.limit == OUTSIDE_SHARE


def test_a_bent_part_is_refused_in_pixels() -> None:
    refused = only(offer(replace(ONE_MEASURED, bow_px=np.array([2.0]))))

    assert refused.reason is Refusal.BENT
    assert refused.value == 2.0
    assert refused.limit == pytest.approx(BOW_WIDTHS * FRAME.width_px)


@pytest.mark.parametrize(
    ("tuning", "value", "limit"),
    [
        (Tuning(depth_m=(0.41, 0.5)), 0.398, 0.41),
        (Tuning(depth_m=(0.3, 0.39)), 0.398, 0.39),
        (Tuning(height_m=(0.01, 0.06)), 0.002, 0.01 - 0.004),
        (Tuning(height_m=(-0.05, -0.01)), 0.002, -0.01 + 0.004),
    ],
)
def test_outside_its_range_it_is_refused_by_depth(tuning: Tuning, value: float, limit: float) -> None:
    refused = only(offer(tuning=tuning))

    assert refused.reason is Refusal.DEPTH
    assert refused.value == pytest.approx(value, abs=0.002)
    assert refused.limit == pytest.approx(limit)


def test_a_steep_part_is_refused_by_its_angle() -> None:
    steep = lying(0.0, 0.0, 60, height_m=0.022, tilt_deg=20)
    pictures = drawn([steep], FRAME)
    found = explained(pictures, FRAME)
    measured = polish(found, pictures.left, pictures.right, pictures.greys, 0.0, FRAME)

    refused = only(offer(measured, found, Tuning(max_tilt_rad=0.2)))

    assert refused.reason is Refusal.TILT
    assert refused.value == pytest.approx(np.radians(20), abs=0.05)
    assert refused.limit == 0.2


def test_a_place_known_worse_than_a_diameter_is_refused_and_stays_recognised() -> None:
    covariance = ONE_MEASURED.covariance.copy()
    covariance[:, [2, 5], [2, 5]] += 9.0

    offered = offer(replace(ONE_MEASURED, covariance=covariance))

    assert only(offered).reason is Refusal.VAGUE
    assert only(offered).limit == pytest.approx(VAGUE_DIAMETERS * 0.004)
    assert only(offered).value == pytest.approx(offered.candidates[0].sigma_m)
    assert offered.candidates[0].recognised


@pytest.mark.parametrize("row_offset_px", [-4.0, 4.0])
def test_rows_that_are_far_off_refuse_everything(row_offset_px: float) -> None:
    refused = only(offer(row_offset_px=row_offset_px))

    assert refused == Refused(reason=Refusal.ROWS, value=row_offset_px, limit=MOST_ROW_OFFSET_PX, unit="px")


def test_little_evidence_is_a_low_score_with_both_numbers() -> None:
    refused = only(
        offer(found=replace(ONE, margin=np.array([0.2 * 2 * FRAME.length_px])), tuning=Tuning(min_score=0.5))
    )

    assert (refused.reason, refused.limit) == (Refusal.LOW_SCORE, 0.5)
    assert 0.3 < refused.value < 0.5


@settings(max_examples=40, deadline=None)
@given(first=st.floats(-1.0, 4.0), second=st.floats(-1.0, 4.0))
def test_more_evidence_is_never_a_lower_score(first: float, second: float) -> None:
    scores = [
        offer(found=replace(ONE, margin=np.array([of * FRAME.length_px]))).candidates[0].score
        for of in sorted((first, second))
    ]

    assert 0.0 <= scores[0] <= scores[1] <= 1.0


@pytest.mark.parametrize(("angle_deg", "strength", "doubt"), [(4, 0.4, 0.2), (4, 0.9, 0.0), (40, 0.4, 0.0)])
def test_along_the_baseline_an_end_that_is_not_clear_is_in_doubt(
    angle_deg: int, strength: float, doubt: float
) -> None:
    stick = [lying(0.0, 0.0, angle_deg)]
    found = explained(drawn(stick, FRAME), FRAME)
    tips = np.ones_like(found.seen.tip_value)
    tips[found.chosen[0], 1, 0] = strength

    assert _barely_seen(replace(found, seen=replace(found.seen, tip_value=tips))) == pytest.approx([doubt])


@pytest.mark.parametrize(("strain", "first"), [(4.0, True), (6.0, False)])
@pytest.mark.parametrize("row", [0, 1])
def test_a_part_whose_flanks_contradict_each_other_goes_later_though_as_well_known(
    row: int, strain: float, first: bool
) -> None:
    pictures = drawn([lying(-0.03, 0.0, 60), lying(0.03, 0.0, 60)], FRAME)
    found = explained(pictures, FRAME)
    measured = polish(found, pictures.left, pictures.right, pictures.greys, 0.0, FRAME)
    margin, strained = np.full(2, 1.0 * FRAME.length_px), np.ones(2)
    margin[row], strained[row] = 1.5 * FRAME.length_px, strain
    covariance = measured.covariance / strained[:, None, None]

    offered = offer(replace(measured, strain=strained, covariance=covariance), replace(found, margin=margin))

    assert (offered.rows[0] == row) is first


@pytest.mark.parametrize(
    ("missing", "doubt"), [("ends", 0.3), ("two ends", 0.06), ("flanks", 0.3), ("one end", 0.0)]
)
def test_what_is_barely_seen_is_in_doubt(missing: str, doubt: float) -> None:
    seen, row = ONE.seen, ONE.chosen[0]
    tips, flanks = seen.tip_value.copy(), seen.value.copy()
    tips[row] = 1.0
    match missing:
        case "ends":
            tips[row, 1] = 0.0
        case "two ends":
            tips[row, :, 0] = 0.0
        case "one end":
            tips[row, 0, 1] = 0.0
        case "flanks":
            flanks[row, 0, : int(0.6 * seen.count[row, 0]), 1] = 0.0
    found = replace(ONE, seen=replace(seen, tip_value=tips, value=flanks))

    assert _barely_seen(found) == pytest.approx([doubt])


def painted(bgr: tuple[int, int, int]) -> npt.NDArray[np.uint8]:
    """The left picture, its bright part in a colour."""
    share = ALONE.greys[0][..., None].astype(np.float64) / 255.0
    return np.asarray(np.rint(share * np.array(bgr)), np.uint8)


RED = ColourRange(hue_deg=(340.0, 20.0), saturation=(0.5, 1.0))


def test_the_right_colour_is_offered_and_another_refused_by_its_hue() -> None:
    part = replace(ROD, colour=RED)

    assert offer(colour=painted((30, 20, 255)), part=part).candidates[0].offered
    refused = only(offer(colour=painted((255, 40, 30)), part=part))

    assert (refused.reason, refused.unit) == (Refusal.COLOUR, "rad")
    assert np.degrees(refused.value) == pytest.approx(237, abs=4)
    assert np.degrees(refused.limit) == pytest.approx(340)


def test_a_grey_part_is_refused_by_its_saturation() -> None:
    refused = only(offer(colour=painted((200, 200, 215)), part=replace(ROD, colour=RED)))

    assert (refused.reason, refused.unit, refused.limit) == (Refusal.COLOUR, "1", 0.5)
    assert refused.value < 0.15


def test_parts_of_quite_another_length_are_nobodys_concern() -> None:
    assert offer(part=replace(ROD, length_m=0.2)).candidates == ()


def test_pieces_that_no_part_lies_along_are_left() -> None:
    part = ONE_MEASURED.parts[0]
    own = np.stack([part[1:3], 0.5 * (part[1:3] + part[4:6])])
    aside = np.array([20.0, 0.0])
    across = np.stack([part[1:3] + aside, part[1:3] - aside])
    far = own + 50.0

    left = unexplained(np.stack([own, across, far]), ONE_MEASURED, FRAME.width_px)

    assert np.array_equal(left, np.stack([across, far]))
