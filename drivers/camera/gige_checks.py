"""What GigE Vision cameras need on this machine; opens none of them."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from drivers.camera import aravis
from drivers.camera_settings import GigeCameraSettings
from drivers.errors import DeviceUnavailable
from drivers.types import Check

_RMEM_MAX: Final = Path("/proc/sys/net/core/rmem_max")
_INTERFACES: Final = Path("/sys/class/net")


def checks(cameras: tuple[GigeCameraSettings, ...]) -> tuple[Check, ...]:
    """The library, room for packets, and large packets where they are asked for."""
    return (_library(), _room(max(one.socket_buffer_bytes for one in cameras)), *_large(cameras))


def _library() -> Check:
    try:
        found = f"Aravis {aravis.version('cameras')}"
    except DeviceUnavailable as error:
        return Check(what="GigE library", ok=False, found=error.detail, do=aravis.INSTALL)
    return Check(what="GigE library", ok=True, found=found)


def _room(wanted: int) -> Check:
    what = "socket buffer"
    try:
        most = int(_RMEM_MAX.read_text())
    except (OSError, ValueError) as error:
        return Check(what=what, ok=False, found=f"{_RMEM_MAX} cannot be read: {error}", do="look why")
    found = f"net.core.rmem_max {most} bytes, socket_buffer_bytes {wanted}"
    return Check(
        what=what,
        ok=most >= wanted,
        found=found,
        do=f"sudo sysctl -w net.core.rmem_max={wanted}, or ask for less",
    )


def _large(cameras: tuple[GigeCameraSettings, ...]) -> tuple[Check, ...]:
    sizes = [one.packet_size for one in cameras if one.packet_size != "auto"]
    if not sizes or max(sizes) <= 1500:
        return ()
    largest = (
        max(
            int((port / "mtu").read_text())
            for port in _INTERFACES.iterdir()
            if (port / "mtu").is_file() and port.name != "lo"
        )
        if _INTERFACES.is_dir()
        else 0
    )
    return (
        Check(
            what="packet size",
            ok=largest >= max(sizes),
            found=f"largest MTU of a network port {largest}, packet_size {max(sizes)}",
            do="sudo ip link set dev PORT mtu 9000 (and on the switch), or packet_size: auto",
        ),
    )
