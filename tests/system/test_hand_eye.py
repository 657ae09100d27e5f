"""Commissioning the simulated cell live: hand-eye over a dome, then points touched, against its own truth."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from tests.fakes.commissioner import DEMO, Commissioner
from tests.fakes.simcell import sim_cell


def test_the_cameras_are_found_and_points_are_touched(tmp_path: Path) -> None:
    with sim_cell("--sticks", "0", "--speed", "8", "--board", "hand") as cell:
        person = Commissioner(folder=tmp_path, cell=cell)
        person.configure()
        known = json.loads((DEMO / "calibration.json").read_text())
        del known["base_from_camera"]
        (tmp_path / "calibration.json").write_text(json.dumps(known))

        found = person.mikado(
            "calibrate", "hand-eye", "--config", "cell.yaml", "--board", "board.yaml", "--dome", "7",
            "--start-mm", "0", "-330", "130", "--pivot-mm", "0", "115", "0", "--yes", "--save", "session",
        )  # fmt: skip
        assert found.returncode == 0, found.stdout + found.stderr
        assert "scene-mounted" in found.stdout
        assert np.median(person.camera_error_mm()) < 0.5
        about = json.loads((tmp_path / "calibration.json").read_text())["hand_eye"]
        assert about["poses_used"] >= 6

        cell.ask("board", place="tray")
        code, said = person.touch("--tolerance-mm", "1.5")
        assert code == 0, said
        history = (tmp_path / "touch-history.jsonl").read_text().splitlines()
        assert len(history) == 1
        assert len(json.loads(history[0])["points"]) == 5
