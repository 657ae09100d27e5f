"""The alarm table is whole: every fault, and every error of every device, has a row a person can act on."""

from __future__ import annotations

import inspect

import pytest

from cell.alarm_table import CODES, TABLE, AlarmCode, Condition, Device, Health, Priority, alarm_of
from cell.faults import FaultCode, fault_of
from drivers import errors
from drivers.errors import DriverError, SafetyStop
from drivers.types import SafetyMode

ROLES = {
    "camera.left": Device.CAMERAS,
    "camera.right": Device.CAMERAS,
    "rig": Device.CAMERAS,
    "robot": Device.ARM,
    "gripper": Device.GRIPPER,
    "plc": Device.PLC,
}
KINDS = [
    kind
    for _, kind in inspect.getmembers(errors, inspect.isclass)
    if issubclass(kind, DriverError) and kind not in (DriverError, SafetyStop)
]


def test_there_are_kinds_of_errors_to_look_at() -> None:
    assert len(KINDS) >= 5


@pytest.mark.parametrize("role", ROLES)
@pytest.mark.parametrize("kind", KINDS)
def test_every_error_of_every_role_is_an_alarm_of_its_device(kind: type[DriverError], role: str) -> None:
    row = TABLE[fault_of(kind(role, "something")).code]
    assert row.device is ROLES[role]
    assert row.health is not Health.GOOD


@pytest.mark.parametrize("mode", SafetyMode)
def test_every_safety_stop_is_an_alarm_of_the_arm(mode: SafetyMode) -> None:
    assert TABLE[fault_of(SafetyStop("robot", mode)).code].device is Device.ARM


def test_every_fault_is_an_alarm_and_no_number_means_two_things() -> None:
    assert set(TABLE) == set(CODES) == {code for code in FaultCode if code} | set(Condition)
    assert len({int(code) for code in CODES}) == len(CODES)


@pytest.mark.parametrize("code", CODES)
def test_an_alarm_is_found_by_its_number(code: AlarmCode) -> None:
    assert alarm_of(int(code)) is code


@pytest.mark.parametrize("number", [-1, 0, 99, 1000])
def test_a_number_of_nothing_is_no_alarm(number: int) -> None:
    with pytest.raises(ValueError, match=str(number)):
        alarm_of(number)


@pytest.mark.parametrize("code", CODES)
def test_every_alarm_says_why_what_follows_and_what_to_do(code: AlarmCode) -> None:
    row = TABLE[code]
    for text in (row.cause, row.consequence, row.action):
        assert len(text) > 8
        assert not text.endswith(".")
    assert row.on_delay_s >= 0
    assert row.off_delay_s >= 0


def test_not_everything_is_urgent() -> None:
    """ISA-18.2: an operator to whom everything is urgent has no priorities."""
    high = sum(row.priority is Priority.HIGH for row in TABLE.values())
    assert high <= len(TABLE) / 2
