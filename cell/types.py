"""Records of the cell: what passes between its threads."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

from drivers.types import PlcCommand, ResultCode, ToolPose
from vision.types import Candidate


class Outcome(IntEnum):
    """How a pick ended. "Nothing to pick" is an outcome; a fault is something a person must deal with."""

    NONE = 0
    PICKED = 1
    BIN_EMPTY = 2
    NOTHING_GRASPABLE = 3
    MISSED = 4
    ABORTED = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class PickOrder:
    """One accepted command of the PLC; ``request_id`` is its sequence number.

    ``speed_fraction`` 0..1 of the configured speeds; ``max_attempts`` >= 1.
    """

    request_id: int
    command: PlcCommand
    part_code: int
    source_id: int
    destination_id: int
    max_attempts: int
    speed_fraction: float
    pose: ToolPose
    dry_run: bool
    received_at: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pick:
    """One planned grasp in the robot's base frame. ``rank`` 1 is first.

    ``clearance_m`` free space around the fingers; ``gap_free`` False: another part lies between them too.
    """

    rank: int
    approach: ToolPose
    grasp: ToolPose
    retreat: ToolPose
    clearance_m: float
    gap_free: bool
    score: float
    candidate: Candidate


@dataclass(frozen=True, slots=True, kw_only=True)
class PickResult:
    """What an order came to. This is what the journal keeps and the PLC is told."""

    request_id: int
    code: ResultCode
    outcome: Outcome
    detail: int = 0
    quantity: int = 0
    part_type: int = 0
    confidence: float = 0.0
    pose: ToolPose | None = None
    took_s: float = 0.0
    seen: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    durations_s: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class CellReport:
    """What the cell thread says of itself, for the handshake. The defaults are the unsafe side.

    ``state`` is the PackML number; ``accepting`` is True when an order would be started now.
    """

    state: int = 2
    accepting: bool = False
    busy: bool = False
    moving: bool = False
    fault_code: int = 0
    fault_count: int = 0
    emergency_stop: bool = False
    protective_stop: bool = False
    safeguard_stop: bool = False
    robot_link: bool = False
    remote_control: bool = False
    program_running: bool = False
    vision_ok: bool = False
    part_in_gripper: bool = False
    at_home: bool = False
    operator_needed: bool = False
    safety_mode: int = 0
    speed_percent: int = 0
    recipe: int = 0
    total_picks: int = 0
    unit_mode: int = 1
    choice_awaited: bool = False
    first_alarm: int = 0
    alarm_count: int = 0
