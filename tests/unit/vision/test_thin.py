"""Thinning on pictures small enough to read, and on drawn sticks of real size."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from tests.reference import zhang_suen as reference
from tests.reference.topology import euler_number, pieces
from vision.thin import guo_hall, lee, zhang_suen

DATA = Path(__file__).parents[2] / "data" / "thinning.npz"
PHOTOGRAPHS = Path(__file__).parents[4] / "shared" / "data" / "real" / "mbest_S1" / "labels"

needs_contrib = pytest.mark.skipif(not hasattr(cv2, "ximgproc"), reason="needs OpenCV's contrib modules")


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


NOISE = [f"noise_{percent}" for percent in (10, 30, 50, 70, 90)]
DRAWN = ["blobs_1.5", "blobs_3.0", "blobs_6.0", "sticks"]
PICTURES = ["rendered", "coins", "page", "text"]


@pytest.mark.parametrize("name", NOISE + DRAWN + PICTURES)
def test_zhang_suen_is_opencvs(name: str) -> None:
    with np.load(DATA) as data:
        shape = tuple(data[f"{name}.shape"].tolist())
        size = shape[0] * shape[1]
        mask = np.unpackbits(data[f"{name}.mask"], count=size).reshape(shape).astype(bool)
        expected = np.unpackbits(data[f"{name}.skeleton"], count=size).reshape(shape).astype(bool)

    assert 0 < expected.sum() < mask.sum()
    assert np.array_equal(zhang_suen(mask), expected)


def opencv_zhang_suen(mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    contrib = cv2.ximgproc  # type: ignore[attr-defined]  # not in the OpenCV that mypy sees
    framed = np.pad(mask, 1).astype(np.uint8) * 255  # it leaves the outermost pixels alone
    thinned = contrib.thinning(framed, thinningType=contrib.THINNING_ZHANGSUEN)
    return np.asarray(thinned[1:-1, 1:-1] > 0)


@needs_contrib
@pytest.mark.parametrize("density", [0.1, 0.3, 0.5, 0.7, 0.9])
def test_zhang_suen_is_opencvs_on_fresh_noise(density: float) -> None:
    random = np.random.default_rng()
    for _ in range(20):
        mask = random.random((random.integers(1, 90), random.integers(1, 200))) < density
        assert np.array_equal(zhang_suen(mask), opencv_zhang_suen(mask))


@needs_contrib
@pytest.mark.shared_data
@pytest.mark.skipif(not PHOTOGRAPHS.is_dir(), reason="no shared data here")
def test_zhang_suen_is_opencvs_on_photographs() -> None:
    for path in sorted(PHOTOGRAPHS.glob("*.png")):
        mask = np.asarray(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)) > 0
        assert np.array_equal(zhang_suen(mask), opencv_zhang_suen(mask))


def test_lee_thins_a_cross_to_lines_that_stay_connected() -> None:
    mask = np.zeros((60, 80), bool)
    mask[27:32, 10:70] = True
    mask[5:55, 37:42] = True

    skeleton = lee(mask)

    assert skeleton.dtype == np.bool_
    assert not (skeleton & ~mask).any()
    assert euler_number(skeleton) == pieces(skeleton) == 1
    assert skeleton.sum() < 120


@pytest.mark.parametrize("thin", [zhang_suen, guo_hall, lee])
def test_something_not_two_dimensional_is_refused(thin) -> None:  # type: ignore[no-untyped-def]  # parametrised function
    with pytest.raises(ValueError, match="two dimensions"):
        thin(np.zeros((2, 2, 3), bool))
