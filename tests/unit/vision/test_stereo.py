"""The camera pair on a rig with distortion and turned cameras, and on one simple enough to check by hand."""

import numpy as np
import pytest

from vision import stereo, transforms
from vision.types import CameraModel, Plane, StereoModel

PLAIN = CameraModel(
    matrix=np.array([[600.0, 0, 320], [0, 600.0, 240], [0, 0, 1]]),
    distortion=np.zeros(5),
    width_px=640,
    height_px=480,
)
BENT = CameraModel(
    matrix=np.array([[571.6, 0, 314.2], [0, 572.4, 246.9], [0, 0, 1]]),
    distortion=np.array([-0.095, 0.031, -0.0009, 0.0006, 0.004]),
    width_px=640,
    height_px=480,
)


def pair(camera: CameraModel, turn_rad: list[float], shift_m: list[float]) -> StereoModel:
    return StereoModel(left=camera, right=camera, right_from_left=transforms.make(turn_rad, shift_m))


SIMPLE = pair(PLAIN, [0.0, 0.0, 0.0], [-0.08, 0.0, 0.0])
TURNED = pair(BENT, [-0.024, 0.082, 0.019], [-0.0745, -0.0026, 0.0056])
POINTS_M = np.array([[0.0, 0.0, 0.4], [-0.1, 0.08, 0.38], [0.09, -0.1, 0.42]])


def test_depth_is_focal_length_times_baseline_over_disparity() -> None:
    rect = stereo.rectification(SIMPLE)
    found = stereo.triangulate([[320.0, 240.0]], [[200.0, 240.0]], rect)
    np.testing.assert_allclose(found, [[0.0, 0.0, 0.4]], atol=1e-9)


def test_a_point_behind_the_cameras_is_not_a_number() -> None:
    rect = stereo.rectification(SIMPLE)
    assert np.isnan(stereo.triangulate([[300.0, 240.0]], [[310.0, 240.0]], rect)).all()


def test_projected_points_come_back_through_rectification() -> None:
    rect = stereo.rectification(TURNED)
    left, right = stereo.project(POINTS_M, TURNED)
    left_rect = stereo.rectify_points(left, rect, "left")
    right_rect = stereo.rectify_points(right, rect, "right")
    np.testing.assert_allclose(left_rect[:, 1], right_rect[:, 1], atol=1e-6)
    np.testing.assert_allclose(stereo.triangulate(left_rect, right_rect, rect), POINTS_M, atol=1e-8)
    np.testing.assert_allclose(stereo.unrectify_points(left_rect, rect, "left"), left, atol=1e-6)


def test_nothing_of_the_raw_pictures_is_cut_off() -> None:
    rect = stereo.rectification(TURNED)
    corners = [[0, 0], [639, 0], [0, 479], [639, 479], [320, 0], [0, 240]]
    for side in ("left", "right"):
        moved = stereo.rectify_points(corners, rect, side)
        assert (moved >= -1e-6).all()
        assert (moved <= [rect.width_px - 1 + 1e-6, rect.height_px - 1 + 1e-6]).all()


def test_pictures_and_points_are_rectified_alike() -> None:
    rect = stereo.rectification(TURNED)
    grey = np.zeros((480, 640), np.uint8)
    grey[149:152, 499:502] = 255
    picture, _ = stereo.rectify_pictures(grey, grey, rect)
    rows, columns = np.nonzero(picture > 100)
    expected = stereo.rectify_points([[500.0, 150.0]], rect, "left")[0]
    np.testing.assert_allclose([columns.mean(), rows.mean()], expected, atol=0.5)


def test_depth_and_disparity_bounds_are_inverse() -> None:
    rect = stereo.rectification(SIMPLE)
    assert stereo.disparity_bounds_px((0.4, 0.48), rect) == pytest.approx((100.0, 120.0))
    assert stereo.depth_bounds_m((100.0, 120.0), rect) == pytest.approx((0.4, 0.48))
    with pytest.raises(ValueError, match="in order"):
        stereo.disparity_bounds_px((0.5, 0.4), rect)


def test_the_depth_range_of_a_level_table_is_its_heights() -> None:
    table = Plane(normal=np.array([0.0, 0.0, -1.0]), offset_m=0.4)
    assert stereo.depth_range(SIMPLE, table, (-0.01, 0.06)) == pytest.approx((0.34, 0.41))


def test_a_table_that_reaches_the_horizon_is_refused() -> None:
    slanted = Plane(normal=np.array([0.0, -1.0, -0.1]), offset_m=0.4)
    with pytest.raises(ValueError, match="horizon"):
        stereo.depth_range(SIMPLE, slanted, (0.0, 0.05))


def test_impossible_rigs_are_refused() -> None:
    with pytest.raises(ValueError, match="swapped"):
        stereo.rectification(pair(PLAIN, [0.0, 0.0, 0.0], [0.08, 0.0, 0.0]))
    with pytest.raises(ValueError, match="above each other"):
        stereo.rectification(pair(PLAIN, [0.0, 0.0, 0.0], [0.0, -0.08, 0.0]))


def test_a_point_behind_a_camera_has_no_pixel() -> None:
    left, _ = stereo.project([[0.0, 0.0, -0.4]], SIMPLE)
    assert np.isnan(left).all()
