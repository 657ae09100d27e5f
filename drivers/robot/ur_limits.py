"""What an arm is never asked to do, checked before the library sees it; and when a target is reached.

The library passes lists of any length on to the controller, and NaN as well.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from drivers.robot.ur_postures import MODELS, joint_frames, postures
from drivers.settings import UrRobotSettings
from drivers.types import JointMotion, LineMotion, Six

MAX_SPEED_M_S: Final = 3.0
MAX_ACCEL_M_S2: Final = 20.0
MAX_SPEED_RAD_S: Final = math.pi
MAX_ACCEL_RAD_S2: Final = 40.0
JOINT_LIMIT_RAD: Final = (2 * math.pi, 2 * math.pi, math.pi, 2 * math.pi, 2 * math.pi, 2 * math.pi)
"""Of every arm of the series; a narrower limit in the safety configuration stops the arm by itself."""

LINE_TOLERANCE_M: Final = 0.001
LINE_TOLERANCE_RAD: Final = 0.005
JOINT_TOLERANCE_RAD: Final = 0.002

Matrix = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Geometry:
    """Arm, tool and the box the tool may be in. Offline: the nominal arm, without its factory calibration."""

    model: str
    tcp: Six
    box_min_m: tuple[float, float, float]
    box_max_m: tuple[float, float, float]

    @staticmethod
    def of(settings: UrRobotSettings) -> Geometry:
        """Of a configured arm."""
        return Geometry(
            model=settings.model,
            tcp=settings.tcp_m_rad,
            box_min_m=settings.tool_box_min_m,
            box_max_m=settings.tool_box_max_m,
        )

    def tool_at(self, q_rad: Six) -> Six:
        """Where the tool is at these joint angles."""
        flange = joint_frames(MODELS[self.model], np.array(q_rad))[6]
        return six_of(np.asarray(flange @ matrix_of(self.tcp)))

    def some_posture(self, tool: Six) -> bool:
        """Whether some posture within the joint limits brings the tool there."""
        flange = matrix_of(tool) @ np.linalg.inv(matrix_of(self.tcp))
        # angles are in -pi..pi there, which is within every joint's limit
        return not bool(np.isnan(postures(MODELS[self.model], flange[None]).q_rad).all())

    def outside(self, tool: Six) -> str | None:
        """Where a tool position leaves the box; None inside."""
        for axis, value, low, high in zip("xyz", tool, self.box_min_m, self.box_max_m, strict=False):
            if not low <= value <= high:
                return f"{axis} = {value:.4f} m is outside the tool box ({low:g} to {high:g} m)"
        return None


def matrix_of(pose: Six) -> Matrix:
    """(4, 4) of a position and a rotation vector (Rodrigues 1840)."""
    matrix = np.eye(4)
    rotation = np.array(pose[3:])
    angle = float(np.linalg.norm(rotation))
    if angle > 1e-12:
        x, y, z = rotation / angle
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        matrix[:3, :3] += math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross
    matrix[:3, 3] = pose[:3]
    return matrix


def six_of(matrix: Matrix) -> Six:
    """Position and rotation vector of a (4, 4), by the largest part of its quaternion (Shepperd 1978)."""
    r = matrix[:3, :3]
    four = np.array(
        [
            1.0 + r[0, 0] + r[1, 1] + r[2, 2],
            1.0 + r[0, 0] - r[1, 1] - r[2, 2],
            1.0 - r[0, 0] + r[1, 1] - r[2, 2],
            1.0 - r[0, 0] - r[1, 1] + r[2, 2],
        ]
    )
    largest = int(np.argmax(four))
    symmetric, skew = r + r.T, np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    if largest == 0:
        w, vector = four[0], skew
    else:
        i = largest - 1
        w, vector = skew[i], symmetric[i].copy()
        vector[i] = four[largest]
    norm = float(np.linalg.norm(vector))
    angle = 2.0 * math.atan2(norm, abs(float(w)))
    turned = vector * (math.copysign(angle, float(w)) / norm) if norm > 1e-12 else np.zeros(3)
    x, y, z = (float(v) for v in matrix[:3, 3])
    rx, ry, rz = (float(v) for v in turned)
    return (x, y, z, rx, ry, rz)


def refused_line(target: Six, motion: LineMotion, geometry: Geometry) -> str | None:
    """Why a line is not even asked for; None when it may be."""
    return (
        _not_six(target, "target")
        or _not_within("speed_m_s", motion.speed_m_s, MAX_SPEED_M_S)
        or _not_within("accel_m_s2", motion.accel_m_s2, MAX_ACCEL_M_S2)
        or _not_within("timeout_s", motion.timeout_s, 3600.0)
        or geometry.outside(target)
    )


def refused_joints(q_rad: Six, motion: JointMotion, geometry: Geometry) -> str | None:
    """Why a motion through joint space is not even asked for; None when it may be."""
    refused = (
        _not_six(q_rad, "joint angles")
        or _not_within("speed_rad_s", motion.speed_rad_s, MAX_SPEED_RAD_S)
        or _not_within("accel_rad_s2", motion.accel_rad_s2, MAX_ACCEL_RAD_S2)
        or _not_within("timeout_s", motion.timeout_s, 3600.0)
    )
    if refused is not None:
        return refused
    for number, (q, limit) in enumerate(zip(q_rad, JOINT_LIMIT_RAD, strict=True)):
        if abs(q) > limit:
            return f"joint {number} at {q:.3f} rad is beyond its limit of {limit:.3f} rad"
    return geometry.outside(geometry.tool_at(q_rad))


def _not_six(values: tuple[float, ...], what: str) -> str | None:
    if len(values) != 6:
        return f"{what}: {len(values)} numbers instead of six"
    if not all(math.isfinite(v) for v in values):
        return f"{what}: not finite: {list(values)}"
    return None


def _not_within(what: str, value: float, limit: float) -> str | None:
    return None if 0.0 < value <= limit else f"{what} {value:g} is not above 0 and at most {limit:g}"


def line_missed(target: Six, tool: Six) -> str | None:
    """What is missing from the tool to its target; None within tolerance."""
    apart_m = math.dist(target[:3], tool[:3])
    between = matrix_of(target)[:3, :3].T @ matrix_of(tool)[:3, :3]
    turned = math.acos(min(1.0, max(-1.0, (float(np.trace(between)) - 1.0) / 2.0)))
    if apart_m > LINE_TOLERANCE_M or turned > LINE_TOLERANCE_RAD:
        return f"{1000 * apart_m:.1f} mm and {math.degrees(turned):.2f} deg from the target"
    return None


def joints_missed(target: Six, q_rad: Six) -> str | None:
    """What is missing from the joints to their target; None within tolerance."""
    apart = max(abs(a - b) for a, b in zip(target, q_rad, strict=True))
    return (
        None if apart <= JOINT_TOLERANCE_RAD else f"a joint is {math.degrees(apart):.2f} deg from the target"
    )
