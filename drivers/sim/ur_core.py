"""The simulated UR controller without its sockets: power, safety, program, registers, inputs and outputs.

`Core.step` advances it by 2 ms and is deterministic: same orders at the same steps, same controller. Nothing
here waits, knows real time, or can be entered from a second thread.

Where no document says how a real controller behaves (what a protective stop does to the program, how fast it
stops) the choice is an assumption: docs/explanation/simulated-controller.md lists them.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from drivers.sim.ur_arm import UrArm
from drivers.sim.ur_codes import STOPPED_FOR_SAFETY, RobotMode, Runtime, Safety
from drivers.sim.ur_kinematics import MODELS, Six
from drivers.sim.ur_motion import CannotFollow
from drivers.sim.ur_program import STEP_S, ControlProgram, Cycles, ScriptDied, lines
from drivers.sim.ur_script import ControlScript, LineProgram, SetOutput, Write, read

REGISTERS = 48
UNLOCK_AFTER_S = 5.0
PROGRAM_STOP_S = 0.1
"""A stopped program brings the arm to rest within this time. Assumed."""
START_S = 0.02
"""From the end of an upload until the program runs. Assumed."""
BOOT_S = 1.0
BRAKES_S = 0.5
DIES_AFTER_S = 0.2
HOLDS = frozenset({Runtime.PAUSING, Runtime.PAUSED})


@dataclass(frozen=True, slots=True, kw_only=True)
class Setup:
    """What the controller is.

    ``polyscope`` major, minor, bugfix; ``time_scale`` simulated seconds per real second.
    """

    model: str = "UR5e"
    polyscope: tuple[int, int, int] = (5, 15, 0)
    serial: str = "20245500001"
    start_q: Six = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)
    tcp: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    payload_kg: float = 0.0
    time_scale: float = 1.0


@dataclass(slots=True)
class _Watchdog:
    register: int
    longest_s: float
    since_s: float


@dataclass(slots=True)
class Armed:
    """Something that happens once a motion has gone on for ``moving_s``, or at ``at_s``."""

    act: Callable[[], None]
    moving_s: float | None = None
    at_s: float | None = None


@dataclass(slots=True)
class Io:
    """Inputs and outputs as the RTDE names them; bits 0-7 standard, 8-15 configurable, 16-17 of the tool."""

    inputs: int = 0
    outputs: int = 0
    analog_outputs: list[float] = field(default_factory=lambda: [0.0, 0.0])


class Core:
    """One controller and its arm."""

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self.version = setup.polyscope
        self.arm = UrArm(MODELS[setup.model], setup.start_q, setup.tcp)
        self.io = Io()
        self.input_ints, self.output_ints = [0] * REGISTERS, [0] * REGISTERS
        self.input_doubles, self.output_doubles = [0.0] * REGISTERS, [0.0] * REGISTERS
        self.input_bits, self.output_bits = [0, 0, 0, 0], [0, 0, 0, 0]  # 32 each
        self.payload_kg = setup.payload_kg
        self.payload_cog = (0.0, 0.0, 0.0)
        self.steps = 0
        self.runtime = Runtime.STOPPED
        self.mode = RobotMode.RUNNING
        self.safety = Safety.NORMAL
        self.remote = True
        self.script_fault = "normal"  # or "ignore", "die"
        self.counts: Counter[str] = Counter()
        self.events: list[str] = []
        self.program_name = ""
        self.loaded: str | None = None
        self.armed: list[Armed] = []
        self._program: Cycles | None = None
        self._next: ControlScript | LineProgram | None = None
        self._next_at_s = math.inf
        self._dies_at_s = math.inf
        self._mode_changes: list[tuple[float, RobotMode]] = []
        self._watchdog: _Watchdog | None = None
        self._stopped_at_s = -math.inf

    @property
    def time_s(self) -> float:
        """Since it was switched on, simulated."""
        return self.steps * STEP_S

    def note(self, what: str) -> None:
        """One line of history; the last ones are kept."""
        self.events.append(f"{self.time_s:.3f} s: {what}")
        del self.events[:-200]

    # ------------------------------------------------------------------ the step

    def step(self) -> None:
        """Advance by one cycle of 2 ms."""
        self.steps += 1
        if self._mode_changes and self._mode_changes[0][0] <= self.time_s:
            self.mode = self._mode_changes.pop(0)[1]
        if self._watchdog is not None and self.runtime is Runtime.PLAYING:
            self._watch_out(self._watchdog)
        if self._next is not None:
            self._begin_program(self._next)
        if self.runtime is Runtime.PLAYING:
            self._run_program()
        self._move()
        if self.armed:
            self._fire()

    def _move(self) -> None:
        before = self.arm.moves_started, self.arm.motion is not None
        try:
            self.arm.step(STEP_S)
        except CannotFollow as error:
            self.protective_stop(str(error))
        if before[1] and self.arm.motion is None:
            self.counts["rests"] += 1
        if self.runtime is Runtime.STOPPING and self.arm.motion is None:
            self.runtime = Runtime.STOPPED
        elif self.runtime is Runtime.PAUSING and self.arm.resting:
            self.runtime = Runtime.PAUSED
        elif self.runtime is Runtime.RESUMING:
            self.runtime = Runtime.PLAYING
        if self.mode is not RobotMode.RUNNING and self.arm.motion is not None and self.arm.resting:
            self.arm.forget()

    def _fire(self) -> None:
        motion = self.arm.motion
        for each in tuple(self.armed):
            due = each.at_s is not None and self.time_s >= each.at_s - 1e-9
            if each.moving_s is not None and motion is not None:
                due = motion.elapsed_s >= each.moving_s - 1e-9
            if due:
                self.armed.remove(each)
                each.act()

    # ------------------------------------------------------------------ programs

    def upload(self, text: str) -> None:
        """A whole program arrived on one of the script ports."""
        self.counts["uploads"] += 1
        if not self.remote or self.script_fault == "ignore":
            self.note("a program was ignored")
            return
        program = read(text)
        if isinstance(program, LineProgram) and program.secondary:
            self._run_secondary(program)
            return
        self.stop_program("another program was sent")
        self._next, self._next_at_s = program, self.time_s + START_S

    def _run_secondary(self, program: LineProgram) -> None:
        """Secondary programs take no time; here they may switch outputs and write registers."""
        refused = [each for each in program.statements if not isinstance(each, SetOutput | Write)]
        if refused:
            self.note(f"secondary program {program.name} was refused: {refused[0]}")
            return
        for _ in lines(self, program):
            pass

    def _begin_program(self, program: ControlScript | LineProgram) -> None:
        if self.time_s < self._next_at_s or self.runtime is not Runtime.STOPPED:
            return
        self._next = None
        if self.mode is not RobotMode.RUNNING or self.safety in STOPPED_FOR_SAFETY:
            self.note(f"program {program.name} was not started: {self.mode.name}, {self.safety.name}")
            return
        self.counts["programs"] += 1
        self._watchdog = None
        if isinstance(program, ControlScript):
            self._program = ControlProgram(self, program).cycles()
        else:
            self._program = lines(self, program)
        self.program_name = program.name
        self.runtime = Runtime.PLAYING
        self.arm.hold(False)
        self._dies_at_s = self.time_s + DIES_AFTER_S if self.script_fault == "die" else math.inf
        self.note(f"program {program.name} started")

    def _run_program(self) -> None:
        if self._program is None:
            return
        try:
            if self.time_s >= self._dies_at_s:
                raise ScriptDied("told to die")
            next(self._program)
        except StopIteration:
            self.stop_program("the program ended")
        except ScriptDied as error:
            self.stop_program(f"runtime exception: {error}")

    def stop_program(self, why: str) -> None:
        """End what runs or waits; the arm comes to rest and keeps no motion."""
        if self.runtime is not Runtime.STOPPED:
            self.note(f"program {self.program_name} stopped: {why}")
            self.counts["stops"] += 1
            self.runtime = Runtime.STOPPING
        self._program, self._next, self._watchdog = None, None, None
        self.arm.brake_within(PROGRAM_STOP_S)
        if self.arm.motion is not None and self.arm.motion.speed == 0.0:
            self.arm.forget()

    def pause(self) -> bool:
        """Hold the program and the motion."""
        if self.runtime is not Runtime.PLAYING:
            return False
        self.runtime = Runtime.PAUSING
        self.arm.hold(True)
        return True

    def play(self) -> bool:
        """Go on where the program was paused, the old motion included; or run the loaded program."""
        if self.mode is not RobotMode.RUNNING or self.safety in STOPPED_FOR_SAFETY:
            return False
        if self.runtime in HOLDS:
            self.runtime = Runtime.RESUMING
            self.arm.hold(False)
            self.note("program resumed")
            return True
        if self.runtime is Runtime.STOPPED and self.loaded is not None:
            self._program = None
            self.program_name = self.loaded
            self.runtime = Runtime.PLAYING
            self.arm.hold(False)
            return True
        return False

    # ------------------------------------------------------------------ safety and power

    def protective_stop(self, why: str) -> None:
        """Stop and pause the program, motion kept."""
        self._stop_for(Safety.PROTECTIVE_STOP, why)

    def safeguard_stop(self) -> None:
        """A light curtain or a door: stop and pause the program."""
        self._stop_for(Safety.SAFEGUARD_STOP, "safeguard input")

    def _stop_for(self, safety: Safety, why: str) -> None:
        if self.safety in STOPPED_FOR_SAFETY:
            return
        self.note(f"{safety.name}: {why}")
        self.counts[safety.name.lower()] += 1
        self.safety, self._stopped_at_s = safety, self.time_s
        self.arm.hold(True)
        if self.runtime in (Runtime.PLAYING, Runtime.RESUMING):
            self.runtime = Runtime.PAUSING
        elif self.arm.motion is not None and self.runtime is not Runtime.PAUSED:
            self.arm.brake_within(PROGRAM_STOP_S)

    def emergency_stop(self) -> None:
        """The button: stop, program over, power off once at rest."""
        if self.safety is Safety.ROBOT_EMERGENCY_STOP:
            return
        self.note("ROBOT_EMERGENCY_STOP: the button was pressed")
        self.counts["emergency_stop"] += 1
        self.safety, self._stopped_at_s = Safety.ROBOT_EMERGENCY_STOP, self.time_s
        self.stop_program("emergency stop")
        self.mode, self._mode_changes = RobotMode.POWER_OFF, []

    def reduce(self) -> None:
        """Reduced mode: tighter limits, which nothing here checks; only the state is told."""
        if self.safety is Safety.NORMAL:
            self.safety = Safety.REDUCED

    def release(self, resume: bool = False) -> bool:
        """Let go of the button or leave the light curtain; ``resume`` plays on after a safeguard."""
        match self.safety:
            case Safety.ROBOT_EMERGENCY_STOP | Safety.SYSTEM_EMERGENCY_STOP:
                self.safety = Safety.NORMAL
            case Safety.REDUCED:
                self.safety = Safety.NORMAL
            case Safety.SAFEGUARD_STOP:
                self.safety = Safety.NORMAL
                if resume:
                    self.play()
            case _:
                return False
        return True

    def unlock(self) -> bool:
        """Clear a protective stop; False within the first 5 s of it. The program stays paused."""
        if self.safety is Safety.PROTECTIVE_STOP:
            if self.time_s - self._stopped_at_s < UNLOCK_AFTER_S:
                return False
            self.safety = Safety.NORMAL
            if self.runtime is Runtime.STOPPED:
                self.arm.forget()
        return True

    def power_on(self) -> None:
        """Motors on, brakes still set."""
        if self.mode is RobotMode.POWER_OFF and self.safety not in STOPPED_FOR_SAFETY:
            self._change_mode((0.0, RobotMode.POWER_ON), (BOOT_S, RobotMode.IDLE))

    def brake_release(self) -> None:
        """Ready to move; switches the power on where it is off."""
        if self.safety in STOPPED_FOR_SAFETY:
            return
        if self.mode is RobotMode.IDLE:
            self._change_mode((BRAKES_S, RobotMode.RUNNING))
        elif self.mode in (RobotMode.POWER_OFF, RobotMode.POWER_ON):
            self._change_mode(
                (0.0, RobotMode.POWER_ON), (BOOT_S, RobotMode.IDLE), (BOOT_S + BRAKES_S, RobotMode.RUNNING)
            )

    def power_off(self) -> None:
        """Motors off; what runs is over."""
        self.stop_program("power off")
        self.mode, self._mode_changes = RobotMode.POWER_OFF, []

    def restart_safety(self) -> None:
        """After a fault or violation: safe again, and powered off."""
        self.power_off()
        self.safety = Safety.NORMAL

    def _change_mode(self, *changes: tuple[float, RobotMode]) -> None:
        self._mode_changes = [(self.time_s + after_s, mode) for after_s, mode in changes]

    # ------------------------------------------------------------------ what programs and clients touch

    def watch(self, register: int, min_frequency_hz: float) -> None:
        """Stop the program when this input register is written less often; real time, not simulated.

        0 takes the watchdog away.
        """
        if min_frequency_hz <= 0.0:
            self._watchdog = None
            return
        longest_s = self.setup.time_scale / min_frequency_hz
        self._watchdog = _Watchdog(register, longest_s, self.time_s)

    def input_written(self, register: int) -> None:
        """A client wrote this whole-number register; feeds the watchdog."""
        if self._watchdog is not None and self._watchdog.register == register:
            self._watchdog.since_s = self.time_s

    def _watch_out(self, watchdog: _Watchdog) -> None:
        if self.time_s - watchdog.since_s > watchdog.longest_s + 1e-9:
            self.counts["watchdog"] += 1
            self.stop_program("no RTDE input within the watchdog's time")

    def was_late(self, seconds: float) -> None:
        """This process did not run for so long; what its clients sent meanwhile came in time all the same."""
        if self._watchdog is not None:
            self._watchdog.since_s += seconds

    def set_output_bit(self, bit: int, on: bool) -> None:
        """Switch one digital output."""
        self.io.outputs = self.io.outputs | 1 << bit if on else self.io.outputs & ~(1 << bit)

    def within_safety_limits(self, q: Six) -> bool:
        """Whether the arm may stand there."""
        return self.arm.within_limits(q)

    def set_slider(self, fraction: float) -> None:
        """The speed slider, 0 to 1."""
        if math.isfinite(fraction):
            self.arm.slider = max(0.0, min(1.0, fraction))
