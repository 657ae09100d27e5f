"""Lost devices are opened again by themselves, with longer and longer pauses, and not for ever.

Opening moves nothing, and the fault stands until somebody resets it: what is won is that the PLC and the
operator see the device back, and that the reset then works at once.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from cell.faults import FaultCode
from cell.logs import logger
from cell.operation import RecoveryConfig
from drivers.errors import DriverError
from drivers.interfaces import Device
from drivers.timing import Clock

log = logger("cell")

LOST: Final = frozenset(
    {
        FaultCode.CAMERA_LOST,
        FaultCode.CAMERA_SLOW,
        FaultCode.CAMERA_STALE,
        FaultCode.ROBOT_LOST,
        FaultCode.ROBOT_STALE,
        FaultCode.GRIPPER_LOST,
    }
)
"""Faults of a device that may come back by itself. After a safety stop nothing is opened before the reset."""


class Reconnect:
    """When to try, and how often. Used by the cell thread."""

    def __init__(self, settings: RecoveryConfig, clock: Clock) -> None:
        self._settings = settings
        self._clock = clock
        self._tries = 0
        self._due_at: float | None = None

    def began(self, code: FaultCode) -> None:
        """A fault was raised: after one of a lost device, tries are due."""
        self._tries = 0
        lost = code in LOST and self._settings.reconnect_tries > 0
        self._due_at = self._clock.now() + self._settings.reconnect_first_s if lost else None

    def over(self) -> None:
        """Reset, or ended: nothing is tried any more."""
        self._due_at = None

    def attempt(self, devices: tuple[Device, ...], check: Callable[[], None]) -> bool:
        """Open all anew if that is due; True when it worked and ``check`` raised nothing."""
        if self._due_at is None or self._clock.now() < self._due_at:
            return False
        self._tries += 1
        try:
            for device in reversed(devices):
                device.close()
            for device in devices:
                device.open()
            check()
        except DriverError as error:
            pause_s = min(
                self._settings.reconnect_first_s * 2.0**self._tries, self._settings.reconnect_longest_s
            )
            if self._tries >= self._settings.reconnect_tries:
                log.warning("reconnect_given_up", tries=self._tries, detail=str(error), action="reset")
                self._due_at = None
            else:
                log.info("reconnect_failed", tries=self._tries, detail=str(error), next_in_s=pause_s)
                self._due_at = self._clock.now() + pause_s
            return False
        log.info("devices_reconnected", tries=self._tries, action="reset to go on")
        self._due_at = None
        return True
