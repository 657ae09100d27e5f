"""A camera that has been knocked is noticed by the ends of the parts; a true rig is left alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.reference.looks import ROD, drawn, explained, frame, seen
from tests.reference.sticks import TABLE, lying, pair, rig
from vision.default import locate_default
from vision.rows import LEAST_ENDS, RowOffset, row_offset
from vision.types import Tuning

THICK = replace(ROD, diameter_m=0.007)
"""Ten pixels wide: an end is read on most of its lanes."""
FRAME = frame(THICK)
STICKS = [
    replace(lying(-0.065 + 0.026 * k, 0.008 * (k % 3 - 1), 50 + 15 * k, height_m=0.0035), radius_m=0.0035)
    for k in range(6)
]


@pytest.mark.parametrize("offset_px", [-2.0, -1.0, 0.5, 1.0, 2.0])
def test_a_row_offset_is_found_within_three_of_its_own_deviations(offset_px: float) -> None:
    pictures = seen(pair(STICKS, row_offset_px=offset_px), FRAME)

    found = row_offset(explained(pictures, FRAME), pictures.left, pictures.right, FRAME)

    assert abs(found.px - offset_px) < 3 * found.sigma_px
    assert found.sigma_px < 0.15
    assert found.significant


@pytest.mark.parametrize("seed", range(4))
def test_a_true_rig_is_not_corrected(seed: int) -> None:
    pictures = drawn(STICKS, FRAME, seed)

    found = row_offset(explained(pictures, FRAME), pictures.left, pictures.right, FRAME)

    assert not found.significant
    assert abs(found.px) < 0.25


def test_with_the_offset_corrected_depth_is_right_again() -> None:
    left, right = pair(STICKS, row_offset_px=1.5)

    scene = locate_default(left, right, rig(), THICK, Tuning(), TABLE)

    assert scene.row_offset_px == pytest.approx(1.5, abs=0.2)
    middles = np.array([0.5 * (stick.start + stick.end) for stick in STICKS])
    assert len(scene.recognised) == 6
    for candidate in scene.recognised:
        assert np.linalg.norm(middles - candidate.centre, axis=1).min() < 0.0012


def test_one_end_tells_nothing_and_nothing_says_so() -> None:
    empty = drawn([], FRAME)
    one = drawn(STICKS[:1], FRAME)

    nothing = row_offset(explained(empty, FRAME), empty.left, empty.right, FRAME)
    few = row_offset(explained(one, FRAME), one.left, one.right, FRAME)

    assert (nothing.ends, nothing.significant) == (0, False)
    assert few.ends < LEAST_ENDS
    assert not few.significant


def test_significant_is_far_in_pixels_and_in_deviations() -> None:
    assert RowOffset(px=-0.4, sigma_px=0.05, ends=9).significant
    assert not RowOffset(px=0.2, sigma_px=0.01, ends=9).significant
    assert not RowOffset(px=0.4, sigma_px=0.2, ends=9).significant
    assert not RowOffset(px=3.0, sigma_px=0.05, ends=LEAST_ENDS - 1).significant
