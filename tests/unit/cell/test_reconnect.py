"""A lost device is tried again with growing pauses, not for ever, and the fault stands all the same."""

from __future__ import annotations

import pytest

from cell.faults import FaultCode
from cell.operation import RecoveryConfig
from cell.reconnect import Reconnect
from drivers.errors import DeviceUnavailable
from drivers.interfaces import Device
from tests.fakes.clock import FakeClock

SETTINGS = RecoveryConfig(reconnect_first_s=1.0, reconnect_longest_s=6.0, reconnect_tries=5)


class Flaky:
    """A device that can be opened again after so many refusals."""

    name = "camera.left"

    def __init__(self, refusals: int) -> None:
        self.refusals = refusals
        self.opened_at: list[float] = []
        self.clock: FakeClock | None = None

    def open(self) -> None:
        assert self.clock is not None
        self.opened_at.append(self.clock.now())
        if len(self.opened_at) <= self.refusals:
            raise DeviceUnavailable(self.name, "no cable")

    def close(self) -> None: ...


def tried(code: FaultCode, refusals: int, for_s: float = 120.0) -> tuple[list[float], bool]:
    clock = FakeClock(now=0.0)
    device = Flaky(refusals)
    device.clock = clock
    again = Reconnect(SETTINGS, clock)
    devices: tuple[Device, ...] = (device,)
    again.began(code)
    worked = False
    while clock.now() < for_s:
        worked = again.attempt(devices, lambda: None) or worked
        clock.turn(0.1)
    return device.opened_at, worked


def test_pauses_double_up_to_the_longest() -> None:
    at, worked = tried(FaultCode.CAMERA_LOST, refusals=4)
    assert worked
    pauses = [b - a for a, b in zip([0.0, *at], at, strict=False)]
    assert pauses == pytest.approx([1.0, 2.0, 4.0, 6.0, 6.0], abs=0.15)


def test_it_gives_up() -> None:
    at, worked = tried(FaultCode.ROBOT_LOST, refusals=100)
    assert not worked
    assert len(at) == 5


@pytest.mark.parametrize("code", [FaultCode.PROTECTIVE_STOP, FaultCode.EMERGENCY_STOP, FaultCode.INTERNAL])
def test_after_a_safety_stop_nothing_is_opened(code: FaultCode) -> None:
    assert tried(code, refusals=0) == ([], False)
