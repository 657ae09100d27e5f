"""A UR5e-sized arm: kinematics, and motions advanced by a deterministic `Arm.step`.

Kinematics: the maker's published Denavit-Hartenberg parameters of the UR5e (a, d, alpha below), without the
calibration a real arm brings. Inverse kinematics is numeric (damped least squares, Nakamura and Hanafusa
1986), starts where the arm is and gives the same answer for the same question.
Base frame, metres, radians, seconds of simulated time.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from drivers.sim.geometry import Floats, pose_matrix, rotation_of, rotvec_of
from drivers.sim.layout import ArmLayout
from drivers.types import JointAngles, SafetyMode, Six, ToolPose

DH_A_M = (0.0, -0.425, -0.3922, 0.0, 0.0, 0.0)
DH_D_M = (0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996)
DH_ALPHA = (np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0)
LIMIT_RAD = np.array([2.0, 2.0, 1.0, 2.0, 2.0, 2.0]) * np.pi
"""Joint limits; the elbow turns half as far as the others."""

WAYPOINT_M = 0.005
WAYPOINT_RAD = 0.04
JUMP_RAD = 0.35
"""A line whose joints turn further than this between two waypoints runs through a singularity."""


class Refused(Exception):
    """The arm says no: unreachable, or not in a state to move."""


class MotionEnd(Enum):
    """How far a motion is. Values go over the wire."""

    RUNNING = "running"
    DONE = "done"
    HALTED = "halted"
    SAFETY = "safety"


def _link(a_m: float, d_m: float, alpha: float, angle: float) -> Floats:
    ca, sa, ct, st = np.cos(alpha), np.sin(alpha), np.cos(angle), np.sin(angle)
    return np.array(
        [
            [ct, -st * ca, st * sa, a_m * ct],
            [st, ct * ca, -ct * sa, a_m * st],
            [0.0, sa, ca, d_m],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def link_frames(q_rad: Floats) -> Floats:
    """(7, 4, 4): base, then the frame at the end of each link; the last one is the flange."""
    frames = np.empty((7, 4, 4))
    frames[0] = np.eye(4)
    for i in range(6):
        frames[i + 1] = frames[i] @ _link(DH_A_M[i], DH_D_M[i], DH_ALPHA[i], q_rad[i])
    return frames


def forward(q_rad: Floats, flange_from_tool: Floats) -> Floats:
    """base_from_tool (4, 4) of six joint angles."""
    return np.asarray(link_frames(q_rad)[6] @ flange_from_tool)


def _error(goal: Floats, now: Floats) -> Floats:
    """(6,) what is missing from ``now`` to ``goal``: metres, then rotation vector, base frame."""
    return np.concatenate([goal[:3, 3] - now[:3, 3], rotvec_of(goal[:3, :3] @ now[:3, :3].T)])


def inverse_kinematics(
    goal: Floats, seed_rad: Floats, flange_from_tool: Floats, iterations: int = 60
) -> Floats | None:
    """Joint angles (6,) that bring the tool to ``goal`` (4, 4 base_from_tool), or None.

    Damped least squares from ``seed_rad``; the damping follows the error, so it is Newton's method near the
    goal and careful far away. Accepted below 1 micrometre and 1 microradian, within the joint limits.
    """
    q = np.array(seed_rad, dtype=np.float64)
    for _ in range(iterations):
        frames = link_frames(q)
        tool = frames[6] @ flange_from_tool
        error = _error(goal, tool)
        if np.abs(error[:3]).max() < 1e-6 and np.abs(error[3:]).max() < 1e-6:
            return q if bool(np.all(np.abs(q) <= LIMIT_RAD)) else None
        axes = frames[:6, :3, 2]
        jacobian = np.vstack([np.cross(axes, tool[:3, 3] - frames[:6, :3, 3]).T, axes.T])
        damping = 1e-8 + 2e-2 * float(error @ error)
        step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + damping * np.eye(6), error)
        q = q + step * min(1.0, 0.5 / max(float(np.abs(step).max()), 1e-12))
    return None


def find_joints(goal: Floats, here_rad: Floats, flange_from_tool: Floats) -> Floats | None:
    """`inverse_kinematics` from where the arm is, then from a few fixed postures towards the goal."""
    bearing = float(np.arctan2(-goal[1, 3], -goal[0, 3]))
    seeds = [here_rad]
    for base in (bearing, bearing + 0.35):
        for wrist in (0.0, np.pi / 2, -np.pi / 2):
            seeds.append(np.array([base, -1.6, 1.9, -1.9, -np.pi / 2, wrist]))
    for seed in seeds:
        found = inverse_kinematics(goal, seed, flange_from_tool)
        if found is not None:
            return found
    return None


@dataclass(slots=True)
class _Motion:
    """A path through joint space with a trapezoid of speed along its length 0..1."""

    waypoints: Floats  # (N, 6), evenly spaced along the path
    speed: float  # paths per second
    accel: float  # paths per second squared
    elapsed_s: float = 0.0
    at: float = 0.0
    rate: float = 0.0
    braking: float = 0.0  # deceleration once halted, 0 while it is not

    def duration_s(self) -> float:
        if self.speed**2 / self.accel >= 1.0:
            return float(2.0 * np.sqrt(1.0 / self.accel))
        return 1.0 / self.speed + self.speed / self.accel

    def profile(self, t: float) -> float:
        """Where on the path, 0..1, after ``t`` seconds."""
        total = self.duration_s()
        if t >= total:
            return 1.0
        ramp = min(self.speed / self.accel, 0.5 * total)
        if t < ramp:
            return 0.5 * self.accel * t * t
        if t > total - ramp:
            return 1.0 - 0.5 * self.accel * (total - t) ** 2
        return 0.5 * self.accel * ramp * ramp + self.accel * ramp * (t - ramp)

    def step(self, dt: float) -> bool:
        """Advance; True when it rests, at the goal or where it was halted."""
        if self.braking > 0.0:
            used = min(dt, self.rate / self.braking)
            self.at = min(1.0, self.at + self.rate * used - 0.5 * self.braking * used * used)
            self.rate -= self.braking * used
            return self.rate <= 1e-9
        self.elapsed_s += dt
        before, self.at = self.at, self.profile(self.elapsed_s)
        if dt > 0.0:
            self.rate = (self.at - before) / dt
        return self.at >= 1.0

    def joints(self) -> Floats:
        place = self.at * (len(self.waypoints) - 1)
        i = min(int(place), len(self.waypoints) - 2)
        w = place - i
        return np.asarray((1.0 - w) * self.waypoints[i] + w * self.waypoints[i + 1])


class Arm:
    """Joint angles, one motion at a time, and a safety state. Time is what `step` is told."""

    def __init__(self, layout: ArmLayout) -> None:
        self._layout = layout
        self.flange_from_tool = pose_matrix(layout.tcp_m_rad)
        self.q = np.array(layout.start_q_rad, dtype=np.float64)
        self.safety = SafetyMode.NORMAL
        self.motions_started = 0
        self._motion: _Motion | None = None
        self._last = MotionEnd.DONE
        self._led = False

    @property
    def moving(self) -> bool:
        """True from the acceptance of a motion until the arm rests, or while it is led."""
        return self._motion is not None or self._led

    @property
    def led(self) -> bool:
        """Moving after somebody else's joint angles."""
        return self._led

    @property
    def motion_state(self) -> MotionEnd:
        """How the latest motion stands."""
        return MotionEnd.RUNNING if self._motion is not None else self._last

    def base_from_flange(self) -> Floats:
        """(4, 4) where the flange is."""
        return np.asarray(link_frames(self.q)[6])

    def base_from_tool(self) -> Floats:
        """(4, 4) where the tool is."""
        return forward(self.q, self.flange_from_tool)

    def reachable(self, target: ToolPose) -> bool:
        """Whether some posture brings the tool there. Says nothing of the way."""
        return find_joints(pose_matrix(target.six()), self.q, self.flange_from_tool) is not None

    def start_line(self, target: ToolPose, speed_m_s: float, accel_m_s2: float) -> None:
        """Move the tool along a straight line, turning evenly on the way.

        The whole line is solved first; raises `Refused` if any of it cannot be reached without a jump.
        """
        self._ready(speed_m_s, accel_m_s2)
        start, goal = self.base_from_tool(), pose_matrix(target.six())
        way = goal[:3, 3] - start[:3, 3]
        turn = rotvec_of(goal[:3, :3] @ start[:3, :3].T)
        distance, angle = float(np.linalg.norm(way)), float(np.linalg.norm(turn))
        count = max(1, int(np.ceil(max(distance / WAYPOINT_M, angle / WAYPOINT_RAD))))
        waypoints = [self.q]
        for i in range(1, count + 1):
            pose = np.eye(4)
            pose[:3, :3] = rotation_of(turn * (i / count)) @ start[:3, :3]
            pose[:3, 3] = start[:3, 3] + way * (i / count)
            q = inverse_kinematics(pose, waypoints[-1], self.flange_from_tool, iterations=20)
            if q is None:
                raise Refused(f"the line cannot be followed beyond {100 * (i - 1) // count} % of its way")
            if float(np.abs(q - waypoints[-1]).max()) > JUMP_RAD:
                raise Refused(f"the line runs through a singularity at {100 * i // count} % of its way")
            waypoints.append(q)
        slowest = max(distance, 1e-9)
        speed = min(speed_m_s / slowest, self._layout.turn_speed_rad_s / max(angle, 1e-9))
        accel = min(accel_m_s2 / slowest, 4.0 * self._layout.turn_speed_rad_s / max(angle, 1e-9))
        self._begin(np.array(waypoints), speed, accel)

    def start_joints(self, target: JointAngles, speed_rad_s: float, accel_rad_s2: float) -> None:
        """Turn all joints evenly; the one with the longest way sets the pace."""
        self._ready(speed_rad_s, accel_rad_s2)
        goal = np.array(target.q_rad, dtype=np.float64)
        if bool(np.any(np.abs(goal) > LIMIT_RAD)):
            raise Refused("a joint target lies outside the joint limits")
        longest = max(float(np.abs(goal - self.q).max()), 1e-9)
        self._begin(np.array([self.q, goal]), speed_rad_s / longest, accel_rad_s2 / longest)

    def _ready(self, speed: float, accel: float) -> None:
        if self.safety not in (SafetyMode.NORMAL, SafetyMode.REDUCED):
            raise Refused(f"safety mode is {self.safety.name}")
        if self._motion is not None:
            raise Refused("still moving")
        if not (speed > 0.0 and accel > 0.0):
            raise Refused("speed and acceleration must be positive")

    def _begin(self, waypoints: Floats, speed: float, accel: float) -> None:
        self._motion = _Motion(waypoints=waypoints, speed=speed, accel=accel)
        self.motions_started += 1

    def lead(self, q_rad: Floats, moving: bool) -> None:
        """Be where another arm is: a controller outside moves this one."""
        self._motion = None
        self.motions_started += int(moving and not self._led)
        self.q, self._led = np.array(q_rad, dtype=np.float64), moving

    def halt(self) -> None:
        """Come to rest on the path, from full speed within the layout's time."""
        if self._motion is not None and self._motion.braking == 0.0:
            self._motion.braking = max(self._motion.rate, 1e-9) / self._layout.stop_decel_s

    def stop_for_safety(self, mode: SafetyMode) -> None:
        """Stand still at once in ``mode``; the motion is lost."""
        self.safety = mode
        if self._motion is not None:
            self._motion, self._last = None, MotionEnd.SAFETY

    def step(self, dt: float) -> None:
        """Advance by ``dt`` seconds."""
        motion = self._motion
        if motion is None:
            return
        resting = motion.step(dt)
        self.q = motion.joints()
        if resting:
            self._last = MotionEnd.HALTED if motion.at < 1.0 else MotionEnd.DONE
            self._motion = None

    def joints(self) -> Six:
        """The six joint angles as plain numbers."""
        a, b, c, d, e, f = (float(v) for v in self.q)
        return (a, b, c, d, e, f)
