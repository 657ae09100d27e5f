"""The drift watch of a cell: kept from run to run, of one calibration, shown by a command."""

from __future__ import annotations

from pathlib import Path

import pytest

from cell import drift
from cell.commissioning import DriftConfig
from cell.errors import ConfigError
from vision.drift import Limits, observe

LIMITS = Limits(rows_px=0.5, length=0.01, memory_looks=20.0)


def test_what_was_watched_is_there_after_a_restart(tmp_path: Path) -> None:
    file = tmp_path / "drift.json"
    kept = drift.Watched(calibration="a")
    for _ in range(10):
        kept = drift.Watched(
            calibration="a",
            drift=observe(kept.drift, 0.2, [0.1001], 0.1, LIMITS),
            looks=(*kept.looks, (0.2, 1.001)),
        )
    drift.save(file, kept)
    again = drift.load(file, "a")
    assert again.drift.rows_px.looks == 10
    assert again.drift.rows_px.value == pytest.approx(0.2)
    assert len(again.looks) == 10


def test_another_calibration_begins_anew(tmp_path: Path) -> None:
    file = tmp_path / "drift.json"
    drift.save(file, drift.Watched(calibration="a", looks=((0.1, 1.0),)))
    assert drift.load(file, "b").looks == ()


def test_a_file_of_something_else_is_not_overwritten(tmp_path: Path) -> None:
    file = tmp_path / "drift.json"
    file.write_text('{"mine": 1}')
    with pytest.raises(ConfigError, match=r"not a drift file"):
        drift.DriftWatch(file, DriftConfig(), tmp_path / "calibration.json")
