"""What a driver may raise: a few kinds, each naming the device and what happened."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from drivers.types import SafetyMode


class DriverError(Exception):
    """Something a device did or did not do. Only its subclasses are raised."""

    def __init__(self, device: str, detail: str) -> None:
        super().__init__(f"{device}: {detail}")
        self.device = device
        self.detail = detail


class DeviceUnavailable(DriverError):
    """Cannot be reached, or was lost."""


class DeviceTimeout(DriverError):
    """Reachable, but not in time."""


class StaleData(DriverError):
    """Answers, but with old news."""


class CommandRejected(DriverError):
    """Said no."""


class NotInRemote(CommandRejected):
    """Said no because somebody works at its panel: it is in local control."""


class SafetyStop(DriverError):
    """Stopped by its own safety system; a person has to look."""

    def __init__(self, device: str, mode: SafetyMode) -> None:
        super().__init__(device, f"stopped by its safety system: {mode.name}")
        self.mode = mode
