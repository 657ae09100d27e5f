"""Recorded pictures as a camera: their order, and errors that name the file."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.camera.replay import ReplayCamera, natural
from drivers.camera_settings import ReplayCameraSettings
from drivers.errors import CommandRejected, DeviceTimeout, DeviceUnavailable
from tests.fakes.clock import FakeClock


def write(path: Path, value: int, width_px: int = 8) -> None:
    assert cv2.imwrite(str(path), np.full((6, width_px, 3), value, dtype=np.uint8))


def camera(folder: Path, pattern: str = "left*.png", *, repeat: bool = False) -> ReplayCamera:
    settings = ReplayCameraSettings(
        driver="replay", folder=folder, pattern=pattern, width_px=8, height_px=6, repeat=repeat
    )
    made = ReplayCamera("camera.left", settings, FakeClock(100.0))
    made.open()
    return made


def values(made: ReplayCamera, count: int) -> list[int]:
    return [int(made.grab(newer_than=0.0, timeout_s=1.0).pixels[0, 0, 0]) for _ in range(count)]


def test_pictures_come_in_the_order_a_person_would_count_them(tmp_path: Path) -> None:
    for number in (10, 2, 1):
        write(tmp_path / f"left{number}.png", number)
    write(tmp_path / "right1.png", 99)
    assert values(camera(tmp_path), 3) == [1, 2, 10]


def test_names_with_and_without_numbers_can_be_ordered() -> None:
    assert sorted(["b", "1", "a10", "a9", "A1"], key=natural) == ["1", "A1", "a9", "a10", "b"]


def test_after_the_last_picture_it_times_out_or_starts_again(tmp_path: Path) -> None:
    for number in (1, 2):
        write(tmp_path / f"left{number}.png", number)
    once = camera(tmp_path)
    assert values(once, 2) == [1, 2]
    with pytest.raises(DeviceTimeout, match="all 2 pictures"):
        once.grab(newer_than=0.0, timeout_s=1.0)
    assert values(camera(tmp_path, repeat=True), 5) == [1, 2, 1, 2, 1]


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(DeviceUnavailable, match="nowhere is not a folder"):
        camera(tmp_path / "nowhere")


def test_a_pattern_that_matches_nothing_is_named(tmp_path: Path) -> None:
    with pytest.raises(DeviceUnavailable, match=r"matches 'left\*.png'"):
        camera(tmp_path)


@pytest.mark.parametrize("content", [b"", b"this is no picture"])
def test_a_file_that_is_no_picture_is_named(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "left1.png").write_bytes(content)
    with pytest.raises(DeviceUnavailable, match=r"left1\.png is not a picture"):
        camera(tmp_path).grab(newer_than=0.0, timeout_s=1.0)


def test_a_file_that_vanished_is_named(tmp_path: Path) -> None:
    write(tmp_path / "left1.png", 1)
    made = camera(tmp_path)
    (tmp_path / "left1.png").unlink()
    with pytest.raises(DeviceUnavailable, match=r"left1\.png cannot be read"):
        made.grab(newer_than=0.0, timeout_s=1.0)


def test_a_picture_of_another_size_is_named_with_both_sizes(tmp_path: Path) -> None:
    write(tmp_path / "left1.png", 1, width_px=9)
    with pytest.raises(CommandRejected, match=r"left1\.png is 9x6, the settings say 8x6"):
        camera(tmp_path).grab(newer_than=0.0, timeout_s=1.0)


def test_a_picture_of_the_near_future_is_waited_for(tmp_path: Path) -> None:
    write(tmp_path / "left1.png", 1)
    frame = camera(tmp_path).grab(newer_than=100.3, timeout_s=1.0)
    assert frame.captured_at > 100.3
