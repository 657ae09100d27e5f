"""A small pile explained: every part once, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from tests.reference.looks import drawn, explained, frame, worst_end_m
from tests.reference.sticks import Stick, lying
from vision.refine import KIND

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
