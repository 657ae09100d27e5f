"""How arms of a crossing are paired."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from vision.tracing_arms import bending
from vision.tracing_crossings import pairing


def ways(arms: list[int]) -> Iterator[list[tuple[int, int]]]:
    """All ways to pair some of the arms."""
    if not arms:
        yield []
        return
    first, *rest = arms
    yield from ways(rest)
    for other in rest:
        for more in ways([arm for arm in rest if arm != other]):
            yield [(first, other), *more]


@pytest.mark.parametrize("arms", [0, 1, 2, 3, 4, 5, 6, 7])
def test_no_way_to_pair_the_arms_is_cheaper(arms: int) -> None:
    random = np.random.default_rng(arms)
    for _ in range(20):
        cost = random.uniform(0, 3, (arms, arms))
        cost += cost.T
        single = float(random.uniform(0, 2))

        partner, total = pairing(cost, single)

        prices = [
            sum(cost[i, j] - 2 * single for i, j in way) + arms * single for way in ways(list(range(arms)))
        ]
        assert total == pytest.approx(min(prices))
        pairs = [(i, int(j)) for i, j in enumerate(partner) if j > i]
        assert sum(cost[i, j] - 2 * single for i, j in pairs) + arms * single == pytest.approx(total)
        assert all(partner[partner[i]] == i for i in range(arms) if partner[i] >= 0)


def test_many_arms_are_paired_best_first() -> None:
    cost = np.full((20, 20), 5.0)
    for k in range(0, 20, 2):
        cost[k, k + 1] = cost[k + 1, k] = 0.01 * k
    cost[18, 19] = cost[19, 18] = 5.0

    partner, total = pairing(cost, 1.0)

    assert partner.tolist() == [*(k ^ 1 for k in range(18)), -1, -1]
    assert total == pytest.approx(sum(0.01 * k for k in range(0, 18, 2)) + 2.0)


def test_an_arc_costs_its_turn_squared_and_an_s_three_times_as_much() -> None:
    turn = 0.4

    def arm(u: float, inwards: float) -> np.ndarray:
        return np.array([u, 0.0, np.cos(inwards), np.sin(inwards)])

    straight = bending(arm(-10, 0.0), arm(10, np.pi))
    arc = bending(arm(-10, turn / 2), arm(10, np.pi - turn / 2))
    ess = bending(arm(-10, turn / 2), arm(10, np.pi + turn / 2))

    assert straight == pytest.approx(0.0)
    assert arc == pytest.approx(turn**2)
    assert ess == pytest.approx(3 * turn**2)
