"""Rotations and rigid motions of the simulated cell, written apart from the detector's on purpose.

Metres and radians. A pose is a (4, 4) homogeneous matrix named ``a_from_b``. If simulation and detector
shared this code, a sign error in it would go unnoticed in every test.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from drivers.types import Six, ToolPose

Floats: TypeAlias = npt.NDArray[np.float64]
Bools: TypeAlias = npt.NDArray[np.bool_]


def cross_matrix(v: Floats) -> Floats:
    """The (3, 3) matrix that takes w to ``v`` x w."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def rotation_of(rotvec: Floats) -> Floats:
    """(3,) rotation vector, rad, to (3, 3) matrix (Rodrigues' formula)."""
    angle = float(np.linalg.norm(rotvec))
    if angle < 1e-12:
        return np.eye(3) + cross_matrix(rotvec)
    k = cross_matrix(rotvec / angle)
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * (k @ k))


def rotvec_of(rotation: Floats) -> Floats:
    """(3, 3) matrix to (3,) rotation vector, rad, of length 0..pi.

    Goes through the unit quaternion, taken from its largest component, so that half turns are exact too.
    """
    m = rotation
    squares = np.array(
        [
            1.0 + m[0, 0] + m[1, 1] + m[2, 2],
            1.0 + m[0, 0] - m[1, 1] - m[2, 2],
            1.0 - m[0, 0] + m[1, 1] - m[2, 2],
            1.0 - m[0, 0] - m[1, 1] + m[2, 2],
        ]
    )
    largest = int(np.argmax(squares))
    rows = (
        (squares[0], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]),
        (m[2, 1] - m[1, 2], squares[1], m[1, 0] + m[0, 1], m[0, 2] + m[2, 0]),
        (m[0, 2] - m[2, 0], m[1, 0] + m[0, 1], squares[2], m[2, 1] + m[1, 2]),
        (m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[2, 1] + m[1, 2], squares[3]),
    )
    q = np.array(rows[largest], dtype=np.float64)
    q /= np.linalg.norm(q)
    if q[0] < 0.0:
        q = -q
    sine = float(np.linalg.norm(q[1:]))
    if sine < 1e-12:
        return np.asarray(2.0 * q[1:])
    return np.asarray(q[1:] * (2.0 * np.arctan2(sine, q[0]) / sine))


def pose_matrix(six: Six) -> Floats:
    """Six numbers (x, y, z m; rx, ry, rz rad, rotation vector) to a (4, 4) matrix."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_of(np.array(six[3:], dtype=np.float64))
    matrix[:3, 3] = six[:3]
    return matrix


def tool_pose(matrix: Floats) -> ToolPose:
    """(4, 4) base_from_tool to the record that crosses the driver border."""
    x, y, z = (float(v) for v in matrix[:3, 3])
    rx, ry, rz = (float(v) for v in rotvec_of(matrix[:3, :3]))
    return ToolPose(x=x, y=y, z=z, rx=rx, ry=ry, rz=rz)


def inverse(matrix: Floats) -> Floats:
    """b_from_a of an a_from_b, (4, 4)."""
    back = np.eye(4)
    back[:3, :3] = matrix[:3, :3].T
    back[:3, 3] = -matrix[:3, :3].T @ matrix[:3, 3]
    return back


def apply(matrix: Floats, points: Floats) -> Floats:
    """a_from_b times points (..., 3) in b: points in a."""
    return np.asarray(points @ matrix[:3, :3].T + matrix[:3, 3])


def looking_at(position: Floats, target: Floats, roll_rad: float) -> Floats:
    """base_from_camera (4, 4) of a camera at ``position`` that sees ``target`` in the middle.

    With no roll the picture's x axis lies level and as near to the base's x axis as that allows; a roll
    turns the camera about its own viewing direction.
    """
    z = (target - position) / np.linalg.norm(target - position)
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z
    x /= np.linalg.norm(x)
    matrix = np.eye(4)
    matrix[:3, :3] = np.column_stack([x, np.cross(z, x), z]) @ rotation_of(np.array([0.0, 0.0, roll_rad]))
    matrix[:3, 3] = position
    return matrix


def segment_distance(a0: Floats, a1: Floats, b0: Floats, b1: Floats) -> float:
    """Shortest distance of two segments in space, m (Ericson, Real-Time Collision Detection, 5.1.9)."""
    d1, d2, r = a1 - a0, b1 - b0, a0 - b0
    a, e, f = float(d1 @ d1), float(d2 @ d2), float(d2 @ r)
    b, c = float(d1 @ d2), float(d1 @ r)
    denominator = a * e - b * b
    s = min(1.0, max(0.0, (b * f - c * e) / denominator)) if denominator > 1e-18 else 0.0
    t = (b * s + f) / e
    if t < 0.0:
        t, s = 0.0, min(1.0, max(0.0, -c / a))
    elif t > 1.0:
        t, s = 1.0, min(1.0, max(0.0, (b - c) / a))
    return float(np.linalg.norm(r + d1 * s - d2 * t))
