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
    assert found.gap[1, 0] == pytest.approx(0.004, rel=0.05)
    assert found.gap[0, 1] == -found.gap[1, 0]


def test_where_they_cross_on_the_table_is_told_on_both() -> None:
    found = relation([LOWER, UPPER], 0.1)

    # seen straight down, not from the camera: both are that place's distance from the middle of the picture
    here, there = (
        stick.start + place * (stick.end - stick.start)
        for stick, place in ((LOWER, found.place[0, 1]), (UPPER, found.place[1, 0]))
    )
    assert np.linalg.norm(here[:2] - there[:2]) < 0.0003


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


@pytest.mark.parametrize(("off_m", "higher_m"), [(0.0, 0.004), (0.002, 0.0035), (0.0035, 0.002)])
def test_a_part_that_brushes_another_with_its_end_lies_on_it(off_m: float, higher_m: float) -> None:
    # across the end of the lower one, its axis ends before or beside that of the lower one
    low = lying(0.0, 0.0, 0, height_m=0.002)
    high = lying(0.03, 0.05 + off_m, 90, height_m=0.002 + higher_m)

    found = relation([low, high], 0.1)

    assert found.above[1, 0] > 0
    assert found.place[0, 1] == pytest.approx(0.8, abs=0.02)
    assert not found.middle[0, 1]
    assert not found.beside.any()


def test_a_part_that_reaches_over_the_middle_third_beside_its_axis_lies_over_it() -> None:
    low = lying(0.0, 0.0, 0, height_m=0.002)
    steep = lying(0.018, 0.0, 80, height_m=0.006)  # its axis crosses just outside, its flank inside

    found = relation([low, steep], 0.1)

    assert found.place[0, 1] > 2 / 3
    assert found.middle[0, 1]


@pytest.mark.parametrize("apart_m", [0.0038, 0.0042, 0.0048])
def test_two_that_lie_side_by_side_do_not_lie_on_each_other(apart_m: float) -> None:
    found = relation([lying(0.0, 0.0, 0), lying(0.01, apart_m, 0)], 0.1)

    assert not found.above.any()
    assert np.isnan(found.place).all()
    assert found.beside[0, 1]
    assert found.beside[1, 0]


@pytest.mark.parametrize(("higher_m", "may_lie_on"), [(-0.001, False), (0.001, True), (0.003, False)])
def test_of_two_side_by_side_only_one_a_little_higher_may_lie_on_the_other(
    higher_m: float, may_lie_on: bool
) -> None:
    low = lying(0.0, 0.0, 0, height_m=0.004)

    found = relation([low, lying(0.01, 0.0048, 0, height_m=0.004 + higher_m)], 0.1)

    assert not found.above.any()
    assert found.beside[1, 0] == may_lie_on
    assert found.beside[0, 1] == (higher_m == -0.001)


def test_where_an_end_lies_on_a_part_flanks_that_go_on_tell_nothing() -> None:
    """Depth says little, and the lower part's flanks go on beside the end that lies on it."""
    low = lying(0.0, 0.0, 0, height_m=0.002)
    high = lying(0.0, 0.048, 90, height_m=0.006)
    rows = hypotheses([low, high], FRAME)
    now = state_of(rows, drawn([low, high], FRAME), FRAME)
    now.value[0], now.value[1] = 1.0, 0.0
    covariance = np.tile(np.eye(6), (2, 1, 1))

    found = crossed(rows, covariance, [0, 1], now, FRAME)

    assert found.above[1, 0] > 0
    assert found.above[0, 1] == 0


def weighing(above: Floats, sure: Floats | float = 3.0) -> Crossed:
    none = np.zeros(above.shape, np.bool_)
    sure = np.broadcast_to(sure, above.shape)
    return Crossed(above=above, sure=sure, place=above, gap=above, middle=none, beside=none)


def order_of(found: Crossed, worth: list[float], offered: list[bool] | None = None) -> list[int]:
    return ranked(found, np.array(worth), offered or [True] * len(worth), np.zeros(len(worth)))


def test_first_comes_what_nothing_lies_on_then_what_it_lay_on() -> None:
    # 2 on 1 on 0; 3 alone and worth little
    above = np.zeros((4, 4))
    above[2, 1] = above[1, 0] = 1.0

    assert order_of(weighing(above), [9.0, 9.0, 9.0, 1.0]) == [2, 1, 0, 3]


def test_what_is_not_to_be_taken_stays_and_weighs() -> None:
    above = np.zeros((3, 3))
    above[0, 1] = 1.0

    assert order_of(weighing(above), [1.0, 9.0, 2.0], [False, True, True]) == [2, 1]


def test_an_unsure_order_weighs_less_than_a_sure_one() -> None:
    above = np.zeros((4, 4))
    above[0, 1] = above[0, 2] = 1.0
    sure = np.full((4, 4), 3.0)
    sure[0, 1] = 0.4

    assert order_of(weighing(above, sure), [1.0] * 4, [False, True, True, True]) == [3, 1, 2]


def test_of_a_ring_one_is_first() -> None:
    above = np.zeros((3, 3))
    above[0, 1] = above[1, 2] = 1.0
    above[2, 0] = 1.0
    sure = np.full((3, 3), 3.0)
    sure[2, 0] = 0.4

    assert order_of(weighing(above, sure), [1.0] * 3) == [0, 1, 2]


def test_who_hardly_seems_to_lie_above_waits_for_who_crosses_nothing() -> None:
    above = np.zeros((3, 3))
    above[0, 1] = 1.0
    sure = np.zeros((3, 3))

    def order(known: float) -> list[int]:
        sure[0, 1] = known
        return order_of(weighing(above, sure), [9.0, 1.0, 5.0])

    assert order(4.0) == [0, 2, 1]
    assert order(0.5)[0] == 2


def test_who_may_have_another_on_it_waits_for_who_has_not() -> None:
    found = weighing(np.zeros((3, 3)))
    found.beside[0, 1] = found.beside[1, 0] = True

    assert order_of(found, [9.0, 8.0, 1.0]) == [2, 0, 1]
    found.beside[0, 1] = False
    assert order_of(found, [9.0, 8.0, 1.0]) == [1, 0, 2]


def test_who_is_hardly_known_is_not_the_first() -> None:
    found = weighing(np.zeros((3, 3)))

    assert ranked(found, np.array([9.0, 1.0, 5.0]), [True] * 3, np.array([0.4, 0.0, 0.01])) == [2, 0, 1]
