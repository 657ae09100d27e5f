"""Rigid motions: rotation vectors and matrices, compose, invert, apply, average, compare.

A ``Transform`` named ``a_from_b`` takes coordinates in b to coordinates in a, so neighbouring names cancel:
``compose(base_from_tool, tool_from_camera)`` is ``base_from_camera``.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from vision.types import Floats, Transform, read_only

ORTHOGONAL_TOLERANCE = 1e-6


def make(rotation: npt.ArrayLike, translation: npt.ArrayLike) -> Transform:
    """A checked transform from its parts.

    Parameters
    ----------
    rotation : (3, 3) or (3,)
        A rotation matrix, or a rotation vector in rad.
    translation : (3,)
        Metres.

    Raises
    ------
    ValueError
        Wrong shapes, numbers that are not finite, or a matrix that does not rotate.
    """
    given = np.asarray(rotation, dtype=np.float64)
    matrix = matrix_from_vector(given) if given.shape == (3,) else given.copy()
    shift = np.asarray(translation, dtype=np.float64).reshape(-1).copy()
    if matrix.shape != (3, 3) or shift.shape != (3,):
        raise ValueError(f"a transform needs (3, 3) and (3,), got {matrix.shape} and {shift.shape}")
    if not (np.isfinite(matrix).all() and np.isfinite(shift).all()):
        raise ValueError("a transform needs finite numbers")
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > ORTHOGONAL_TOLERANCE or np.linalg.det(matrix) < 0:
        raise ValueError("the matrix of a transform must be a rotation")
    return Transform(rotation=read_only(matrix), translation=read_only(shift))


def identity() -> Transform:
    """The transform that changes nothing."""
    return make(np.eye(3), np.zeros(3))


def matrix_from_vector(rotation_rad: npt.ArrayLike) -> Floats:
    """(3, 3) rotation matrix of a (3,) rotation vector in rad (Rodrigues' formula)."""
    vector = np.asarray(rotation_rad, dtype=np.float64).reshape(3, 1)
    return np.asarray(cv2.Rodrigues(vector)[0], dtype=np.float64)


def vector_from_matrix(rotation: npt.ArrayLike) -> Floats:
    """(3,) rotation vector in rad, length 0..pi, of a (3, 3) rotation matrix.

    By way of the quaternion, whose largest part is found first so that nothing is lost near no turn and near
    half a turn; `cv2.Rodrigues` drops turns below 1e-5 rad in this direction.
    """
    m = np.asarray(rotation, dtype=np.float64).reshape(3, 3)
    # the outer product q q^T times four, in the order w, x, y, z: its column with the largest diagonal is q
    w = [1 + m[0, 0] + m[1, 1] + m[2, 2], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]]
    x = [w[1], 1 + m[0, 0] - m[1, 1] - m[2, 2], m[1, 0] + m[0, 1], m[0, 2] + m[2, 0]]
    y = [w[2], x[2], 1 - m[0, 0] + m[1, 1] - m[2, 2], m[2, 1] + m[1, 2]]
    z = [w[3], x[3], y[3], 1 - m[0, 0] - m[1, 1] + m[2, 2]]
    outer = np.array([w, x, y, z], dtype=np.float64)
    quaternion = outer[np.argmax(np.diag(outer))]
    if quaternion[0] < 0:
        quaternion = -quaternion
    length = float(np.linalg.norm(quaternion[1:]))
    if length == 0.0:
        return np.zeros(3)
    angle = 2.0 * np.arctan2(length, quaternion[0])
    return np.asarray(quaternion[1:] * (angle / length), dtype=np.float64)


def compose(first: Transform, *others: Transform) -> Transform:
    """``a_from_d`` of ``a_from_b``, ``b_from_c``, ``c_from_d`` ...; rounding is taken out of the rotation."""
    rotation, translation = first.rotation, first.translation
    for other in others:
        translation = rotation @ other.translation + translation
        rotation = rotation @ other.rotation
    return make(nearest_rotation(rotation), translation)


def invert(transform: Transform) -> Transform:
    """``b_from_a`` of ``a_from_b``."""
    rotation = transform.rotation.T
    return make(rotation, -rotation @ transform.translation)


def apply(transform: Transform, points_m: npt.ArrayLike) -> Floats:
    """Points (..., 3) m in frame b of ``a_from_b``, in frame a."""
    points = np.asarray(points_m, dtype=np.float64)
    return np.asarray(points @ transform.rotation.T + transform.translation, dtype=np.float64)


def rotation_distance_rad(first: npt.ArrayLike, second: npt.ArrayLike) -> float:
    """Angle 0..pi rad of the turn that takes one (3, 3) rotation to the other.

    From sine and cosine both, because the arc cosine alone loses half the digits at small angles.
    """
    turn = np.asarray(first, dtype=np.float64).T @ np.asarray(second, dtype=np.float64)
    twice_sine = np.hypot.reduce(
        [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]  # 2 sin(a) times the axis
    )
    return float(np.arctan2(twice_sine, np.trace(turn) - 1.0))


def nearest_rotation(matrix: npt.ArrayLike) -> Floats:
    """The (3, 3) rotation closest to a matrix in the sum of squares (polar decomposition)."""
    u, _, vt = np.linalg.svd(np.asarray(matrix, dtype=np.float64))
    keep_handed = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(u @ vt)))])
    return np.asarray(u @ keep_handed @ vt, dtype=np.float64)


def average(transforms: tuple[Transform, ...] | list[Transform]) -> Transform:
    """The mean motion: mean translation, and the rotation nearest to the mean matrix (chordal mean).

    Raises
    ------
    ValueError
        Nothing to average.
    """
    if not transforms:
        raise ValueError("an average needs at least one transform")
    rotation = nearest_rotation(np.mean([t.rotation for t in transforms], axis=0))
    return make(rotation, np.mean([t.translation for t in transforms], axis=0))


def align(from_points_m: npt.ArrayLike, to_points_m: npt.ArrayLike) -> Transform:
    """The motion ``to_from_from`` with the least sum of squared distances (Kabsch).

    Both (N, 3) m with N >= 2, row i of both the same point. Flat point sets are turned over rather than
    mirrored. With two points the turn about their line is arbitrary.
    """
    source, target = np.asarray(from_points_m, dtype=np.float64), np.asarray(to_points_m, dtype=np.float64)
    if source.shape != target.shape or source.ndim != 2 or source.shape[0] < 2 or source.shape[1] != 3:
        raise ValueError(
            f"point sets to align must both be (N, 3) with N >= 2: {source.shape}, {target.shape}"
        )
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    rotation = nearest_rotation((target - target_mean).T @ (source - source_mean))
    return make(rotation, target_mean - rotation @ source_mean)
