"""The global band and its proposal."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from vision import binarize
from vision.types import Grey

SCENES = Path(__file__).parents[4] / "shared" / "data" / "scenes-dev" / "scenes"


def table(ground: float, part: float | None, noise: float = 4.0) -> Grey:
    """A ground with a bar of 2 % of the picture."""
    grey = np.full((100, 100), float(ground))
    if part is not None:
        grey[40:44, 20:70] = part
    grey += np.random.default_rng(2).normal(0, noise, grey.shape)
    return np.asarray(np.clip(np.rint(grey), 0, 255), np.uint8)


def test_both_ends_of_the_band_belong_to_it() -> None:
    grey = np.array([[99, 100, 150, 200, 201]], np.uint8)
    assert binarize.in_band(grey, (100, 200)).tolist() == [[False, True, True, True, False]]


@pytest.mark.parametrize("band", [(200, 100), (-1, 10), (10, 256)])
def test_a_band_out_of_order_is_refused(band: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="band"):
        binarize.in_band(np.zeros((2, 2), np.uint8), band)


@pytest.mark.parametrize(("ground", "part"), [(50, 220), (20, 90), (110, 200), (50, 400)])
def test_the_proposal_separates_bright_parts_from_the_ground(ground: float, part: float) -> None:
    grey = table(ground, part)
    mask = binarize.in_band(grey, binarize.propose_band(grey))
    assert mask[40:44, 20:70].all()
    assert np.count_nonzero(mask) == 200


def test_a_table_without_parts_gives_an_empty_mask() -> None:
    grey = table(50, None)
    assert not binarize.in_band(grey, binarize.propose_band(grey)).any()


def test_a_grey_block_of_middling_brightness_stays_out() -> None:
    grey = table(55, 225)
    grey[60:90, 60:90] = 100
    mask = binarize.in_band(grey, binarize.propose_band(grey))
    assert np.count_nonzero(mask) == 200


@pytest.mark.shared_data
@pytest.mark.skipif(not SCENES.is_dir(), reason="no shared data here")
@pytest.mark.parametrize(
    "scene",
    ["A1", "A1-ind", "B1", "B1-ind", "H10-2", "H20-1", "H20-2-ind", "H40-3", "L-dim", "L-even", "T40"],
)
def test_the_proposed_mask_is_the_true_outline(scene: str) -> None:
    folder = SCENES / scene
    for side in ("left", "right"):
        grey = np.asarray(cv2.imread(str(folder / f"{side}.png"), cv2.IMREAD_GRAYSCALE), np.uint8)
        truth = np.asarray(cv2.imread(str(folder / f"ids_{side}.png"), cv2.IMREAD_GRAYSCALE))
        parts = (truth > 0) & (truth < 250)
        mask = binarize.in_band(grey, binarize.propose_band(grey))
        overlap = np.count_nonzero(mask & parts) / np.count_nonzero(mask | parts)
        assert overlap > 0.8


@pytest.mark.shared_data
@pytest.mark.skipif(not SCENES.is_dir(), reason="no shared data here")
def test_an_empty_table_gives_nothing() -> None:
    grey = np.asarray(cv2.imread(str(SCENES / "N-empty" / "left.png"), cv2.IMREAD_GRAYSCALE), np.uint8)
    assert not binarize.in_band(grey, binarize.propose_band(grey)).any()
