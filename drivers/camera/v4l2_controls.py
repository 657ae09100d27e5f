"""The controls a configuration speaks of: what each is to be, set in an order that works, read back and
compared."""

from __future__ import annotations

import errno
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from drivers.camera.v4l2_device import ControlRange, VideoDevice
from drivers.camera.v4l2_errors import explained
from drivers.camera_settings import V4l2CameraSettings
from drivers.errors import CommandRejected

AUTO_EXPOSURE: Final = 0x009A0901
EXPOSURE: Final = 0x009A0902
DYNAMIC_RATE: Final = 0x009A0903
FOCUS: Final = 0x009A090A
AUTO_FOCUS: Final = 0x009A090C
AUTO_WHITE_BALANCE: Final = 0x0098090C
AUTO_GAIN: Final = 0x00980912
GAIN: Final = 0x00980913
POWER_LINE: Final = 0x00980918
WHITE_BALANCE: Final = 0x0098091A

_MANUAL_EXPOSURE: Final = 1
_POWER_LINE_OF_HZ: Final = {0: 0, 50: 1, 60: 2}


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """A control and its value. ``key`` is the setting it comes from; without one it is an automatic that is
    switched off where the camera has it, and no matter where it has not."""

    number: int
    name: str
    value: int
    key: str | None


def wanted(settings: V4l2CameraSettings) -> tuple[Wanted, ...]:
    """What the settings ask of the controls: automatics first, for they hold the values they make."""
    asked = [
        Wanted(number=AUTO_EXPOSURE, name="auto_exposure", value=_MANUAL_EXPOSURE, key="exposure_us"),
        # else the camera lengthens the time between pictures when it is dark
        Wanted(number=DYNAMIC_RATE, name="exposure_dynamic_framerate", value=0, key=None),
        Wanted(number=AUTO_GAIN, name="gain_automatic", value=0, key=None),
        Wanted(number=AUTO_WHITE_BALANCE, name="white_balance_automatic", value=0, key=None),
        Wanted(number=AUTO_FOCUS, name="focus_automatic_continuous", value=0, key=None),
        Wanted(
            number=EXPOSURE,
            name="exposure_time_absolute",
            value=settings.exposure_us // 100,
            key="exposure_us",
        ),
    ]
    given = (
        (GAIN, "gain", settings.gain, "gain"),
        (WHITE_BALANCE, "white_balance_temperature", settings.white_balance_k, "white_balance_k"),
        (FOCUS, "focus_absolute", settings.focus, "focus"),
    )
    asked += [Wanted(number=n, name=name, value=v, key=key) for n, name, v, key in given if v is not None]
    if settings.power_line_hz is not None:
        value = _POWER_LINE_OF_HZ[settings.power_line_hz]
        asked.append(Wanted(number=POWER_LINE, name="power_line_frequency", value=value, key="power_line_hz"))
    return tuple(asked)


def apply(name: str, path: Path, device: VideoDevice, asked: tuple[Wanted, ...]) -> None:
    """Set every control that is asked for, then `verify`.

    Raises
    ------
    DriverError
        As `verify`; or the device refused a value.
    """
    for one in asked:
        there = device.control(one.number)
        if there is None:
            if one.key is not None:
                raise CommandRejected(
                    name, f"{path} has no control {one.name}; leave `{one.key}` out, or take another camera"
                )
            continue
        if there.read_only:
            continue  # `verify` tells whether it stands where it should
        try:
            device.set(one.number, one.value)
        except OSError as error:
            if error.errno in _REFUSALS:
                raise CommandRejected(name, _mismatch(path, one, "refused", there)) from error
            raise explained(name, path, f"set {one.name} of", error) from error
    verify(name, path, device, asked)


def verify(name: str, path: Path, device: VideoDevice, asked: tuple[Wanted, ...]) -> None:
    """Read every control back.

    Raises
    ------
    CommandRejected
        One stands elsewhere than asked for, or an automatic of the camera has it; names the control, what was
        wanted, what it has, and its range.
    """
    for one in asked:
        there = device.control(one.number)
        if there is None:
            continue
        try:
            has = device.get(one.number)
        except OSError as error:
            raise explained(name, path, f"read {one.name} of", error) from error
        if has != one.value:
            raise CommandRejected(name, _mismatch(path, one, f"it has {has}", there))
        if there.inactive and one.key is not None:
            raise CommandRejected(
                name, _mismatch(path, one, f"it has {has}, but an automatic of the camera moves it", there)
            )


_REFUSALS: Final = frozenset({errno.EINVAL, errno.ERANGE, errno.EBUSY, errno.EACCES})
"""The last two: an automatic of the camera has the control."""


def _mismatch(path: Path, one: Wanted, got: str, there: ControlRange) -> str:
    from_key = f" (from `{one.key}`)" if one.key is not None else ""
    in_units = " in units of 100 us" if one.number == EXPOSURE else ""
    return (
        f"{path}: control {one.name}: wanted {one.value}{from_key}, {got}; it takes {there.minimum} to "
        f"{there.maximum} in steps of {there.step}{in_units}"
    )
