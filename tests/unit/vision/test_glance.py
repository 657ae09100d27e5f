"""What is certain before anything is explained: whole parts, no doubtful pairs, nothing crossing above."""

from __future__ import annotations

import numpy as np
import pytest

from bench import own, piles, rigs
from bench.looks import see
from bench.rigs import RIGS
from bench.scoring import answer_of, score
from tests.reference.looks import frame, pool_of, seen, worst_end_m
from tests.reference.sticks import Stick, lying, pair
from vision.glance import at_first_sight
from vision.refine import COLUMNS, DA, DB, KIND
from vision.types import Floats

FRAME = frame()


def told(sticks: list[Stick]) -> Floats:
    """Hypotheses (C, `COLUMNS`) that are certain."""
    pictures = seen(pair(sticks), FRAME)
    found = at_first_sight(pool_of(pictures, FRAME), pictures.left, pictures.right, FRAME)
    if found is None:
        return np.zeros((0, COLUMNS))
    return found.hypotheses[found.chosen]


@pytest.mark.parametrize("angle_deg", [20, 50, 90, 135])
def test_a_stick_that_lies_alone_is_certain(angle_deg: int) -> None:
    stick = lying(0.01, -0.02, angle_deg)

    (row,) = told([stick])

    assert worst_end_m(row, stick, FRAME) < 0.002


def test_nothing_is_certain_on_an_empty_table() -> None:
    assert len(told([])) == 0


@pytest.mark.parametrize("angle_deg", [40, 90, 120])
def test_of_two_that_cross_the_lower_is_not_certain(angle_deg: int) -> None:
    below = lying(0.0, 0.0, angle_deg)
    above = lying(0.0, 0.0, angle_deg + 65, height_m=0.006)

    for row in told([below, above]):
        assert worst_end_m(row, above, FRAME) < 0.003


@pytest.mark.parametrize("angle_deg", [40, 90, 120])
def test_one_that_only_seems_to_lie_below_is_laid_on_its_edges_before_it_is_believed(angle_deg: int) -> None:
    """Two lines tell a disparity to a few px only. Here they make the upper one the lower."""
    below = lying(0.0, 0.0, angle_deg)
    above = lying(0.0, 0.0, angle_deg + 65, height_m=0.006)
    pictures = seen(pair([below, above]), FRAME)
    pool = pool_of(pictures, FRAME).copy()
    upper = [n for n, row in enumerate(pool) if worst_end_m(row, above, FRAME) < 0.015]
    assert upper
    pool[np.ix_(upper, [DA, DB])] -= 1.5 * FRAME.diameter_d

    found = at_first_sight(pool, pictures.left, pictures.right, FRAME)

    rows = np.zeros((0, COLUMNS)) if found is None else found.hypotheses[found.chosen]
    assert all(worst_end_m(row, below, FRAME) > 0.01 for row in rows)


@pytest.mark.parametrize("angle_deg", [60, 90, 110])
def test_the_left_of_one_and_the_right_of_its_neighbour_are_never_a_part(angle_deg: int) -> None:
    first = lying(0.0, 0.0, angle_deg)
    along = (first.end - first.start) / 0.1
    step = 0.006 * np.array([-along[1], along[0], 0.0])
    second = Stick(start=first.start + step, end=first.end + step)

    for row in told([first, second]):
        assert min(worst_end_m(row, first, FRAME), worst_end_m(row, second, FRAME)) < 0.003


def test_what_is_no_product_is_not_told() -> None:
    pictures = seen(pair([lying(0.0, 0.0, 60)]), FRAME)
    pool = pool_of(pictures, FRAME).copy()
    pool[:, KIND] = -1.0

    assert pool.shape[1] == COLUMNS
    assert at_first_sight(pool, pictures.left, pictures.right, FRAME) is None


def test_along_the_baseline_nothing_is_certain_that_does_not_show_all_its_ends() -> None:
    """A heap in which such a stick was told at first sight, six degrees wrong."""
    webcam = RIGS["webcam"]
    shot = piles.draw("H10", webcam, 20261209, 641)
    case = own.case_of(shot, rigs.known(webcam), "H10", "H10-642", 20261209)

    seen = see(case, "default")

    assert seen.told is None
    assert score(answer_of(seen.scene), case.truth).free
