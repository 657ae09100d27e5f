"""Kinematics of UR e-Series arms for many poses at once: forward, all eight inverse postures, and how far
these are from singularities. Pure: arrays in, arrays out.

Denavit-Hartenberg parameters as Universal Robots publishes them ("DH Parameters for calculations of
kinematics and dynamics"): the nominal arm. A real one carries a calibration of its own and stands one or two
millimetres beside it, so what is worked out here decides whether a place can be reached, never where the arm
is sent. The inverse follows from the chain: the wrist's centre gives joint 1, the hand's axis joint 5, the
rest is a triangle in the arm's plane (Hawkins, *Analytic Inverse Kinematics for the Universal Robots UR-5/
UR-10 Arms*, 2013). Tested against ur-analytic-ik, which nobody here wrote. Metres, radians, base frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

BRANCHES: Final = np.array([(s, w, e) for s in (1, -1) for w in (1, -1) for e in (1, -1)], dtype=np.float64)
"""(8, 3) which of two shoulders, wrists and elbows."""
_ALPHA: Final = (math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Links:
    """One model's lengths, metres; upper arm ``a2`` and forearm ``a3`` are negative by convention.

    ``fastest_rad_s`` of each joint, by the maker's data sheet.
    """

    fastest_rad_s: tuple[float, float, float, float, float, float]
    d1: float
    a2: float
    a3: float
    d4: float
    d5: float
    d6: float

    @property
    def stretched_m(self) -> float:
        """Shoulder to wrist with the elbow straight."""
        return abs(self.a2) + abs(self.a3)


_HALF, _THIRD, _TURN = math.pi, 2.0 * math.pi / 3.0, 2.0 * math.pi
MODELS: Final = {
    "UR3e": Links(
        fastest_rad_s=(_HALF, _HALF, _HALF, _TURN, _TURN, _TURN),
        d1=0.15185,
        a2=-0.24355,
        a3=-0.2132,
        d4=0.13105,
        d5=0.08535,
        d6=0.0921,
    ),
    "UR5e": Links(
        fastest_rad_s=(_HALF, _HALF, _HALF, _HALF, _HALF, _HALF),
        d1=0.1625,
        a2=-0.425,
        a3=-0.3922,
        d4=0.1333,
        d5=0.0997,
        d6=0.0996,
    ),
    "UR10e": Links(
        fastest_rad_s=(_THIRD, _THIRD, _HALF, _HALF, _HALF, _HALF),
        d1=0.1807,
        a2=-0.6127,
        a3=-0.57155,
        d4=0.17415,
        d5=0.11985,
        d6=0.11655,
    ),
}


def joint_frames(links: Links, q_rad: Floats) -> Floats:
    """(7, 4, 4) base, then the frame at the end of each link, of six joint angles; the last is the flange."""
    frames = np.empty((7, 4, 4))
    frames[0] = np.eye(4)
    a = (0.0, links.a2, links.a3, 0.0, 0.0, 0.0)
    d = (links.d1, 0.0, 0.0, links.d4, links.d5, links.d6)
    for i in range(6):
        c, s, ca, sa = math.cos(q_rad[i]), math.sin(q_rad[i]), math.cos(_ALPHA[i]), math.sin(_ALPHA[i])
        step = np.array(
            [
                [c, -s * ca, s * sa, a[i] * c],
                [s, c * ca, -c * sa, a[i] * s],
                [0.0, sa, ca, d[i]],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
        frames[i + 1] = frames[i] @ step
    return frames


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Postures:
    """All postures for N poses, in the order of `BRANCHES`.

    ``q_rad`` (N, 8, 6), each angle in -pi..pi, NaN where there is no such posture. ``needed_m`` (N, 8) what
    lies between shoulder and wrist, to be spanned by the two links; NaN where the wrist's centre lies nearer
    to the base's axis than the arm can fold: ``beside_m`` (N,) is its distance from that axis.
    """

    q_rad: Floats
    needed_m: Floats
    beside_m: Floats


def postures(links: Links, base_from_flange: Floats) -> Postures:
    """Every posture that brings the flange to each of (N, 4, 4) poses.

    >>> home = np.array([0.0, -1.5, 1.6, -1.7, -1.57, 0.3])
    >>> found = postures(MODELS["UR5e"], joint_frames(MODELS["UR5e"], home)[6][None])
    >>> bool(np.isclose(found.q_rad[0], home).all(axis=1).any())
    True
    """
    rotation, flange = base_from_flange[:, None, :3, :3], base_from_flange[:, None, :3, 3]
    shoulder, wrist, elbow = BRANCHES.T
    centre = flange - links.d6 * rotation[..., 2]
    beside = np.hypot(centre[..., 0], centre[..., 1])
    with np.errstate(invalid="ignore", divide="ignore"):
        q1 = (
            np.arctan2(centre[..., 1], centre[..., 0]) + shoulder * np.arccos(links.d4 / beside) + math.pi / 2
        )
        s1, c1 = np.sin(q1), np.cos(q1)
        across = (flange[..., 0] * s1 - flange[..., 1] * c1 - links.d4) / links.d6
        # a rounding error beyond one is the hand in line with joint 4
        q5 = wrist * np.arccos(np.where(np.abs(across) < 1.0 + 1e-9, np.clip(across, -1.0, 1.0), np.nan))
        sign = np.where(np.sin(q5) < 0.0, -1.0, 1.0)
        q6 = np.arctan2(
            sign * (-rotation[..., 0, 1] * s1 + rotation[..., 1, 1] * c1),
            sign * (rotation[..., 0, 0] * s1 - rotation[..., 1, 0] * c1),
        )
        c5, s5, c6, s6 = np.cos(q5), np.sin(q5), np.cos(q6), np.sin(q6)
        # frame 4 in the base: the hand turned back by joints 6 and 5
        x5 = rotation[..., 0] * c6[..., None] - rotation[..., 1] * s6[..., None]
        z4 = -rotation[..., 0] * s6[..., None] - rotation[..., 1] * c6[..., None]
        x4 = x5 * c5[..., None] - rotation[..., 2] * s5[..., None]
        origin4 = centre - links.d5 * z4
        # in the arm's plane: x outwards, y up
        out = np.stack([c1, s1, np.zeros_like(s1)], axis=-1)
        side = np.stack([s1, -c1, np.zeros_like(s1)], axis=-1)
        origin3 = origin4 - links.d4 * side
        x, y = (origin3 * out).sum(axis=-1), origin3[..., 2] - links.d1
        needed = np.hypot(x, y)
        c3 = (needed**2 - links.a2**2 - links.a3**2) / (2.0 * links.a2 * links.a3)
        q3 = elbow * np.arccos(c3)
        q2 = np.arctan2(y, x) - np.arctan2(links.a3 * np.sin(q3), links.a2 + links.a3 * np.cos(q3))
        q4 = np.arctan2(x4[..., 2], (x4 * out).sum(axis=-1)) - q2 - q3
        q = np.stack([q1, q2, q3, q4, q5, q6], axis=-1)
        q = (q + math.pi) % (2.0 * math.pi) - math.pi
    q[np.isnan(q).any(axis=-1)] = np.nan
    return Postures(q_rad=q, needed_m=needed, beside_m=beside[:, 0])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Distances:
    """How far (N,) postures are from the three singularities: angle of the wrist and of the elbow from being
    straight (radians), distance of the wrist's centre from the shoulder's plane (metres)."""

    wrist_rad: Floats
    elbow_rad: Floats
    shoulder_m: Floats


def distances(links: Links, q_rad: Floats) -> Distances:
    """Of (N, 6) postures. The determinant of the arm's Jacobian is their product
    ``a2 a3 sin(q3) sin(q5) (a2 cos(q2) + a3 cos(q2+q3) + d5 sin(q2+q3+q4))``, up to its sign."""
    q2, q3, q4, q5 = (q_rad[:, i] for i in range(1, 5))
    reach = links.a2 * np.cos(q2) + links.a3 * np.cos(q2 + q3) + links.d5 * np.sin(q2 + q3 + q4)
    return Distances(
        wrist_rad=np.arcsin(np.abs(np.sin(q5))),
        elbow_rad=np.arcsin(np.abs(np.sin(q3))),
        shoulder_m=np.abs(reach),
    )
