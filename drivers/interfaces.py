"""The Protocols every device satisfies. The words behind the signatures are in docs/design.md, section 5,
and `tests/contract/` checks them on every implementation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from drivers.plc_map import Area
from drivers.timing import StopToken
from drivers.types import (
    Frame,
    FramePair,
    Grip,
    JointAngles,
    JointMotion,
    LineMotion,
    NotReachable,
    PlcInputs,
    PlcOutputs,
    RobotState,
    ToolPose,
)


class Device(Protocol):
    """Constructing does nothing; `open` does all or nothing; `close` may come twice and never raises."""

    @property
    def name(self) -> str:
        """How logs, faults and the PLC page call it: ``camera.left``, ``robot``, ..."""
        ...

    def open(self) -> None: ...

    def close(self) -> None: ...


class Camera(Device, Protocol):
    """One camera."""

    def grab(self, *, newer_than: float, timeout_s: float) -> Frame:
        """A frame exposed after ``newer_than``, or `DeviceTimeout`."""
        ...

    def check(self) -> None:
        """Does not wait; raises `DeviceUnavailable` when it is known to be lost, or is not open."""
        ...


class StereoRig(Device, Protocol):
    """Two cameras that look at one instant."""

    def grab_pair(self, *, newer_than: float, timeout_s: float) -> FramePair:
        """Frames exposed after ``newer_than``, within the skew limit; or `DeviceTimeout`, `StaleData`."""
        ...

    def check(self) -> None:
        """Does not wait; raises `DeviceUnavailable` when a camera is known to be lost, or is not open."""
        ...


class DigitalIo(Protocol):
    """Digital inputs and outputs."""

    def set_output(self, pin: int, on: bool) -> None: ...

    def read_input(self, pin: int) -> bool: ...


class WatchedArm(Device, Protocol):
    """An arm that is only looked at: nothing is started on its controller, and a person may lead it."""

    def state(self) -> RobotState:
        """Does not wait; raises `StaleData` when the controller's own clock has not moved."""
        ...


class Robot(Device, DigitalIo, Protocol):
    """An arm. Moves return when it has arrived; they never return early in silence."""

    def state(self) -> RobotState:
        """Does not wait; raises `StaleData` when the controller's own clock has not moved."""
        ...

    def reachable(self, target: ToolPose) -> bool: ...

    def move_line(self, target: ToolPose, motion: LineMotion, stop: StopToken) -> None: ...

    def move_joints(self, target: JointAngles, motion: JointMotion, stop: StopToken) -> None: ...

    def halt(self) -> None: ...

    def recover(self) -> None:
        """Clears what software may clear; called on an explicit reset only."""
        ...


class Kinematics(Protocol):
    """What is known of an arm without asking it."""

    def refused(self, start: JointAngles, way: Sequence[ToolPose]) -> NotReachable | None:
        """What stands against going from ``start`` along straight lines through ``way``; None: nothing that
        is known. Touches no device and takes milliseconds."""
        ...


class Gripper(Device, Protocol):
    """A parallel gripper."""

    def release(self, *, stop: StopToken) -> None: ...

    def grasp(self, *, stop: StopToken) -> Grip: ...

    def grip(self) -> Grip: ...


class Plc(Device, Protocol):
    """One exchange per call: outputs go out, inputs come in."""

    def exchange(self, outputs: PlcOutputs) -> PlcInputs: ...


class CellServer(Protocol):
    """The registers of a cell that is the Modbus server, as its PLC sees them; for a test of the connection.

    Calls connect by themselves and raise `DeviceUnavailable` or, when the cell refuses, `CommandRejected`.
    """

    def swap(self, command: PlcInputs) -> PlcOutputs:
        """Write the command block, then read the status block."""
        ...

    def read(self, area: Area, address: int, count: int) -> list[int]: ...

    def write(self, address: int, words: Sequence[int]) -> None: ...

    def close(self) -> None: ...
