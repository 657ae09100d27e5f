"""The printed board, read back from the page: millimetres, markers, the bar."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pypdfium2
import pytest

from cell.cli import main
from cell.commission import boardfile
from vision.boards import corner_points, detect
from vision.types import Grey

DPI = 300


def rendered(path: Path) -> Grey:
    document = pypdfium2.PdfDocument(path)
    picture = document[0].render(scale=DPI / 72).to_numpy()
    document.close()
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


@pytest.mark.parametrize(
    ("words", "size_mm", "bar_mm"),
    [
        (("--paper", "A4", "--pitch-mm", "20"), (297.0, 210.0), 150.0),
        (("--paper", "letter", "--columns", "7", "--rows", "9", "--pitch-mm", "24"), (215.9, 279.4), 150.0),
        (
            ("--kind", "chessboard", "--columns", "10", "--rows", "7", "--pitch-mm", "25"),
            (297.0, 210.0),
            200.0,
        ),
        (("--paper", "A3", "--dictionary", "DICT_5X5_100", "--pitch-mm", "30"), (420.0, 297.0), 200.0),
    ],
)
def test_the_page_is_exact_and_the_board_on_it_is_found(
    tmp_path: Path, words: tuple[str, ...], size_mm: tuple[float, float], bar_mm: float
) -> None:
    pdf = tmp_path / "board.pdf"

    assert main(["calibrate", "board", *words, "--out", str(pdf)]) == 0

    config = boardfile.load(tmp_path / "board.yaml")
    grey = rendered(pdf)
    mm = 25.4 / DPI
    assert grey.shape == pytest.approx((size_mm[1] / mm, size_mm[0] / mm), abs=1.5)
    corners = detect(grey, config.board())
    assert corners is not None
    assert len(corners.ids) == config.board().corner_count
    off = corners.pixels * mm - 1e3 * corner_points(config.board(), corners.ids)[:, :2]
    assert np.abs(off - off.mean(axis=0)).max() < 0.05
    assert config.bar_m == pytest.approx(bar_mm / 1e3)
    around = 1.3 * corners.spacing_px
    low, high = corners.pixels.min(axis=0) - around, corners.pixels.max(axis=0) + around
    grey[int(low[1]) : int(high[1]), int(low[0]) : int(high[0])] = 255
    assert longest_run_mm(grey, mm) == pytest.approx(bar_mm, abs=0.4)  # ticks have a width


def longest_run_mm(grey: Grey, mm: float) -> float:
    """Length of the bar: the longest dark line of what is left of the page, along either side."""
    best = 0
    for picture in (grey < 160, grey.T < 160):
        for line in picture:
            runs = np.diff(np.flatnonzero(np.diff(np.concatenate([[0], line.astype(int), [0]]))))[::2]
            best = max(best, int(runs.max(initial=0)))
    return best * mm


def test_the_ruler_corrects_the_pitch(tmp_path: Path) -> None:
    pdf, file = tmp_path / "b.pdf", tmp_path / "b.yaml"
    assert main(["calibrate", "board", "--pitch-mm", "20", "--out", str(pdf)]) == 0

    assert main(["calibrate", "board", "--board", str(file), "--measured-bar-mm", "149.1"]) == 0

    config = boardfile.load(file)
    assert config.measured
    assert config.board().pitch_m == pytest.approx(0.020 * 149.1 / 150.0)
    assert config.board().marker_m == pytest.approx(0.015 * 149.1 / 150.0)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--board", "{file}", "--measured-bar-mm", "14.9"), "should be 150 mm long and measures 14.9 mm"),
        (("--paper", "A4", "--pitch-mm", "40", "--out", "x.pdf"), "do not fit on A4"),
        (("--paper", "A9", "--out", "x.pdf"), "no paper 'A9'"),
        (("--out", "x.png"), "let the name end in .pdf"),
        (("--marker-mm", "25", "--out", "x.pdf"), "does not fit a square"),
        (("--board", "{file}"), "--board takes --measured-bar-mm only"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(
    tmp_path: Path, words: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "b.yaml"
    assert main(["calibrate", "board", "--pitch-mm", "20", "--out", str(tmp_path / "b.pdf")]) == 0

    assert main(["calibrate", "board", *(word.format(file=file) for word in words)]) == 2

    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
