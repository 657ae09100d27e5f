"""Every way a device can fail has a fault, a result code for the PLC and an action for a person."""

from __future__ import annotations

import pytest

from cell.faults import (
    TABLE,
    FaultCode,
    PictureUnusable,
    VisionFailed,
    fault_of,
    safety_fault,
)
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

KINDS: tuple[type[DriverError], ...] = (
    DeviceUnavailable,
    DeviceTimeout,
    StaleData,
    CommandRejected,
    NotInRemote,
)
DEVICES = ("camera.left", "camera.right", "rig", "robot", "gripper", "plc")
HUNDREDS = {"camera": 2, "rig": 2, "robot": 4, "gripper": 5, "plc": 6}


@pytest.mark.parametrize("code", FaultCode)
def test_every_fault_has_a_row_with_an_action(code: FaultCode) -> None:
    if code is FaultCode.NONE:
        assert code not in TABLE
    else:
        assert TABLE[code].action
        assert TABLE[code].result not in (ResultCode.NONE, ResultCode.OK, ResultCode.OK_PARTIAL)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_error_of_every_device_is_a_fault_of_that_device(
    device: str, kind: type[DriverError]
) -> None:
    fault = fault_of(kind(device, "something"))
    assert fault.code // 100 == HUNDREDS[device.split(".")[0]]
    assert fault.detail == f"{device}: something"


@pytest.mark.parametrize("mode", SafetyMode)
def test_a_safety_stop_is_never_harmless(mode: SafetyMode) -> None:
    assert fault_of(SafetyStop("robot", mode)).code in (
        FaultCode.PROTECTIVE_STOP,
        FaultCode.SAFEGUARD_STOP,
        FaultCode.EMERGENCY_STOP,
        FaultCode.SAFETY_UNKNOWN,
    )


@pytest.mark.parametrize(
    ("mode", "code", "result"),
    [
        (SafetyMode.PROTECTIVE_STOP, 411, ResultCode.PROTECTIVE_STOP),
        (SafetyMode.SAFEGUARD_STOP, 412, ResultCode.SAFEGUARD_STOP),
        (SafetyMode.EMERGENCY_STOP, 413, ResultCode.EMERGENCY_STOP),
        (SafetyMode.UNKNOWN, 414, ResultCode.ROBOT_NOT_READY),
    ],
)
def test_the_arms_own_stops_keep_their_kind(mode: SafetyMode, code: int, result: ResultCode) -> None:
    fault = safety_fault(mode, "arm")
    assert fault is not None
    assert fault.code == code
    assert TABLE[fault.code].result is result
    assert fault_of(SafetyStop("robot", mode)).code == code


@pytest.mark.parametrize("mode", [SafetyMode.NORMAL, SafetyMode.REDUCED])
def test_an_arm_that_may_move_is_no_fault(mode: SafetyMode) -> None:
    assert safety_fault(mode, "arm") is None


def test_pictures_and_the_detector_have_their_own_faults() -> None:
    assert fault_of(PictureUnusable("left: black")).code is FaultCode.IMAGE_UNUSABLE
    assert fault_of(VisionFailed("ValueError: x")).code is FaultCode.VISION_INTERNAL


def test_what_nobody_foresaw_is_internal_and_names_its_kind() -> None:
    fault = fault_of(ZeroDivisionError("division by zero"))
    assert fault.code is FaultCode.INTERNAL
    assert fault.detail == "ZeroDivisionError: division by zero"


def test_an_unknown_device_is_internal() -> None:
    assert fault_of(DeviceTimeout("lamp", "dark")).code is FaultCode.INTERNAL
