"""Overlay pictures are written for looks, kept to a number, and never in the way of the cell."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from cell import overlays
from cell.overlays import OverlayWriter
from cell.station import Look
from cell.types import PickOrder
from cell.workers import Beat
from drivers.timing import StopToken
from drivers.types import Frame, FramePair
from tests.fakes.clock import FakeClock
from tests.fakes.station import bench, drawn, order, scene, stick
from vision import transforms


@pytest.fixture
def stop() -> StopToken:
    return StopToken(FakeClock())


@pytest.fixture
def writer(tmp_path: Path, stop: StopToken) -> OverlayWriter:
    clock = FakeClock()
    return OverlayWriter(tmp_path / "overlays", bench().station.stereo, stop, Beat("overlays", 30.0, clock))


def look(sequence: int = 1, of: PickOrder | None = None) -> Look:
    frames = [
        Frame(camera=f"camera.{eye}", pixels=drawn(eye, 1)[0], captured_at=1.0, sequence=sequence)
        for eye in ("left", "right")
    ]
    return Look(
        order=of or order(),
        part=bench().station.parts[0],
        pair=FramePair(left=frames[0], right=frames[1]),
        scene=scene(stick((-0.04, -0.45, 0.022), (0.04, -0.45, 0.022))),
        plans=(),
        view=bench().station.mounting.view(transforms.identity()),
    )


def written(writer: OverlayWriter, stop: StopToken, *looks: Look) -> None:
    """Hand the looks in one after another and run until nothing waits."""
    for item in looks:
        writer.put(item)
    stop.stop("service ends")
    writer.run()


def test_a_look_becomes_a_picture_named_by_picture_and_order(
    writer: OverlayWriter, stop: StopToken, tmp_path: Path
) -> None:
    written(writer, stop, look(sequence=12, of=order(request_id=345)))
    (path,) = (tmp_path / "overlays").iterdir()
    assert path.name == "look-000012-order-00345.png"
    picture = cv2.imread(str(path))
    assert picture is not None
    assert picture.shape[1] >= 480
    green = (picture[:, :, 1].astype(int) - picture[:, :, 2] > 60) & (picture[:, :, 1] > 100)
    assert np.count_nonzero(green) > 100  # the offered part is drawn


def test_what_waits_when_the_service_ends_is_still_written(
    writer: OverlayWriter, stop: StopToken, tmp_path: Path
) -> None:
    written(writer, stop, look(1), look(2), look(3))
    assert len(list((tmp_path / "overlays").iterdir())) == 3


def test_more_looks_than_wait_are_dropped_and_nobody_waits(
    writer: OverlayWriter, stop: StopToken, tmp_path: Path
) -> None:
    written(writer, stop, *(look(n) for n in range(1, 8)))
    assert len(list((tmp_path / "overlays").iterdir())) == 4


def test_the_newest_are_kept_also_after_a_camera_began_to_count_anew(
    writer: OverlayWriter, stop: StopToken, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(overlays, "_KEPT", 3)
    folder = tmp_path / "overlays"
    folder.mkdir()
    for age, sequence in enumerate((900, 901, 902)):
        old = folder / f"look-{sequence:06d}-order-00001.png"
        old.write_bytes(b"from the last run")
        os.utime(old, (1000.0 + age, 1000.0 + age))
    written(writer, stop, look(sequence=1))
    names = sorted(path.name for path in folder.iterdir())
    assert names == [
        "look-000001-order-00007.png",
        "look-000901-order-00001.png",
        "look-000902-order-00001.png",
    ]


def test_other_files_in_the_folder_are_left_alone(
    writer: OverlayWriter, stop: StopToken, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(overlays, "_KEPT", 1)
    (tmp_path / "overlays").mkdir()
    (tmp_path / "overlays" / "notes.txt").write_text("mine")
    written(writer, stop, look(1), look(2))
    assert (tmp_path / "overlays" / "notes.txt").exists()


def test_a_folder_that_cannot_be_written_does_not_end_the_thread(
    writer: OverlayWriter, stop: StopToken, tmp_path: Path
) -> None:
    (tmp_path / "overlays").write_text("a file where the folder should be")
    written(writer, stop, look(1), look(2))


@pytest.mark.parametrize("error", [ValueError("no such shape"), cv2.error("assertion failed")])
def test_a_picture_that_cannot_be_drawn_does_not_end_the_thread(
    writer: OverlayWriter,
    stop: StopToken,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    error: Exception,
) -> None:
    def broken(*_: object) -> None:
        raise error

    monkeypatch.setattr(overlays, "draw", broken)
    written(writer, stop, look(1))
    assert not list(tmp_path.glob("overlays/*.png"))
