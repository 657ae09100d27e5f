"""The common drawing area: OpenCV's exact mapping, points in space and back, the table as disparity."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vision import canvas as canvases
from vision import stereo, transforms
from vision.canvas import canvas, disparity_planes, in_space, on_canvas, points_through_grid
from vision.types import CameraModel, Floats, Plane, StereoModel


def bent_rig() -> StereoModel:
    """Two unlike cameras with barrel distortion that turn towards each other and are not level."""
    left = CameraModel(
        matrix=np.array([[560.0, 0.0, 325.0], [0.0, 563.0, 236.0], [0.0, 0.0, 1.0]]),
        distortion=np.array([-0.08, 0.02, 0.0008, -0.0005, 0.0]),
        width_px=640,
        height_px=480,
    )
    right = CameraModel(
        matrix=np.array([[566.0, 0.0, 312.0], [0.0, 564.0, 244.0], [0.0, 0.0, 1.0]]),
        distortion=np.array([-0.06, 0.015, -0.0006, 0.0007, 0.0]),
        width_px=640,
        height_px=480,
    )
    motion = transforms.make([0.01, -0.05, 0.006], [-0.07, 0.001, 0.004])
    return StereoModel(left=left, right=right, right_from_left=motion)


RIG = bent_rig()
ON = canvas(RIG)


def raw_points(count: int, seed: int) -> Floats:
    random = np.random.default_rng(seed)
    return random.uniform((0.0, 0.0), (639.0, 479.0), (count, 2))


@pytest.mark.parametrize("side", [0, 1])
def test_the_grid_is_the_exact_mapping_to_a_hundredth_of_a_pixel(side: int) -> None:
    raw = raw_points(2000, side)
    camera = (RIG.left, RIG.right)[side]
    turn = (ON.rect.rect_from_left, ON.rect.rect_from_right)[side]
    ideal = np.array(
        [[ON.focal_px, 0.0, ON.centre_px[0]], [0.0, ON.focal_px, ON.centre_px[1]], [0.0, 0.0, 1.0]]
    )
    # thousands of turns instead of five: the inverse of the distortion to the last digit
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 2000, 1e-12)
    exact = cv2.undistortPointsIter(
        raw.reshape(-1, 1, 2), camera.matrix, camera.distortion, turn, ideal, stop
    ).reshape(-1, 2)

    moved = points_through_grid(ON.from_raw[side], raw)

    assert np.abs(moved - exact).max() < 0.01


@pytest.mark.parametrize("side", [0, 1])
def test_there_and_back_is_where_it_was(side: int) -> None:
    raw = raw_points(500, 5 + side)

    back = points_through_grid(ON.to_raw[side], points_through_grid(ON.from_raw[side], raw))

    assert np.abs(back - raw).max() < 0.02


@settings(max_examples=60, deadline=None)
@given(x=st.floats(-0.15, 0.15), y=st.floats(-0.12, 0.12), z=st.floats(0.25, 0.7))
def test_space_and_canvas_are_inverse_and_agree_with_the_raw_pictures(x: float, y: float, z: float) -> None:
    point = np.array([[x, y, z]])

    pixel = on_canvas(point, ON)

    assert in_space(pixel, ON) == pytest.approx(point, abs=1e-9)
    raw_l, raw_r = stereo.project(point, RIG)
    if (raw_l > 0).all() and (raw_l < (639, 479)).all() and (raw_r > 0).all() and (raw_r < (639, 479)).all():
        left = points_through_grid(ON.from_raw[0], raw_l)[0]
        right = points_through_grid(ON.from_raw[1], raw_r)[0]
        assert left == pytest.approx(pixel[0, :2], abs=0.02)
        assert right == pytest.approx(pixel[0, :2] - (pixel[0, 2], 0.0), abs=0.02)


def test_far_beyond_every_depth_a_point_stays_finite() -> None:
    assert np.isfinite(in_space(np.array([[100.0, 100.0, 0.0]]), ON)).all()
    nearest = in_space(np.array([[100.0, 100.0, canvases.LEAST_DISPARITY_PX]]), ON)
    assert in_space(np.array([[100.0, 100.0, -3.0]]), ON) == pytest.approx(nearest)


def test_the_planes_of_a_tilted_table_are_the_disparities_of_its_points() -> None:
    normal = np.array([0.15, -0.2, -1.0])
    normal /= np.linalg.norm(normal)
    table = Plane(normal=normal, offset_m=0.41)
    heights = (-0.005, 0.002, 0.06)
    random = np.random.default_rng(3)

    planes = disparity_planes(ON, heights, table, None)

    for height, plane in zip(heights, planes, strict=True):
        rays = np.column_stack([random.uniform(-0.3, 0.3, (200, 2)), np.ones(200)])
        points = rays * ((height - table.offset_m) / (rays @ normal))[:, None]
        assert points @ normal + table.offset_m == pytest.approx(height, abs=1e-12)
        pixels = on_canvas(points, ON)
        assert pixels[:, :2] @ plane[:2] + plane[2] == pytest.approx(pixels[:, 2], abs=1e-6)


def test_the_planes_of_a_depth_range_are_its_ends_and_the_middle_between() -> None:
    planes = disparity_planes(ON, (0.0, 0.0, 0.0), None, (0.3, 0.5))

    near, far = ON.focal_px * ON.baseline_m / 0.3, ON.focal_px * ON.baseline_m / 0.5
    assert planes[:, :2] == pytest.approx(0.0)
    assert planes[:, 2] == pytest.approx([far, 0.5 * (near + far), near])
