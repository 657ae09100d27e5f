"""A small pile explained: every part once, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from tests.reference.looks import drawn, explained, frame, hypotheses, worst_end_m
from tests.reference.sticks import Stick, lying
from vision.explain import explain
from vision.refine import DA, KIND, XA, XB

FRAME = frame()
RANDOM = np.random.default_rng(5)
PILE = [
    lying(RANDOM.uniform(-0.05, 0.05), RANDOM.uniform(-0.04, 0.04), 17 + 29 * k, height_m=0.002 + 0.004 * k)
    for k in range(6)
]
PICTURES = drawn(PILE, FRAME)
FOUND = explained(PICTURES, FRAME)


def test_every_stick_of_the_pile_is_explained_once_and_nothing_else_is() -> None:
    rows = FOUND.hypotheses[FOUND.chosen]
    nearest = [int(np.argmin([worst_end_m(row, stick, FRAME) for stick in PILE])) for row in rows]

    assert sorted(nearest) == list(range(6))
    assert max(worst_end_m(row, PILE[n], FRAME) for row, n in zip(rows, nearest, strict=True)) < 0.003
    assert (rows[:, KIND] >= 0).all()


def test_margins_are_what_each_part_adds_and_more_for_those_on_top() -> None:
    rows = FOUND.hypotheses[FOUND.chosen]
    top = int(np.argmin([worst_end_m(row, PILE[-1], FRAME) for row in rows]))

    assert FOUND.margin.shape == (6,)
    assert (FOUND.margin > 2 * 0.15 * FRAME.length_px).all()
    assert FOUND.margin[top] > np.median(FOUND.margin)


def test_nearly_all_edges_have_an_owner_and_few_have_two() -> None:
    for table, taken in (
        (PICTURES.left.table, FOUND.state.taken_l),
        (PICTURES.right.table, FOUND.state.taken_r),
    ):
        clear = table[:, 4] > 0.5
        assert (taken[:-1][clear] > 0).mean() > 0.7
        assert (taken[:-1][clear] > 1).mean() < 0.1


def test_a_long_stick_is_not_explained_as_a_short_one() -> None:
    long = lying(0.0, 0.0, 40, length_m=0.14)

    found = explained(drawn([long], FRAME), FRAME)

    rows = found.hypotheses[found.chosen]
    assert len(rows) == 1
    assert rows[0, KIND] < 0
    assert worst_end_m(rows[0], long, FRAME) < 0.002


def test_nothing_explains_nothing() -> None:
    found = explained(drawn([], FRAME), FRAME)

    assert found.chosen == []
    assert found.margin.shape == (0,)


@pytest.mark.parametrize("gap_m", [0.005, 0.006])
def test_parallel_sticks_are_not_crossed_over(gap_m: float) -> None:
    first = lying(-0.01, 0.0, 75)
    along = (first.end - first.start) / 0.1
    step = gap_m * np.array([-along[1], along[0], 0.0])
    sticks = [Stick(start=first.start + k * step, end=first.end + k * step) for k in range(4)]

    found = explained(drawn(sticks, FRAME), FRAME)

    rows = found.hypotheses[found.chosen]
    assert len(rows) == 4
    for stick in sticks:
        assert min(worst_end_m(row, stick, FRAME) for row in rows) < 0.002


ALONG = [lying(0.01, 0.0, 3.0, height_m=0.004)]
ALONG_PICTURES = drawn(ALONG, FRAME)


@pytest.mark.parametrize("end", [0, 1])
@pytest.mark.parametrize("left_px", [0.0, 6.0])
def test_along_the_baseline_an_end_taken_from_elsewhere_is_set_right(end: int, left_px: float) -> None:
    """An end six pixels off in one picture is 20 mm of height, and out of reach of the edge that is there."""
    rows = hypotheses(ALONG, FRAME)
    rows[0, XA + 3 * end] += left_px
    rows[0, DA + 3 * end] += 6.0
    assert worst_end_m(rows[0], ALONG[0], FRAME) > 0.01

    found = explain(rows, ALONG_PICTURES.left, ALONG_PICTURES.right, FRAME)

    assert len(found.chosen) == 1
    assert worst_end_m(found.hypotheses[found.chosen[0]], ALONG[0], FRAME) < 0.003


@pytest.mark.parametrize("slid_px", [-11.0, 8.0])
def test_a_part_that_was_slid_along_itself_is_set_right(slid_px: float) -> None:
    stick = lying(0.0, 0.0, 60)
    pictures = drawn([stick], FRAME)
    rows = hypotheses([stick], FRAME)
    way = rows[0, XB : XB + 3] - rows[0, XA : XA + 3]
    for end in range(2):
        rows[0, XA + 3 * end : XA + 3 * end + 3] += slid_px * way / float(np.hypot(way[0], way[1]))

    found = explain(rows, pictures.left, pictures.right, FRAME)

    assert len(found.chosen) == 1
    assert worst_end_m(found.hypotheses[found.chosen[0]], stick, FRAME) < 0.002
