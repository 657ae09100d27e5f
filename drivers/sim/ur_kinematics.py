"""Kinematics of UR3e, UR5e and UR10e in plain Python: forward and all inverse postures in closed form.

Denavit-Hartenberg parameters as Universal Robots publishes them ("DH Parameters for calculations of
kinematics and dynamics"); a real arm carries a calibration of its own, one or two millimetres off. The
inverse is written out from that chain: the wrist centre gives joint 1, the hand's axis joint 5, the rest is a
triangle in the arm's plane. Tested against ur-analytic-ik, which nobody here wrote. Metres and radians.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

Three: TypeAlias = tuple[float, float, float]
Six: TypeAlias = tuple[float, float, float, float, float, float]
Branch: TypeAlias = tuple[int, int, int]
"""Which of two shoulders, wrists and elbows: each +1 or -1."""

TURN = 2.0 * math.pi
BRANCHES: tuple[Branch, ...] = tuple((s, w, e) for s in (1, -1) for w in (1, -1) for e in (1, -1))


class Placement(NamedTuple):
    """Where a frame is: its three axes and its origin, in another frame."""

    x: Three
    y: Three
    z: Three
    origin: Three


@dataclass(frozen=True, slots=True, kw_only=True)
class Links:
    """One model. ``fastest_rad_s`` each joint's limit, ``payload_kg`` the largest load."""

    name: str
    d1: float
    a2: float
    a3: float
    d4: float
    d5: float
    d6: float
    fastest_rad_s: Six
    payload_kg: float


_HALF = math.pi
_SLOWER = math.radians(120.0)
_WRIST = TURN
MODELS = {
    "UR3e": Links(
        name="UR3e",
        d1=0.15185,
        a2=-0.24355,
        a3=-0.2132,
        d4=0.13105,
        d5=0.08535,
        d6=0.0921,
        fastest_rad_s=(_HALF, _HALF, _HALF, _WRIST, _WRIST, _WRIST),
        payload_kg=3.0,
    ),
    "UR5e": Links(
        name="UR5e",
        d1=0.1625,
        a2=-0.425,
        a3=-0.3922,
        d4=0.1333,
        d5=0.0997,
        d6=0.0996,
        fastest_rad_s=(_HALF, _HALF, _HALF, _HALF, _HALF, _HALF),
        payload_kg=5.0,
    ),
    "UR10e": Links(
        name="UR10e",
        d1=0.1807,
        a2=-0.6127,
        a3=-0.57155,
        d4=0.17415,
        d5=0.11985,
        d6=0.11655,
        fastest_rad_s=(_SLOWER, _SLOWER, _HALF, _HALF, _HALF, _HALF),
        payload_kg=12.5,
    ),
}
LIMIT_RAD: Six = (TURN, TURN, math.pi, TURN, TURN, TURN)
"""Joint limits; the elbow turns half as far as the others."""


def six(values: list[float] | tuple[float, ...]) -> Six:
    """Exactly six numbers as a `Six`; `ValueError` otherwise."""
    a, b, c, d, e, f = values
    return (a, b, c, d, e, f)


# ------------------------------------------------------------------ rotations and placements


def dot(a: Three, b: Three) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def distance(a: Three, b: Three) -> float:
    """Length of the way between two points."""
    return math.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)


def placement_of(pose: Six) -> Placement:
    """x, y, z in metres and a rotation vector in radians to a placement (Rodrigues' formula)."""
    x, y, z, rx, ry, rz = pose
    angle = math.sqrt(rx * rx + ry * ry + rz * rz)
    if angle < 1e-12:
        return Placement((1.0, rz, -ry), (-rz, 1.0, rx), (ry, -rx, 1.0), (x, y, z))
    kx, ky, kz = rx / angle, ry / angle, rz / angle
    c, s = math.cos(angle), math.sin(angle)
    v = 1.0 - c
    return Placement(
        (c + kx * kx * v, ky * kx * v + kz * s, kz * kx * v - ky * s),
        (kx * ky * v - kz * s, c + ky * ky * v, kz * ky * v + kx * s),
        (kx * kz * v + ky * s, ky * kz * v - kx * s, c + kz * kz * v),
        (x, y, z),
    )


def rotation_vector(placement: Placement) -> Three:
    """The rotation of a placement as a vector of length 0 to pi, by way of the unit quaternion."""
    (m00, m10, m20), (m01, m11, m21), (m02, m12, m22), _ = placement
    trace = m00 + m11 + m22
    if trace > 0.0:
        w, x, y, z = 1.0 + trace, m21 - m12, m02 - m20, m10 - m01
    elif m00 >= m11 and m00 >= m22:
        w, x, y, z = m21 - m12, 1.0 + m00 - m11 - m22, m01 + m10, m02 + m20
    elif m11 >= m22:
        w, x, y, z = m02 - m20, m01 + m10, 1.0 - m00 + m11 - m22, m12 + m21
    else:
        w, x, y, z = m10 - m01, m02 + m20, m12 + m21, 1.0 - m00 - m11 + m22
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    sine = math.sqrt(x * x + y * y + z * z)
    if sine < 1e-12 * w:
        return (2.0 * x / w, 2.0 * y / w, 2.0 * z / w)
    factor = 2.0 * math.atan2(sine, w) / sine
    return (x * factor, y * factor, z * factor)


def pose_of(placement: Placement) -> Six:
    """A placement as x, y, z and a rotation vector."""
    x, y, z = placement.origin
    rx, ry, rz = rotation_vector(placement)
    return (x, y, z, rx, ry, rz)


def turned(placement: Placement, v: Three) -> Three:
    """A direction given in the placed frame, in the frame outside."""
    x, y, z, _ = placement
    a, b, c = v
    return (
        x[0] * a + y[0] * b + z[0] * c,
        x[1] * a + y[1] * b + z[1] * c,
        x[2] * a + y[2] * b + z[2] * c,
    )


def compose(outer: Placement, inner: Placement) -> Placement:
    """a_from_b and b_from_c to a_from_c."""
    p, o = turned(outer, inner.origin), outer.origin
    return Placement(
        turned(outer, inner.x),
        turned(outer, inner.y),
        turned(outer, inner.z),
        (p[0] + o[0], p[1] + o[1], p[2] + o[2]),
    )


def inverse(placement: Placement) -> Placement:
    """b_from_a of an a_from_b."""
    x, y, z, o = placement
    return Placement(
        (x[0], y[0], z[0]), (x[1], y[1], z[1]), (x[2], y[2], z[2]), (-dot(x, o), -dot(y, o), -dot(z, o))
    )


# ------------------------------------------------------------------ the arm


def forward(links: Links, q: Six) -> Placement:
    """base_from_flange of six joint angles."""
    s1, c1, s2, c2 = math.sin(q[0]), math.cos(q[0]), math.sin(q[1]), math.cos(q[1])
    s23, c23 = math.sin(q[1] + q[2]), math.cos(q[1] + q[2])
    s234, c234 = math.sin(q[1] + q[2] + q[3]), math.cos(q[1] + q[2] + q[3])
    s5, c5, s6, c6 = math.sin(q[4]), math.cos(q[4]), math.sin(q[5]), math.cos(q[5])
    # the arm's plane: (c1, s1, 0) outwards, (0, 0, 1) up, (s1, -c1, 0) across
    x4, z4 = (c234 * c1, c234 * s1, s234), (s234 * c1, s234 * s1, -c234)
    x5 = (c5 * x4[0] + s5 * s1, c5 * x4[1] - s5 * c1, c5 * x4[2])
    z5 = (-s5 * x4[0] + c5 * s1, -s5 * x4[1] - c5 * c1, -s5 * x4[2])
    out = links.a2 * c2 + links.a3 * c23
    up = links.d1 + links.a2 * s2 + links.a3 * s23
    d4, d5, d6 = links.d4, links.d5, links.d6
    return Placement(
        (c6 * x5[0] - s6 * z4[0], c6 * x5[1] - s6 * z4[1], c6 * x5[2] - s6 * z4[2]),
        (-s6 * x5[0] - c6 * z4[0], -s6 * x5[1] - c6 * z4[1], -s6 * x5[2] - c6 * z4[2]),
        z5,
        (
            out * c1 + d4 * s1 + d5 * z4[0] + d6 * z5[0],
            out * s1 - d4 * c1 + d5 * z4[1] + d6 * z5[1],
            up + d5 * z4[2] + d6 * z5[2],
        ),
    )


def posture(links: Links, flange: Placement, branch: Branch, near: Six) -> Six | None:
    """The joint angles of one branch that bring the flange there, each turn nearest to ``near``.

    None when the branch cannot reach it, or only beyond a joint limit. In the singularity of the wrist the
    last joint stays where ``near`` has it.
    """
    x6, y6, z6, p = flange
    wx, wy = p[0] - links.d6 * z6[0], p[1] - links.d6 * z6[1]
    reach = math.hypot(wx, wy)
    if reach < links.d4:
        return None
    lean = math.asin(links.d4 / reach)
    q1 = math.atan2(wy, wx) + (lean if branch[0] > 0 else math.pi - lean)
    s1, c1 = math.sin(q1), math.cos(q1)
    across_x, across_y = x6[0] * s1 - x6[1] * c1, y6[0] * s1 - y6[1] * c1
    s5, c5 = branch[1] * math.hypot(across_x, across_y), z6[0] * s1 - z6[1] * c1
    q5 = math.atan2(s5, c5)  # not acos, which is blind near the singularity
    q6 = near[5] if abs(s5) < 1e-7 else math.atan2(-across_y / s5, across_x / s5)
    s6, c6 = math.sin(q6), math.cos(q6)
    x5 = (c6 * x6[0] - s6 * y6[0], c6 * x6[1] - s6 * y6[1], c6 * x6[2] - s6 * y6[2])
    z4 = (-s6 * x6[0] - c6 * y6[0], -s6 * x6[1] - c6 * y6[1], -s6 * x6[2] - c6 * y6[2])
    sum234 = math.atan2(
        c5 * x5[2] - s5 * z6[2], c1 * (c5 * x5[0] - s5 * z6[0]) + s1 * (c5 * x5[1] - s5 * z6[1])
    )
    out = c1 * (wx - links.d5 * z4[0]) + s1 * (wy - links.d5 * z4[1])
    up = p[2] - links.d6 * z6[2] - links.d5 * z4[2] - links.d1
    a2, a3 = links.a2, links.a3
    c3 = (out * out + up * up - a2 * a2 - a3 * a3) / (2.0 * a2 * a3)
    if abs(c3) > 1.0 + 1e-12:
        return None
    q3 = branch[2] * math.acos(max(-1.0, min(1.0, c3)))
    q2 = math.atan2(up, out) - math.atan2(a3 * math.sin(q3), a2 + a3 * math.cos(q3))
    found = []
    for angle, beside, limit in zip((q1, q2, q3, sum234 - q2 - q3, q5, q6), near, LIMIT_RAD, strict=True):
        turn = angle + TURN * round((beside - angle) / TURN)
        if abs(turn) > limit:
            turn -= math.copysign(TURN, turn)
            if abs(turn) > limit:
                return None
        found.append(turn)
    return six(found)


def postures(links: Links, flange: Placement, near: Six) -> list[tuple[Branch, Six]]:
    """Every branch that brings the flange there, the nearest to ``near`` first."""
    found = [(b, q) for b in BRANCHES if (q := posture(links, flange, b, near)) is not None]
    found.sort(key=lambda each: max(abs(a - b) for a, b in zip(each[1], near, strict=True)))
    return found


def branch_of(links: Links, q: Six) -> Branch:
    """The branch a posture belongs to."""
    found = postures(links, forward(links, q), q)
    return found[0][0] if found else BRANCHES[0]
