"""Gates, order and score of placed parts, on records made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from tests.reference.sticks import TABLE, Stick, lying, pair, rig
from vision.look import Look
from vision.match import Placed
from vision.offer import VAGUE_DEPTH, candidates
from vision.reconstruct_lines import Solved, from_space
from vision.stereo import Side, project, rectification, rectify_points
from vision.strands import Strands, Tip
from vision.types import Candidate, PartModel, Refusal, Tuning

ROD = PartModel(code=3, name="rod", length_m=0.1, length_tolerance_m=0.004, diameter_m=0.004)
RECT = rectification(rig())
UPPER = lying(0.0, 0.0, 20, height_m=0.006)
LOWER = lying(0.0, 0.0, 100, height_m=0.002)
ASIDE = lying(0.06, 0.03, 60)


def moved(stick: Stick, x_m: float, y_m: float) -> Stick:
    by = np.array([x_m, y_m, 0.0])
    return Stick(start=stick.start + by, end=stick.end + by)


def looks(sticks: list[Stick]) -> tuple[Look, Look]:
    left, right = pair(sticks)
    made = [
        Look(
            grey=grey.astype(np.float32),
            mask=grey > 100,
            rect=RECT,
            side="left" if number == 0 else "right",
            width_px=5.7,
            contrast_grey=140.0,
        )
        for number, grey in enumerate((left, right))
    ]
    return made[0], made[1]


def strands(sticks: list[Stick], side: int, width_px: float = 5.7, kind: Tip = Tip.FREE) -> Strands:
    name: Side = "left" if side == 0 else "right"
    raw = [project(np.stack([s.start, s.end]), rig())[side] for s in sticks]
    tips = np.array([rectify_points(px, RECT, name) for px in raw]).reshape(-1, 2, 2)
    way = tips[:, 1] - tips[:, 0]
    count = len(sticks)
    return Strands(
        tips=tips,
        kind=np.full((count, 2), kind, np.int64),
        tip_sigma_px=np.full((count, 2), 0.4),
        reach_px=np.zeros((count, 2)),
        sure=np.ones((count, 2), np.bool_),
        cautious_tips=tips,
        cautious_reach_px=np.zeros((count, 2)),
        direction=way / np.linalg.norm(way, axis=1, keepdims=True),
        line_sigma_px=np.full((count, 2), 0.1),
        width_px=np.full(count, width_px),
        seen=np.ones(count),
    )


def placed(
    sticks: list[Stick],
    *,
    completed: bool = False,
    slack_m: float = 0.0,
    cover: float = 1.0,
    depth_sigma_m: float = 0.0005,
) -> Placed:
    count = len(sticks)
    ends = np.array([np.stack([s.start, s.end]) for s in sticks]).reshape(-1, 2, 3)
    rows = np.arange(count)
    return Placed(
        solved=Solved(
            left=rows,
            right=rows,
            flipped=np.zeros(count, np.int64),
            ends_px=from_space(ends, RECT),
            ends_m=ends,
            end_sigma_px=np.full((count, 2), 0.4),
            depth_sigma_m=np.full(count, depth_sigma_m),
            chi2=np.ones(count),
            residual_px=np.full(count, 0.1),
        ),
        ends_m=ends,
        completed=np.tile([completed, False], (count, 1)),
        slack_m=np.full(count, slack_m),
        cover=np.full(count, cover),
        cost=np.arange(count, dtype=np.float64),
    )


def offer(
    sticks: list[Stick], parts: Placed | None = None, tuning: Tuning | None = None
) -> tuple[Candidate, ...]:
    return candidates(
        parts or placed(sticks),
        strands(sticks, 0),
        strands(sticks, 1),
        looks(sticks),
        ROD,
        tuning or Tuning(),
        TABLE,
    )


def reasons(candidate: Candidate) -> list[Refusal]:
    return [refused.reason for refused in candidate.refusals]


def test_the_lower_of_two_is_refused_and_comes_last() -> None:
    found = offer([LOWER, UPPER])

    assert [reasons(c) for c in found] == [[], [Refusal.CROSSED]]
    assert found[0].centre[2] < found[1].centre[2]


def test_what_lies_free_comes_before_what_something_lies_on() -> None:
    crossed_at_its_end = moved(LOWER, 0.0, 0.04)

    found = offer([crossed_at_its_end, UPPER, ASIDE])

    assert all(c.offered for c in found)
    assert found[-1].centre == pytest.approx(0.5 * (crossed_at_its_end.start + crossed_at_its_end.end))


def test_a_lone_strand_over_the_middle_refuses_what_its_flanks_cut() -> None:
    sticks = [LOWER, UPPER]

    found = candidates(
        placed([LOWER]), strands(sticks, 0), strands([LOWER], 1), looks(sticks), ROD, Tuning(), TABLE
    )

    assert reasons(found[0]) == [Refusal.CROSSED]


def test_the_same_place_twice_is_offered_once() -> None:
    again = moved(ASIDE, 0.0005, 0.0)

    found = offer([ASIDE, again])

    assert [reasons(c) for c in found] == [[], [Refusal.DUPLICATE]]


def test_a_completed_end_lowers_the_score_and_too_much_slack_refuses() -> None:
    seen = offer([ASIDE])[0]
    completed = offer([ASIDE], placed([ASIDE], completed=True))[0]
    loose = offer([ASIDE], placed([ASIDE], completed=True, slack_m=0.02))[0]

    assert completed.offered
    assert completed.score < seen.score <= 1.0
    assert reasons(loose) == [Refusal.AMBIGUOUS]
    assert loose.refusals[0].value == 0.02


def test_a_part_the_masks_do_not_show_is_refused_as_unmatched() -> None:
    found = offer([ASIDE], placed([ASIDE], cover=0.5))[0]

    assert reasons(found) == [Refusal.UNMATCHED]


def test_a_minimum_score_refuses_with_both_numbers() -> None:
    found = offer([ASIDE], tuning=Tuning(min_score=0.999))[0]

    assert reasons(found) == [Refusal.LOW_SCORE]
    assert found.refusals[0].value == found.score
    assert found.refusals[0].limit == 0.999


def test_a_wrong_width_is_refused_in_pixels() -> None:
    found = candidates(
        placed([ASIDE]),
        strands([ASIDE], 0, 11.0),
        strands([ASIDE], 1, 11.0),
        looks([ASIDE]),
        ROD,
        Tuning(),
        TABLE,
    )

    assert reasons(found[0]) == [Refusal.WIDTH]
    assert found[0].refusals[0].value == 11.0
    assert found[0].refusals[0].unit == "px"


def test_a_tip_at_the_border_is_refused_as_edge() -> None:
    found = candidates(
        placed([ASIDE]),
        strands([ASIDE], 0, kind=Tip.BORDER),
        strands([ASIDE], 1),
        looks([ASIDE]),
        ROD,
        Tuning(),
        TABLE,
    )

    assert reasons(found[0]) == [Refusal.EDGE]


def test_parts_far_from_the_length_are_nobodys_concern() -> None:
    long = lying(0.0, 0.0, 40, length_m=0.16)

    assert offer([long]) == ()


def test_nothing_placed_offers_nothing() -> None:
    assert offer([]) == ()


def test_a_vague_depth_halves_the_score() -> None:
    sharp = offer([ASIDE], placed([ASIDE], depth_sigma_m=0.0))[0]
    vague = offer([ASIDE], placed([ASIDE], depth_sigma_m=VAGUE_DEPTH * ROD.diameter_m))[0]

    assert vague.score == pytest.approx(0.5 * sharp.score)
