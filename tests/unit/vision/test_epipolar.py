"""A camera that was moved shows the same places in other rows."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from cell import calibration
from tests.fakes.station import DATA
from vision.epipolar import MOVED_PX, in_rows, row_residual
from vision.stereo import rectification
from vision.types import Grey

KNOWN = calibration.load(DATA / "calibration.json")
RECT = rectification(KNOWN.stereo)
DEPTH_M = (0.20, 0.40)


def picture(name: str) -> Grey:
    read = cv2.imread(str(DATA / f"{name}.png"), cv2.IMREAD_GRAYSCALE)
    assert read is not None
    return np.asarray(read, np.uint8)


LEFT, RIGHT = picture("left"), picture("right")


def turned(grey: Grey, angle_rad: float, rows: float) -> Grey:
    """A camera that was rolled and tilted a little."""
    height, width = grey.shape
    motion = cv2.getRotationMatrix2D((width / 2, height / 2), np.degrees(angle_rad), 1.0)
    motion[1, 2] += rows
    return np.asarray(
        cv2.warpAffine(grey, motion, (width, height), borderMode=cv2.BORDER_REPLICATE), np.uint8
    )


def test_cameras_that_stand_as_calibrated_show_the_same_rows() -> None:
    rows = row_residual(LEFT, RIGHT, RECT, DEPTH_M)
    assert rows.known
    assert abs(rows.px) < 0.4


@pytest.mark.parametrize("moved_px", [-9.0, -3.0, 2.0, 4.0, 8.0])
def test_a_camera_that_was_tilted_is_off_by_as_many_rows(moved_px: float) -> None:
    rows = row_residual(LEFT, turned(RIGHT, 0.0, moved_px), RECT, DEPTH_M)
    assert rows.known
    assert rows.px == pytest.approx(moved_px, abs=0.5)
    assert abs(rows.px) > MOVED_PX


def test_a_scene_without_corners_says_nothing() -> None:
    flat = np.full_like(LEFT, 90)
    rows = row_residual(flat, flat, RECT, DEPTH_M)
    assert not rows.known
    assert rows.points == 0


def test_two_different_scenes_agree_on_nothing() -> None:
    rng = np.random.default_rng(4)
    noise = (rng.integers(0, 255, LEFT.shape, dtype=np.uint8) for _ in range(2))
    left, right = (np.asarray(cv2.GaussianBlur(one, (0, 0), 2.0), np.uint8) for one in noise)
    assert not in_rows(left, right, (20.0, 60.0)).known
