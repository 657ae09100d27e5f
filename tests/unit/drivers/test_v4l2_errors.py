"""What the kernel says of a camera, in words that say what to do."""

from __future__ import annotations

import errno
import subprocess
from pathlib import Path

import pytest

from drivers.camera.v4l2_errors import explained, held_by
from drivers.errors import CommandRejected, DeviceUnavailable, DriverError

DEVICE = Path("/dev/v4l/by-path/pci-0000-usb-0:1:1.0-video-index0")


@pytest.mark.parametrize(
    ("code", "kind", "says"),
    [
        (errno.ENOENT, DeviceUnavailable, ("is not there", "uvcvideo", "mikado camera list")),
        (errno.ENODEV, DeviceUnavailable, ("ENODEV", "unplugged")),
        (errno.EACCES, DeviceUnavailable, ("EACCES", "group `video`")),
        (errno.EPERM, DeviceUnavailable, ("DeviceAllow=char-video4linux", "modules-load.d")),
        (errno.EBUSY, DeviceUnavailable, ("EBUSY", "another program", "usbcore.autosuspend=-1")),
        (errno.ENOSPC, CommandRejected, ("bandwidth", "MJPG", "rate_hz", "controllers", "quirks=0x80")),
        (errno.EPROTO, DeviceUnavailable, ("EPROTO", "cable")),
        (errno.EINVAL, CommandRejected, ("EINVAL", "does not do that")),
        (errno.ENOMEM, DeviceUnavailable, ("ENOMEM", "begin to stream from")),
    ],
    ids=lambda value: errno.errorcode.get(value, "") if isinstance(value, int) else "",
)
def test_an_error_number_comes_with_what_to_do(
    code: int, kind: type[DriverError], says: tuple[str, ...]
) -> None:
    error = explained("camera.left", DEVICE, "begin to stream from", OSError(code, "as the kernel says"))
    assert type(error) is kind
    assert error.device == "camera.left"
    assert str(DEVICE) in error.detail
    for words in says:
        assert words in error.detail


def test_who_holds_a_device_is_named_with_its_number() -> None:
    device = Path("/dev/full")
    with device.open("wb") as held, subprocess.Popen(["sleep", "60"], stdout=held) as holder:
        try:
            assert f"sleep ({holder.pid})" in held_by(device)
            assert any("this program" in one for one in held_by(device))
        finally:
            holder.kill()
    assert held_by(device) == ()


def test_nobody_holds_what_is_not_there() -> None:
    assert held_by(Path("/dev/v4l/by-path/nothing")) == ()
