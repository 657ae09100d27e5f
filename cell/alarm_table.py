"""The alarm table, the only place that knows what an alarm means: ISA-18.2's rationalisation, a row each.

Every fault is an alarm of the same number; the rest are conditions that are no fault. Never reuse a code.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Final, TypeAlias

from cell.faults import TABLE as FAULTS
from cell.faults import FaultCode


class Priority(Enum):
    """How soon a person has to act; the smaller the more urgent."""

    HIGH = 1
    MEDIUM = 2
    LOW = 3


class Health(Enum):
    """NAMUR NE 107: what is the matter with a device. Worst first."""

    FAILURE = "failure"
    CHECK_FUNCTION = "check function"
    OUT_OF_SPECIFICATION = "out of specification"
    MAINTENANCE = "maintenance required"
    GOOD = "good"


class Device(Enum):
    """What the cell is made of, for NE 107."""

    CAMERAS = "cameras"
    ARM = "arm"
    GRIPPER = "gripper"
    PLC = "PLC"
    CONTROLLER = "controller"


class Condition(IntEnum):
    """Alarms that are no fault: the cell goes on. Their numbers are beside those of the faults."""

    CONFIG_LAST_GOOD = 103
    CALIBRATION_DRIFT = 104
    BIN_EMPTY = 311
    NOTHING_GRASPABLE = 312
    GRIPS_FAIL = 511
    PLACES_FULL = 512
    CHOICE_AWAITED = 911
    NOT_IN_PRODUCTION = 912


AlarmCode: TypeAlias = FaultCode | Condition
CODES: Final[tuple[AlarmCode, ...]] = (*(code for code in FaultCode if code), *Condition)
"""Every alarm."""


def alarm_of(number: int) -> AlarmCode:
    """The alarm of a number; `ValueError` where there is none."""
    for code in CODES:
        if code == number:
            return code
    raise ValueError(f"{number} is not the code of an alarm")


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One alarm as a person reads it. Delays keep a condition that flickers from being many alarms."""

    priority: Priority
    device: Device
    health: Health
    cause: str
    consequence: str
    action: str
    on_delay_s: float = 0.0
    off_delay_s: float = 0.0


_STANDS: Final = "the order under way ended with this result; nothing moves until a reset and the next order"
_H, _M, _L = Priority.HIGH, Priority.MEDIUM, Priority.LOW
_F, _C, _S, _R = (
    Health.FAILURE,
    Health.CHECK_FUNCTION,
    Health.OUT_OF_SPECIFICATION,
    Health.MAINTENANCE,
)
_CAM, _ARM, _GRIP, _PLC, _CON = Device.CAMERAS, Device.ARM, Device.GRIPPER, Device.PLC, Device.CONTROLLER


def _fault(
    code: FaultCode, priority: Priority, device: Device, health: Health, cause: str, **delays: float
) -> tuple[AlarmCode, Row]:
    return code, Row(
        priority=priority,
        device=device,
        health=health,
        cause=cause,
        consequence=_STANDS,
        action=FAULTS[code].action,
        **delays,
    )


TABLE: Final[dict[AlarmCode, Row]] = dict(
    (
        _fault(FaultCode.CALIBRATION_MISSING, _H, _CAM, _F, "there is no calibration file"),
        _fault(FaultCode.CALIBRATION_MISMATCH, _H, _CAM, _F, "the calibration is of other cameras"),
        _fault(FaultCode.CAMERA_LOST, _H, _CAM, _F, "a camera cannot be reached, or has gone"),
        _fault(FaultCode.CAMERA_SLOW, _M, _CAM, _F, "a camera gave no picture in time"),
        _fault(FaultCode.CAMERA_STALE, _M, _CAM, _F, "a camera gives old pictures"),
        _fault(FaultCode.CAMERA_SKEW, _M, _CAM, _S, "the two exposures were too far apart"),
        _fault(
            FaultCode.IMAGE_UNUSABLE, _M, _CAM, _S, "a picture is black, saturated, flat or always the same"
        ),
        _fault(FaultCode.VISION_INTERNAL, _M, _CON, _F, "the detector failed on a pair of pictures"),
        _fault(FaultCode.ROBOT_LOST, _H, _ARM, _F, "the arm's controller cannot be reached, or has gone"),
        _fault(FaultCode.ROBOT_SLOW, _M, _ARM, _S, "a motion was not finished in its time"),
        _fault(FaultCode.ROBOT_STALE, _H, _ARM, _F, "the controller answers with old news"),
        _fault(FaultCode.PROTECTIVE_STOP, _H, _ARM, _C, "the arm met something, or a limit of its own"),
        _fault(FaultCode.SAFEGUARD_STOP, _M, _ARM, _C, "a guard is open"),
        _fault(FaultCode.EMERGENCY_STOP, _H, _ARM, _C, "an emergency stop is pressed"),
        _fault(FaultCode.SAFETY_UNKNOWN, _H, _ARM, _F, "the arm does not say how safe it is"),
        _fault(FaultCode.MOVE_REJECTED, _M, _ARM, _F, "the arm refused a motion, or its program was ended"),
        _fault(FaultCode.NOT_IN_REMOTE, _M, _ARM, _C, "somebody works at the arm's panel"),
        _fault(FaultCode.GRIPPER_LOST, _H, _GRIP, _F, "the gripper does not answer, or not in time"),
        _fault(FaultCode.GRIP_UNKNOWN, _M, _GRIP, _F, "the gripper does not say what it holds"),
        _fault(
            FaultCode.PLC_LOST, _M, _PLC, _F, "the PLC cannot be reached", on_delay_s=3.0, off_delay_s=2.0
        ),
        _fault(
            FaultCode.PLC_SILENT,
            _M,
            _PLC,
            _F,
            "the PLC's heartbeat stands, or it has not been heard since the start",
            on_delay_s=3.0,
            off_delay_s=2.0,
        ),
        _fault(FaultCode.PLC_BAD_ORDER, _L, _PLC, _S, "an order does not make sense"),
        _fault(FaultCode.JOURNAL_UNWRITABLE, _H, _CON, _F, "the journal's disk is full or cannot be written"),
        _fault(FaultCode.INTERNAL, _H, _CON, _F, "the program met something it does not know"),
    )
)
TABLE.update(
    {
        Condition.CONFIG_LAST_GOOD: Row(
            priority=_M,
            device=_CON,
            health=_S,
            cause="the configuration cannot be used; the last good one runs",
            consequence="what was changed in the configuration has no effect",
            action="correct it (`mikado check CONFIG` names file, line and key), restart the service",
        ),
        Condition.CALIBRATION_DRIFT: Row(
            priority=_M,
            device=_CAM,
            health=_R,
            cause="in production, rows of the two pictures or lengths of parts are no longer as calibrated",
            consequence="picks go on, perhaps less exact; nothing is corrected by itself",
            action="`mikado drift` shows the trend; `mikado verify touch`, then calibrate again",
        ),
        Condition.BIN_EMPTY: Row(
            priority=_L,
            device=_CON,
            health=Health.GOOD,
            cause="the last look saw an empty bin",
            consequence="orders end with 10, detail 2, until parts are there",
            action="fill the bin",
            on_delay_s=1.0,
            off_delay_s=1.0,
        ),
        Condition.NOTHING_GRASPABLE: Row(
            priority=_L,
            device=_CON,
            health=Health.GOOD,
            cause="parts lie in the bin, but none can be gripped",
            consequence="orders end with 10, 11 or 12, detail 3",
            action="stir or turn the parts; `mikado look` shows what stands against each",
            on_delay_s=1.0,
            off_delay_s=1.0,
        ),
        Condition.GRIPS_FAIL: Row(
            priority=_L,
            device=_GRIP,
            health=_R,
            cause="three orders in a row brought no part",
            consequence="the cell is slow; parts may be bent",
            action="look at jaws and fingers for wear and dirt; verify the hand-eye calibration",
        ),
        Condition.PLACES_FULL: Row(
            priority=_M,
            device=_CON,
            health=Health.GOOD,
            cause="every place of the pattern is taken",
            consequence="orders that place end with 15; nothing is gripped",
            action="change the tray, then command 10 with choice 5",
        ),
        Condition.CHOICE_AWAITED: Row(
            priority=_M,
            device=_CON,
            health=_C,
            cause="grips failed so often that a person is to choose",
            consequence="the cell is held; no order is taken",
            action="look at the bin; then command 10 with 1 retry, 2 skip, 3 count as picked, 4 stop; a "
            "reset is skip",
        ),
        Condition.NOT_IN_PRODUCTION: Row(
            priority=_L,
            device=_ARM,
            health=_C,
            cause="the cell is in maintenance, manual or dry-run mode",
            consequence="slower, step by step, or without gripping",
            action="command 11 with 1 goes back to production",
        ),
    }
)
