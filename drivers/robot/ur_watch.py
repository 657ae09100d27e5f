"""A UR arm that is only looked at: state by RTDE, no program, so that a person can lead it by hand."""

from __future__ import annotations

from drivers.errors import CommandRejected
from drivers.robot.ur_codes import RUNNING, Runtime
from drivers.robot.ur_preflight import offset_of
from drivers.robot.ur_stream import Snapshot, UrStream
from drivers.settings import UrRobotSettings
from drivers.timing import Clock
from drivers.types import JointAngles, RobotState, ToolPose


def state_of(snapshot: Snapshot) -> RobotState:
    """The same as every arm says it."""
    return RobotState(
        safety=snapshot.safety,
        powered=snapshot.robot_mode == RUNNING,
        program_running=snapshot.runtime == Runtime.PLAYING,
        tool=ToolPose.of(snapshot.tool),
        joints=JointAngles(q_rad=snapshot.q_rad),
        moving=snapshot.moving,
        speed_fraction=snapshot.speed_fraction,
        controller_time_s=snapshot.controller_time_s,
        read_at=snapshot.at,
    )


class UrWatch:
    """Satisfies `drivers.interfaces.WatchedArm`. A running control program would hold the arm still."""

    def __init__(self, name: str, settings: UrRobotSettings, clock: Clock) -> None:
        self._name = name
        self._settings = settings
        self._stream = UrStream(name, clock, offset_of(settings), lambda _why: None)

    @property
    def name(self) -> str:
        """How logs and faults call it."""
        return self._name

    def open(self) -> None:
        """Connect; `CommandRejected` where only the control program knows the tool."""
        if self._settings.tool_from == "configuration":
            raise CommandRejected(
                self._name,
                "tool_from: configuration sets the tool with the control program, which cannot run while a "
                "person leads the arm; set the tool on the pendant and tool_from: installation",
            )
        self._stream.open(self._settings.host)

    def close(self) -> None:
        """Hang up; never raises, may come twice."""
        self._stream.close()

    def state(self) -> RobotState:
        """What the arm says of itself; see `drivers.interfaces.Robot`."""
        return state_of(self._stream.latest())
