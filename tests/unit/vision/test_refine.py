"""A part laid on its edges: from near by to a few hundredths of a pixel, with an honest covariance."""

from __future__ import annotations

import numpy as np
import pytest

from tests.reference.looks import Seen, drawn, frame, hypotheses, outlined, seen
from tests.reference.sticks import lying, pair
from vision.canvas import in_space
from vision.ends import TIP_SIGMA_PX, cap_px
from vision.explain import settle
from vision.refine import (
    DA,
    DB,
    FLANK_SIGMA_PX,
    LENGTH,
    ROW_SIGMA_PX,
    UNIT,
    XA,
    axis_length,
)
from vision.types import Floats

FRAME = frame()


def settled(rows: Floats, of: Seen, rounds: int = 8, tilt_share: float = 0.25) -> Floats:
    """Refines in place; the normal matrices."""
    free = (np.zeros(len(of.left.table) + 1, np.uint16), np.zeros(len(of.right.table) + 1, np.uint16))
    return settle(rows, of.left, of.right, free, FRAME, tilt_share, rounds, 1.5)


def disturbed(rows: Floats, by_px: float, seed: int) -> Floats:
    moved = rows.copy()
    moved[:, 1:7] += np.random.default_rng(seed).uniform(-by_px, by_px, (len(rows), 6))
    return moved


@pytest.mark.parametrize("angle_deg", [20, 60, 90, 130, 165])
def test_wherever_it_starts_near_by_it_ends_on_the_same_spot(angle_deg: int) -> None:
    sticks = [lying(0.01, -0.01, angle_deg)]
    of = drawn(sticks, FRAME)
    rows = np.repeat(hypotheses(sticks, FRAME), 12, axis=0)
    rows[1:] = disturbed(rows[1:], 1.2, seed=angle_deg)

    settled(rows, of, rounds=14)

    assert np.abs(rows[:, 1:7] - rows[0, 1:7]).max() < 0.05


@pytest.mark.parametrize("angle_deg", [20, 60, 90, 130])
def test_without_noise_in_the_way_it_is_where_it_is(angle_deg: int) -> None:
    sticks = [lying(0.01, -0.01, angle_deg)]
    of = seen(pair(sticks, noise_grey=0.3), FRAME)
    rows = hypotheses(sticks, FRAME)
    truth = rows[0, 1:7].copy()
    rows = disturbed(rows, 0.8, seed=3)

    settled(rows, of, rounds=12)

    middle, true_middle = rows[0, 1:4] + rows[0, 4:7], truth[:3] + truth[3:]
    assert 0.5 * np.abs(middle - true_middle).max() < 0.15
    assert np.abs(rows[0, 1:7] - truth).max() < 0.5


def test_the_known_length_is_kept_and_an_unknown_one_is_found() -> None:
    sticks = [lying(0.01, -0.01, 60)]
    of = drawn(sticks, FRAME)
    known, free = hypotheses(sticks, FRAME), hypotheses(sticks, FRAME, free=True)
    known[:, LENGTH] = 0.097

    settled(known, of)
    settled(free, of)

    ends = in_space(np.concatenate([known, free])[:, 1:7].reshape(-1, 2, 3), FRAME.on)
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    # half a per cent of doubt against what both ends say
    assert 0.0972 < length[0] < length[1] - 0.0005
    assert length[1] == pytest.approx(0.1, abs=0.0007)


def test_edges_that_are_somebody_elses_do_not_pull() -> None:
    first, second = lying(0.0, 0.0, 60), lying(0.004, 0.0, 62)
    of = drawn([first, second], FRAME)
    rows = hypotheses([first], FRAME)
    truth = rows.copy()
    nobody = (np.zeros(len(of.left.table) + 1, np.uint16), np.zeros(len(of.right.table) + 1, np.uint16))
    everybody = (np.ones_like(nobody[0]), np.ones_like(nobody[1]))
    rows[:, XA] += 1.0

    settle(rows, of.left, of.right, everybody, FRAME, 0.25, 6, 1.5)

    # with nothing to lie on only its length and its tilt are known
    assert rows[0, XA] == pytest.approx(truth[0, XA] + 1.0, abs=0.2)


def test_where_nothing_tells_the_tilt_a_part_lies_flat() -> None:
    stick = lying(0.0, 0.0, 0.0)
    of = drawn([stick], FRAME)
    rows = hypotheses([stick], FRAME)
    rows[:, DA] += 2.0
    rows[:, DB] -= 2.0

    settled(rows, of, rounds=14, tilt_share=0.05)

    assert abs(rows[0, DA] - rows[0, DB]) < 1.0


LAW_MIDDLE_PX = 0.1
"""How far light moves all flanks of one view in the test of the covariance."""


def scattered(row: Floats, random: np.random.Generator) -> Seen:
    """Edges of one part as the law behind the covariance has them: each flank scattered, each view moved as a
    whole, rows a little off, ends doubtful."""
    moved = (random.normal(0, LAW_MIDDLE_PX), random.normal(0, LAW_MIDDLE_PX))
    beyond = np.zeros((2, 2))
    for view in range(2):
        for end in range(2):
            cap, doubt = cap_px(
                row[1:7].copy(), end, view, row[UNIT] * row[DA + 3 * end], FRAME.camera, False
            )
            beyond[view, end] = cap + random.normal(0, np.hypot(TIP_SIGMA_PX, doubt))
    # the middle of two flanks scatters by FLANK_SIGMA_PX, so each of them by more
    return outlined(
        row, FRAME, beyond, moved, random.normal(0, ROW_SIGMA_PX), FLANK_SIGMA_PX * np.sqrt(2.0), random
    )


@pytest.mark.parametrize("angle_deg", [40, 90, 120])
def test_the_covariance_is_the_spread_of_results_to_a_half(angle_deg: int) -> None:
    random = np.random.default_rng(angle_deg)
    truth = hypotheses([lying(0.01, -0.01, angle_deg)], FRAME)
    found, said = [], []
    for _ in range(80):
        of = scattered(truth[0], random)
        rows = truth.copy()
        free = (np.zeros(len(of.left.table) + 1, np.uint16), np.zeros(len(of.right.table) + 1, np.uint16))
        bias = np.full((1, 2), LAW_MIDDLE_PX)
        normals = settle(rows, of.left, of.right, free, FRAME, 1.0, 12, 1.0, np.zeros((1, 2, 2)), bias)
        found.append(rows[0, 1:7] - truth[0, 1:7])
        said.append(np.linalg.inv(normals[0] + 1e-6 * np.eye(6)))
    off, covariance = np.array(found), np.median(said, axis=0)

    middle = np.array([0, 0, 0.5, 0, 0, 0.5])
    assert np.std(off @ middle) == pytest.approx(np.sqrt(middle @ covariance @ middle), rel=0.3)
    way = truth[0, 4:6] - truth[0, 1:3]
    nx, ny = -way[1] / np.hypot(*way), way[0] / np.hypot(*way)
    for across in (np.array([nx, ny, 0, 0, 0, 0]), np.array([0, 0, 0, nx, ny, 0])):
        assert np.std(off @ across) == pytest.approx(np.sqrt(across @ covariance @ across), rel=0.45)


def test_the_length_of_an_axis_is_its_length_in_space() -> None:
    rows = hypotheses([lying(0.02, 0.01, 40, tilt_deg=12)], FRAME)
    focal, baseline, cx, cy = FRAME.camera

    assert axis_length(rows[0, 1:7].copy(), focal * baseline, focal, cx, cy) == pytest.approx(0.1, abs=1e-12)
