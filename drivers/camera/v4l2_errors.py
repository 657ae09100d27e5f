"""What the kernel's error numbers mean for a camera, and what to do about them."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from drivers.errors import CommandRejected, DeviceUnavailable, DriverError

_GONE: Final = frozenset({errno.ENODEV, errno.ENXIO})
_USB: Final = frozenset(
    {errno.EIO, errno.EPROTO, errno.EPIPE, errno.ETIMEDOUT, errno.EILSEQ, errno.EOVERFLOW}
)


def explained(name: str, device: Path, doing: str, error: OSError) -> DriverError:
    """The error as one of ours, with what to do. ``doing`` completes "cannot ..."."""
    code = error.errno or 0
    said = f"cannot {doing} {device}: {os.strerror(code)} ({errno.errorcode.get(code, code)})"
    if code == errno.ENOENT:
        return DeviceUnavailable(
            name,
            f"{device} is not there: the camera is not plugged in, sits in another socket than the name "
            "says, or the module uvcvideo is not loaded; `mikado camera list` shows the cameras there are",
        )
    if code in _GONE:
        return DeviceUnavailable(name, f"{said}; it was unplugged, or lost power")
    if code == errno.EACCES:
        return DeviceUnavailable(
            name,
            f"{said}; put the user into the group `video` and log in again "
            "(a service: SupplementaryGroups=video)",
        )
    if code == errno.EPERM:
        return DeviceUnavailable(
            name,
            f"{said}; the service manager forbids it: the unit needs DeviceAllow=char-video4linux rw, and "
            "uvcvideo must be loaded before it starts (a file in /etc/modules-load.d)",
        )
    if code == errno.EBUSY:
        holders = held_by(device)
        who = f"held by {', '.join(holders)}" if holders else "held by another program"
        return DeviceUnavailable(
            name,
            f"{said}; it is {who}. End that program; if there is none, start the kernel with "
            "usbcore.autosuspend=-1 and plug the camera in anew",
        )
    if code == errno.ENOSPC:
        return CommandRejected(
            name,
            f"{said}: no USB bandwidth left for this camera. Use `format: MJPG`, a lower rate_hz or a "
            "smaller picture; plug the cameras into sockets of different USB controllers (`lsusb -t`), "
            "without a hub in between; or load uvcvideo with quirks=0x80, which reserves what is needed and "
            "not what the camera asks for",
        )
    if code in _USB:
        return DeviceUnavailable(
            name, f"{said}; the camera does not answer on USB: check cable, hub and power, plug it in anew"
        )
    if code in (errno.EINVAL, errno.ENOTTY, errno.ERANGE):
        return CommandRejected(name, f"{said}; the driver of this device does not do that")
    return DeviceUnavailable(name, said)


@contextmanager
def told_as_ours(name: str, device: Path, doing: str) -> Iterator[None]:
    """What the kernel refuses meanwhile is raised as `explained`."""
    try:
        yield
    except OSError as error:
        raise explained(name, device, doing, error) from error


def held_by(device: Path, processes: Path = Path("/proc")) -> tuple[str, ...]:
    """Programs that have the device open, as ``name (pid)``; those of other users show only to root."""
    try:
        number = os.stat(device).st_rdev
    except OSError:
        return ()
    found = []
    for process in processes.iterdir():
        if not process.name.isdigit():
            continue
        try:
            open_here = any(os.stat(link).st_rdev == number for link in _links(process / "fd"))
            if open_here:
                here = ", this program" if process.name == str(os.getpid()) else ""
                found.append(f"{(process / 'comm').read_text().strip()} ({process.name}{here})")
        except OSError:
            continue  # ended meanwhile, or somebody else's
    return tuple(sorted(found))


def _links(folder: Path) -> list[Path]:
    links = []
    for link in folder.iterdir():
        try:
            if str(os.readlink(link)).startswith("/dev/"):
                links.append(link)
        except OSError:
            continue  # closed meanwhile
    return links
