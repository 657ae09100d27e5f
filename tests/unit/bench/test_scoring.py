"""The score: what counts as right, found, first and honest."""

from __future__ import annotations

import importlib.util
import json
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from bench.cases import truth_from
from bench.scoring import Answer, Crossing, Found, TruePart, Truth, answer_of, score, summary
from vision.graph import trace
from vision.types import (
    Candidate,
    Floats,
    Matches,
    Refusal,
    Refused,
    Scene,
    Segments3D,
    View,
)
from vision.types import Crossing as Over

SHARED = Path(__file__).parents[4] / "shared" / "data" / "scenes-dev"
NONE = np.zeros((0, 2, 3))


def part(x: float, y: float, *, pickable: bool = True, free: bool = True, visible: float = 1.0) -> TruePart:
    """A stick of 100 mm along x, 400 mm away, with its middle at (x, y) m."""
    ends = np.array([[x - 0.05, y, 0.4], [x + 0.05, y, 0.4]])
    return TruePart(ends=ends, edges=ends[None], visible=visible, in_frame=True, pickable=pickable, free=free)


LOWER = part(0.0, 0.0, pickable=False, free=False)
UPPER = part(0.0, 0.05)
HIDDEN = part(0.0, 0.1, visible=0.3)
# the crossing is made up: what counts is who is above whom, and where
TRUTH = Truth(parts=(LOWER, UPPER, HIDDEN), crossings=(Crossing(above=1, below=0, at=0.5),))


def found(one: TruePart, shift: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Found:
    return Found(ends=one.ends + np.array(shift))


def answer(*parts: Found, over: tuple[tuple[int, int], ...] | None = None) -> Answer:
    return Answer(found=parts, segments=NONE, over=over)


def test_a_perfect_answer_gets_everything() -> None:
    total = summary([score(answer(found(UPPER), found(LOWER)), TRUTH)])

    assert (total.recall, total.precision, total.first, total.free, total.ranked) == (1, 1, 1, 1, 1)
    assert total.middle_mm == (0, 0)


def test_hidden_parts_are_not_asked_for_but_right_when_found() -> None:
    without = score(answer(found(UPPER)), TRUTH)
    beside = score(answer(found(UPPER), found(HIDDEN)), TRUTH)

    assert without.asked == beside.asked == 2
    assert beside.right == 2
    assert beside.asked_hit == 1


def test_the_order_of_the_ends_does_not_matter() -> None:
    turned = Found(ends=UPPER.ends[::-1])

    got = score(answer(turned), TRUTH)

    assert got.right == 1
    assert got.errors[0].ends_m == (0, 0)


def test_a_duplicate_costs_precision_only() -> None:
    total = summary([score(answer(found(UPPER), found(LOWER), found(UPPER), found(LOWER)), TRUTH)])

    assert total.recall == 1
    assert total.precision == 0.5


@pytest.mark.parametrize(
    ("shift", "right"),
    [((0.0045, 0, 0), 1), ((0.0055, 0, 0), 0), ((0, 0, 0.0075), 1), ((0, 0, 0.0085), 0)],
)
def test_it_may_be_five_millimetres_off_across_and_eight_in_depth(
    shift: tuple[float, float, float], right: int
) -> None:
    assert score(answer(found(UPPER, shift)), TRUTH).right == right


def test_a_tenth_too_short_and_five_degrees_off_is_the_limit() -> None:
    middle = UPPER.ends.mean(axis=0)

    def turned(degrees: float) -> Found:
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        return Found(ends=middle + (UPPER.ends - middle) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]]))

    assert score(answer(Found(ends=middle + 0.91 * (UPPER.ends - middle))), TRUTH).right == 1
    assert score(answer(Found(ends=middle + 0.89 * (UPPER.ends - middle))), TRUTH).right == 0
    assert score(answer(turned(4.9)), TRUTH).right == 1
    assert score(answer(turned(5.1)), TRUTH).right == 0


def test_a_first_pick_under_another_part_is_wrong_and_so_is_the_order() -> None:
    got = score(answer(found(LOWER), found(UPPER)), TRUTH)

    assert got.first is False
    assert got.free is False
    assert (got.ranked, got.misranked) == (1, 1)


def test_the_first_pick_is_the_first_that_is_offered() -> None:
    covered = Found(ends=LOWER.ends, offered=False)

    assert score(answer(covered, found(UPPER)), TRUTH).free is True
    assert score(answer(covered), TRUTH).free is False
    assert score(answer(), TRUTH).free is False


def test_a_pick_told_early_is_judged_and_not_the_one_that_came_first_later() -> None:
    later = answer(found(UPPER), found(LOWER))

    assert score(replace(later, told=found(UPPER)), TRUTH).free is True
    assert score(replace(later, told=found(LOWER)), TRUTH).free is False
    assert score(replace(later, told=found(UPPER, (0.02, 0, 0))), TRUTH).first is False


def test_a_part_touched_near_its_end_is_pickable_and_not_free() -> None:
    touched = part(0.0, 0.0, free=False)
    got = score(answer(found(touched)), Truth(parts=(touched, UPPER)))

    assert got.first is True
    assert got.free is False


def test_relations_are_scored_when_they_are_told() -> None:
    both = (found(LOWER), found(UPPER))

    assert score(answer(*both), TRUTH).told == 0
    assert score(answer(*both, over=((1, 0),)), TRUTH).truly == 1
    wrong = score(answer(*both, over=((0, 1),)), TRUTH)
    assert (wrong.told, wrong.truly, wrong.inverted) == (1, 0, 1)
    assert score(answer(*both, over=()), TRUTH).told == 1


def test_everything_found_where_nothing_is_asked_for_is_a_false_pick() -> None:
    stranger = replace(UPPER, target=False)
    total = summary([score(answer(found(UPPER)), Truth(parts=(stranger,), negative=True))])

    assert (total.false_picks, total.negatives) == (1, 1)
    assert np.isnan(total.precision)


def test_sigma_is_honest_when_errors_are_inside_two_of_them() -> None:
    inside = replace(found(UPPER, (0.0019, 0, 0)), sigma_m=0.001, sigma_rad=0.01)
    outside = replace(found(LOWER, (0.0021, 0, 0)), sigma_m=0.001, sigma_rad=0.01)
    silent = found(HIDDEN, (0.004, 0, 0))

    total = summary([score(answer(inside, outside, silent), TRUTH)])

    assert total.inside_m == 0.5
    assert total.inside_rad == 1.0
    assert np.isnan(summary([score(answer(silent), TRUTH)]).inside_m)


def test_segments_count_when_they_lie_along_a_part_in_the_picture() -> None:
    half = np.stack([UPPER.ends[0], UPPER.ends.mean(axis=0)])
    nearer = half * 0.95  # the same picture, 20 mm nearer
    elsewhere = half + np.array([0.0, 0.3, 0.0])

    got = score(Answer(found=(), segments=np.stack([half, nearer, elsewhere])), TRUTH)

    assert (got.segments_right, got.segments) == (1, 2)


def candidate(one: TruePart, refusals: tuple[Refused, ...] = ()) -> Candidate:
    start, end = one.ends
    return Candidate(
        part_code=1,
        start=start,
        end=end,
        centre=one.ends.mean(axis=0),
        axis=(end - start) / 0.1,
        length_m=0.1,
        nodes=one.ends,
        score=1.0,
        residual_px=0.0,
        refusals=refusals,
        sigma_m=0.001,
        sigma_rad=0.01,
    )


def test_a_scene_is_read_as_offered_parts_first_with_sigmas_and_who_lies_on_whom() -> None:
    under = Refused(reason=Refusal.CROSSED, value=1, limit=0, unit="1")
    short = Refused(reason=Refusal.LENGTH, value=0.05, limit=0.1, unit="m")
    blank = np.zeros((2, 2), np.uint8)
    nothing = trace(blank > 0)
    view = View(grey=blank, mask=blank > 0, skeleton=blank > 0, graph=nothing, band=(0, 255))
    none = np.zeros(0, np.int64)
    scene = Scene(
        method="default",
        candidates=(candidate(HIDDEN, (short,)), candidate(LOWER, (under,)), candidate(UPPER)),
        segments=Segments3D(start=NONE[:, 0], end=NONE[:, 0], edge=none, residual_px=np.zeros(0)),
        left=view,
        right=view,
        matches=Matches(left=none, right=none, cost_px=np.zeros(0), unmatched=0, ambiguous=0),
        crossings=(Over(above=2, below=1, point=np.zeros(3), gap_m=0.0, sure=3.0),),
    )

    got = answer_of(scene)

    assert [one.offered for one in got.found] == [True, False]
    assert np.array_equal(got.found[0].ends, UPPER.ends)
    assert got.found[0].sigma_m == 0.001
    assert got.over == ((0, 1),)
    assert score(got, TRUTH).truly == 1


# ---------------------------------------------------------------------- against the scenes' own evaluator


def evaluator() -> ModuleType:
    spec = importlib.util.spec_from_file_location("scenes_evaluate", SHARED / "evaluate.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def muddled(ends: list[Floats], rng: np.random.Generator) -> list[Floats]:
    """True ends m with some dropped, some twice, some moved a little or far, in another order."""
    out = []
    for one in ends:
        for _ in range(rng.choice([0, 1, 1, 1, 2])):
            moved = one + rng.normal(0.0, rng.choice([0.0005, 0.002, 0.004]), (2, 3))
            out.append(moved + rng.normal(0.0, 0.002, 3))
    return [out[i] for i in rng.permutation(len(out))]


@pytest.mark.shared_data
@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared scenes are not here")
@pytest.mark.parametrize(
    "scene", ["A1", "B2", "D1", "E1", "F2", "G1", "H10-1", "H20-1-ind", "L-dim", "N-cable"]
)
def test_the_scenes_own_evaluator_agrees(scene: str) -> None:
    theirs = evaluator()
    known = json.loads((SHARED / "scenes" / scene / "gt.json").read_text(encoding="utf-8"))
    truth = truth_from(known, known["request"]["cls"])
    rng = np.random.default_rng(sum(map(ord, scene)))
    for _ in range(3):
        some = muddled([one.ends for one in truth.parts], rng)
        pieces = [*some[:4], *(part.ends * 0.97 for part in truth.parts[:3])]
        result = {
            "detections": [
                {"p0": (1000 * ends[0]).tolist(), "p1": (1000 * ends[1]).tolist()} for ends in some
            ],
            "segments": [(1000 * ends).tolist() for ends in pieces],
        }
        their = theirs.score_scene(known, result)
        ours = score(
            Answer(found=tuple(Found(ends=e) for e in some), segments=np.array(pieces).reshape(-1, 2, 3)),
            truth,
        )
        assert ours.targets == their["n_gt"]
        assert (ours.found, ours.right) == (their["n_det"], their["tp"])
        assert (ours.asked, ours.asked_hit) == (their["n_vis"], their["hit_vis"])
        assert (ours.pickable, ours.pickable_hit) == (their["n_pick"], their["hit_pick"])
        assert ours.first == their["rank1"]
        assert (ours.ranked, ours.misranked) == (their["order_pairs"], their["order_bad"])
        assert (ours.segments_right, ours.segments) == (their["seg_good"], their["seg_total"])
        assert ours.negative == their["negative"]
        assert sorted(1000 * e.middle_m for e in ours.errors) == pytest.approx(sorted(their["mid_err"]))
        degrees = sorted(float(np.degrees(e.axis_rad)) for e in ours.errors)
        assert degrees == pytest.approx(sorted(their["axis_err"]), abs=1e-4)
