"""Motions of the simulated UR arm: a way in joint or tool space, and a trapezoid of speed along it.

The trapezoid runs in time of its own, which the speed slider stretches and a pause holds; a stop brakes along
the way from whatever speed there is. Deterministic: time is what `Motion.step` is told.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from drivers.sim.ur_kinematics import (
    Links,
    Placement,
    Six,
    Three,
    branch_of,
    compose,
    distance,
    forward,
    inverse,
    placement_of,
    posture,
    rotation_vector,
    six,
    turned,
)

TURN_SPEED_RAD_S = 2.0
"""A tool turns no faster than this along a line. Assumed."""


class CannotFollow(Exception):
    """The arm cannot go further on this way: out of reach, at a joint limit or in a singularity."""


class Way(Protocol):
    """A way as long as ``length``: radians of the leading joint, or metres of the tool.

    ``fastest``: speed along it beyond which the tool would turn too fast.
    """

    length: float
    fastest: float

    def at(self, s: float, near: Six) -> Six:
        """Joint angles ``s`` along the way; `CannotFollow` where there are none."""
        ...


class JointWay:
    """All joints turn evenly; the one that turns furthest gives the length."""

    def __init__(self, start: Six, goal: Six) -> None:
        self._start, self._goal = start, goal
        self._turns = tuple(b - a for a, b in zip(start, goal, strict=True))
        self.length = max(abs(turn) for turn in self._turns)
        self.fastest = math.inf

    def at(self, s: float, near: Six) -> Six:  # noqa: ARG002 - joint angles need no choice
        """Joint angles after the leading joint turned by ``s``."""
        if s >= self.length:
            return self._goal
        share = s / self.length
        return six([a + share * turn for a, turn in zip(self._start, self._turns, strict=True)])


class LineWay:
    """The tool goes straight and turns evenly about one axis on the way; a pure turn is long as its angle."""

    def __init__(self, links: Links, start: Six, goal: Placement, flange_from_tool: Placement) -> None:
        self._links = links
        self._tool_from_flange = inverse(flange_from_tool)
        self._start = compose(forward(links, start), flange_from_tool)
        self._goal = goal
        self._branch = branch_of(links, start)
        self._turn = turned(self._start, rotation_vector(compose(inverse(self._start), goal)))
        travel = distance(self._start.origin, goal.origin)
        angle = math.sqrt(sum(t * t for t in self._turn))
        self.length = travel if travel > 1e-6 else angle
        self.fastest = TURN_SPEED_RAD_S * self.length / angle if angle > 1e-9 else math.inf

    def tool_at(self, s: float) -> Placement:
        """base_from_tool ``s`` along the way."""
        if s >= self.length:
            return self._goal
        share = s / self.length
        tx, ty, tz = self._turn
        x, y, z = (a + share * (b - a) for a, b in zip(self._start.origin, self._goal.origin, strict=True))
        turn = placement_of((0.0, 0.0, 0.0, share * tx, share * ty, share * tz))
        axes: list[Three] = [turned(turn, axis) for axis in self._start[:3]]
        return Placement(axes[0], axes[1], axes[2], (x, y, z))

    def at(self, s: float, near: Six) -> Six:
        """Joint angles there, in the branch the line began in."""
        found = posture(self._links, compose(self.tool_at(s), self._tool_from_flange), self._branch, near)
        if found is None:
            raise CannotFollow(f"the line leaves the arm's reach {1e3 * s:.1f} mm from its start")
        return found


@dataclass(frozen=True, slots=True)
class Trapezoid:
    """Even acceleration, even speed, even deceleration over ``length``."""

    length: float
    speed: float
    accel: float

    @property
    def ramp_s(self) -> float:
        """How long it accelerates."""
        return min(self.speed / self.accel, math.sqrt(self.length / self.accel))

    @property
    def duration_s(self) -> float:
        """From rest to rest."""
        ramp_s = self.ramp_s
        return 2.0 * ramp_s + (self.length - self.accel * ramp_s * ramp_s) / (self.accel * ramp_s)

    def at(self, t: float) -> tuple[float, float]:
        """Way and speed after ``t`` seconds."""
        ramp_s, duration_s, a = self.ramp_s, self.duration_s, self.accel
        if t >= duration_s:
            return self.length, 0.0
        if t < ramp_s:
            return 0.5 * a * t * t, a * t
        left = duration_s - t
        if left < ramp_s:
            return self.length - 0.5 * a * left * left, a * left
        return 0.5 * a * ramp_s * ramp_s + a * ramp_s * (t - ramp_s), a * ramp_s


class Motion:
    """A way being gone.

    Attributes
    ----------
    s, speed
        How far along the way, and how fast in real (not stretched) time.
    elapsed_s
        Since it began, stretched and held time included.
    """

    def __init__(self, way: Way, speed: float, accel: float) -> None:
        self.way = way
        self.s = 0.0
        self.speed = 0.0
        self.elapsed_s = 0.0
        pace = min(1.0, way.fastest / speed)  # the tool may not turn too fast on the way
        self._profile = Trapezoid(max(way.length, 1e-12), pace * speed, pace * accel)
        self._own_s = 0.0
        self._duration_s = self._profile.duration_s
        self._braking: float | None = None

    @property
    def at_rest(self) -> bool:
        """At the goal, or stopped on the way for good."""
        if self._braking is not None:
            return self.speed <= 0.0
        return self._own_s >= self._duration_s

    @property
    def arrived(self) -> bool:
        """At the goal."""
        return self.s >= self.way.length

    @property
    def braking(self) -> bool:
        """Told to stop."""
        return self._braking is not None

    def brake(self, decel: float) -> None:
        """Come to rest on the way; of two orders the harder one counts."""
        self._braking = max(decel, self._braking or 0.0)

    def step(self, dt: float, fraction: float) -> None:
        """Advance; ``fraction`` of its own speed, 0 holds it."""
        self.elapsed_s += dt
        if self._braking is None:
            self._own_s += dt * fraction
            self.s, own_speed = self._profile.at(self._own_s)
            self.speed = own_speed * fraction
            return
        used_s = min(dt, self.speed / self._braking)
        self.s = min(self.way.length, self.s + self.speed * used_s - 0.5 * self._braking * used_s * used_s)
        self.speed = self.speed - self._braking * used_s if used_s == dt else 0.0
        if self.s >= self.way.length:
            self.speed = 0.0
