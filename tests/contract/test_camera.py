"""What every camera promises (DESIGN section 5): the simulated cell over its socket, a folder, the double;
and webcams of the kernel, in the virtual machine of tests/lab."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.camera.replay import ReplayCamera
from drivers.camera_settings import ReplayCameraSettings, SimCameraSettings, V4l2CameraSettings
from drivers.errors import CommandRejected, DeviceTimeout, DeviceUnavailable
from drivers.factory import Factory
from drivers.interfaces import Camera
from drivers.sim.devices import SimCamera
from drivers.timing import MonotonicClock
from tests.fakes.camera import FakeCamera
from tests.fakes.simcell import SimCell, sim_cell

CLOCK = MonotonicClock()
MARGIN_S = 0.7
ROOT = Path(__file__).parents[2]
NOWHERE = 9  # the discard port: nobody listens there
WEBCAM = Path("/dev/v4l/by-path/platform-vhci_hcd.0-usb-0:1:1.0-video-index0")
"""Made of nothing, in the virtual machine of tests/lab."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """One implementation: a camera that works, and one whose device is not there."""

    good: Callable[[], Camera]
    absent: Callable[[], Camera]


@pytest.fixture(scope="module")
def cell() -> Iterator[SimCell]:
    with sim_cell("--sticks", "3", "--speed", "4") as running:
        yield running


def sim(port: int, eye: str = "left", width_px: int = 640) -> SimCamera:
    settings = SimCameraSettings.model_validate(
        {"driver": "sim", "port": port, "eye": eye, "width_px": width_px, "height_px": 480}
    )
    return SimCamera(f"camera.{eye}", settings, CLOCK)


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pictures")
    rng = np.random.default_rng(3)
    for i in range(6):
        noise = rng.integers(0, 255, (480, 640, 3), dtype=np.uint8)
        assert cv2.imwrite(str(folder / f"left{i}.png"), noise)
    return folder


def replay(folder: Path) -> ReplayCamera:
    settings = ReplayCameraSettings(
        driver="replay", folder=folder, pattern="left*.png", width_px=640, height_px=480
    )
    return ReplayCamera("camera.left", settings, CLOCK)


def scripted(open_error: Exception | None = None) -> FakeCamera:
    rng = np.random.default_rng(3)
    answers = [rng.integers(0, 255, (480, 640, 3), dtype=np.uint8) for _ in range(6)]
    camera = FakeCamera("camera.left", CLOCK, answers)
    camera.open_error = open_error
    return camera


def webcam(capture: str, device: Path = WEBCAM) -> Camera:
    settings = V4l2CameraSettings.model_validate(
        {
            "driver": "v4l2",
            "device": str(device),
            "capture": capture,
            "width_px": 640,
            "height_px": 480,
            "exposure_us": 5000,
            # what an emulated machine can decode, and slow is not lost there
            "rate_hz": 5,
            "lost_s": 5.0,
        }
    )
    return Factory(CLOCK).camera("camera.left", settings)


@pytest.fixture(
    params=["sim", "replay", "scripted", "v4l2", "v4l2 through OpenCV", "gige", "gige by software"]
)
def kind(request: pytest.FixtureRequest) -> Iterator[Kind]:
    match request.param:
        case "sim":
            cell: SimCell = request.getfixturevalue("cell")
            yield Kind(good=lambda: sim(cell.port), absent=lambda: sim(NOWHERE))
        case "replay":
            pictures: Path = request.getfixturevalue("pictures")
            yield Kind(good=lambda: replay(pictures), absent=lambda: replay(pictures / "nothing"))
        case "scripted":
            gone = DeviceUnavailable("camera.left", "not there")
            yield Kind(good=scripted, absent=lambda: scripted(gone))
        case "gige" | "gige by software":
            from tests.lab import gige  # not in the virtual machine of the webcams

            gige.require()
            trigger = "software" if "software" in request.param else "free"
            picture = ROOT / "tests" / "data" / "left.png"
            with gige.network() as net, gige.peer(net, "left", "--picture", str(picture)):

                def vision(address: str) -> Camera:
                    wanted = gige.settings("left", address=address, pixel_format="BayerRG8", trigger=trigger)
                    return Factory(CLOCK).camera("camera.left", wanted)

                yield Kind(good=lambda: vision(gige.ADDRESSES["left"]), absent=lambda: vision("10.77.1.99"))
        case _:
            if not WEBCAM.exists():
                pytest.skip("no USB camera of the lab here; tests/lab/test_v4l2.py runs this in its machine")
            capture = "opencv" if "OpenCV" in request.param else "ioctl"
            nowhere = WEBCAM.with_name("nothing-video-index0")
            yield Kind(good=lambda: webcam(capture), absent=lambda: webcam(capture, nowhere))


@pytest.fixture
def camera(kind: Kind) -> Iterator[Camera]:
    made = kind.good()
    made.open()
    yield made
    made.close()


def test_constructing_does_nothing_so_a_camera_that_was_not_opened_is_unavailable(kind: Kind) -> None:
    made = kind.good()
    with pytest.raises(DeviceUnavailable):
        made.grab(newer_than=0.0, timeout_s=0.5)


def test_closing_twice_or_without_opening_is_fine(kind: Kind) -> None:
    made = kind.good()
    made.close()
    made.open()
    made.close()
    made.close()
    with pytest.raises(DeviceUnavailable):
        made.grab(newer_than=0.0, timeout_s=0.5)


def test_an_absent_device_fails_at_open_and_stays_closed(kind: Kind) -> None:
    made = kind.absent()
    with pytest.raises(DeviceUnavailable):
        made.open()
    with pytest.raises(DeviceUnavailable):
        made.grab(newer_than=0.0, timeout_s=0.5)


def test_a_frame_is_newer_than_asked_for_and_cannot_be_written_to(camera: Camera) -> None:
    asked_at = CLOCK.now()
    frame = camera.grab(newer_than=asked_at, timeout_s=2.0)
    assert asked_at < frame.captured_at <= CLOCK.now()
    assert (frame.camera, frame.pixels.shape) == ("camera.left", (480, 640, 3))
    assert frame.pixels.dtype == np.uint8
    assert not frame.pixels.flags.writeable


def test_two_frames_are_not_the_same_picture(camera: Camera) -> None:
    first = camera.grab(newer_than=CLOCK.now(), timeout_s=2.0)
    second = camera.grab(newer_than=first.captured_at, timeout_s=2.0)
    assert second.sequence > first.sequence
    assert second.captured_at > first.captured_at
    assert not np.array_equal(first.pixels, second.pixels)


def test_a_frame_of_the_far_future_times_out_in_time(camera: Camera) -> None:
    asked_at = CLOCK.now()
    with pytest.raises(DeviceTimeout):
        camera.grab(newer_than=asked_at + 60.0, timeout_s=0.2)
    assert CLOCK.now() - asked_at < 0.2 + MARGIN_S


# ------------------------------------------------------------------ the simulated eye alone


@pytest.fixture
def mended(cell: SimCell) -> Iterator[SimCell]:
    yield cell
    cell.mend()


@pytest.mark.parametrize(("fault", "low", "high"), [("camera_black", 0, 5), ("camera_saturate", 225, 255)])
def test_a_spoilt_eye_gives_a_spoilt_picture(mended: SimCell, fault: str, low: float, high: float) -> None:
    eye = sim(mended.port)
    eye.open()
    mended.fault(fault, eye="left")
    frame = eye.grab(newer_than=CLOCK.now(), timeout_s=2.0)
    eye.close()
    assert low <= float(frame.pixels.mean()) <= high


def test_a_frozen_eye_repeats_its_picture_bit_for_bit_with_a_new_time(mended: SimCell) -> None:
    eye = sim(mended.port)
    eye.open()
    first = eye.grab(newer_than=CLOCK.now(), timeout_s=2.0)
    mended.fault("camera_freeze")
    second = eye.grab(newer_than=CLOCK.now(), timeout_s=2.0)
    eye.close()
    assert second.captured_at > first.captured_at
    assert np.array_equal(first.pixels, second.pixels)


@pytest.mark.parametrize("fault", ["camera_slow", "camera_silent"])
def test_a_slow_or_silent_eye_times_out_in_time_and_then_works_again(mended: SimCell, fault: str) -> None:
    eye = sim(mended.port)
    eye.open()
    mended.fault(fault, seconds=0.8)
    asked_at = CLOCK.now()
    with pytest.raises(DeviceTimeout):
        eye.grab(newer_than=asked_at, timeout_s=0.3)
    assert CLOCK.now() - asked_at < 0.3 + MARGIN_S
    mended.mend()
    again_at = CLOCK.now()
    assert eye.grab(newer_than=again_at, timeout_s=3.0).captured_at > again_at
    eye.close()


def test_another_picture_size_than_configured_is_refused_by_name(cell: SimCell) -> None:
    eye = sim(cell.port, width_px=800)
    eye.open()
    with pytest.raises(CommandRejected, match=r"640x480.*800x480"):
        eye.grab(newer_than=CLOCK.now(), timeout_s=2.0)
    eye.close()


def test_when_the_process_is_gone_the_camera_is_unavailable() -> None:
    with sim_cell("--sticks", "0") as running:
        eye = sim(running.port)
        eye.open()
        eye.grab(newer_than=CLOCK.now(), timeout_s=2.0)
        running.process.kill()
        running.process.wait(5.0)
        with pytest.raises(DeviceUnavailable):
            eye.grab(newer_than=CLOCK.now(), timeout_s=1.0)
        with pytest.raises(DeviceUnavailable):
            eye.grab(newer_than=CLOCK.now(), timeout_s=1.0)
        eye.close()
