"""What a person sees while turning lens and lamp; and the commands that say it."""

from __future__ import annotations

import math
import shutil
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from cell.aiming import aim, width_px
from cell.cli import main
from drivers.camera import aravis
from tests.fakes.station import DATA
from vision.types import Grey


def sticks(width: int, sigma_px: float = 0.7) -> Grey:
    grey = np.full((240, 320), 50, np.uint8)
    for n in range(4):
        cv2.line(grey, (30 + 60 * n, 30), (50 + 60 * n, 200), 190, width, cv2.LINE_AA)
    return np.asarray(cv2.GaussianBlur(grey, (0, 0), sigma_px), np.uint8)


@pytest.mark.parametrize("width", [4, 6, 9])
def test_the_width_of_parts_is_measured_in_pixels(width: int) -> None:
    assert width_px(sticks(width), 6.0) == pytest.approx(width, abs=1.5)


def test_a_wide_band_is_no_part_and_an_empty_picture_has_none() -> None:
    grey = np.full((240, 320), 50, np.uint8)
    grey[100:140] = 200
    assert math.isnan(width_px(grey, 6.0))
    assert math.isnan(width_px(np.full((240, 320), 50, np.uint8), 6.0))


def test_figures_say_what_to_do() -> None:
    good = aim(sticks(6), 6.0).text()
    assert "focus" not in good
    assert "UNUSABLE" not in good
    assert "(focus)" in aim(sticks(6, sigma_px=2.5), 6.0).text()
    dark = np.asarray(sticks(6) // 4, np.uint8)
    assert "longer exposure" in aim(dark, 6.0).text()
    assert "UNUSABLE: saturated" in aim(np.full((100, 100), 255, np.uint8), 6.0).text()


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    for name in ("cell.yaml", "calibration.json", "left.png", "right.png"):
        shutil.copy(DATA / name, tmp_path)
    return tmp_path / "cell.yaml"


def test_aim_prints_a_line_per_camera_and_how_far_the_rows_are_off(
    cell: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["camera", "aim", str(cell), "--times", "1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "px wide by the calibration" in lines[0]
    assert [line.split()[0] for line in lines[1:]] == ["left", "right", "both"]
    assert "blur" in lines[1]
    assert "rows off" in lines[3]


def test_aim_of_one_side_opens_only_that_camera(cell: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (cell.parent / "right.png").unlink()
    assert main(["camera", "aim", str(cell), "--side", "left", "--times", "1"]) == 0
    assert capsys.readouterr().out.splitlines()[1].split()[0] == "left"


def test_aim_of_a_camera_that_is_not_there_says_so(cell: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (cell.parent / "right.png").unlink()
    assert main(["camera", "aim", str(cell), "--times", "1"]) != 0
    assert "camera.right" in capsys.readouterr().err


def test_list_tells_of_every_camera_or_what_to_try(capsys: pytest.CaptureFixture[str]) -> None:
    # what is plugged in differs between machines
    code = main(["camera", "list"])
    said = capsys.readouterr().out
    assert (code, "no camera found" in said) in ((0, False), (1, True))


def test_list_says_what_to_install_for_cameras_it_cannot_look_for(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    aravis._loaded.cache_clear()
    monkeypatch.setitem(sys.modules, "gi", None)  # as where the extra is not installed
    main(["camera", "list"])
    aravis._loaded.cache_clear()
    said = capsys.readouterr().out
    assert "GigE Vision cameras were not looked for" in said
    assert "mikado-cell[gige]" in said
