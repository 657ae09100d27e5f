"""The drift watch of a cell: kept from run to run, of one calibration, shown by a command."""

from __future__ import annotations

from pathlib import Path

import pytest

from cell import drift
from cell.commissioning import DriftConfig
from cell.errors import ConfigError
from tests.fakes.station import scene, stick
from vision.drift import SETTLED_LOOKS, Limits, observe

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


def test_parts_that_measure_too_long_are_told_until_they_measure_right_again(tmp_path: Path) -> None:
    file = tmp_path / "drift.json"
    config = DriftConfig(memory_looks=4.0)

    def looks(watch: drift.DriftWatch, share: float, count: int) -> None:
        for _ in range(count):
            watch.look(scene(stick((0.0, -0.45, 0.02), (0.1 * share, -0.45, 0.02))), 1, 0.1)

    watch = drift.DriftWatch(file, config, tmp_path / "calibration.json")
    looks(watch, 1.0, SETTLED_LOOKS)
    assert watch.drifted() is None
    looks(watch, 1.03, SETTLED_LOOKS)
    assert str(watch.drifted()).startswith("measured over true length of parts: 1.02")
    # a restart forgets nothing
    assert drift.DriftWatch(file, config, tmp_path / "calibration.json").drifted() == watch.drifted()
    looks(watch, 1.0, SETTLED_LOOKS)
    assert watch.drifted() is None
