"""The simulated cell: sticks in a tray, an arm, two jaws, a drop box, and what happens between them.

`World.step` moves it by a stretch of simulated time; nothing here knows sockets, threads or real time. The
same layout, seed and sequence of calls give the same world. Base frame, metres, seconds.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from drivers.sim import jaws
from drivers.sim.arm import Arm
from drivers.sim.board import BoardPlace, place_of
from drivers.sim.geometry import Floats, apply
from drivers.sim.layout import WorldLayout
from drivers.sim.piles import Stick, drop_one, drop_pile, fits, resettle, settle
from drivers.types import Grip, SafetyMode

STEP_S = 0.008
"""Longest stretch of simulated time between two looks at what the jaws touch."""
CLEAR_M = 0.01
"""The jaws are clear of what they struck when their tips are this far above the tray's walls."""
LEAD_RAD = 0.01
"""A led arm is looked at each time its joints turned this far."""
DROPS_WITHIN_S = 1.5
"""A part that is going to slip does so within this time after the grasp."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Snapshot:
    """The world at one instant, for the renderer and for whoever wants the truth.

    ``lying`` sticks in the tray in the order they were dropped; ``held`` the one in the jaws;
    ``pile_version`` changes whenever ``lying`` does. ``q`` (6,) joint angles, ``jaw_gap_m`` clear opening;
    ``base_from_flange`` and ``base_from_tool`` (4, 4), ``base_from_board`` of a calibration board, None where
    none is shown.
    """

    lying: tuple[Stick, ...]
    held: Stick | None
    pile_version: int
    q: Floats
    base_from_tool: Floats
    base_from_flange: Floats
    jaw_gap_m: float
    base_from_board: Floats | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Held:
    stick: Stick
    centre: Floats  # tool frame
    axis: Floats  # tool frame
    slips_after_s: float | None


class World:
    """Everything in the simulated cell.

    Parameters
    ----------
    layout
        The world file.
    seed
        Of the pile and of slipping parts; None takes the world file's.
    count
        Sticks in the tray; None takes the world file's.
    """

    def __init__(self, layout: WorldLayout, *, seed: int | None = None, count: int | None = None) -> None:
        self.layout = layout
        kind = layout.sticks if count is None else layout.sticks.model_copy(update={"count": count})
        self._rng = np.random.default_rng(layout.seed if seed is None else seed)
        self.arm = Arm(layout.arm)
        self.time_s = 0.0
        self.counts: Counter[str] = Counter()
        self.events: list[str] = []
        self.drop_next = False
        self.miss_next = False
        self.board = BoardPlace.NOWHERE
        self.exposures = 0
        self._lying = drop_pile(kind, layout.tray, self._rng)
        self._next_number = len(self._lying)
        self._pile_version = 0
        self._grip = Grip.OPEN
        self._held: _Held | None = None
        self._jaws_until: float | None = None
        self._jaws_close = False
        self._struck: frozenset[int] = frozenset()
        self._blocked = False
        self._crashed = False

    # ------------------------------------------------------------------ what is

    @property
    def lying(self) -> tuple[Stick, ...]:
        """Sticks in the tray, in the order they were dropped."""
        return self._lying

    @property
    def grip(self) -> Grip:
        """What the jaws hold; UNKNOWN while they move."""
        return Grip.UNKNOWN if self._jaws_until is not None else self._grip

    def snapshot(self) -> Snapshot:
        """The world at this instant."""
        held = self._held_stick()
        gap = self.layout.gripper.opening_m
        if held is not None:
            gap = held.diameter_m
        elif self._grip is Grip.CLOSED_EMPTY:
            gap = 0.0
        flange = self.arm.base_from_flange()
        tool = flange @ self.arm.flange_from_tool
        return Snapshot(
            lying=self._lying,
            held=held,
            pile_version=self._pile_version,
            q=self.arm.q.copy(),
            base_from_tool=tool,
            base_from_flange=flange,
            jaw_gap_m=gap,
            base_from_board=place_of(self.board, self.layout, flange, self.exposures),
        )

    def _held_stick(self) -> Stick | None:
        if self._held is None:
            return None
        tool = self.arm.base_from_tool()
        return self._held.stick.moved(apply(tool, self._held.centre), tool[:3, :3] @ self._held.axis)

    # ------------------------------------------------------------------ what happens

    def step(self, dt: float) -> None:
        """Advance by ``dt`` seconds of simulated time."""
        while dt > 0.0:
            part = min(dt, STEP_S)
            was_moving = self.arm.moving
            self.arm.step(part)
            self.time_s += part
            dt -= part
            if was_moving and not self.arm.led and self._grip is Grip.OPEN and self._jaws_until is None:
                self._feel()
            if self._jaws_until is not None and self.time_s >= self._jaws_until:
                self._jaws_arrive()
            if self._held is not None and self._held.slips_after_s is not None:
                self._slip(part)

    def lead(self, q_rad: Floats, moving: bool) -> None:
        """The arm goes where another one is, (6,) joint angles; the jaws feel what is on the way."""
        start = self.arm.q
        count = max(1, int(np.ceil(float(np.abs(q_rad - start).max()) / LEAD_RAD)))
        for i in range(1, count + 1):
            self.arm.lead(start + (q_rad - start) * (i / count), moving)
            if moving and self._grip is Grip.OPEN and self._jaws_until is None:
                self._feel()

    def _feel(self) -> None:
        """What the open jaws run into on their way."""
        tool, gripper, tray = self.arm.base_from_tool(), self.layout.gripper, self.layout.tray
        tip_z = float(apply(tool, np.array([0.0, 0.0, gripper.tip_beyond_tool_m]))[2])
        if tip_z > tray.centre_m[2] + tray.wall_height_m + CLEAR_M:
            self._struck, self._blocked, self._crashed = frozenset(), False, False
            return
        hard = jaws.crash(tool, gripper, tray)
        if hard is not None and not (self.arm.led and self._crashed):
            self._crashed = True  # a led arm takes its time to rest, and has to come out again
            self._collide(f"jaws into the {hard}")
            self.arm.stop_for_safety(SafetyMode.PROTECTIVE_STOP)
        for number in sorted(jaws.struck(self._lying, tool, gripper) - self._struck):
            self._struck |= {number}
            self._collide(f"jaws onto stick {number}")

    def _collide(self, what: str) -> None:
        self._blocked = True
        self.counts["collisions"] += 1
        self.events.append(f"{self.time_s:.3f} s: {what}")

    def begin_release(self) -> None:
        """Start opening the jaws; what they hold falls when they have opened."""
        self._jaws_until = self.time_s + self.layout.gripper.release_s
        self._jaws_close = False

    def begin_grasp(self) -> None:
        """Start closing the jaws; what they get shows when they have closed."""
        self._jaws_until = self.time_s + self.layout.gripper.grasp_s
        self._jaws_close = True

    def _jaws_arrive(self) -> None:
        self._jaws_until = None
        if not self._jaws_close:
            self._grip = Grip.OPEN
            self._let_go()
        elif self._held is None:
            self._grip = Grip.HOLDING if self._close() else Grip.CLOSED_EMPTY

    def _close(self) -> bool:
        self.counts["grasps"] += 1
        missed, self.miss_next = self.miss_next, False
        tool = self.arm.base_from_tool()
        found = [
            (stick, offset)
            for stick in self._lying
            if (offset := jaws.grip_offset(stick, tool, self.layout.gripper)) is not None
        ]
        if missed or self._blocked or not found:
            self.counts["misses"] += 1
            return False
        stick, offset = max(found, key=lambda each: float(each[0].centre[2]))
        centre, axis = jaws.held_pose(stick, tool, offset)
        slips = self.drop_next or self._rng.random() < self.layout.gripper.drop_probability
        after = float(self._rng.uniform(0.3, 1.0)) * DROPS_WITHIN_S if slips else None
        self.drop_next = False
        self._held = _Held(stick=stick, centre=centre, axis=axis, slips_after_s=after)
        remaining = tuple(s for s in self._lying if s is not stick)
        settled = resettle(remaining, stick, self.layout.tray, self.layout.sticks.wall_margin_m)
        if any(a is not b for a, b in zip(settled, remaining, strict=True)):
            self.counts["pulled_from_under"] += 1
        self._lying = settled
        self._pile_version += 1
        return True

    def _slip(self, dt: float) -> None:
        held = self._held
        if held is None or held.slips_after_s is None:
            return
        left = held.slips_after_s - dt
        self._held = _Held(stick=held.stick, centre=held.centre, axis=held.axis, slips_after_s=left)
        if left <= 0.0:
            self.counts["dropped"] += 1
            self.events.append(f"{self.time_s:.3f} s: stick {held.stick.number} slipped out of the jaws")
            self._let_go()
            self._grip = Grip.CLOSED_EMPTY

    def _let_go(self) -> None:
        """The held stick falls straight down: into the box, back into the tray, or beside both."""
        stick = self._held_stick()
        self._held = None
        if stick is None:
            return
        box, tray = self.layout.drop_box, self.layout.tray
        over_box = np.abs(stick.centre[:2] - np.array(box.centre_m[:2])) <= 0.5 * np.array(box.size_m)
        if bool(np.all(over_box)):
            self.counts["in_box"] += 1
            return
        flat = np.array([stick.axis[0], stick.axis[1], 0.0])
        if np.linalg.norm(flat) < 0.1:
            flat = np.array([1.0, 0.0, 0.0])
        flat /= np.linalg.norm(flat)
        over_tray = np.abs(stick.centre[:2] - np.array(tray.centre_m[:2])) <= 0.5 * np.array(tray.inner_m)
        if not bool(np.all(over_tray)):
            self.counts["lost"] += 1
            return
        margin = 0.5 * stick.diameter_m
        room = 0.5 * np.array(tray.inner_m) - np.abs(flat[:2]) * 0.5 * stick.length_m - margin
        if not fits(tray, stick.centre, flat, stick.length_m, margin) and bool(np.any(room < 0.0)):
            self.counts["lost"] += 1
            return
        middle = np.array(tray.centre_m[:2])
        plan = middle + np.clip(stick.centre[:2] - middle, -room, room)  # it slides down the inside of a wall
        fallen = Stick(
            number=self._next_number,
            length_m=stick.length_m,
            diameter_m=stick.diameter_m,
            shade=stick.shade,
            centre=np.array([plan[0], plan[1], tray.centre_m[2]]),
            axis=flat,
        )
        self._next_number += 1
        self._lying = (*self._lying, settle(fallen, self._lying, tray, margin))
        self._pile_version += 1
        self.counts["fell_back"] += 1

    def add_sticks(self, count: int) -> None:
        """Somebody throws ``count`` more sticks into the tray."""
        for _ in range(count):
            stick = drop_one(self._next_number, self.layout.sticks, self.layout.tray, self._lying, self._rng)
            self._next_number += 1
            self._lying = (*self._lying, stick)
            self._pile_version += 1
