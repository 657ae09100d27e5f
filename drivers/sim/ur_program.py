"""What the uploaded programs do, cycle by cycle: the register protocol of ur-rtde's control script, and small
programs of one statement a line.

A program is a generator: one ``yield`` is one 2 ms cycle of the controller. It sees a `Cell`, never a socket.
Blocking URScript calls (``movej`` and friends) are loops that yield until the arm rests.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from typing import Protocol, TypeAlias

from drivers.sim.ur_arm import UrArm
from drivers.sim.ur_kinematics import Six, compose, placement_of, pose_of, six
from drivers.sim.ur_motion import CannotFollow, Way
from drivers.sim.ur_script import (
    ControlScript,
    LineProgram,
    Move,
    Progress,
    SetOutput,
    Sleep,
    Statement,
    Write,
)

Cycles: TypeAlias = Iterator[None]

READY, DONE = 1, 2
LARGEST = 1e6
STOP_SCRIPT = 255
STEP_S = 0.002
REPLACED_STOP_S = 0.1
"""A motion that another one replaces comes to rest within this time. Assumed."""


class ScriptDied(Exception):
    """A runtime exception of the program: it stops, with this text."""


class Cell(Protocol):
    """What a program may touch."""

    arm: UrArm
    input_ints: list[int]
    input_doubles: list[float]
    output_ints: list[int]
    output_doubles: list[float]
    payload_kg: float
    payload_cog: tuple[float, float, float]
    counts: Counter[str]

    def protective_stop(self, why: str) -> None: ...

    def watch(self, register: int, min_frequency_hz: float) -> None: ...

    def set_output_bit(self, bit: int, on: bool) -> None: ...

    def within_safety_limits(self, q: Six) -> bool: ...


def rest(cell: Cell) -> Cycles:
    """Until no motion is left."""
    while cell.arm.motion is not None:
        yield


def go(cell: Cell, make_way: Callable[[], Way], speed: float, accel: float) -> Cycles:
    """Bring what moves to rest, then go that way; both take their time.

    A way that cannot be gone is a protective stop, as one that turns out so underway.
    """
    if cell.arm.motion is not None:
        cell.arm.brake_within(REPLACED_STOP_S)
        yield from rest(cell)
    try:
        cell.arm.start(make_way(), speed, accel)
    except CannotFollow as error:
        cell.protective_stop(str(error))
        yield
        return
    yield from rest(cell)


def way_of(cell: Cell, move: Move) -> Way:
    """The way of a ``movej`` or ``movel`` with a pose or joint angles."""
    target = six(move.target)
    if move.straight:
        return cell.arm.line_way(target if move.pose else cell.arm.tool_of(target))
    if not move.pose:
        return cell.arm.joint_way(target)
    return cell.arm.joint_way(_joints(cell, target))


def _joints(cell: Cell, pose: Six, near: Six | None = None) -> Six:
    found = cell.arm.joints_for(pose, near)
    if found is None:
        raise ScriptDied("get_inverse_kin: unable to find an inverse kinematics solution")
    return found


def carry_out(cell: Cell, each: Statement) -> Cycles:
    """One statement of a small program."""
    match each:
        case Move():
            yield from go(cell, lambda: way_of(cell, each), each.speed, each.accel)
        case Write(register=register, value=value, whole=True):
            cell.output_ints[_register(register)] = max(-(1 << 31), min((1 << 31) - 1, int(value)))
        case Write(register=register, value=value):
            cell.output_doubles[_register(register)] = value
        case SetOutput(bit=bit, on=on):
            cell.set_output_bit(bit, on)
        case Sleep(seconds=seconds):
            for _ in range(max(1, round(seconds / STEP_S))):
                yield
        case Progress():
            raise ScriptDied("signal_async_progress outside of the control script")
        case _:
            raise ScriptDied(f"cannot carry out the line {each.line!r}")


def _register(number: int) -> int:
    if not 0 <= number < 48:
        raise ScriptDied(f"there is no register {number}")
    return number


def lines(cell: Cell, program: LineProgram) -> Cycles:
    """A small program from its first statement to its last."""
    yield
    for each in program.statements:
        yield from carry_out(cell, each)


class _Async:
    """The status word of asynchronous operations, and the one that runs.

    Bits 0-14 progress, 15 running, 16-22 how often it was written, 24-30 operation; each written progress
    of 0 counts the operation up, also when a path signals it, as in the script.
    """

    def __init__(self, cell: Cell, register: int) -> None:
        self._cell, self._register = cell, register
        self._operation = self._writes = 0
        self._cycles: Cycles | None = None

    def write(self, progress: int | None) -> None:
        """Tell how far it is; None that nothing runs."""
        self._writes = (self._writes + 1) & 0x7F
        word = 0
        if progress is not None:
            self._operation = (self._operation + (progress == 0)) & 0x7F
            word = min(progress, 0x7FFF) | 1 << 15
        self._cell.output_ints[self._register] = word | self._writes << 16 | self._operation << 24

    def begin(self, cycles: Cycles) -> None:
        """Start an operation; one that runs ends first."""
        self.end()
        self._cycles = cycles
        self.write(0)

    def end(self) -> None:
        """Over, finished or not."""
        if self._cycles is not None:
            self._cycles = None
            self.write(None)

    def step(self) -> None:
        """One cycle of the operation that runs."""
        if self._cycles is not None:
            try:
                next(self._cycles)
            except StopIteration:
                self.end()


class ControlProgram:
    """The loop of ur-rtde's control script on the registers from ``script.int_offset`` on."""

    def __init__(self, cell: Cell, script: ControlScript) -> None:
        self._cell, self._script = cell, script
        self._int, self._double = script.int_offset, script.float_offset
        self._operation = _Async(cell, script.int_offset + 2)

    def cycles(self) -> Cycles:
        """Until it is told to stop, or dies."""
        cell, executing = self._cell, False
        self._operation.write(None)
        cell.output_ints[self._int] = READY
        while True:
            yield
            self._operation.step()
            command = cell.input_ints[self._int]
            if command == STOP_SCRIPT:
                return
            if command == 0:
                executing = False
                cell.output_ints[self._int] = READY
            elif command in REAL_TIME:
                yield from self._command(command)
                cell.output_ints[self._int] = READY
            elif not executing:
                yield from self._command(command)
                cell.output_ints[self._int] = DONE
                executing = True

    # ------------------------------------------------------------------ registers

    def _i(self, number: int) -> int:
        return self._cell.input_ints[self._int + number]

    def _d(self, first: int, count: int) -> tuple[float, ...]:
        """Numbers a controller could reckon with; the program dies of others."""
        start = self._double + first
        values = tuple(self._cell.input_doubles[start : start + count])
        if not all(abs(value) <= LARGEST for value in values):
            raise ScriptDied(f"registers {start} to {start + count - 1} hold {values}")
        return values

    def _six(self, first: int) -> Six:
        return six(self._d(first, 6))

    def _answer(self, values: tuple[float, ...]) -> None:
        self._cell.output_doubles[self._double : self._double + len(values)] = values

    def _say(self, yes: bool) -> None:
        self._cell.output_ints[self._int + 1] = int(yes)

    # ------------------------------------------------------------------ commands

    def _command(self, command: int) -> Cycles:
        self._cell.counts["commands"] += 1
        if command in MOVES:
            yield from self._move(command)
        elif command in STOPS:
            yield from self._stop(command)
        elif command == 45:
            yield from self._perhaps_async(self._path(), self._i(1) == 1)
        elif not (self._set(command) or self._ask(command)):
            raise ScriptDied(f"command {command} of the control script is not simulated")

    def _perhaps_async(self, cycles: Cycles, asynchronous: bool) -> Cycles:
        self._operation.end()
        if asynchronous:
            self._operation.begin(cycles)
        else:
            yield from cycles

    def _move(self, command: int) -> Cycles:
        move = Move(
            straight=command in (3, 4),
            pose=command in (2, 3),
            target=self._d(0, 6),
            speed=self._d(6, 1)[0],
            accel=self._d(7, 1)[0],
        )
        cycles = go(self._cell, lambda: way_of(self._cell, move), move.speed, move.accel)
        yield from self._perhaps_async(cycles, self._i(1) == 1)

    def _stop(self, command: int) -> Cycles:
        decel, arm = self._d(0, 1)[0], self._cell.arm
        if decel <= 0.0:
            raise ScriptDied(f"a stop needs a deceleration above 0, not {decel:g}")
        if command in (33, 15):
            arm.brake_tool(decel)
        else:
            arm.brake_joints(decel)
        asynchronous = command in (33, 34) and self._i(1) == 1
        yield from self._perhaps_async(rest(self._cell), asynchronous)

    def _path(self) -> Cycles:
        for each in self._script.path:
            if isinstance(each, Progress):
                self._operation.write(each.value)
            else:
                yield from carry_out(self._cell, each)

    def _set(self, command: int) -> bool:
        """Commands that change something at once."""
        cell = self._cell
        match command:
            case 8 | 59:  # nothing here has a force sensor or gravity
                return True
            case 17 | 65:
                mass, x, y, z = self._d(0, 4)
                if not 0.0 <= mass <= 2.0 * cell.arm.links.payload_kg:
                    raise ScriptDied(f"set_payload: {mass:g} kg is more than the arm can carry")
                cell.payload_kg = mass
                if x or y or z:  # the script keeps the old centre of gravity for zeros
                    cell.payload_cog = (x, y, z)
            case 29:
                cell.arm.set_tcp(self._six(0))
            case 31:
                cell.protective_stop("asked for by the program")
            case 35:
                cell.watch(self._int, self._d(0, 1)[0])
            case _:
                return False
        return True

    def _ask(self, command: int) -> bool:
        """Commands that answer in the output registers."""
        arm = self._cell.arm
        match command:
            case 26:
                self._answer((STEP_S,))
            case 28:
                self._answer(arm.pose)
            case 27:
                self._answer(arm.q)
            case 30:
                self._answer(_joints(self._cell, self._six(0), self._six(6)))
            case 46:
                self._answer(_joints(self._cell, self._six(0)))
            case 60:
                self._say(arm.joints_for(self._six(0)) is not None)
            case 61:
                self._say(arm.joints_for(self._six(0), self._six(6)) is not None)
            case 36:
                q = arm.joints_for(self._six(0))
                self._say(q is not None and self._cell.within_safety_limits(q))
            case 37:
                self._say(self._cell.within_safety_limits(self._six(0)))
            case 38:
                self._answer((0.0,) * 6)
            case 39:
                self._answer(pose_of(compose(placement_of(self._six(0)), placement_of(self._six(6)))))
            case 40:
                self._answer(arm.tcp)
            case 43:
                self._answer(arm.pose)
            case 44:
                self._answer(arm.tool_of(self._six(0), self._six(6)))
            case 47:
                self._say(arm.steady)
            case 58:
                self._answer(arm.flange_pose)
            case _:
                return False
        return True


REAL_TIME = frozenset({6, 9, 10, 11, 24, 25, 26, 27, 38, 58, 66, 67, 68, 69, 70, 71})
"""Commands the script carries out in every cycle they stand in the register."""
MOVES = frozenset({1, 2, 3, 4})
STOPS = frozenset({15, 16, 33, 34})
