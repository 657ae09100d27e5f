"""The webcam driver on a scripted device: what a real kernel does not do on request.

The real one is in tests/lab."""

from __future__ import annotations

import errno
from collections import deque
from pathlib import Path
from typing import cast

import cv2
import numpy as np
import pytest

from drivers.camera import v4l2_abi as abi
from drivers.camera import v4l2_controls
from drivers.camera.v4l2 import V4l2Source
from drivers.camera.v4l2_device import (
    ControlRange,
    Filled,
    Identity,
    OfferedSize,
    PictureFormat,
    VideoDevice,
)
from drivers.camera_settings import V4l2CameraSettings
from drivers.errors import CommandRejected, DeviceUnavailable, DriverError
from tests.fakes.clock import FakeClock

PATH = "/dev/v4l/by-path/lab-video-index0"
EXPOSURE, GAIN, AUTO = v4l2_controls.EXPOSURE, v4l2_controls.GAIN, v4l2_controls.AUTO_EXPOSURE


class ScriptedDevice:
    """What a webcam answers; one control may be stubborn, or fall back when the stream begins."""

    def __init__(self) -> None:
        self.values = {AUTO: 3, EXPOSURE: 156, GAIN: 0}
        self.stubborn: set[int] = set()
        self.falls_back: dict[int, int] = {}
        self.stream_error: OSError | None = None
        self.monotonic = True
        self.ready: deque[Filled] = deque()
        self.error: OSError | None = None
        self.closed = 0

    def identity(self) -> Identity:
        return Identity(driver="uvcvideo", model="Scripted", bus="usb-1", captures=True)

    def set_format(self, width_px: int, height_px: int, letters: str) -> PictureFormat:
        return PictureFormat(width_px=min(width_px, 640), height_px=height_px, letters=letters, row_bytes=0)

    def set_rate(self, rate_hz: float) -> float:
        return min(rate_hz, 30.0)

    def offered(self) -> tuple[OfferedSize, ...]:
        return (OfferedSize(letters="MJPG", width_px=640, height_px=480, rates_hz=(30.0, 15.0)),)

    def control(self, number: int) -> ControlRange | None:
        if number not in self.values:
            return None
        automatic = number == EXPOSURE and self.values[AUTO] != 1
        return ControlRange(
            id=number, label="", minimum=0, maximum=5000, step=1, default=0, inactive=automatic,
            read_only=False,
        )  # fmt: skip

    def get(self, number: int) -> int:
        return self.values[number]

    def set(self, number: int, value: int) -> None:
        if number not in self.stubborn:
            self.values[number] = value

    def stream(self, buffers: int) -> bool:
        if self.stream_error is not None:
            raise self.stream_error
        self.values.update(self.falls_back)
        return self.monotonic

    def wait(self, timeout_s: float) -> bool:
        if not self.ready and self.error is None:
            CLOCK.turn(max(timeout_s, 0.001))
            return False
        return True

    def take(self) -> Filled | None:
        if self.ready:
            return self.ready.popleft()
        if self.error is not None:
            raise self.error
        return None

    def close(self) -> None:
        self.closed += 1


CLOCK = FakeClock()


def source(scripted: ScriptedDevice, **changed: object) -> V4l2Source:
    values = {
        "driver": "v4l2",
        "device": PATH,
        "width_px": 640,
        "height_px": 480,
        "exposure_us": 5000,
        **changed,
    }
    settings = V4l2CameraSettings.model_validate(values)
    return V4l2Source("camera.left", settings, CLOCK, lambda path: cast("VideoDevice", scripted))


def filled(sequence: int, *, at: float = 10.0, spoilt: bool = False, content: bytes | None = None) -> Filled:
    if content is None:
        content = cv2.imencode(".jpg", np.full((480, 640, 3), 90, np.uint8))[1].tobytes()
    return Filled(content=content, at=at, sequence=sequence, spoilt=spoilt)


def refusal(device: ScriptedDevice, **changed: object) -> DriverError:
    one = source(device, **changed)
    with pytest.raises(DriverError) as caught:
        one.start()
    assert device.closed == 1, "what was opened is closed again"
    with pytest.raises(DeviceUnavailable):
        one.next(0.0)
    return caught.value


def test_no_usb_bandwidth_is_said_as_such_when_the_stream_begins() -> None:
    device = ScriptedDevice()
    device.stream_error = OSError(errno.ENOSPC, "No space left on device")
    error = refusal(device)
    assert type(error) is CommandRejected
    assert "begin to stream from" in error.detail
    assert "USB bandwidth" in error.detail


def test_a_control_that_does_not_take_its_value_is_refused_by_name_with_both_values_and_the_range() -> None:
    device = ScriptedDevice()
    device.stubborn = {EXPOSURE}
    error = refusal(device)
    assert type(error) is CommandRejected
    assert (
        "exposure_time_absolute: wanted 50 (from `exposure_us`), it has 156; it takes 0 to 5000"
        in error.detail
    )


def test_an_automatic_that_cannot_be_switched_off_is_refused() -> None:
    device = ScriptedDevice()
    device.stubborn = {AUTO}
    assert "auto_exposure: wanted 1" in refusal(device).detail


def test_a_control_that_falls_back_when_the_stream_begins_is_refused() -> None:
    device = ScriptedDevice()
    device.falls_back = {GAIN: 0}
    assert "gain: wanted 7 (from `gain`), it has 0" in refusal(device, gain=7).detail


def test_a_control_the_camera_has_not_is_refused_with_the_key_to_leave_out() -> None:
    assert "no control focus_absolute; leave `focus` out" in refusal(ScriptedDevice(), focus=5).detail


def test_a_size_or_rate_the_camera_bends_is_refused_with_what_it_offers() -> None:
    size = refusal(ScriptedDevice(), width_px=1280)
    assert "wanted MJPG 1280x480, it has MJPG 640x480; it offers MJPG 640x480 at 30, 15 Hz" in size.detail
    assert "rate_hz: wanted 60, it has 30" in refusal(ScriptedDevice(), rate_hz=60.0).detail


def test_pictures_timed_by_another_clock_are_refused() -> None:
    device = ScriptedDevice()
    device.monotonic = False
    assert "monotonic clock" in refusal(device).detail


def test_a_frame_counts_as_exposed_its_exposure_and_one_picture_before_its_first_bytes() -> None:
    device = ScriptedDevice()
    one = source(device)
    one.start()
    device.ready.append(filled(4, at=10.0))
    frame = one.next(1.0)
    assert frame is not None
    assert frame.captured_at == pytest.approx(10.0 - 0.005 - 1 / 30)
    assert frame.sequence == 4


def test_of_several_that_wait_the_newest_good_one_comes_and_the_others_are_counted() -> None:
    device = ScriptedDevice()
    one = source(device)
    one.start()
    device.ready.extend([filled(0), filled(1), filled(5), filled(6, spoilt=True)])
    frame = one.next(1.0)
    assert frame is not None
    assert frame.sequence == 5
    told = one.counters()
    # two waited too long, three never came
    assert (told.frames, told.dropped, told.incomplete) == (1, 5, 1)


def test_numbers_that_start_again_from_nothing_are_no_loss_at_the_wrap() -> None:
    device = ScriptedDevice()
    one = source(device)
    one.start()
    for sequence in (0xFFFFFFFE, 0xFFFFFFFF, 0, 1):
        device.ready.append(filled(sequence))
        assert one.next(1.0) is not None
    assert one.counters().dropped == 0


def test_an_overtaken_picture_is_counted_once_and_never_comes_after_a_later_one() -> None:
    device = ScriptedDevice()
    one = source(device)
    one.start()
    came = []
    # 101 arrives after 102, as where a kernel fills buffers side by side; 103 comes twice
    for waiting in ((100,), (102,), (101,), (103,), (103, 104)):
        device.ready.extend(filled(sequence) for sequence in waiting)
        frame = one.next(0.05)
        came.append(None if frame is None else frame.sequence)
    assert came == [100, 102, None, 103, 104]
    told = one.counters()
    assert (told.frames, told.dropped) == (4, 1)


def test_numbers_that_begin_anew_without_a_wrap_stop_nothing() -> None:
    device = ScriptedDevice()
    one = source(device)
    one.start()
    for sequence in (5000, 5001, 0, 1, 3):
        device.ready.append(filled(sequence))
        frame = one.next(1.0)
        assert frame is not None
        assert frame.sequence == sequence
    assert one.counters().dropped == 1


def test_a_picture_cut_short_is_counted_and_the_wait_goes_on_to_its_end() -> None:
    device = ScriptedDevice()
    one = source(device)
    one.start()
    device.ready.append(filled(0, content=b"\xff\xd8 cut short"))
    began = CLOCK.now()
    assert one.next(0.5) is None
    assert CLOCK.now() - began >= 0.5
    assert one.counters().incomplete == 1


def test_a_device_that_is_gone_says_so_and_after_stop_it_is_not_open() -> None:
    device = ScriptedDevice()
    one = source(device)
    one.start()
    device.error = OSError(errno.ENODEV, "No such device")
    with pytest.raises(DeviceUnavailable, match=r"unplugged"):
        one.next(0.5)
    one.stop()
    one.stop()
    with pytest.raises(DeviceUnavailable, match="not open"):
        one.next(0.5)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"device": "/dev/video0"}, "this number changes"),
        ({"device": "v4l/by-path/x"}, "give the whole path"),
        ({"exposure_us": 5050}, "steps of 100"),
        ({"exposure_us": 40000}, "longer than the 33333 us"),
        ({"format": "H264"}, "MJPG"),
        ({"power_line_hz": 55}, "50"),
        ({"buffers": 1}, "greater than or equal to 2"),
    ],
)
def test_settings_that_cannot_be_meant_are_refused(change: dict[str, object], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        source(ScriptedDevice(), **change)


def test_request_numbers_are_those_of_the_kernels_header_on_64_bit() -> None:
    assert (abi.QUERYCAP, abi.S_FMT, abi.QUERYBUF) == (0x80685600, 0xC0D05605, 0xC0585609)
    assert (abi.DQBUF, abi.STREAMON, abi.S_PARM) == (0xC0585611, 0x40045612, 0xC0CC5616)
    assert (abi.QUERYCTRL, abi.ENUM_FRAMESIZES, abi.ENUM_FRAMEINTERVALS) == (
        0xC0445624,
        0xC02C564A,
        0xC034564B,
    )


def test_a_path_that_is_no_video_device_is_refused_at_once(tmp_path: Path) -> None:
    plain = tmp_path / "plain"
    plain.write_bytes(b"")
    settings = V4l2CameraSettings.model_validate(
        {"driver": "v4l2", "device": str(plain), "width_px": 640, "height_px": 480, "exposure_us": 5000}
    )
    with pytest.raises(CommandRejected, match="ENOTTY"):
        V4l2Source("camera.left", settings, CLOCK).start()
