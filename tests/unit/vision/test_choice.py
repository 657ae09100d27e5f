"""The choice of a set: evidence once, both of two that cross, hidden where something lies over."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.reference.looks import drawn, frame, hypotheses, state_of
from tests.reference.sticks import Stick, lying
from vision.choice import deepen, energy, exchange, greedy
from vision.claims import NEVER, State, gain_of, give_back, take
from vision.types import Bools

FRAME = frame()
UPPER = lying(0.0, 0.0, 20, height_m=0.006)
LOWER = lying(0.0, 0.0, 80, height_m=0.002)
ASIDE = lying(0.06, 0.03, 60)
THREE = [UPPER, LOWER, ASIDE]
PICTURES = drawn(THREE, FRAME)
FULL = 2 * FRAME.length_px


def moved(stick: Stick, along_m: float = 0.0, aside_m: float = 0.0) -> Stick:
    way = (stick.end - stick.start) / np.linalg.norm(stick.end - stick.start)
    by = along_m * way + aside_m * np.array([-way[1], way[0], 0.0])
    return Stick(start=stick.start + by, end=stick.end + by)


def fresh(sticks: list[Stick]) -> tuple[State, Bools]:
    return state_of(hypotheses(sticks, FRAME), PICTURES, FRAME), np.zeros(len(sticks), np.bool_)


def choose(sticks: list[Stick]) -> list[int]:
    now, chosen = fresh(sticks)
    greedy(now, chosen)
    exchange(now, chosen)
    deepen(now, chosen, 0.25 * FULL, 20)
    return [int(k) for k in np.flatnonzero(chosen)]


def test_of_two_that_cross_both_are_chosen() -> None:
    assert choose(THREE) == [0, 1, 2]


def test_a_part_in_the_open_gains_about_one_and_a_half_px_a_px_and_its_ends() -> None:
    now, _ = fresh([ASIDE])

    assert 1.0 < gain_of(0, now) / FULL < 2.0


def test_where_there_is_nothing_a_part_loses_more_than_it_can_gain() -> None:
    now, _ = fresh([lying(-0.06, -0.03, 10)])

    assert gain_of(0, now) < -FULL


def test_one_piece_of_evidence_is_not_used_twice() -> None:
    now, _ = fresh([ASIDE, moved(ASIDE, aside_m=0.0002), moved(ASIDE, along_m=0.03)])
    alone = [gain_of(k, now) for k in range(3)]
    nobody = np.zeros(3, np.bool_)

    take(now, 0, nobody)

    assert alone[1] > 0.8 * FULL
    # the same place in space is not to be had twice, wherever the evidence is
    assert gain_of(1, now) == NEVER
    assert gain_of(2, now) == NEVER
    assert choose([ASIDE, moved(ASIDE, aside_m=0.0002), moved(ASIDE, along_m=0.03)]) == [0]


def test_evidence_that_another_claims_does_not_count_though_both_could_be() -> None:
    higher = Stick(start=ASIDE.start * (1 - 0.03), end=ASIDE.end * (1 - 0.03))
    now, _ = fresh([ASIDE, higher])
    take(now, 0, np.zeros(2, np.bool_))

    # twelve millimetres nearer on the same rays of the left camera: its left flanks are another's
    assert now.hard[1] == 0
    low_l = now.edge[1, 0, : now.samples[1, 0]]
    assert (now.taken_l[low_l[low_l >= 0]] > 0).mean() > 0.9
    assert gain_of(1, now) < 0


def test_where_another_lies_over_it_a_part_loses_next_to_nothing() -> None:
    now, _ = fresh([LOWER, UPPER])
    before = gain_of(0, now)

    take(now, 1, np.zeros(2, np.bool_))

    assert now.covered[0].tolist() == [1, 1]
    assert now.covers[0, 0, 0, 0] == 1
    # the few edges at the crossing are the upper one's now
    assert gain_of(0, now) > before - 0.03 * FULL
    covered = now.covers[0, 0, 0, 2] - now.covers[0, 0, 0, 1]
    assert covered * 1.5 == pytest.approx(FRAME.width_px / np.sin(np.radians(60)), rel=0.7)
    # the upper one is covered by nothing
    assert now.covered[1].tolist() == [0, 0]


def test_a_covered_end_costs_less_than_one_that_ought_to_be_seen() -> None:
    """The lower part is laid too far: one end shows nothing. With something over that end it may be so."""
    too_far = moved(LOWER, along_m=0.012)
    end = too_far.end
    cover = Stick(
        start=end + np.array([-0.05, 0.0, -0.006]), end=end + np.array([0.05, 0.0, -0.006]), radius_m=0.002
    )
    now, _ = fresh([too_far, cover])
    open_end = gain_of(0, now)

    take(now, 1, np.zeros(2, np.bool_))

    assert gain_of(0, now) > open_end + 0.5 * FRAME.width_px


def test_an_exchange_puts_the_better_in_and_the_sum_never_falls() -> None:
    sticks = [moved(ASIDE, along_m=0.02), ASIDE, UPPER, LOWER]
    now, chosen = fresh(sticks)
    chosen[0] = True
    take(now, 0, np.zeros(4, np.bool_))
    before = energy(now, chosen, np.ones_like(chosen))

    assert exchange(now, chosen)

    assert chosen[:2].tolist() == [False, True]
    assert energy(now, chosen, np.ones_like(chosen)) > before


def test_what_is_not_worth_it_is_not_taken_and_does_not_stay() -> None:
    now, chosen = fresh([moved(ASIDE, aside_m=0.0035)])

    greedy(now, chosen)

    assert not chosen[0]
    chosen[0] = True
    take(now, 0, np.zeros(1, np.bool_))
    assert exchange(now, chosen)
    assert not chosen[0]
    assert now.taken_l.sum() == now.taken_r.sum() == 0


MANY = [
    *THREE,
    *(
        moved(s, along_m=a, aside_m=b)
        for s in THREE
        for a, b in ((0.004, 0.0), (-0.01, 0.0005), (0.0, 0.003))
    ),
    lying(0.03, 0.01, 130, height_m=0.004),
    lying(0.031, 0.01, 131, height_m=0.005),
]
BOARD, _ = fresh(MANY)


def board() -> State:
    """A board of its own for each example, with nothing chosen."""
    return BOARD._replace(
        taken_l=BOARD.taken_l.copy(), taken_r=BOARD.taken_r.copy(), soft=BOARD.soft.copy(),
        hard=BOARD.hard.copy(), covers=BOARD.covers.copy(), covered=BOARD.covered.copy(),
        gain=BOARD.gain.copy(),
    )  # fmt: skip


def copied(now: State) -> list[npt.NDArray[Any]]:
    """All that `take` changes, but for the gains and for what it only remembers."""
    used: list[npt.NDArray[Any]] = [
        now.covers[h, view, : now.covered[h, view]].copy() for h in range(len(MANY)) for view in range(2)
    ]
    return [now.taken_l.copy(), now.taken_r.copy(), now.hard.copy(), now.covered.copy(), *used]


@settings(max_examples=60, deadline=None)
@given(
    base=st.lists(st.integers(0, len(MANY) - 1), unique=True, max_size=6),
    more=st.lists(st.integers(0, len(MANY) - 1), unique=True, min_size=1, max_size=6),
    data=st.data(),
)
def test_giving_back_undoes_taking_exactly_whatever_the_order(
    base: list[int], more: list[int], data: st.DataObject
) -> None:
    nobody = np.zeros(len(MANY), np.bool_)
    now = board()
    more = [k for k in more if k not in base]
    for k in base:
        take(now, k, nobody)
    before, soft = copied(now), now.soft.copy()
    gains = [gain_of(h, now) for h in range(len(MANY))]

    for k in more:
        take(now, k, nobody)
    for k in data.draw(st.permutations(more)):
        give_back(now, k)

    assert all(np.array_equal(a, b) for a, b in zip(before, copied(now), strict=True))
    assert pytest.approx(soft, abs=1e-9) == now.soft
    assert [gain_of(h, now) for h in range(len(MANY))] == pytest.approx(gains)
    for k in base:
        give_back(now, k)
    assert now.taken_l.sum() == now.taken_r.sum() == now.hard.sum() == now.covered.sum() == 0


@settings(max_examples=30, deadline=None)
@given(chosen=st.sets(st.integers(0, len(MANY) - 1), max_size=5))
def test_the_sum_of_gains_leaves_the_state_as_it_was(chosen: set[int]) -> None:
    nobody = np.zeros(len(MANY), np.bool_)
    now = board()
    which = np.zeros(len(MANY), np.bool_)
    for k in chosen:
        which[k] = True
        take(now, k, nobody)
    taken = now.taken_l.copy()

    first = energy(now, which, np.ones_like(which))

    assert energy(now, which, np.ones_like(which)) == pytest.approx(first)
    assert np.array_equal(taken, now.taken_l)
