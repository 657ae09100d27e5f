"""Which camera a calibration belongs to, in one word."""

from __future__ import annotations

from typing import Final

from cell.config import CamerasConfig
from drivers.camera_settings import CameraSettings, ReplayCameraSettings

_TELLING: Final = ("serial", "address", "device", "eye")
"""Settings that name one device; the first a driver has counts."""


def identity(settings: CameraSettings) -> str | None:
    """``driver-name`` of a configured camera; None for recorded pictures, which do not tell who took them."""
    if isinstance(settings, ReplayCameraSettings):
        return None
    values = settings.model_dump(mode="json")
    name = next((str(values[key]) for key in _TELLING if values.get(key)), "")
    return f"{settings.driver}-{name}"


def identities(cameras: CamerasConfig) -> tuple[str, str] | None:
    """Both cameras of a rig; None unless both are known."""
    left, right = identity(cameras.left), identity(cameras.right)
    return None if left is None or right is None else (left, right)
