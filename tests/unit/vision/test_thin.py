"""Thinning on pictures small enough to read, and on drawn sticks of real size."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from tests.reference import zhang_suen as reference
from vision.thin import guo_hall, zhang_suen


def picture(text: str) -> npt.NDArray[np.bool_]:
    return np.array([[c == "#" for c in line.strip()] for line in text.strip().splitlines()])


def test_a_bar_becomes_its_middle_row() -> None:
    mask = picture(
        """
        .........
        .#######.
        .#######.
        .#######.
        .........
        """
    )

    skeleton = guo_hall(mask)

    assert skeleton.sum(axis=0).max() == 1
    assert skeleton[2].any()
    assert not skeleton[[0, 1, 3, 4]].any()


def test_zhang_suen_swallows_a_square_of_four_as_published() -> None:
    mask = np.zeros((4, 4), bool)
    mask[1:3, 1:3] = True

    assert np.array_equal(zhang_suen(mask), reference.zhang_suen(mask))
    assert guo_hall(mask).sum() >= 1


@pytest.mark.parametrize("thin", [zhang_suen, guo_hall])
@pytest.mark.parametrize("shape", [(1, 1), (1, 200), (200, 1), (3, 64), (5, 65), (7, 63), (2, 128)])
def test_full_and_empty_pictures_of_any_size(thin, shape: tuple[int, int]) -> None:  # type: ignore[no-untyped-def]  # parametrised function
    slow = reference.zhang_suen if thin is zhang_suen else reference.guo_hall
    full = np.ones(shape, bool)

    assert np.array_equal(thin(full), slow(full))
    assert not thin(np.zeros(shape, bool)).any()


@pytest.mark.parametrize("angle_deg", range(0, 180, 15))
def test_a_drawn_stick_thins_as_published_at_every_angle(angle_deg: int) -> None:
    canvas = np.zeros((90, 100), np.uint8)
    along = np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))])
    start, end = np.array([50, 45]) - 38 * along, np.array([50, 45]) + 38 * along
    cv2.line(canvas, np.rint(start).astype(int).tolist(), np.rint(end).astype(int).tolist(), 255, 5)
    mask = canvas > 0

    assert np.array_equal(zhang_suen(mask), reference.zhang_suen(mask))
    skeleton = guo_hall(mask)
    assert np.array_equal(skeleton, reference.guo_hall(mask))
    v, u = np.nonzero(skeleton)
    assert np.hypot(u.max() - u.min(), v.max() - v.min()) > 0.85 * 76


def test_something_not_two_dimensional_is_refused() -> None:
    with pytest.raises(ValueError, match="two dimensions"):
        zhang_suen(np.zeros((2, 2, 3), bool))
