"""A broken configuration is refused, or run over with the last good one where that was asked for."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from cell import cli
from cell.errors import ConfigError
from cell.last_good import usable
from tests.fakes.station import DATA


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("cell.yaml", "calibration.json"):
        shutil.copy(DATA / name, tmp_path / name)
    return tmp_path


def broken(folder: Path) -> None:
    path = folder / "cell.yaml"
    path.write_text(path.read_text().replace("version: 1", "version: 1\nspeed: much"))


def test_a_good_one_is_kept_whole(folder: Path) -> None:
    kept = folder / "state" / "good.yaml"
    config, refused = usable(folder / "cell.yaml", kept)
    assert refused is None
    assert kept.read_bytes() == (folder / "cell.yaml").read_bytes()
    assert config.files.calibration == folder / "calibration.json"
    assert list(kept.parent.iterdir()) == [kept]


def test_a_broken_one_is_refused_with_file_and_key(folder: Path) -> None:
    broken(folder)
    with pytest.raises(ConfigError, match=r"cell\.yaml.*speed"):
        usable(folder / "cell.yaml", None)


def test_without_a_last_good_one_it_is_refused_too(folder: Path) -> None:
    broken(folder)
    with pytest.raises(ConfigError, match="speed"):
        usable(folder / "cell.yaml", folder / "good.yaml")


def test_the_last_good_one_runs_with_the_paths_it_had(folder: Path) -> None:
    kept = folder / "state" / "good.yaml"
    before, _ = usable(folder / "cell.yaml", kept)
    broken(folder)
    config, refused = usable(folder / "cell.yaml", kept)
    assert config == before
    assert refused is not None
    assert "speed" in refused
    assert "speed: much" not in kept.read_text()


def test_a_missing_calibration_counts_as_broken(folder: Path) -> None:
    (folder / "calibration.json").rename(folder / "elsewhere.json")
    kept = folder / "good.yaml"
    text = (folder / "cell.yaml").read_text()
    kept.write_text(text.replace("calibration: calibration.json", "calibration: elsewhere.json"))
    assert "elsewhere" in kept.read_text()
    config, refused = usable(folder / "cell.yaml", kept)
    assert config.files.calibration == folder / "elsewhere.json"
    assert refused is not None


def test_check_keeps_what_is_good_and_nothing_else(folder: Path) -> None:
    kept = folder / "good.yaml"
    assert cli.main(["check", str(folder / "cell.yaml"), "--keep", str(kept)]) == 0
    good = kept.read_bytes()
    broken(folder)
    assert cli.main(["check", str(folder / "cell.yaml"), "--keep", str(kept)]) == cli.EXIT_CONFIG
    assert kept.read_bytes() == good
