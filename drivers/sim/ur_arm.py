"""The moving part of the simulated UR controller: posture, tool, one motion at a time, and what slows it.

Nothing here knows programs, safety or sockets; `UrArm.step` is told the time and who holds the arm is told by
`UrArm.hold`. Base frame, metres, radians, seconds.
"""

from __future__ import annotations

import math

from drivers.sim.ur_kinematics import (
    LIMIT_RAD,
    Links,
    Placement,
    Six,
    Three,
    compose,
    distance,
    forward,
    inverse,
    placement_of,
    pose_of,
    postures,
    rotation_vector,
    six,
)
from drivers.sim.ur_motion import CannotFollow, JointWay, LineWay, Motion, Way

ZERO: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
RAMP_S = 0.1
"""From full speed to a hold, and back. Assumed; a real arm's depends on load and speed."""
STEADY_S = 0.1
"""Resting this long counts as steady. Assumed."""
SLOWEST = 1e-6
TOO_FAST = 1.05
"""A joint that would have to turn faster than its limit by this factor trips a protective stop."""


class UrArm:
    """Where the arm is, where it goes, and how fast it may."""

    def __init__(self, links: Links, q: Six, tcp: Six) -> None:
        self.links = links
        self.q = q
        self.qd: Six = ZERO
        self.tool_speed: Six = ZERO
        self.moves_started = 0
        self.moves_finished = 0
        self.distance_m = 0.0
        self.slider = 1.0
        self.slow = 1.0
        self.fraction = 1.0  # of full speed, in force now
        self._held = False
        self._motion: Motion | None = None
        self._rested_s = STEADY_S
        self._speed_limits = tuple(limit * TOO_FAST for limit in links.fastest_rad_s)
        self.set_tcp(tcp)

    # ------------------------------------------------------------------ what is

    @property
    def motion(self) -> Motion | None:
        """The motion being gone; held ones included."""
        return self._motion

    @property
    def resting(self) -> bool:
        """Nothing turns now, whether or not a motion is held."""
        return self._motion is None or (self._motion.speed == 0.0 and self.fraction == 0.0)

    @property
    def steady(self) -> bool:
        """At rest for some time."""
        return self._rested_s >= STEADY_S

    @property
    def tool(self) -> Placement:
        """base_from_tool."""
        return self._tool

    @property
    def pose(self) -> Six:
        """base_from_tool as position and rotation vector."""
        return self._pose

    @property
    def flange_pose(self) -> Six:
        """base_from_flange as position and rotation vector."""
        return pose_of(forward(self.links, self.q))

    def set_tcp(self, tcp: Six) -> None:
        """Where the tool is in the flange's frame, from now on."""
        self.tcp = tcp
        self._flange_from_tool = placement_of(tcp)
        self._take(self.q)

    def place(self, q: Six) -> None:
        """Be there; for setting up, not a motion."""
        self._take(q)

    def _take(self, q: Six) -> None:
        self.q = q
        self._tool = compose(forward(self.links, q), self._flange_from_tool)
        self._pose = pose_of(self._tool)

    # ------------------------------------------------------------------ questions

    def tool_of(self, q: Six, tcp: Six | None = None) -> Six:
        """Where the tool would be."""
        flange_from_tool = self._flange_from_tool if tcp is None else placement_of(tcp)
        return pose_of(compose(forward(self.links, q), flange_from_tool))

    def joints_for(self, pose: Six, near: Six | None = None) -> Six | None:
        """The posture nearest to ``near`` (default: where the arm is) that brings the tool there."""
        flange = compose(placement_of(pose), inverse(self._flange_from_tool))
        found = postures(self.links, flange, self.q if near is None else near)
        return found[0][1] if found else None

    @staticmethod
    def within_limits(q: Six) -> bool:
        """Whether every joint is inside its limits."""
        return all(math.isfinite(a) and abs(a) <= limit for a, limit in zip(q, LIMIT_RAD, strict=True))

    # ------------------------------------------------------------------ motions

    def joint_way(self, goal: Six) -> Way:
        """From here to these joint angles; `CannotFollow` beyond a limit."""
        if not self.within_limits(goal):
            raise CannotFollow("a joint target lies outside the joint limits")
        return JointWay(self.q, goal)

    def line_way(self, pose: Six) -> Way:
        """From here in a straight line; whether all of it can be gone shows on the way."""
        if not all(map(math.isfinite, pose)):
            raise CannotFollow("the target is not six finite numbers")
        return LineWay(self.links, self.q, placement_of(pose), self._flange_from_tool)

    def start(self, way: Way, speed: float, accel: float) -> None:
        """Go this way, from rest; `CannotFollow` for a speed or an acceleration that is none."""
        if not (SLOWEST <= speed < math.inf and SLOWEST <= accel < math.inf):
            raise CannotFollow(f"speed {speed:g} and acceleration {accel:g} must be above 0")
        self._motion = Motion(way, speed, accel)
        self.moves_started += 1
        if not self._held:
            self.fraction = self.slider * self.slow

    def brake(self, decel: float) -> None:
        """Come to rest with this deceleration along the way, and forget the motion."""
        if self._motion is not None:
            self._motion.brake(max(decel, 1e-6))

    def brake_tool(self, decel_m_s2: float) -> None:
        """`brake` so that the tool slows down this much."""
        self._brake_as(decel_m_s2, math.sqrt(sum(v * v for v in self.tool_speed[:3])))

    def brake_joints(self, decel_rad_s2: float) -> None:
        """`brake` so that the fastest joint slows down this much."""
        self._brake_as(decel_rad_s2, max(map(abs, self.qd)))

    def brake_within(self, seconds: float) -> None:
        """`brake` so that it rests after this time."""
        if self._motion is not None:
            self.brake(max(self._motion.speed, 1e-6) / seconds)

    def _brake_as(self, decel: float, speed: float) -> None:
        if self._motion is not None:
            along = self._motion.speed
            self.brake(decel * along / speed if speed > 1e-9 and along > 0.0 else 1e6)

    def hold(self, held: bool) -> None:
        """Stop on the way and keep the motion, or let it go on."""
        self._held = held

    def forget(self) -> None:
        """Drop a motion that rests on a hold."""
        self._motion = None
        self.qd = self.tool_speed = ZERO

    def step(self, dt: float) -> None:
        """Advance by ``dt`` seconds; `CannotFollow` stops it where it is."""
        motion = self._motion
        wanted = 0.0 if self._held else self.slider * self.slow
        if motion is None:
            self.fraction = wanted
            self._rested_s += dt
            return
        most = dt / RAMP_S
        self.fraction += max(-most, min(most, wanted - self.fraction))
        s_before = motion.s
        motion.step(dt, self.fraction)
        if motion.s != s_before:
            try:
                self._turn(motion.way.at(motion.s, self.q), dt)
            except CannotFollow:
                self.forget()
                raise
            self._rested_s = 0.0
        else:
            self.qd = self.tool_speed = ZERO
            self._rested_s += dt
        if motion.at_rest:
            self.moves_finished += int(motion.arrived)
            self.forget()

    def _turn(self, q: Six, dt: float) -> None:
        qd = six([(b - a) / dt for a, b in zip(self.q, q, strict=True)])
        for joint, (speed, limit) in enumerate(zip(qd, self._speed_limits, strict=True)):
            if abs(speed) > limit:
                raise CannotFollow(f"joint {joint + 1} would have to turn at {speed:.2f} rad/s")
        before = self._tool
        self._take(q)
        self.qd = qd
        moved = distance(before.origin, self._tool.origin)
        self.distance_m += moved
        vx, vy, vz = ((b - a) / dt for a, b in zip(before.origin, self._tool.origin, strict=True))
        wx, wy, wz = (w / dt for w in _turn_between(before, self._tool))
        self.tool_speed = (vx, vy, vz, wx, wy, wz)


def _turn_between(before: Placement, after: Placement) -> Three:
    """The rotation vector, base frame, from one placement to the next."""
    bare = Placement(before.x, before.y, before.z, (0.0, 0.0, 0.0))
    return rotation_vector(compose(after, inverse(bare)))
