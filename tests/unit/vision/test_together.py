"""Scenes of several kinds of products made one: what is whose, what lies over what; two widths in a look."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.fakes.station import scene as scene_of
from tests.reference.looks import ROD
from tests.reference.sticks import DEPTH_M, TABLE, Stick, lying, pair, rig
from vision.locate import locate
from vision.together import THICK_SHARE, joined
from vision.types import Candidate, Crossing, Floats, Refusal, Refused, Scene, Tuning

THICK = replace(ROD, code=8, name="thick", length_m=0.09, diameter_m=0.0064)
PARTS = (ROD, THICK)
TOO_SHORT = Refused(reason=Refusal.LENGTH, value=0.08, limit=0.096, unit="m")


def at(
    x_m: float,
    y_m: float,
    turn_deg: float,
    *,
    code: int = 7,
    length_m: float = 0.1,
    height_m: float = 0.002,
    score: float = 0.9,
    refusals: tuple[Refused, ...] = (),
) -> Candidate:
    """A level candidate on the drawn table, left camera frame."""
    stick = lying(x_m, y_m, turn_deg, length_m=length_m, height_m=height_m)
    return Candidate(
        part_code=code,
        start=stick.start,
        end=stick.end,
        centre=(stick.start + stick.end) / 2,
        axis=(stick.end - stick.start) / length_m,
        length_m=length_m,
        nodes=np.stack([stick.start, stick.end]),
        score=score,
        residual_px=0.1,
        refusals=refusals,
        sigma_m=0.0005,
        sigma_rad=0.001,
    )


def seen(*candidates: Candidate, lone: tuple[Floats, ...] = ()) -> Scene:
    """A scene of one kind: its candidates, each a segment, and unexplained pieces (2, 3) m."""
    nothing = scene_of()
    pieces = [np.stack([c.start, c.end]) for c in candidates] + list(lone)
    ends = np.array(pieces).reshape(-1, 2, 3)
    segments = replace(
        nothing.segments,
        start=ends[:, 0],
        end=ends[:, 1],
        edge=np.full(len(ends), -1, np.int64),
        residual_px=np.array([0.1] * len(candidates) + [np.nan] * len(lone)),
    )
    return replace(nothing, candidates=candidates, segments=segments)


def reasons(candidate: Candidate) -> list[Refusal]:
    return [why.reason for why in candidate.refusals]


def test_parts_in_different_places_stay_as_they_are() -> None:
    rod, thick = at(-0.03, 0.0, 20), at(0.03, 0.0, 70, code=8)

    whole = joined([seen(rod), seen(thick)], PARTS)

    assert whole.candidates == (rod, thick)
    assert whole.crossings == ()
    assert len(whole.segments.start) == 2


def test_what_is_offered_comes_before_what_is_refused_of_any_kind() -> None:
    short, thick = at(-0.03, 0.0, 20, refusals=(TOO_SHORT,)), at(0.03, 0.0, 70, code=8)

    assert joined([seen(short), seen(thick)], PARTS).candidates == (thick, short)


def test_a_refused_candidate_where_another_product_lies_is_gone() -> None:
    refused = at(0.0, 0.0, 20, length_m=0.08, refusals=(TOO_SHORT,))
    thick = at(0.001, 0.0, 20, code=8)

    assert joined([seen(refused), seen(thick)], PARTS).candidates == (thick,)


@pytest.mark.parametrize(
    ("thick_score", "believed"), [(0.9, 8), (THICK_SHARE * 0.9 + 0.01, 8), (THICK_SHARE * 0.9 - 0.01, 7)]
)
def test_of_a_thin_and_a_thick_one_in_one_place_one_is_refused(thick_score: float, believed: int) -> None:
    rod, thick = at(0.0, 0.0, 20), at(0.001, 0.0005, 21, code=8, score=thick_score)

    whole = joined([seen(rod), seen(thick)], PARTS)

    offered, refused = whole.candidates
    assert (offered.part_code, reasons(offered)) == (believed, [])
    assert reasons(refused) == [Refusal.DUPLICATE]


def test_two_thin_ones_side_by_side_are_no_thick_one() -> None:
    beside = np.array([-np.sin(np.radians(20)), np.cos(np.radians(20))]) * 0.002
    rods = [at(float(s * beside[0]), float(s * beside[1]), 20, score=0.7) for s in (-1.0, 1.0)]
    thick = at(0.0, 0.0, 20, code=8, score=1.0)

    whole = joined([seen(*rods), seen(thick)], PARTS)

    assert whole.offered == tuple(rods)
    assert reasons(whole.candidates[2]) == [Refusal.DUPLICATE]


def test_a_part_under_one_of_another_kind_is_covered() -> None:
    rod = at(0.0, 0.0, 20)
    thick = at(0.0, 0.0, 100, code=8, height_m=0.0075)

    whole = joined([seen(rod), seen(thick)], PARTS)

    assert whole.candidates[0] is thick
    (why,) = whole.candidates[1].refusals
    assert (why.reason, why.value, why.limit) == (Refusal.CROSSED, 1.0, 0.0)
    (crossing,) = whole.crossings
    assert (crossing.above, crossing.below) == (0, 1)
    assert crossing.point == pytest.approx([0.0, 0.0, DEPTH_M - 0.0075], abs=1e-6)
    # from axis to axis 5.5 mm, less both radii
    assert crossing.gap_m == pytest.approx(0.0055 - 0.0052, abs=1e-5)


def test_covers_of_the_own_kind_and_of_another_add_up() -> None:
    once = Refused(reason=Refusal.CROSSED, value=1.0, limit=0.0, unit="1")
    rod, over = at(0.0, 0.0, 20, refusals=(once,)), at(-0.01, 0.0, 80, height_m=0.006)
    crossing = Crossing(above=0, below=1, point=np.zeros(3), gap_m=0.0, sure=3.0)
    thick = at(0.01, 0.0, 100, code=8, height_m=0.0075)

    whole = joined([replace(seen(over, rod), crossings=(crossing,)), seen(thick)], PARTS)

    lower = whole.candidates[-1]
    assert [(why.reason, why.value) for why in lower.refusals] == [(Refusal.CROSSED, 2.0)]
    pairs = {(whole.candidates[c.above], whole.candidates[c.below]) for c in whole.crossings}
    assert pairs == {(over, lower), (thick, lower)}


def test_what_crosses_near_an_end_is_told_but_covers_nothing() -> None:
    rod = at(0.0, 0.0, 0)
    thick = at(0.04, 0.0, 90, code=8, height_m=0.0075)

    whole = joined([seen(rod), seen(thick)], PARTS)

    assert len(whole.offered) == 2
    assert len(whole.crossings) == 1


def test_a_piece_that_another_kind_explains_is_in_nobodys_way() -> None:
    thick = at(0.03, 0.0, 70, code=8)
    its = np.stack([thick.start, thick.end]) * 1.002
    own = np.array([[-0.05, 0.05, 0.4], [-0.02, 0.05, 0.4]])

    whole = joined([seen(lone=(its, own)), seen(thick)], PARTS)

    lone = np.isnan(whole.segments.residual_px)
    assert np.allclose(whole.segments.start[lone], own[:1])


@pytest.mark.parametrize("turn_deg", [15, 60, 105, 150])
def test_in_pictures_of_two_widths_each_is_what_it_is(turn_deg: int) -> None:
    rod, far = lying(-0.05, 0.0, turn_deg), lying(0.05, 0.045, turn_deg + 40)
    flat = lying(0.04, -0.02, turn_deg + 80, length_m=0.09, height_m=0.0032)
    thick = Stick(start=flat.start, end=flat.end, radius_m=0.0032)
    left, right = pair([rod, far, thick])

    scene = locate(left, right, rig(), ROD, Tuning(), TABLE, among=(THICK,))

    assert sorted(c.part_code for c in scene.offered) == [7, 7, 8]
    for code, stick in ((7, rod), (7, far), (8, thick)):
        middle = 0.5 * (stick.start + stick.end)
        (found,) = (c for c in scene.offered if np.linalg.norm(c.centre - middle) < 0.003)
        assert found.part_code == code


def test_with_several_widths_there_is_no_first_answer() -> None:
    left, right = pair([lying(0.0, 0.0, 60)])
    told: list[str] = []

    def tell(stage: str, product: object) -> None:
        assert product is not None
        told.append(stage)

    locate(left, right, rig(), ROD, Tuning(), TABLE, tell)
    assert "first" in told
    told.clear()
    locate(left, right, rig(), ROD, Tuning(), TABLE, tell, among=(THICK,))
    assert "first" not in told
    assert "retrieve" in told
