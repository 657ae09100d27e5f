"""Projection, edge search and the fit of a pose, each against what is known."""

from __future__ import annotations

import numpy as np
import pytest

from tests.reference.shapes import TEE, laid, sticks_of
from tests.reference.sticks import TABLE, pair, rig
from vision.shape_model import shape_model
from vision.shape_pose import both_slopes, flat_camera, project_one, refine, scratch_size, seek
from vision.stereo import project
from vision.transforms import make, matrix_from_vector
from vision.types import CameraModel, StereoModel


@pytest.mark.parametrize(
    "distortion",
    [[0.0] * 5, [-0.2, 0.1, 0.001, -0.002, 0.01], [0.1, -0.05, 0.001, 0.0, 0.01, 0.2, 0.05, -0.01]],
)
def test_points_are_projected_as_opencv_does(distortion: list[float]) -> None:
    camera = CameraModel(
        matrix=np.array([[570.0, 0.0, 310.0], [0.0, 575.0, 250.0], [0.0, 0.0, 1.0]]),
        distortion=np.array(distortion),
        width_px=640,
        height_px=480,
    )
    motion = make([0.05, -0.1, 0.02], [-0.07, 0.001, 0.004])
    points = np.random.default_rng(2).uniform([-0.1, -0.1, 0.3], [0.1, 0.1, 0.5], (40, 3))
    wanted = project(points, StereoModel(left=camera, right=camera, right_from_left=motion))

    for flat, expected in zip((flat_camera(camera, None), flat_camera(camera, motion)), wanted, strict=True):
        found = np.array([project_one(flat, *point) for point in points.tolist()])
        np.testing.assert_allclose(found, expected, atol=1e-6)


def test_a_camera_with_more_distortion_than_is_known_here_is_refused() -> None:
    camera = CameraModel(matrix=np.eye(3), distortion=np.full(12, 0.1), width_px=10, height_px=10)
    with pytest.raises(ValueError, match="distortion"):
        flat_camera(camera, None)


@pytest.mark.parametrize("edge_px", [9.0, 10.3, 11.75])
def test_an_edge_is_found_to_a_tenth_of_a_pixel_and_only_if_it_falls_outwards(edge_px: float) -> None:
    u = np.arange(24.0)
    slope = -40.0 * np.exp(-0.5 * (u - edge_px) ** 2)
    rise_u = np.ascontiguousarray(np.tile(slope, (9, 1)), np.float32)
    rise_v = np.zeros_like(rise_u)
    falls = np.empty(scratch_size(3.0))

    place, steep = seek(rise_u, rise_v, 10.0, 4.0, 1.0, 0.0, 3.0, 5.0, falls)
    _, other_way = seek(rise_u, rise_v, 10.0, 4.0, -1.0, 0.0, 3.0, 5.0, falls)

    assert place == pytest.approx(edge_px - 10.0, abs=0.1)
    assert steep > 30.0
    assert other_way == 0.0


@pytest.mark.parametrize("seed", range(6))
def test_the_fit_comes_back_to_the_truth_from_two_millimetres_and_two_degrees_off(seed: int) -> None:
    random = np.random.default_rng(seed)
    truth = laid(TEE, 0.02, -0.01, float(random.uniform(20, 160)))
    left, right = pair(sticks_of(truth), seed=seed)
    slopes = both_slopes((left, right), rig(), (8.0, 8.0), 5.7)
    shape = shape_model(TEE, 0.001)
    turn = matrix_from_vector(random.uniform(-0.03, 0.03, 3)) @ truth.rotation
    start = np.concatenate([turn.T.reshape(-1), truth.origin_m + random.uniform(-0.002, 0.002, 3)])

    pose, _, matrix, spread, used = refine(
        start, 0.0, 0.0, shape.points, shape.normals, shape.grows, shape.weights,
        np.stack([one.camera for one in slopes]), slopes[0].rise_u, slopes[0].rise_v, slopes[1].rise_u,
        slopes[1].rise_v, np.array([8.0, 8.0]), np.array([4.0, 2.5, 1.5, 1.5]), TABLE.normal, 0.15, 0.9,
    )  # fmt: skip

    assert np.linalg.norm(pose[9:] - truth.origin_m) < 0.0012
    assert spread < 0.3
    assert used > len(shape.points)
    assert np.linalg.eigvalsh(matrix).min() > 0
    np.testing.assert_allclose(pose[:9].reshape(3, 3) @ pose[:9].reshape(3, 3).T, np.eye(3), atol=1e-9)
