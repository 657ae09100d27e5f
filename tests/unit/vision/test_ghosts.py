"""What is not chosen but still explains something weighs on what lies below it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.reference.looks import drawn, explained, frame, worst_end_m
from tests.reference.sticks import Stick, lying
from vision import claims
from vision.crossings import crossed
from vision.explain import Explanation
from vision.ghosts import below_ghosts
from vision.offer import candidates
from vision.polish import polish
from vision.types import Tuning

FRAME = frame()
UPPER = lying(0.0, 0.0, 20, height_m=0.006)
LOWER = lying(0.0, 0.0, 100, height_m=0.002)
ASIDE = lying(-0.06, 0.05, 60)


def without(found: Explanation, stick: Stick) -> Explanation:
    """The same explanation with one stick given back."""
    (k,) = (row for row in found.chosen if worst_end_m(found.hypotheses[row], stick, FRAME) < 0.003)
    claims.give_back(found.state, k)
    place = found.chosen.index(k)
    return replace(
        found, chosen=[row for row in found.chosen if row != k], margin=np.delete(found.margin, place)
    )


def row_of(found: Explanation, stick: Stick) -> int:
    return int(np.argmin([worst_end_m(found.hypotheses[row], stick, FRAME) for row in found.chosen]))


def test_where_everything_is_explained_there_is_no_ghost() -> None:
    pictures = drawn([LOWER, UPPER, ASIDE], FRAME)
    found = explained(pictures, FRAME)

    assert len(found.chosen) == 3
    assert not below_ghosts(found, found.hypotheses[found.chosen], FRAME).any()


def test_what_is_left_out_haunts_what_lies_below_it_and_nothing_else() -> None:
    pictures = drawn([LOWER, UPPER, ASIDE], FRAME)
    found = without(explained(pictures, FRAME), UPPER)

    haunted = below_ghosts(found, found.hypotheses[found.chosen], FRAME)

    assert haunted[row_of(found, LOWER)]
    assert not haunted[row_of(found, ASIDE)]


def test_what_is_left_out_below_haunts_nothing() -> None:
    pictures = drawn([LOWER, UPPER, ASIDE], FRAME)
    found = without(explained(pictures, FRAME), LOWER)

    assert not below_ghosts(found, found.hypotheses[found.chosen], FRAME).any()


def test_one_for_which_there_is_no_room_is_a_ghost_too() -> None:
    pictures = drawn([LOWER, UPPER, ASIDE], FRAME)
    found = without(explained(pictures, FRAME), UPPER)
    # as a neighbour read too high would have it
    found.state.hard[:] += 1
    blocked = found.state.hard.copy()

    assert below_ghosts(found, found.hypotheses[found.chosen], FRAME)[row_of(found, LOWER)]
    assert np.array_equal(found.state.hard, blocked)


def test_a_haunted_part_is_offered_after_one_that_is_not() -> None:
    pictures = drawn([LOWER, ASIDE], FRAME)
    found = explained(pictures, FRAME)
    measured = polish(found, pictures.left, pictures.right, pictures.greys, 0.0, FRAME)
    over = crossed(measured.parts, measured.covariance, found.chosen, found.state, FRAME)

    for stick, other in ((LOWER, ASIDE), (ASIDE, LOWER)):
        haunted = np.zeros(len(found.chosen), np.bool_)
        haunted[row_of(found, stick)] = True
        offered = candidates(measured, found, over, FRAME, Tuning(), None, None, 0.0, haunted=haunted)
        middle = 0.5 * (other.start + other.end)
        assert np.linalg.norm(offered.candidates[0].centre - middle) < 0.002
        assert all(candidate.offered for candidate in offered.candidates)
