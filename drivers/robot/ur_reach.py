"""Whether a UR arm can go a way of straight lines, worked out without asking it.

The tool goes from pose to pose as the controller's straight motion does: its point along a line, its turn
evenly about one axis. On all of it the arm must stay in the posture in which it starts, away from its joint
limits, and away from the three singularities, near which a slow straight line asks for joints that race.

The nominal arm is reckoned with. A real one stands up to ``reach.calibration_m`` beside it, and the reach is
taken to be that much shorter: the elbow's margin grows where it has to.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from drivers.robot.ur_limits import JOINT_LIMIT_RAD, matrix_of
from drivers.robot.ur_postures import MODELS, Floats, Postures, distances, joint_frames, postures
from drivers.settings import UrRobotSettings
from drivers.types import JointAngles, LineMotion, NotReachable, ReachLimit, ToolPose

STEP_M: Final = 0.02
STEP_RAD: Final = 0.1
SWING_RAD: Final = 0.8
"""No joint turns further than this from one step of a line to the next, unless the posture changes."""
_TURN_RAD: Final = 2.0 * math.pi
SPEED_SHARE: Final = 0.7
ACCEL_RAD_S2: Final = 8.0
"""Of the joint that turns most along a line."""


class UrKinematics:
    """Satisfies `drivers.interfaces.Kinematics` for one configured arm."""

    def __init__(self, settings: UrRobotSettings) -> None:
        reach = settings.reach
        self._box_min_m = np.array(settings.tool_box_min_m)
        self._box_max_m = np.array(settings.tool_box_max_m)
        self._links = MODELS[settings.model]
        self._flange_from_tool = matrix_of(settings.tcp_m_rad)
        self._tool_from_flange = np.linalg.inv(self._flange_from_tool)
        limits = reach.joint_limits_rad or JOINT_LIMIT_RAD
        self._joint_rad = np.array(limits) - reach.joint_margin_rad
        self._wrist_rad = reach.wrist_margin_rad
        self._shoulder_m = reach.shoulder_margin_m
        a, b = abs(self._links.a2), abs(self._links.a3)
        sure_m = a + b - reach.calibration_m
        short_rad = math.acos((sure_m * sure_m - a * a - b * b) / (2.0 * a * b))
        self._elbow_rad = max(reach.elbow_margin_rad, short_rad)
        self._longest_m = math.sqrt(a * a + b * b + 2.0 * a * b * math.cos(self._elbow_rad))

    def refused(self, start: JointAngles, way: Sequence[ToolPose]) -> NotReachable | None:
        """What stands against going from ``start`` along straight lines through ``way``; None: nothing."""
        q = np.array(start.q_rad, dtype=np.float64)
        here = joint_frames(self._links, q)[6] @ self._flange_from_tool
        poses = [matrix_of(pose.six()) for pose in way]
        against = self._outside([here, *poses]) or self._against(q[None], 0)
        if against is not None or not way:
            return against
        lines = [_line(a, b) for a, b in itertools.pairwise([here, *poses])]
        found = postures(self._links, np.concatenate(lines) @ self._tool_from_flange)
        ends = np.cumsum([len(line) for line in lines])
        # a place nobody can reach is told as such, whatever else the way there would meet
        for leg, last in enumerate(ends - 1):
            against = self._out_of_reach(found, int(last), leg)
            if against is not None:
                return against
        begins = 0
        for leg, end in enumerate(ends):
            followed, against = self._follow(q, found, range(begins, int(end)), leg)
            # what comes first on the way is what is told
            against = (self._against(followed, leg) if len(followed) else None) or against
            if against is not None:
                return against
            q, begins = followed[-1], int(end)
        return None

    def paced(self, start: JointAngles, target: ToolPose, motion: LineMotion) -> LineMotion:
        """A line slowed until no joint has to turn faster than `SPEED_SHARE` of what it can.

        A line's speed is that of its point. A hand that turns a lot on a short line asks for joints that
        race, and the arm's safety system stops it.
        """
        q = np.array(start.q_rad, dtype=np.float64)
        here = joint_frames(self._links, q)[6] @ self._flange_from_tool
        there = matrix_of(target.six())
        length = float(np.linalg.norm(there[:3, 3] - here[:3, 3]))
        found = postures(self._links, _line(here, there) @ self._tool_from_flange)
        followed, against = self._follow(q, found, range(len(found.q_rad)), 0)
        if against is not None or length < 1e-6:
            return motion  # for the arm to refuse; or a turn on the spot, which has no speed along its line
        turned = np.abs(np.diff(np.vstack([q, followed]), axis=0)) / (length / len(followed))
        speed = SPEED_SHARE / float((turned / np.array(self._links.fastest_rad_s)).max(initial=1e-9))
        accel = ACCEL_RAD_S2 / float(turned.max(initial=1e-9))
        return replace(
            motion,
            speed_m_s=min(motion.speed_m_s, speed),
            accel_m_s2=min(motion.accel_m_s2, accel),
        )

    def _outside(self, poses: list[Floats]) -> NotReachable | None:
        """The first of the places, the start before the legs' ends, that lies outside the tool's box."""
        points = np.array([pose[:3, 3] for pose in poses])
        beyond = np.maximum(self._box_min_m - points, points - self._box_max_m).max(axis=1)
        for number, metres in enumerate(beyond):
            if metres > 0.0:
                return _not(ReachLimit.BOX, float(metres), 0.0, "m", max(0, number - 1))
        return None

    def _out_of_reach(self, found: Postures, number: int, leg: int) -> NotReachable | None:
        """Whether one pose can be reached at all, straight elbow left aside."""
        needed = found.needed_m[number]
        lengths = needed[~np.isnan(needed)]
        within = len(lengths) > 0 and lengths.min() <= self._longest_m
        if within and not np.isnan(found.q_rad[number]).all():
            return None
        return self._too_far(float(found.beside_m[number]), needed, leg)

    def _follow(
        self, q: Floats, found: Postures, numbers: range, leg: int
    ) -> tuple[Floats, NotReachable | None]:
        """(K, 6) postures for the poses of these numbers, each next to the one before; and why not all."""
        first = np.abs((found.q_rad[numbers[0]] - q + math.pi) % _TURN_RAD - math.pi).max(axis=1)
        branch = 0 if np.isnan(first).all() else int(np.nanargmin(first))
        path = found.q_rad[numbers[0] : numbers[-1] + 1, branch]
        gaps = np.isnan(path[:, 0])
        reached = int(np.argmax(gaps)) if gaps.any() else len(path)
        # a posture is the same branch all along: away from singularities the branches do not touch
        path = np.unwrap(np.vstack([q, path[:reached]]), axis=0)
        swings = np.abs(np.diff(path, axis=0)).max(axis=1, initial=0.0)
        if (swings > SWING_RAD).any():
            swung = int(np.argmax(swings > SWING_RAD))
            return path[1 : swung + 1], _not(ReachLimit.SWING, float(swings[swung]), SWING_RAD, "rad", leg)
        if reached < len(gaps):
            number = numbers[reached]
            return path[1:], self._too_far(float(found.beside_m[number]), found.needed_m[number], leg)
        return path[1:], None

    def _too_far(self, beside_m: float, needed_m: Floats, leg: int) -> NotReachable:
        if beside_m < self._links.d4:
            return _not(ReachLimit.TOO_NEAR, beside_m, self._links.d4, "m", leg)
        nearest = float(np.nanmin(needed_m))
        if nearest > self._longest_m:
            return _not(ReachLimit.TOO_FAR, nearest, self._longest_m, "m", leg)
        folded = abs(abs(self._links.a2) - abs(self._links.a3))
        return _not(ReachLimit.TOO_NEAR, float(np.nanmax(needed_m)), folded, "m", leg)

    def _against(self, q_rad: Floats, leg: int) -> NotReachable | None:
        """The first of (N, 6) postures that is too near to a limit, and which limit."""
        turned = np.abs(q_rad) - self._joint_rad
        near = distances(self._links, q_rad)
        bad = (
            (turned > 0.0).any(axis=1)
            | (near.wrist_rad < self._wrist_rad)
            | (near.elbow_rad < self._elbow_rad)
            | (near.shoulder_m < self._shoulder_m)
        )
        if not bad.any():
            return None
        i = int(np.argmax(bad))
        if (turned[i] > 0.0).any():
            joint = int(np.argmax(turned[i]))
            angle, most = float(abs(q_rad[i, joint])), float(self._joint_rad[joint])
            return _not(ReachLimit.JOINT, angle, most, "rad", leg, joint)
        if near.wrist_rad[i] < self._wrist_rad:
            return _not(ReachLimit.WRIST, float(near.wrist_rad[i]), self._wrist_rad, "rad", leg)
        if near.elbow_rad[i] < self._elbow_rad:
            return _not(ReachLimit.ELBOW, float(near.elbow_rad[i]), self._elbow_rad, "rad", leg)
        return _not(ReachLimit.SHOULDER, float(near.shoulder_m[i]), self._shoulder_m, "m", leg)


def _not(
    limit: ReachLimit, value: float, bound: float, unit: str, leg: int, joint: int | None = None
) -> NotReachable:
    return NotReachable(
        limit=limit, value=value, bound=bound, unit="m" if unit == "m" else "rad", leg=leg, joint=joint
    )


def _line(start: Floats, end: Floats) -> Floats:
    """(N, 4, 4) poses after ``start`` up to ``end``: straight, and turning evenly about one axis."""
    between = start[:3, :3].T @ end[:3, :3]
    axis, angle = _turn(between)
    way = end[:3, 3] - start[:3, 3]
    count = max(1, math.ceil(max(float(np.linalg.norm(way)) / STEP_M, angle / STEP_RAD)))
    share = np.arange(1, count + 1) / count
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, cosine = np.sin(angle * share)[:, None, None], np.cos(angle * share)[:, None, None]
    poses = np.zeros((count, 4, 4))
    poses[:, :3, :3] = start[:3, :3] @ (np.eye(3) + sine * cross + (1.0 - cosine) * cross @ cross)
    poses[:, :3, 3] = start[:3, 3] + share[:, None] * way
    poses[:, 3, 3] = 1.0
    return poses


def _turn(rotation: Floats) -> tuple[Floats, float]:
    """Axis (3,) and angle 0..pi of a rotation matrix."""
    skew = np.array(
        [
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        ]
    )
    sine, cosine = float(np.linalg.norm(skew)) / 2.0, (float(np.trace(rotation)) - 1.0) / 2.0
    if sine > 1e-6:
        return skew / (2.0 * sine), math.atan2(sine, cosine)
    if cosine > 0.0:
        return np.array([0.0, 0.0, 1.0]), 0.0
    # half a turn: the axis is the column of R + 1 with the largest length
    columns = rotation + np.eye(3)
    best = int(np.argmax(np.linalg.norm(columns, axis=0)))
    return columns[:, best] / float(np.linalg.norm(columns[:, best])), math.pi
