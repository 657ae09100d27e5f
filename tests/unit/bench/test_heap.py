"""Dense heaps: as many crossings as physical ones, nothing inside anything, everything held up."""

from __future__ import annotations

import numpy as np
import pytest

from bench.families import heap, scenery
from bench.heap import Block, Rod, settle
from bench.rigs import MIDDLE_M, RIGS, TABLE_Z_M, WEBCAM
from drivers.sim.geometry import segment_distance
from drivers.sim.layout import TrayLayout
from drivers.sim.piles import Stick
from drivers.sim.piles import settle as settle_in_tray
from vision.types import Floats


def rods_of(sticks: int, seed: int) -> tuple[Rod, ...]:
    return heap(sticks, WEBCAM, np.random.default_rng(seed)).rods


def gap_m(a: Rod, b: Rod) -> float:
    return segment_distance(*a.ends, *b.ends) - a.radius_m - b.radius_m


def smallest_gap_m(rods: tuple[Rod, ...]) -> float:
    return min(gap_m(a, b) for i, a in enumerate(rods) for b in rods[:i])


def in_plan(rods: tuple[Rod, ...]) -> float:
    """How many others a rod's axis crosses in plan, on average."""
    count = 0
    for i, a in enumerate(rods):
        for b in rods[:i]:
            (p, q), (r, s) = a.ends[:, :2], b.ends[:, :2]
            sides = [np.cross([*(q - p), 0.0], [*(x - p), 0.0])[2] for x in (r, s)]
            others = [np.cross([*(s - r), 0.0], [*(x - r), 0.0])[2] for x in (p, q)]
            count += int(sides[0] * sides[1] < 0.0 and others[0] * others[1] < 0.0)
    return 2.0 * count / len(rods)


@pytest.mark.parametrize(
    ("sticks", "low", "high", "steepest_deg"),
    [(5, 1.9, 3.2, 15), (10, 2.7, 4.2, 16), (20, 4.9, 7.0, 20), (40, 11.0, 14.5, 27)],
)
def test_heaps_are_as_dense_and_as_flat_as_physical_ones(
    sticks: int, low: float, high: float, steepest_deg: float
) -> None:
    heaps = [rods_of(sticks, seed) for seed in range(6)]
    assert low < np.mean([in_plan(rods) for rods in heaps]) < high
    assert max(np.degrees(np.arcsin(abs(rod.axis[2]))) for rods in heaps for rod in rods) < steepest_deg


@pytest.mark.parametrize(
    ("family", "seed"), [("H10", 1), ("H40", 2), ("H40", 3), ("F", 4), ("F", 5), ("N", 2)]
)
@pytest.mark.parametrize("rig", sorted(RIGS))
def test_nothing_passes_through_anything_or_the_table(family: str, seed: int, rig: str) -> None:
    rods = scenery(family, RIGS[rig], np.random.default_rng(seed), seed).rods
    assert smallest_gap_m(rods) > -2e-5
    assert all(end[2] - TABLE_Z_M - rod.radius_m > -1e-6 for rod in rods for end in rod.ends)


def supports(rod: Rod, others: tuple[Rod, ...]) -> Floats:
    """Places along a rod (-1..1) where it touches the table or another rod."""
    places = []
    for end, place in zip(rod.ends, (-1.0, 1.0), strict=True):
        if end[2] - TABLE_Z_M - rod.radius_m < 2e-5:
            places.append(place)
    for other in others:
        at = np.linspace(-1.0, 1.0, 2001)
        points = rod.centre + 0.5 * rod.length_m * at[:, None] * rod.axis
        along = np.clip((points - other.centre) @ other.axis, -0.5 * other.length_m, 0.5 * other.length_m)
        away = np.linalg.norm(points - other.centre - along[:, None] * other.axis, axis=1)
        if away.min() - rod.radius_m - other.radius_m < 2e-5:
            places.append(float(at[int(np.argmin(away))]))
    return np.array(places)


def test_every_rod_is_held_on_both_sides_of_its_middle_by_those_before_it() -> None:
    rods = rods_of(20, 8)
    for n, rod in enumerate(rods):
        held = supports(rod, rods[:n])
        assert held.min() < 0.0 < held.max()


def test_the_same_seed_gives_the_same_heap() -> None:
    for a, b in zip(rods_of(20, 5), rods_of(20, 5), strict=True):
        assert np.array_equal(a.ends, b.ends)
    assert not np.array_equal(rods_of(20, 5)[0].ends, rods_of(20, 6)[0].ends)


def test_a_rod_that_does_not_move_rests_as_in_the_simulated_cell() -> None:
    poses = np.array([[-0.03, 0.0, 1.4], [0.032, 0.005, 1.8], [0.002, 0.001, 0.1]])
    centres, axes = settle(poses[:, None], np.full(3, 0.1), np.full(3, 0.0019), 0.0, moves=0)
    # far walls; the third lies level enough not to move in the cell either
    tray = TrayLayout(centre_m=(0.0, 0.0, 0.0), inner_m=(1.0, 1.0), wall_height_m=0.02, wall_thickness_m=0.01)
    below: tuple[Stick, ...] = ()
    for n, (x, y, heading) in enumerate(poses):
        stick = Stick(
            number=n,
            length_m=0.1,
            diameter_m=0.0038,
            shade=1.0,
            centre=np.array([x, y, 0.0]),
            axis=np.array([np.cos(heading), np.sin(heading), 0.0]),
        )
        below = (*below, settle_in_tray(stick, below, tray, 0.0))
    assert np.abs(centres[2] - below[2].centre).max() < 1e-5
    assert np.abs(axes[2] - below[2].axis).max() < 2e-4


def test_a_rod_on_a_block_leans_from_its_edge_to_the_table() -> None:
    block = Block(
        middle=np.array([0.0, 0.0]),
        half_m=np.array([0.03, 0.03]),
        turn_rad=0.0,
        height_m=0.03,
        colour=np.ones(3),
    )
    pose = np.array([[[0.03 + 0.03, 0.0, 0.0]]])
    centres, axes = settle(pose, np.array([0.1]), np.array([0.002]), 0.0, blocks=(block,), moves=0)
    ends = centres[0] + 0.05 * np.array([[-1.0], [1.0]]) * axes[0]
    low, high = sorted(ends, key=lambda end: float(end[2]))
    assert low[2] == pytest.approx(0.002, abs=1e-5)
    assert high[0] < 0.03
    # it touches the edge (0.03, 0, 0.03): the axis passes it at one radius
    to_edge = np.array([0.03, 0.0, 0.03]) - centres[0]
    assert np.linalg.norm(np.cross(to_edge, axes[0])) == pytest.approx(0.002, abs=5e-5)


def test_tilted_rods_are_as_steep_as_the_family_says_and_stay_in_place() -> None:
    tilts = []
    for seed in range(8):
        rods = scenery("T", WEBCAM, np.random.default_rng(seed), 0).rods
        tilts += [float(np.degrees(np.arcsin(abs(rod.axis[2])))) for rod in rods]
        assert all(np.linalg.norm(rod.centre[:2] - MIDDLE_M) < 0.11 for rod in rods)
    assert min(tilts) > 5.0
    assert 25.0 < max(tilts) < 45.0
