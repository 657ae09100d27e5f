"""Piles obey gravity and the tray: nothing passes through anything, everything is supported on both sides."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.sim.geometry import segment_distance
from drivers.sim.layout import SticksLayout, TrayLayout
from drivers.sim.piles import Stick, drop_one, drop_pile, fits, lowest_line, resettle, settle, tube_top

TRAY = TrayLayout(
    centre_m=(0.0, -0.45, 0.02), inner_m=(0.26, 0.20), wall_height_m=0.025, wall_thickness_m=0.006
)
RADIUS_M = 0.0019


def kind(count: int, spread: float) -> SticksLayout:
    return SticksLayout(count=count, length_m=0.1, diameter_m=0.0038, spread=spread, wall_margin_m=0.018)


def pile(count: int, spread: float, seed: int) -> tuple[Stick, ...]:
    return drop_pile(kind(count, spread), TRAY, np.random.default_rng(seed))


def laid(x: float, y: float, heading_rad: float, number: int = 0) -> Stick:
    return Stick(
        number=number,
        length_m=0.1,
        diameter_m=0.0038,
        shade=1.0,
        centre=np.array([x, y - 0.45, 0.02]),
        axis=np.array([np.cos(heading_rad), np.sin(heading_rad), 0.0]),
    )


def closest_m(sticks: tuple[Stick, ...]) -> float:
    """Smallest gap between two surfaces, negative when they pass through each other."""
    gaps = [
        segment_distance(*a.ends, *b.ends) - 2.0 * RADIUS_M for i, a in enumerate(sticks) for b in sticks[:i]
    ]
    return min(gaps)


def lowest_m(sticks: tuple[Stick, ...]) -> float:
    """Smallest height of an axis end above where it lies on the floor."""
    return min(float(end[2]) for stick in sticks for end in stick.ends) - 0.02 - RADIUS_M


@pytest.mark.parametrize(("count", "spread"), [(12, 1.0), (12, 0.5), (24, 0.4)])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nothing_passes_through_another_stick_the_floor_or_a_wall(
    count: int, spread: float, seed: int
) -> None:
    sticks = pile(count, spread, seed)
    assert len(sticks) == count
    assert closest_m(sticks) >= -1e-4
    assert lowest_m(sticks) >= -1e-6
    assert all(fits(TRAY, s.centre, s.axis, s.length_m, 0.018 - 1e-9) for s in sticks)


def test_the_same_seed_gives_the_same_pile() -> None:
    for a, b in zip(pile(12, 0.6, 5), pile(12, 0.6, 5), strict=True):
        assert np.array_equal(a.centre, b.centre)
        assert np.array_equal(a.axis, b.axis)
    assert not np.array_equal(pile(12, 0.6, 5)[0].centre, pile(12, 0.6, 6)[0].centre)


def test_a_heap_is_higher_than_a_spread_pile() -> None:
    heights = [
        np.mean([max(float(s.centre[2]) for s in pile(12, spread, seed)) for seed in range(5)])
        for spread in (1.0, 0.1)
    ]
    assert heights[0] < heights[1]


def test_a_single_stick_lies_flat_on_the_floor() -> None:
    stick = settle(laid(0.0, 0.0, 0.3), (), TRAY, 0.0)
    assert stick.centre[2] == pytest.approx(0.02 + RADIUS_M, abs=1e-9)
    assert stick.axis[2] == 0.0


def test_a_stick_across_two_others_lies_level_on_both() -> None:
    below = tuple(settle(laid(x, 0.0, np.pi / 2, n), (), TRAY, 0.0) for n, x in enumerate((-0.03, 0.03)))
    stick = settle(laid(0.0, 0.0, 0.0, 2), below, TRAY, 0.0)
    assert stick.centre[2] == pytest.approx(0.02 + 3.0 * RADIUS_M, abs=2e-5)
    assert abs(float(stick.axis[2])) < 1e-3


def test_a_stick_over_one_other_leans_on_it_with_its_far_end_on_the_floor() -> None:
    below = (settle(laid(0.03, 0.0, np.pi / 2), (), TRAY, 0.0),)
    stick = settle(laid(0.0, 0.0, 0.0, 1), below, TRAY, 0.0)
    far, near = sorted(stick.ends, key=lambda end: float(end[0]))
    assert far[2] == pytest.approx(0.02 + RADIUS_M, abs=2e-5)
    assert near[2] > far[2] + 0.003
    assert np.arcsin(abs(stick.axis[2])) == pytest.approx(np.arctan(2 * RADIUS_M / 0.08), abs=4e-3)


def test_a_stick_dropped_on_the_flank_of_a_parallel_one_rolls_off() -> None:
    below = (settle(laid(0.0, 0.0, 0.0), (), TRAY, 0.0),)
    stick = settle(laid(0.0, 0.0025, 0.0, 1), below, TRAY, 0.0)
    assert stick.centre[1] > -0.45 + 0.0025
    assert stick.centre[2] < 0.02 + 2.2 * RADIUS_M
    assert closest_m((*below, stick)) >= -1e-4


def test_what_lay_on_a_removed_stick_settles_lower_and_the_rest_stays() -> None:
    low = settle(laid(0.03, 0.0, np.pi / 2), (), TRAY, 0.0)
    high = settle(laid(0.0, 0.0, 0.0, 1), (low,), TRAY, 0.0)
    away = settle(laid(0.0, 0.08, 0.0, 2), (low, high), TRAY, 0.0)
    fallen, same = resettle((high, away), low, TRAY, 0.0)
    assert fallen.centre[2] == pytest.approx(0.02 + RADIUS_M, abs=1e-9)
    assert same is away


def test_a_pile_taken_apart_stick_by_stick_never_passes_through_itself() -> None:
    sticks = pile(16, 0.4, 9)
    while len(sticks) > 2:
        k = len(sticks) // 2
        sticks = resettle(sticks[:k] + sticks[k + 1 :], sticks[k], TRAY, 0.018)
        assert closest_m(sticks) >= -1e-4
        assert lowest_m(sticks) >= -1e-6


def test_a_tray_that_is_too_small_is_refused() -> None:
    tray = TRAY.model_copy(update={"inner_m": (0.08, 0.05)})
    with pytest.raises(ValueError, match="finds no place"):
        drop_one(0, kind(1, 1.0), tray, (), np.random.default_rng(1))


def test_the_lowest_line_over_obstacles_touches_one_on_each_side() -> None:
    at = np.array([-2.0, -1.0, 1.0, 2.0])
    height, slope = lowest_line(at, np.array([0.0, 1.0, 0.0, 0.0]))
    assert height == pytest.approx(2.0 / 3.0)
    assert slope == pytest.approx(-1.0 / 3.0)


def test_the_top_of_a_tube_is_a_radius_from_its_axis() -> None:
    start, end = np.array([[0.0, 0.0, 0.01]]), np.array([[0.08, 0.03, 0.03]])
    rng = np.random.default_rng(4)
    points = rng.uniform((-0.003, -0.003), (0.083, 0.033), (500, 2))
    top = tube_top(points, start, end, 0.004)[0]
    met = np.isfinite(top)
    assert 20 < met.sum() < 500
    for point, z in zip(points[met], top[met], strict=True):
        on_top = np.array([point[0], point[1], z])
        assert segment_distance(on_top, on_top + 1e-9, start[0], end[0]) == pytest.approx(0.004, abs=1e-6)
