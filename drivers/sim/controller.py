"""The simulated cell in real time: one world, its clock, its two eyes, and who may move the arm.

Every call first brings the world to the present instant, so an answer, and a picture, is never older than the
moment it was asked for. Safe to call from many threads.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np

from drivers.sim.arm import MotionEnd, Refused
from drivers.sim.board import BoardPlace
from drivers.sim.eyes import Eyes
from drivers.sim.geometry import tool_pose
from drivers.sim.optics import Eye
from drivers.sim.world import Snapshot, World
from drivers.timing import Clock
from drivers.types import Grip, JointAngles, RobotState, SafetyMode, Six, ToolPose

LEASE_S = 0.3
"""A motion goes on only while its client asks after it at least this often (real time)."""
LONGEST_JUMP_S = 0.25
"""After the process was frozen, simulated time goes on from where it was."""
PINS = 16
JAWS_OUTPUT, HELD_INPUT = 0, 0
"""Pins of the arm: the output that closes the jaws (off: opens them), the input that says a part is held."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Drive:
    """What a controller outside says of its arm: joints, state, and 16 digital outputs as bits."""

    q_rad: Six
    moving: bool
    safety: SafetyMode
    outputs: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Driven:
    """What it hears: 16 digital inputs as bits, and a safety mode somebody asks for (or None)."""

    inputs: int
    asked: SafetyMode | None


class Controller:
    """The world in real time.

    Parameters
    ----------
    world, clock
        What is run, and by which clock.
    speed
        Simulated seconds per real second.
    eyes
        Left and right.
    """

    def __init__(self, world: World, clock: Clock, speed: float, eyes: tuple[Eye, Eye], seed: int) -> None:
        self._world = world
        self._clock = clock
        self._speed = speed
        self._lock = threading.RLock()
        self._since = clock.now()
        self.eyes = Eyes(world, eyes, seed, clock, self._lock, self.advance)
        self._holder: int | None = None
        self._asked_at = clock.now()
        self._robot_frozen = False
        self._frozen_state: RobotState | None = None
        self._outputs = [False] * PINS
        self._inputs = [False] * PINS
        self._driver: int | None = None
        self._driven_close = False
        self._asked_safety: SafetyMode | None = None
        self.lease_halts = 0

    def advance(self) -> float:
        """Bring the world to now, which it returns; halt a motion nobody asks after."""
        with self._lock:
            now = self._clock.now()
            passed, self._since = now - self._since, now
            if self._world.arm.moving and not self._world.arm.led and now - self._asked_at > LEASE_S:
                self._world.arm.halt()
                self.lease_halts += 1
                self._asked_at = now
            self._world.step(min(passed, LONGEST_JUMP_S) * self._speed)
            return now

    # ------------------------------------------------------------------ arm

    def take_control(self, client: int) -> None:
        """Only one client moves the arm; `Refused` while another one has it."""
        with self._lock:
            if self._holder not in (None, client):
                raise Refused("another client controls the arm")
            self._holder = client

    def drop_control(self, client: int) -> None:
        """The client is gone: whatever moves for it halts."""
        with self._lock:
            if self._holder == client:
                self.advance()
                self._world.arm.halt()
                if self._driver == client:
                    self._world.arm.lead(self._world.arm.q, moving=False)
                self._holder = self._driver = None

    def _own(self, client: int) -> None:
        self.take_control(client)
        self.advance()
        if self._robot_frozen:
            raise Refused("the controller does not react")
        self._asked_at = self._clock.now()

    def move_line(self, client: int, target: ToolPose, speed_m_s: float, accel_m_s2: float) -> None:
        """Start; `Refused` if it cannot be done."""
        with self._lock:
            self._own(client)
            self._world.arm.start_line(target, speed_m_s, accel_m_s2)
            self._begin_clock()

    def move_joints(self, client: int, target: JointAngles, speed_rad_s: float, accel_rad_s2: float) -> None:
        """Start; `Refused` if it cannot be done."""
        with self._lock:
            self._own(client)
            self._world.arm.start_joints(target, speed_rad_s, accel_rad_s2)
            self._begin_clock()

    def _begin_clock(self) -> None:
        # solving a line takes a moment of real time that the arm must not make up for
        self._since = self._asked_at = self._clock.now()

    def poll(self, client: int) -> tuple[MotionEnd, RobotState]:
        """How the motion stands; keeps it alive if the client has control."""
        with self._lock:
            if self._holder == client:
                self._asked_at = self._clock.now()
            state = self.robot_state()
            if self._robot_frozen:  # what it says of the motion is as old as the rest
                return MotionEnd.RUNNING if state.moving else MotionEnd.DONE, state
            return self._world.arm.motion_state, state

    def drive(self, client: int, drive: Drive) -> Driven:
        """A controller outside moves the arm and wires its pins: output 0 closes the jaws, input 0 says that
        a part is held. `Refused` while another client has control; while this one has, nobody else moves.
        """
        with self._lock:
            self.take_control(client)
            self._driver = client
            self.advance()
            world = self._world
            safety_before = drive.safety
            world.arm.safety = safety_before
            world.lead(np.array(drive.q_rad), drive.moving)
            if world.arm.safety is not safety_before:  # the jaws ran into something
                self._asked_safety = world.arm.safety
            self._outputs = [bool(drive.outputs >> pin & 1) for pin in range(PINS)]
            close = self._outputs[JAWS_OUTPUT]
            if close is not self._driven_close:
                self._driven_close = close
                self.begin_jaws(close)
            asked, self._asked_safety = self._asked_safety, None
            inputs = sum(on << pin for pin, on in enumerate(self._inputs))
            return Driven(inputs=inputs | (world.grip is Grip.HOLDING) << HELD_INPUT, asked=asked)

    def halt(self) -> None:
        """Come to rest; anybody may ask for that."""
        with self._lock:
            self.advance()
            self._world.arm.halt()

    def recover(self) -> None:
        """Clear a protective or safeguard stop; `Refused` while the emergency stop is pressed."""
        with self._lock:
            self.advance()
            if self._world.arm.safety is SafetyMode.EMERGENCY_STOP:
                raise Refused("the emergency stop is pressed; release it at the cell")
            self._world.arm.safety = SafetyMode.NORMAL

    def reachable(self, target: ToolPose) -> bool:
        """Whether some posture brings the tool there."""
        with self._lock:
            return self._world.arm.reachable(target)

    def robot_state(self) -> RobotState:
        """What the arm says of itself; the same again and again while it is frozen."""
        with self._lock:
            self.advance()
            arm = self._world.arm
            state = RobotState(
                safety=arm.safety,
                powered=arm.safety is not SafetyMode.EMERGENCY_STOP,
                program_running=arm.safety in (SafetyMode.NORMAL, SafetyMode.REDUCED),
                tool=tool_pose(arm.base_from_tool()),
                joints=JointAngles(q_rad=arm.joints()),
                moving=arm.moving,
                speed_fraction=1.0,
                controller_time_s=self._world.time_s,
                read_at=self._since,
            )
            if self._robot_frozen:
                if self._frozen_state is None:
                    self._frozen_state = state
                return self._frozen_state
            return state

    def stop_for_safety(self, mode: SafetyMode) -> None:
        """Something outside stops the arm; NORMAL releases it."""
        with self._lock:
            self.advance()
            self._world.arm.stop_for_safety(mode)
            if self._driver is not None:
                self._asked_safety = mode

    def freeze_robot(self, frozen: bool) -> None:
        """The controller goes on answering, but with old news."""
        with self._lock:
            if frozen:
                self.robot_state()
                self._world.arm.halt()
            self._frozen_state = None
            self._robot_frozen = frozen

    def set_output(self, pin: int, on: bool) -> None:
        """A digital output; `Refused` for a pin there is not. `JAWS_OUTPUT` moves the jaws."""
        self._pin(pin)
        with self._lock:
            changed, self._outputs[pin] = self._outputs[pin] is not on, on
            if changed and pin == JAWS_OUTPUT:
                self.begin_jaws(on)

    def read_input(self, pin: int) -> bool:
        """A digital input; `Refused` for a pin there is not. `HELD_INPUT` is the jaws' own sensor as well."""
        self._pin(pin)
        held = pin == HELD_INPUT and self.grip() is Grip.HOLDING
        return held or self._inputs[pin]

    def set_input(self, pin: int, on: bool) -> None:
        """What is wired to an input, from outside."""
        self._pin(pin)
        self._inputs[pin] = on

    def _pin(self, pin: int) -> None:
        if not 0 <= pin < PINS:
            raise Refused(f"there is no pin {pin}")

    # ------------------------------------------------------------------ jaws and parts

    def begin_jaws(self, close: bool) -> None:
        """Start closing or opening."""
        with self._lock:
            self.advance()
            if close:
                self._world.begin_grasp()
            else:
                self._world.begin_release()

    def grip(self) -> Grip:
        """What the jaws hold now."""
        with self._lock:
            self.advance()
            return self._world.grip

    def spoil_next(self, *, drop: bool = False, miss: bool = False) -> None:
        """The next grasp slips on the way, or closes beside the part."""
        with self._lock:
            self._world.drop_next = self._world.drop_next or drop
            self._world.miss_next = self._world.miss_next or miss

    def add_sticks(self, count: int) -> None:
        """Throw more sticks into the tray."""
        with self._lock:
            self.advance()
            self._world.add_sticks(count)

    def show_board(self, place: BoardPlace) -> None:
        """Somebody puts the calibration board there, or takes it away."""
        with self._lock:
            self.advance()
            self._world.board = place

    def peek(self) -> tuple[World, Snapshot]:
        """The world at this instant; for reading."""
        with self._lock:
            self.advance()
            return self._world, self._world.snapshot()
