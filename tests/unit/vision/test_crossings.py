"""Which part lies on which: by depth, by whose flanks go on, and in which order they can be taken."""

from __future__ import annotations

import numpy as np
import pytest

from tests.reference.looks import Floats, drawn, frame, hypotheses, state_of
from tests.reference.sticks import Stick, lying
from vision.crossings import Crossed, crossed, ranked

FRAME = frame()


def relation(sticks: list[Stick], sigma_px: float, through: int | None = None) -> Crossed:
    """Of drawn sticks; with ``through`` depth says nothing, but the flanks of that one go on everywhere and
    those of others nowhere."""
    rows = hypotheses(sticks, FRAME)
    now = state_of(rows, drawn(sticks, FRAME), FRAME)
    parts = rows.copy()
    if through is not None:
        parts[:, [3, 6]] = 100.0
        now.value[:] = 0.0
        now.value[through] = 1.0
    covariance = np.tile(sigma_px**2 * np.eye(6), (len(sticks), 1, 1))
    return crossed(parts, covariance, list(range(len(sticks))), now, FRAME)


UPPER = lying(0.0, 0.0, 20, height_m=0.006)
LOWER = lying(0.0, 0.01, 80, height_m=0.002)


def test_the_nearer_one_is_above_and_its_gap_is_a_diameter() -> None:
    found = relation([LOWER, UPPER], 0.1)

    assert found.above[1, 0] == pytest.approx(1.0, abs=0.05)
    assert found.above[0, 1] == 0.0
    assert found.sure[1, 0] > 3.0
    assert found.gap[1, 0] == pytest.approx(FRAME.diameter_d, rel=0.05)
    assert found.gap[0, 1] == -found.gap[1, 0]


def test_where_they_cross_is_told_on_both() -> None:
    found = relation([LOWER, UPPER], 0.1)

    for own, other, place in ((LOWER, UPPER, found.place[0, 1]), (UPPER, LOWER, found.place[1, 0])):
        point = own.start + place * (own.end - own.start)
        way = (other.end - other.start) / 0.1
        ray = point / np.linalg.norm(point)
        apart = other.start - point
        normal = np.cross(ray, way)
        assert abs(apart @ normal) / np.linalg.norm(normal) < 0.0003


@pytest.mark.parametrize("order", [0, 1])
def test_when_depth_does_not_tell_the_flanks_that_go_on_do(order: int) -> None:
    sticks = [LOWER, UPPER] if order == 0 else [UPPER, LOWER]
    upper = 1 - order

    found = relation(sticks, 1.0, through=upper)

    assert found.above[upper, 1 - upper] > 0
    assert found.above[1 - upper, upper] == 0
    assert found.sure[upper, 1 - upper] > 1.0


def test_a_vague_depth_is_less_sure() -> None:
    assert relation([LOWER, UPPER], 1.0).sure[1, 0] < relation([LOWER, UPPER], 0.1).sure[1, 0]


def test_parts_that_do_not_meet_have_no_crossing() -> None:
    found = relation([lying(-0.05, 0.0, 80), lying(0.05, 0.0, 85)], 0.1)

    assert not found.above.any()
    assert np.isnan(found.place).all()


def weighing(above: Floats) -> Crossed:
    return Crossed(above=above, sure=np.full(above.shape, 3.0), place=above, gap=above)


def test_first_comes_what_nothing_lies_on_then_what_it_lay_on() -> None:
    # 2 on 1 on 0; 3 alone and worth little
    above = np.zeros((4, 4))
    above[2, 1] = above[1, 0] = 1.0

    assert ranked(weighing(above), np.array([9.0, 9.0, 9.0, 1.0]), [True] * 4) == [2, 1, 0, 3]


def test_what_is_not_to_be_taken_stays_and_weighs() -> None:
    above = np.zeros((3, 3))
    above[0, 1] = 1.0

    assert ranked(weighing(above), np.array([1.0, 9.0, 2.0]), [False, True, True]) == [2, 1]


def test_an_unsure_order_weighs_less_than_a_sure_one() -> None:
    above = np.zeros((4, 4))
    above[0, 1] = above[0, 2] = 1.0
    sure = np.full((4, 4), 3.0)
    sure[0, 1] = 0.4

    order = ranked(
        Crossed(above=above, sure=sure, place=above, gap=above), np.ones(4), [False, True, True, True]
    )

    assert order == [3, 1, 2]


def test_of_a_ring_one_is_first() -> None:
    above = np.zeros((3, 3))
    above[0, 1] = above[1, 2] = 1.0
    above[2, 0] = 0.4

    assert ranked(weighing(above), np.ones(3), [True] * 3) == [0, 1, 2]


def test_who_hardly_seems_to_lie_above_waits_for_who_crosses_nothing() -> None:
    above = np.zeros((3, 3))
    above[0, 1] = 1.0
    sure = np.zeros((3, 3))

    def order(known: float) -> list[int]:
        sure[0, 1] = known
        found = Crossed(above=above, sure=sure, place=np.full((3, 3), np.nan), gap=np.zeros((3, 3)))
        return ranked(found, np.array([9.0, 1.0, 5.0]), [True] * 3)

    assert order(4.0) == [0, 2, 1]
    assert order(0.5)[0] == 2
