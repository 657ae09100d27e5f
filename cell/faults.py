"""Faults: code, name, what the PLC is told, what a person does. One table; never reuse a code."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from cell.errors import JournalError
from drivers.errors import (
    CommandRejected,
    DeviceTimeout,
    DeviceUnavailable,
    DriverError,
    NotInRemote,
    SafetyStop,
    StaleData,
)
from drivers.types import ResultCode, SafetyMode


class FaultCode(IntEnum):
    """Hundreds are the device, so that a PLC can act on ``code // 100`` alone."""

    NONE = 0
    CALIBRATION_MISSING = 101
    CALIBRATION_MISMATCH = 102
    CAMERA_LOST = 201
    CAMERA_SLOW = 202
    CAMERA_STALE = 203
    CAMERA_SKEW = 204
    IMAGE_UNUSABLE = 205
    VISION_INTERNAL = 301
    ROBOT_LOST = 401
    ROBOT_SLOW = 402
    ROBOT_STALE = 403
    PROTECTIVE_STOP = 411
    SAFEGUARD_STOP = 412
    EMERGENCY_STOP = 413
    SAFETY_UNKNOWN = 414
    MOVE_REJECTED = 421
    NOT_IN_REMOTE = 422
    GRIPPER_LOST = 501
    GRIP_UNKNOWN = 502
    PLC_LOST = 601
    PLC_SILENT = 602
    PLC_BAD_ORDER = 603
    JOURNAL_UNWRITABLE = 701
    INTERNAL = 901


class VisionFailed(Exception):
    """The detector raised on a picture pair it should have handled."""


class PictureUnusable(Exception):
    """A picture cannot be used: black, saturated, flat, blurred or unchanging. Names camera and number."""


class CameraMoved(PictureUnusable):
    """The two cameras no longer stand as they were calibrated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One fault as it is journaled, logged and shown."""

    code: FaultCode
    detail: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """What a fault means: the result code for the order it ended, and the way out."""

    result: ResultCode
    action: str


_RESET = "put it right, then reset (rising edge of control bit 3)"
TABLE: Final[dict[FaultCode, Row]] = {
    FaultCode.CALIBRATION_MISSING: Row(result=ResultCode.INTERNAL, action="calibrate, restart the service"),
    FaultCode.CALIBRATION_MISMATCH: Row(
        result=ResultCode.INTERNAL, action="calibrate these cameras, restart the service"
    ),
    FaultCode.CAMERA_LOST: Row(
        result=ResultCode.VISION_ERROR, action=f"check cable and power of the camera; {_RESET}"
    ),
    FaultCode.CAMERA_SLOW: Row(result=ResultCode.VISION_TIMEOUT, action=f"check the camera's link; {_RESET}"),
    FaultCode.CAMERA_STALE: Row(result=ResultCode.VISION_ERROR, action=f"check the camera; {_RESET}"),
    FaultCode.CAMERA_SKEW: Row(
        result=ResultCode.VISION_ERROR, action=f"the two pictures were too far apart in time; {_RESET}"
    ),
    FaultCode.IMAGE_UNUSABLE: Row(
        result=ResultCode.VISION_ERROR, action=f"check light, lens cap, focus, exposure; {_RESET}"
    ),
    FaultCode.VISION_INTERNAL: Row(
        result=ResultCode.VISION_ERROR, action="reset; send the journal to the makers if it comes again"
    ),
    FaultCode.ROBOT_LOST: Row(
        result=ResultCode.ROBOT_LINK_LOST, action=f"check the controller and its cable; {_RESET}"
    ),
    FaultCode.ROBOT_SLOW: Row(
        result=ResultCode.MOTION_TIMEOUT, action=f"look why the arm was slow; {_RESET}"
    ),
    FaultCode.ROBOT_STALE: Row(result=ResultCode.ROBOT_LINK_LOST, action=f"check the controller; {_RESET}"),
    FaultCode.PROTECTIVE_STOP: Row(
        result=ResultCode.PROTECTIVE_STOP,
        action="go to the robot, clear the cause, acknowledge there; then reset",
    ),
    FaultCode.SAFEGUARD_STOP: Row(
        result=ResultCode.SAFEGUARD_STOP, action="close the guard, acknowledge; then reset"
    ),
    FaultCode.EMERGENCY_STOP: Row(
        result=ResultCode.EMERGENCY_STOP, action="release the emergency stop at the robot; then reset"
    ),
    FaultCode.SAFETY_UNKNOWN: Row(
        result=ResultCode.ROBOT_NOT_READY,
        action="the arm's safety state is unknown: look at its panel; then reset",
    ),
    FaultCode.MOVE_REJECTED: Row(
        result=ResultCode.ROBOT_NOT_READY, action=f"read the arm's message in the log; {_RESET}"
    ),
    FaultCode.NOT_IN_REMOTE: Row(
        result=ResultCode.LOCAL_CONTROL,
        action="switch the arm to remote control at its panel (upper right corner); then reset",
    ),
    FaultCode.GRIPPER_LOST: Row(result=ResultCode.GRIP_FAILED, action=f"check the gripper; {_RESET}"),
    FaultCode.GRIP_UNKNOWN: Row(
        result=ResultCode.GRIP_FAILED, action=f"look what the gripper holds, empty it; {_RESET}"
    ),
    FaultCode.PLC_LOST: Row(
        result=ResultCode.PLC_LINK_LOST, action="check the PLC and the network; goes away by itself"
    ),
    FaultCode.PLC_SILENT: Row(
        result=ResultCode.PLC_LINK_LOST, action="the PLC's heartbeat stands: is its program running?"
    ),
    FaultCode.PLC_BAD_ORDER: Row(
        result=ResultCode.BAD_PARAMETER, action="correct the order in the PLC program"
    ),
    FaultCode.JOURNAL_UNWRITABLE: Row(
        result=ResultCode.INTERNAL,
        action=f"make room on the journal's disk (no order is taken without it); {_RESET}",
    ),
    FaultCode.INTERNAL: Row(
        result=ResultCode.INTERNAL, action="reset; send the journal to the makers if it comes again"
    ),
}

_SAFETY: Final[dict[SafetyMode, FaultCode]] = {
    SafetyMode.PROTECTIVE_STOP: FaultCode.PROTECTIVE_STOP,
    SafetyMode.SAFEGUARD_STOP: FaultCode.SAFEGUARD_STOP,
    SafetyMode.EMERGENCY_STOP: FaultCode.EMERGENCY_STOP,
    SafetyMode.UNKNOWN: FaultCode.SAFETY_UNKNOWN,
}

_BY_DEVICE: Final[dict[str, dict[type[DriverError], FaultCode]]] = {
    "camera": {
        DeviceUnavailable: FaultCode.CAMERA_LOST,
        DeviceTimeout: FaultCode.CAMERA_SLOW,
        StaleData: FaultCode.CAMERA_STALE,
        CommandRejected: FaultCode.CAMERA_LOST,
    },
    "rig": {
        DeviceUnavailable: FaultCode.CAMERA_LOST,
        DeviceTimeout: FaultCode.CAMERA_SLOW,
        StaleData: FaultCode.CAMERA_SKEW,
        CommandRejected: FaultCode.CAMERA_LOST,
    },
    "robot": {
        DeviceUnavailable: FaultCode.ROBOT_LOST,
        DeviceTimeout: FaultCode.ROBOT_SLOW,
        StaleData: FaultCode.ROBOT_STALE,
        CommandRejected: FaultCode.MOVE_REJECTED,
        NotInRemote: FaultCode.NOT_IN_REMOTE,
    },
    "gripper": {
        DeviceUnavailable: FaultCode.GRIPPER_LOST,
        DeviceTimeout: FaultCode.GRIPPER_LOST,
        StaleData: FaultCode.GRIP_UNKNOWN,
        CommandRejected: FaultCode.GRIPPER_LOST,
    },
    "plc": {
        DeviceUnavailable: FaultCode.PLC_LOST,
        DeviceTimeout: FaultCode.PLC_LOST,
        StaleData: FaultCode.PLC_SILENT,
        CommandRejected: FaultCode.PLC_BAD_ORDER,
    },
}


def safety_fault(mode: SafetyMode, detail: str) -> Fault | None:
    """The fault of a safety mode; None where the arm may move."""
    code = _SAFETY.get(mode)
    return None if code is None else Fault(code=code, detail=detail)


def fault_of(error: Exception) -> Fault:
    """The fault an exception means. Devices are told apart by the first word of their name.

    >>> fault_of(DeviceTimeout("camera.left", "no frame")).code.name
    'CAMERA_SLOW'
    """
    match error:
        case SafetyStop(mode=mode):
            return Fault(code=_SAFETY.get(mode, FaultCode.SAFETY_UNKNOWN), detail=str(error))
        case DriverError(device=device):
            kinds = _BY_DEVICE.get(device.split(".")[0], {})
            known = (kinds[kind] for kind in type(error).__mro__ if kind in kinds)
            return Fault(code=next(known, FaultCode.INTERNAL), detail=str(error))
        case CameraMoved():
            return Fault(code=FaultCode.CALIBRATION_MISMATCH, detail=str(error))
        case PictureUnusable():
            return Fault(code=FaultCode.IMAGE_UNUSABLE, detail=str(error))
        case JournalError():
            return Fault(code=FaultCode.JOURNAL_UNWRITABLE, detail=str(error))
        case VisionFailed():
            return Fault(code=FaultCode.VISION_INTERNAL, detail=str(error))
        case _:
            return Fault(code=FaultCode.INTERNAL, detail=f"{type(error).__name__}: {error}")
