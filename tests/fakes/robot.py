"""A scripted arm: it is where it was last told to go, unless the script says otherwise."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from drivers.errors import DeviceTimeout, DeviceUnavailable, SafetyStop
from drivers.timing import Clock, StopRequested, StopToken
from drivers.types import (
    JointAngles,
    JointMotion,
    LineMotion,
    NotReachable,
    RobotState,
    SafetyMode,
    ToolPose,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Call:
    """One call that could move or change something: its name and its target, if any."""

    what: str
    target: ToolPose | JointAngles | None = None


class FakeKinematics:
    """Knows nothing against any way, but what the test wrote down for ways over a pose of ``against``."""

    def __init__(self) -> None:
        self.against: dict[ToolPose, NotReachable] = {}
        self.asked: list[tuple[JointAngles, tuple[ToolPose, ...]]] = []

    def refused(self, start: JointAngles, way: Sequence[ToolPose]) -> NotReachable | None:
        self.asked.append((start, tuple(way)))
        return next((self.against[pose] for pose in way if pose in self.against), None)


class FakeRobot:
    """Satisfies `drivers.interfaces.Robot`.

    ``faults[n]`` is raised by the n-th move, counted from 0, instead of arriving. Every move takes
    ``move_s`` on the token's clock.
    """

    def __init__(
        self, name: str, clock: Clock, *, move_s: float = 0.1, unreachable: Iterable[ToolPose] = ()
    ) -> None:
        self._name = name
        self._clock = clock
        self.move_s = move_s
        self.unreachable = frozenset(unreachable)
        self.faults: dict[int, Exception] = {}
        self.state_error: Exception | None = None
        self.open_error: Exception | None = None
        self.safety = SafetyMode.NORMAL
        self.program = True
        self.tool = ToolPose(x=0.3, y=-0.3, z=0.3, rx=3.14159, ry=0.0, rz=0.0)
        self.joints = JointAngles(q_rad=(0.0, -1.57, 1.57, -1.57, -1.57, 0.0))
        self.inputs: dict[int, bool] = {}
        self.outputs: dict[int, bool] = {}
        self.calls: list[Call] = []
        self.moves = 0
        self.opened = 0
        self.closed = 0
        self._open = False
        self._moving = False

    @property
    def name(self) -> str:
        return self._name

    @property
    def targets(self) -> list[ToolPose | JointAngles]:
        """Where it was told to go, in order."""
        return [call.target for call in self.calls if call.target is not None]

    def open(self) -> None:
        self.opened += 1
        if self.open_error is not None:
            raise self.open_error
        self._open = True

    def close(self) -> None:
        self.closed += 1
        self._open = False

    def _need_open(self) -> None:
        if not self._open:
            raise DeviceUnavailable(self._name, "not open")

    def state(self) -> RobotState:
        self._need_open()
        if self.state_error is not None:
            raise self.state_error
        now = self._clock.now()
        return RobotState(
            safety=self.safety,
            powered=True,
            program_running=self.program and self.safety is SafetyMode.NORMAL,
            tool=self.tool,
            joints=self.joints,
            moving=self._moving,
            speed_fraction=1.0,
            controller_time_s=now,
            read_at=now,
        )

    def reachable(self, target: ToolPose) -> bool:
        self._need_open()
        return target not in self.unreachable

    def move_line(self, target: ToolPose, motion: LineMotion, stop: StopToken) -> None:
        self._move(Call(what="move_line", target=target), motion.timeout_s, stop)
        self.tool = replace(target)

    def move_joints(self, target: JointAngles, motion: JointMotion, stop: StopToken) -> None:
        self._move(Call(what="move_joints", target=target), motion.timeout_s, stop)
        self.joints = replace(target)

    def _move(self, call: Call, timeout_s: float, stop: StopToken) -> None:
        self._need_open()
        self.calls.append(call)
        number, self.moves = self.moves, self.moves + 1
        stop.check()
        if self.safety is not SafetyMode.NORMAL:
            raise SafetyStop(self._name, self.safety)
        fault = self.faults.pop(number, None)
        if isinstance(fault, SafetyStop):
            self.safety = fault.mode
        if fault is not None:
            raise fault
        self._moving = True
        try:
            stop.wait(min(self.move_s, timeout_s))
        except StopRequested:
            self.halt()
            raise
        finally:
            self._moving = False
        if self.move_s > timeout_s:
            self.halt()
            raise DeviceTimeout(self._name, f"not there within {timeout_s:.2f} s; halted")

    def halt(self) -> None:
        self.calls.append(Call(what="halt"))

    def recover(self) -> None:
        self._need_open()
        self.calls.append(Call(what="recover"))
        self.safety = SafetyMode.NORMAL
        self.program = True

    def set_output(self, pin: int, on: bool) -> None:
        self._need_open()
        self.calls.append(Call(what=f"set_output {pin} {on}"))
        self.outputs[pin] = on

    def read_input(self, pin: int) -> bool:
        self._need_open()
        return self.inputs.get(pin, False)
