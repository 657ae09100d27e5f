"""Which pictures are refused, and with which number."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from vision import quality
from vision.types import Grey, PictureFlaw

SCENES = Path(__file__).parents[4] / "shared" / "data" / "scenes-dev" / "scenes"


def noisy(level: float, spread: float) -> Grey:
    values = np.random.default_rng(1).normal(level, spread, (48, 64))
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    ("picture", "flaw"),
    [
        (noisy(4, 2.0), PictureFlaw.BLACK),
        (noisy(300, 5.0), PictureFlaw.SATURATED),
        (noisy(120, 2.0), PictureFlaw.FLAT),
        (np.zeros((4, 4), np.uint8), PictureFlaw.BLACK),
    ],
)
def test_a_useless_picture_is_named(picture: Grey, flaw: PictureFlaw) -> None:
    found = quality.assess(picture)
    assert found is not None
    assert found.flaw is flaw


def test_the_number_is_past_its_limit() -> None:
    found = quality.assess(np.full((4, 4), 255, np.uint8))
    assert found is not None
    assert found.value > found.limit


def test_a_dark_table_with_one_bright_stick_is_usable() -> None:
    picture = noisy(20, 2.0)
    picture[10:13, 10:50] = 90
    assert quality.assess(picture) is None


def test_the_same_picture_twice_is_noticed_and_one_changed_pixel_is_enough() -> None:
    before = noisy(60, 5.0)
    now = before.copy()
    same = quality.unchanged(before, now)
    assert same is not None
    assert same.flaw is PictureFlaw.UNCHANGING
    now[3, 3] ^= 1
    assert quality.unchanged(before, now) is None
    assert quality.unchanged(before, before[:-1]) is None


def test_colour_and_other_types_are_refused() -> None:
    with pytest.raises(ValueError, match="uint8"):
        quality.assess(np.zeros((4, 4)))  # type: ignore[arg-type]  # the point of the test
    with pytest.raises(ValueError, match=r"\(H, W\)"):
        quality.assess(np.zeros((4, 4, 3), np.uint8))


@pytest.mark.shared_data
@pytest.mark.skipif(not SCENES.is_dir(), reason="no shared data here")
@pytest.mark.parametrize(
    ("scene", "flaw"),
    [
        ("N-saturated", PictureFlaw.SATURATED),
        ("N-empty", None),
        ("L-dim", None),
        ("L-specular", None),
        ("C2", None),
        ("H40-1", None),
    ],
)
def test_real_pictures_are_judged_right(scene: str, flaw: PictureFlaw | None) -> None:
    for side in ("left", "right"):
        grey = np.asarray(cv2.imread(str(SCENES / scene / f"{side}.png"), cv2.IMREAD_GRAYSCALE), np.uint8)
        found = quality.assess(grey)
        assert (found.flaw if found else None) is flaw
