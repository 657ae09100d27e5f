"""Records that cross the driver border: plain numbers, no vendor types.

Metres, radians, seconds. Instants end in ``_at`` and come from the monotonic clock.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

Pixels: TypeAlias = npt.NDArray[np.uint8]
Three: TypeAlias = tuple[float, float, float]
Six: TypeAlias = tuple[float, float, float, float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """One picture. ``pixels`` (H, W) or (H, W, 3) uint8 BGR, read-only.

    ``captured_at`` is never later than the exposure: the driver subtracts its worst buffering.
    """

    camera: str
    pixels: Pixels
    captured_at: float
    sequence: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FramePair:
    """Two pictures of one instant."""

    left: Frame
    right: Frame

    @property
    def skew_s(self) -> float:
        """How far apart the two exposures are, >= 0."""
        return abs(self.left.captured_at - self.right.captured_at)


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundCamera:
    """A camera that is there, configured or not. ``device`` is what a configuration calls it, under ``key``;
    ``problem`` says why nothing more is known of it."""

    driver: str
    device: str
    key: str = "device"
    also: tuple[str, ...] = ()
    model: str = ""
    formats: tuple[str, ...] = ()
    controls: tuple[str, ...] = ()
    problem: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ToolPose:
    """The tool in the robot's base frame: metres, and a rotation vector in radians."""

    x: float
    y: float
    z: float
    rx: float
    ry: float
    rz: float

    def six(self) -> Six:
        """x, y, z, rx, ry, rz."""
        return (self.x, self.y, self.z, self.rx, self.ry, self.rz)

    @staticmethod
    def of(values: Six) -> ToolPose:
        """The pose of six numbers in the order of `six`."""
        x, y, z, rx, ry, rz = (float(v) for v in values)
        return ToolPose(x=x, y=y, z=z, rx=rx, ry=ry, rz=rz)


@dataclass(frozen=True, slots=True, kw_only=True)
class JointAngles:
    """``q_rad``: six angles, base to wrist 3."""

    q_rad: Six


@dataclass(frozen=True, slots=True, kw_only=True)
class LineMotion:
    """How to move along a line."""

    speed_m_s: float
    accel_m_s2: float
    timeout_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class JointMotion:
    """How to move through joint space."""

    speed_rad_s: float
    accel_rad_s2: float
    timeout_s: float


class SafetyMode(Enum):
    """The arm's own safety state. UNKNOWN is where everything starts."""

    NORMAL = "normal"
    REDUCED = "reduced"
    PROTECTIVE_STOP = "protective_stop"
    SAFEGUARD_STOP = "safeguard_stop"
    EMERGENCY_STOP = "emergency_stop"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotState:
    """What the arm says of itself. ``controller_time_s`` is the controller's own clock."""

    safety: SafetyMode
    powered: bool
    program_running: bool
    tool: ToolPose
    joints: JointAngles
    moving: bool
    speed_fraction: float
    controller_time_s: float
    read_at: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """One line of a look at a device before it is used: what was found, and what to do when it is wrong."""

    what: str
    ok: bool
    found: str
    do: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pins:
    """Digital pins of an arm at one instant, bit n for pin n."""

    inputs: int
    outputs: int


class ReachLimit(Enum):
    """What keeps an arm from a place, or from the way there. Values are what a person reads."""

    BOX = "outside the box the tool may be in"
    TOO_FAR = "farther than the arm reaches"
    TOO_NEAR = "nearer to its base than the arm can fold"
    JOINT = "a joint at its limit"
    WRIST = "wrist nearly straight or folded"
    ELBOW = "elbow nearly straight or folded"
    SHOULDER = "hand nearly above the base"
    SWING = "the arm would have to change its posture on the way"


@dataclass(frozen=True, slots=True, kw_only=True)
class NotReachable:
    """Why an arm is not to go a way: ``value`` against ``bound``, on its ``leg``-th line (from 0)."""

    limit: ReachLimit
    value: float
    bound: float
    unit: Literal["m", "rad"]
    leg: int
    joint: int | None = None


class Grip(Enum):
    """What the gripper holds. UNKNOWN is where everything starts."""

    OPEN = "open"
    CLOSED_EMPTY = "closed_empty"
    HOLDING = "holding"
    UNKNOWN = "unknown"


class PlcCommand(IntEnum):
    """``cmd_code`` of map v1."""

    PICK = 1
    PLACE = 2
    PICK_AND_PLACE = 3
    HOME = 4
    RETRACT = 5
    LOAD_RECIPE = 6
    VISION_ONLY = 7
    GRIPPER_OPEN = 8
    GRIPPER_CLOSE = 9
    RECOVER = 10
    SET_MODE = 11
    PING = 255


class ResultCode(IntEnum):
    """``ack_code`` and ``result_code`` of map v1. Never reused."""

    NONE = 0
    OK = 1
    OK_PARTIAL = 2
    NO_PART_FOUND = 10
    UNREACHABLE = 11
    COLLISION = 12
    GRIP_FAILED = 13
    PART_LOST = 14
    PLACE_BLOCKED = 15
    VISION_ERROR = 20
    VISION_TIMEOUT = 21
    ROBOT_NOT_READY = 30
    PROTECTIVE_STOP = 31
    EMERGENCY_STOP = 32
    SAFEGUARD_STOP = 33
    ROBOT_LINK_LOST = 34
    ROBOT_PROGRAM_STOPPED = 35
    MOTION_TIMEOUT = 36
    LOCAL_CONTROL = 37
    SAFETY_LIMITS = 38
    ABORTED = 40
    PLC_LINK_LOST = 41
    INTERRUPTED_BY_RESTART = 42
    UNKNOWN_COMMAND = 50
    BAD_PARAMETER = 51
    BAD_SEQUENCE = 52
    BUSY = 53
    NOT_ENABLED = 54
    MAP_VERSION = 55
    CRC = 56
    INTERNAL = 90


@dataclass(frozen=True, slots=True, kw_only=True)
class PlcInputs:
    """The command block of map v1, PLC to cell. ``crc_ok`` is True where the PLC uses none (word 22 = 0)."""

    map_version: int
    heartbeat: int
    enable: bool
    abort: bool
    hold: bool
    reset_fault: bool
    dry_run: bool
    home_on_stop: bool
    cmd_seq: int
    cmd_code: int
    recipe: int
    source_id: int
    destination_id: int
    max_attempts: int
    speed_percent: int
    pose: ToolPose
    crc_used: bool
    crc_ok: bool
    result_ack_seq: int
    read_at: float


QUIET = PlcInputs(
    map_version=1,
    heartbeat=0,
    enable=False,
    abort=False,
    hold=False,
    reset_fault=False,
    dry_run=False,
    home_on_stop=False,
    cmd_seq=0,
    cmd_code=0,
    recipe=0,
    source_id=0,
    destination_id=0,
    max_attempts=0,
    speed_percent=0,
    pose=ToolPose(x=0.0, y=0.0, z=0.0, rx=0.0, ry=0.0, rz=0.0),
    crc_used=False,
    crc_ok=True,
    result_ack_seq=0,
    read_at=0.0,
)
"""A PLC of map v1 that neither enables nor wants anything; `dataclasses.replace` makes the others."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlcOutputs:
    """The status block of map v1, cell to PLC. The defaults are the unsafe side: nothing is ready."""

    map_version: int = 1
    heartbeat: int = 0
    ready: bool = False
    busy: bool = False
    moving: bool = False
    result_valid: bool = False
    fault: bool = False
    emergency_stop: bool = False
    protective_stop: bool = False
    safeguard_stop: bool = False
    robot_link: bool = False
    remote_control: bool = False
    program_running: bool = False
    vision_ok: bool = False
    plc_link_ok: bool = False
    part_in_gripper: bool = False
    at_home: bool = False
    operator_needed: bool = False
    state: int = 2
    accepted_seq: int = 0
    ack_code: int = 0
    result_seq: int = 0
    result_code: int = 0
    result_detail: int = 0
    quantity: int = 0
    part_type: int = 0
    confidence: float = 0.0
    pose: ToolPose = ToolPose(x=0.0, y=0.0, z=0.0, rx=0.0, ry=0.0, rz=0.0)
    cycle_time_s: float = 0.0
    total_picks: int = 0
    robot_mode: int = -1
    safety_mode: int = 0
    runtime_state: int = 0
    fault_code: int = 0
    fault_count: int = 0
    plc_link_age_s: float = 0.0
    active_recipe: int = 0
    actual_speed_percent: int = 0
    boot_id: int = 0
    first_alarm: int = 0
    alarm_count: int = 0
    unit_mode: int = 0
