"""The last measurement: doubt in metres against a Monte Carlo, light from one side, bent parts."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tests.reference.looks import ROD, Floats, drawn, explained, frame, hypotheses, seen, worst_end_m
from tests.reference.sticks import Stick, lying, pair
from vision.canvas import in_space
from vision.offer import BOW_WIDTHS
from vision.polish import Measured, polish, sigmas
from vision.types import read_only

FRAME = frame()


def measured(
    sticks: list[Stick], light_from: Floats | None = None, gamma: float = 1.0, seed: int = 0
) -> Measured:
    greys = pair(sticks, light_from=light_from, gamma=gamma, light=180.0, table_grey=25.0, seed=seed)
    pictures = seen(greys, FRAME)
    return polish(explained(pictures, FRAME), pictures.left, pictures.right, greys, 0.0, FRAME)


@pytest.mark.parametrize("angle_deg", [15, 60, 90])
def test_doubt_in_metres_is_the_spread_of_triangulated_draws(angle_deg: int) -> None:
    random = np.random.default_rng(angle_deg)
    row = hypotheses([lying(0.02, 0.03, angle_deg, tilt_deg=8)], FRAME)[0]
    root = random.normal(0, 0.1, (6, 6))
    covariance = root @ root.T
    drawn_px = random.multivariate_normal(row[1:7], covariance, 20000)
    ends = in_space(drawn_px.reshape(-1, 2, 3), FRAME.on)
    centre = ends.mean(axis=1)
    way = ends[:, 1] - ends[:, 0]
    way /= np.linalg.norm(way, axis=1, keepdims=True)

    (sigma_m,), (sigma_rad,) = sigmas(row[None], covariance[None], FRAME)

    assert sigma_m == pytest.approx(np.sqrt(np.linalg.eigvalsh(np.cov(centre.T))[-1]), rel=0.05)
    assert sigma_rad == pytest.approx(np.sqrt(np.linalg.eigvalsh(np.cov(way.T))[-1]), rel=0.05)


SIDEWAYS, BELOW = np.array([0.4, 0.2, -0.87]), np.array([0.1, -0.5, -0.85])
APART = [lying(-0.065 + 0.026 * k, 0.008 * (k % 3 - 1), 50 + 15 * k) for k in range(6)]


@pytest.mark.parametrize("light_from", [SIDEWAYS, BELOW])
def test_light_from_one_side_does_not_move_parts_beyond_their_doubt(light_from: Floats) -> None:
    sticks = APART

    found = measured(sticks, light_from / np.linalg.norm(light_from))

    assert len(found.parts) == 6
    centre = in_space(found.parts[:, 1:7].reshape(-1, 2, 3), FRAME.on).mean(axis=1)
    sigma_m, _ = sigmas(found.parts, found.covariance, FRAME)
    for stick in sticks:
        nearest = int(np.argmin(np.linalg.norm(centre - 0.5 * (stick.start + stick.end), axis=1)))
        off = float(np.linalg.norm(centre[nearest] - 0.5 * (stick.start + stick.end)))
        assert off < 3 * sigma_m[nearest]
        assert off < 0.001


def test_a_camera_that_encodes_light_is_told_from_one_that_does_not() -> None:
    assert measured(APART, SIDEWAYS, gamma=1.0).gamma == 1.0
    assert measured(APART, SIDEWAYS, gamma=2.2).gamma == 2.2


def test_a_straight_stick_has_no_bow_and_its_ends_tell_its_length() -> None:
    found = measured([lying(0.0, 0.0, 60)])

    assert found.bow_px[0] < 0.12 * FRAME.width_px
    assert found.free_length_m[0] == pytest.approx(ROD.length_m, abs=0.0008)
    assert found.goes_on[0] == 0.0


def test_a_bent_stick_has_a_bow() -> None:
    """Short pieces on an arc: one millimetre between its middle and its chord."""
    turn = np.radians(np.linspace(-5, 5, 15))
    radius = 0.05 / np.sin(turn[-1])
    points = np.stack([radius * np.sin(turn), radius * (np.cos(turn) - 1), np.full(15, 0.398)], axis=1)
    pieces = [Stick(start=a, end=b) for a, b in pairwise(points)]

    greys = pair(pieces)
    pictures = seen(greys, FRAME)
    found = explained(pictures, FRAME)

    assert found.chosen
    bow = polish(found, pictures.left, pictures.right, greys, 0.0, FRAME).bow_px
    assert bow.max() > BOW_WIDTHS * FRAME.width_px


def test_flanks_that_contradict_each_other_are_doubted() -> None:
    """The middle third of a stick's edges is moved inwards, as beside a neighbour's shadow."""
    pictures = drawn([lying(0.0, 0.0, 60)], FRAME)
    found = explained(pictures, FRAME)
    spoilt = []
    for view in (pictures.left, pictures.right):
        table = view.table.copy()
        low, high = np.quantile(table[:, 1], [1 / 3, 2 / 3])
        third = (table[:, 1] > low) & (table[:, 1] < high)
        table[third, :2] += 0.6 * table[third, 2:4]
        spoilt.append(replace(view, table=read_only(table)))

    calm = polish(found, pictures.left, pictures.right, pictures.greys, 0.0, FRAME).strain
    strained = polish(found, spoilt[0], spoilt[1], pictures.greys, 0.0, FRAME).strain

    assert calm[0] == 1.0
    assert strained[0] > 1.5


def test_the_state_of_the_choice_is_as_before_and_nothing_measures_nothing() -> None:
    pictures = drawn([lying(0.0, 0.0, 60), lying(0.0, 0.0, 120, height_m=0.006)], FRAME)
    found = explained(pictures, FRAME)
    before = found.state.taken_l.copy(), found.state.taken_r.copy()

    one = polish(found, pictures.left, pictures.right, pictures.greys, 0.0, FRAME, found.chosen[:1])

    assert len(one.parts) == 1
    assert np.array_equal(before[0], found.state.taken_l)
    assert np.array_equal(before[1], found.state.taken_r)
    empty = drawn([], FRAME)
    nothing = polish(explained(empty, FRAME), empty.left, empty.right, empty.greys, 0.0, FRAME)
    assert nothing.parts.shape == (0, 10)


def test_parts_are_where_they_are() -> None:
    sticks = [lying(-0.03, 0.0, 50), lying(0.03, 0.0, 110)]

    found = measured(sticks)

    for stick in sticks:
        assert min(worst_end_m(row, stick, FRAME) for row in found.parts) < 0.001
