"""What a pair of cameras promises: one instant, or a clear no."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.camera.pair import TwoCameraRig
from drivers.camera_settings import ReplayCameraSettings, SimCameraSettings
from drivers.errors import DeviceTimeout, DeviceUnavailable, StaleData
from drivers.factory import Factory
from drivers.timing import MonotonicClock
from drivers.types import Frame, Pixels
from tests.fakes.camera import FakeCamera
from tests.fakes.clock import FakeClock
from tests.fakes.simcell import SimCell, sim_cell

GREY = np.zeros((4, 6), dtype=np.uint8)


def frame(camera: str, captured_at: float) -> Frame:
    pixels: Pixels = GREY.copy()
    pixels.setflags(write=False)
    return Frame(camera=camera, pixels=pixels, captured_at=captured_at, sequence=1)


def rig(
    clock: FakeClock, left: list[float], right: list[float]
) -> tuple[TwoCameraRig, FakeCamera, FakeCamera]:
    """A rig of two doubles whose frames were exposed at these times."""
    eyes = [
        FakeCamera(name, clock, [frame(name, at) for at in times])
        for name, times in (("left", left), ("right", right))
    ]
    made = TwoCameraRig(eyes[0], eyes[1], 0.04, clock)
    made.open()
    return made, eyes[0], eyes[1]


def test_two_frames_of_one_instant_are_a_pair() -> None:
    clock = FakeClock(10.0)
    made, _, _ = rig(clock, [10.0], [10.03])
    pair = made.grab_pair(newer_than=9.0, timeout_s=1.0)
    assert pair.skew_s == pytest.approx(0.03)


def test_the_older_of_two_frames_too_far_apart_is_taken_anew() -> None:
    clock = FakeClock(10.0)
    made, left, right = rig(clock, [10.0, 10.19], [10.2])
    pair = made.grab_pair(newer_than=9.0, timeout_s=1.0)
    assert (pair.left.captured_at, pair.right.captured_at) == (10.19, 10.2)
    assert (len(left.calls), len(right.calls)) == (2, 1)


def test_frames_that_never_come_close_are_stale() -> None:
    clock = FakeClock(10.0)
    made, left, _ = rig(clock, [10.0], [10.5])
    left.answers = [frame("left", 10.0)]
    clock.at(10.0, lambda: None)

    class Slow(FakeCamera):
        def grab(self, *, newer_than: float, timeout_s: float) -> Frame:
            clock.turn(1.0)
            return super().grab(newer_than=newer_than, timeout_s=timeout_s)

    slow = Slow("right", clock, [frame("right", 10.5)])
    made = TwoCameraRig(left, slow, 0.04, clock)
    made.open()
    with pytest.raises(StaleData, match=r"0\.500 s apart"):
        made.grab_pair(newer_than=9.0, timeout_s=1.0)


def test_what_is_left_of_the_time_goes_to_the_second_camera() -> None:
    clock = FakeClock(10.0)
    left = FakeCamera("left", clock, [frame("left", 10.0)])
    right = FakeCamera("right", clock)
    made = TwoCameraRig(left, right, 0.04, clock)
    made.open()
    with pytest.raises(DeviceTimeout):
        made.grab_pair(newer_than=9.0, timeout_s=1.0)
    assert right.calls[0].timeout_s <= 1.0


def test_if_the_second_camera_does_not_open_the_first_is_closed_again() -> None:
    clock = FakeClock()
    left, right = FakeCamera("left", clock), FakeCamera("right", clock)
    right.open_error = DeviceUnavailable("right", "unplugged")
    with pytest.raises(DeviceUnavailable, match="unplugged"):
        TwoCameraRig(left, right, 0.04, clock).open()
    assert left.closed == 1


def test_closing_twice_is_fine() -> None:
    made, _, _ = rig(FakeClock(), [], [])
    made.close()
    made.close()


@pytest.fixture(scope="module")
def cell() -> Iterator[SimCell]:
    with sim_cell("--sticks", "4") as running:
        yield running


def test_the_simulated_eyes_open_at_the_very_same_instant_again_and_again(cell: SimCell) -> None:
    clock = MonotonicClock()
    left, right = (
        SimCameraSettings.model_validate(
            {"driver": "sim", "port": cell.port, "eye": eye, "width_px": 640, "height_px": 480}
        )
        for eye in ("left", "right")
    )
    made = Factory(clock).rig(left, right, 0.04)
    made.open()
    seen = []
    for _ in range(3):
        asked_at = clock.now()
        pair = made.grab_pair(newer_than=asked_at, timeout_s=3.0)
        assert pair.skew_s == 0.0
        assert pair.left.captured_at > asked_at
        seen.append(pair)
    made.close()
    assert not np.array_equal(seen[0].left.pixels, seen[1].left.pixels)
    assert not np.array_equal(seen[0].left.pixels, seen[0].right.pixels)


def test_recorded_pairs_stay_together(tmp_path: Path) -> None:
    for i in range(3):
        for eye in ("left", "right"):
            assert cv2.imwrite(str(tmp_path / f"{eye}{i}.png"), np.full((4, 6, 3), 10 * i, dtype=np.uint8))
    left, right = (
        ReplayCameraSettings(driver="replay", folder=tmp_path, pattern=f"{eye}*.png", width_px=6, height_px=4)
        for eye in ("left", "right")
    )
    clock = MonotonicClock()
    made = Factory(clock).rig(left, right, 0.0)
    made.open()
    pairs = [made.grab_pair(newer_than=clock.now(), timeout_s=1.0) for _ in range(3)]
    made.close()
    assert [int(p.left.pixels[0, 0, 0]) for p in pairs] == [0, 10, 20]
    assert [int(p.right.pixels[0, 0, 0]) for p in pairs] == [0, 10, 20]


# ------------------------------------------------------------------ cameras that run freely


def scene(captured_at: float, grey: int, camera: str = "left", block: int = 90) -> Frame:
    """A picture with a bright block."""
    pixels: Pixels = np.full((64, 64), 90, dtype=np.uint8)
    pixels[16:32, block // 10 : block // 10 + 16] = grey
    pixels.setflags(write=False)
    return Frame(camera=camera, pixels=pixels, captured_at=captured_at, sequence=1)


def free_rig(clock: FakeClock, left: list[Frame], right: list[Frame]) -> TwoCameraRig:
    eyes = [FakeCamera("left", clock, left), FakeCamera("right", clock, right)]
    made = TwoCameraRig(eyes[0], eyes[1], 0.04, clock, free_running=True)
    made.open()
    return made


def test_a_free_running_pair_of_a_standing_scene_is_taken_after_one_more_look() -> None:
    made = free_rig(FakeClock(10.0), [scene(10.0, 200), scene(10.033, 203)], [scene(10.02, 200)])
    pair = made.grab_pair(newer_than=9.0, timeout_s=1.0)
    assert (pair.left.captured_at, pair.right.captured_at) == (10.0, 10.02)


def test_a_free_running_pair_of_a_scene_that_moved_is_taken_anew() -> None:
    left = [scene(10.0, 200), scene(10.033, 90), scene(10.066, 90), scene(10.1, 90)]
    made = free_rig(FakeClock(10.0), left, [scene(10.02, 90), scene(10.08, 90)])
    pair = made.grab_pair(newer_than=9.0, timeout_s=1.0)
    assert (pair.left.captured_at, pair.right.captured_at) == (10.066, 10.08)


def test_a_free_running_pair_of_a_scene_that_goes_on_moving_is_refused_with_numbers() -> None:
    made = free_rig(FakeClock(10.0), [scene(10.0, 200), scene(10.033, 90)], [scene(10.02, 90)])
    with pytest.raises(StaleData, match=r"moved between two pictures 0\.020 s apart.*stand still"):
        made.grab_pair(newer_than=9.0, timeout_s=0.03)


def test_a_free_running_pair_of_one_instant_needs_no_other_look() -> None:
    made = free_rig(FakeClock(10.0), [scene(10.0, 200)], [scene(10.0005, 200)])
    assert made.grab_pair(newer_than=9.0, timeout_s=1.0).skew_s < 0.001


def test_a_lost_camera_is_told_without_waiting() -> None:
    made, left, _ = rig(FakeClock(10.0), [], [])
    made.check()
    left.lost = "unplugged"
    with pytest.raises(DeviceUnavailable, match="unplugged"):
        made.check()
    made.close()
