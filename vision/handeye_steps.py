"""Small steps of poses and what they do to pixels: the mathematics under `vision.handeye_fit`."""

from __future__ import annotations

import cv2
import numpy as np

from vision import transforms
from vision.types import CameraModel, Floats, Transform


def project_any(points_m: Floats, camera: CameraModel) -> Floats:
    """(N, 3) m in a camera's frame to raw pixels (N, 2); a point at or behind the camera lands far outside,
    so that a fit that has gone astray finds its way back."""
    if not len(points_m):
        return np.zeros((0, 2))
    points = points_m.copy()
    points[:, 2] = np.maximum(points[:, 2], 1e-3)
    still = np.zeros((3, 1))
    pixels, _ = cv2.projectPoints(points.reshape(-1, 1, 3), still, still, camera.matrix, camera.distortion)
    bent = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
    # the polynomial of the distortion is meaningless far outside the picture
    slopes = points[:, :2] / points[:, 2:]
    straight = slopes * np.diag(camera.matrix)[:2] + camera.matrix[:2, 2]
    far = np.hypot(slopes[:, 0], slopes[:, 1]) > 1.5 * _widest_slope(camera)
    bent[far] = straight[far]
    return bent


def _widest_slope(camera: CameraModel) -> float:
    return float(
        np.hypot(camera.width_px / camera.matrix[0, 0], camera.height_px / camera.matrix[1, 1]) * 0.75
    )


def moved(pose: Transform, step: Floats) -> Transform:
    """A transform turned and shifted in its own frame by (6,) rad, m."""
    rotation = pose.rotation @ transforms.matrix_from_vector(step[:3])
    return transforms.make(
        transforms.nearest_rotation(rotation), pose.translation + pose.rotation @ step[3:6]
    )


def cross(vectors: Floats) -> Floats:
    """(N, 3, 3) matrices that take w to v x w."""
    made = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    made[:, 0, 1], made[:, 0, 2], made[:, 1, 2] = -z, y, -x
    made[:, 1, 0], made[:, 2, 0], made[:, 2, 1] = z, -y, x
    return made


def turn_back(turn: Floats) -> Floats:
    return transforms.matrix_from_vector(turn).T


def right_jacobian(turn: Floats) -> Floats:
    """(3, 3) that takes a small change of a rotation vector to the turn it adds in its own frame (Chirikjian,
    Stochastic Models, Information Theory, and Lie Groups 2, 2012, eq. 10.86)."""
    angle = float(np.linalg.norm(turn))
    about = cross(turn[None])[0]
    if angle < 1e-6:
        return np.asarray(np.eye(3) - 0.5 * about, dtype=np.float64)
    first, second = (1.0 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) - first * about + second * about @ about, dtype=np.float64)


def pixel_slopes(points_m: Floats, camera: CameraModel) -> Floats:
    """(N, 2, 3) px per metre of points in a camera's frame, where `project_any` puts them."""
    points = points_m.copy()
    points[:, 2] = np.maximum(points[:, 2], 1e-3)
    still = np.zeros((3, 1))
    _, jacobian = cv2.projectPoints(points.reshape(-1, 1, 3), still, still, camera.matrix, camera.distortion)
    slopes = np.asarray(jacobian, dtype=np.float64)[:, 3:6].reshape(-1, 2, 3).copy()
    ratios = points[:, :2] / points[:, 2:]
    far = np.hypot(ratios[:, 0], ratios[:, 1]) > 1.5 * _widest_slope(camera)
    straight = np.zeros((len(points), 2, 3))
    for axis in (0, 1):
        straight[:, axis, axis] = camera.matrix[axis, axis] / points[:, 2]
        straight[:, axis, 2] = -camera.matrix[axis, axis] * ratios[:, axis] / points[:, 2]
    slopes[far] = straight[far]
    slopes[points_m[:, 2] < 1e-3, :, 2] = 0.0
    return slopes
