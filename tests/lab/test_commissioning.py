"""The whole chain: a simulated cell calibrated from nothing with Mikado's commands only, then the demo."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cell.config import load_part
from tests.fakes.commissioner import DEMO, Commissioner
from tests.fakes.simcell import sim_cell


@pytest.fixture(autouse=True)
def asked_for(pytestconfig: pytest.Config) -> None:
    """Ten minutes on a machine of its own; the short version is in tests/system/test_hand_eye.py."""
    if pytestconfig.getoption("--picks") is None:
        pytest.skip("the whole chain takes minutes: make soak")


def test_a_cell_calibrated_from_nothing_empties_its_tray(tmp_path: Path) -> None:
    with sim_cell("--sticks", "0", "--speed", "4", "--board", "waved") as cell:
        person = Commissioner(folder=tmp_path, cell=cell)
        person.configure()
        assert not (tmp_path / "calibration.json").exists()

        page = person.mikado(
            "calibrate", "board", "--columns", "9", "--rows", "7", "--pitch-mm", "20", "--dictionary",
            "DICT_4X4_50", "--out", "page.pdf",
        )  # fmt: skip
        assert page.returncode == 0, page.stdout + page.stderr

        cameras = person.mikado(
            "calibrate", "cameras", "--config", "cell.yaml", "--board", "board.yaml",
            "--out", "calibration.json", "--views", "24", "--plot", "cameras.png", "--deadline-s", "400",
        )  # fmt: skip
        print(cameras.stdout)
        assert cameras.returncode == 0, cameras.stdout + cameras.stderr

        cell.ask("board", place="hand")
        hand_eye = person.mikado(
            "calibrate", "hand-eye", "--config", "cell.yaml", "--board", "board.yaml", "--dome", "15",
            "--start-mm", "0", "-330", "130", "--pivot-mm", "0", "115", "0", "--yes", "--save", "session",
            "--plot", "poses.png",
        )  # fmt: skip
        print(hand_eye.stdout)
        assert hand_eye.returncode == 0, hand_eye.stdout + hand_eye.stderr

        cell.ask("board", place="tray")
        away = person.mikado("area", "teach", "cell.yaml", "--picture", "area.png")
        assert away.returncode == 0, away.stdout + away.stderr
        code, said = person.touch()
        print(said)
        assert code == 0, said

    errors = person.camera_error_mm()
    print(f"floor points against the truth: {np.median(errors):.3f} mm median, {errors.max():.3f} at worst")
    assert np.median(errors) < 0.5
    assert errors.max() < 1.0

    for driver in ("sim", "ur"):  # the simulated cell's own arm, then the UR driver over RTDE
        out = f"demo-{driver}"
        demo = person.mikado(
            "demo", "--config", "cell.yaml", "--driver", driver, "--speed", "1", "--out", out, timeout_s=400.0
        )
        print(demo.stdout)
        assert demo.returncode == 0, demo.stdout + demo.stderr
        summary = json.loads((tmp_path / out / "summary.json").read_text())
        assert (summary["driver"], summary["in_box"], summary["picked"]) == (driver, 12, 12)


def test_the_other_ways_of_the_guide(tmp_path: Path) -> None:
    """A saved routine, an arm led by hand, a product taught and gripped: each ends with what it promises."""
    with sim_cell("--sticks", "0", "--speed", "8", "--board", "hand") as cell:
        person = Commissioner(folder=tmp_path, cell=cell)
        person.configure()
        known = json.loads((DEMO / "calibration.json").read_text())
        del known["base_from_camera"]
        (tmp_path / "calibration.json").write_text(json.dumps(known))
        live = ("calibrate", "hand-eye", "--config", "cell.yaml", "--board", "board.yaml")
        dome = person.mikado(
            *live, "--dome", "7", "--start-mm", "0", "-330", "130", "--pivot-mm", "0", "115", "0", "--yes",
            "--save", "session",
        )  # fmt: skip
        assert dome.returncode == 0, dome.stdout + dome.stderr

        (tmp_path / "calibration.json").write_text(json.dumps(known))
        routine = person.mikado(*live, "--routine", "session/poses.json", "--yes", "--save", "again")
        assert routine.returncode == 0, routine.stdout + routine.stderr
        assert np.median(person.camera_error_mm()) < 0.5

        (tmp_path / "calibration.json").write_text(json.dumps(known))
        code, said = person.lead(tmp_path / "session" / "poses.json", "led")
        assert code == 0, said
        assert np.median(person.camera_error_mm()) < 0.5

    with sim_cell("--sticks", "0", "--speed", "8") as cell:
        person = Commissioner(folder=tmp_path, cell=cell)
        person.configure()
        empty = person.mikado("area", "empty", "cell.yaml", "--take", "--yes")
        assert empty.returncode == 0, empty.stdout + empty.stderr
        cell.ask("add_sticks", count=1)
        taught = person.mikado(
            "product", "teach", "--config", "cell.yaml", "--length-mm", "100", "--out", "stick.yaml"
        )
        assert taught.returncode == 0, taught.stdout + taught.stderr
        assert load_part(tmp_path / "stick.yaml").diameter_m == pytest.approx(0.0038, rel=0.1)
        wrong = person.mikado(
            "product", "teach", "--config", "cell.yaml", "--length-mm", "90", "--out", "wrong.yaml"
        )
        assert wrong.returncode == 2
        gripped = person.mikado(
            "product", "grasp", "stick.yaml", "--config", "cell.yaml", "--free-rotation-deg", "30",
            "--preview", "grasp.png",
        )  # fmt: skip
        assert gripped.returncode == 0, gripped.stdout + gripped.stderr
