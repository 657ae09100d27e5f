"""A tray with something fixed in it that looks like a part: taken as its empty state, it stays."""

from __future__ import annotations

from pathlib import Path

import yaml

from drivers.types import ResultCode
from tests.fakes.commissioner import DEMO, Commissioner
from tests.fakes.simcell import sim_cell
from tests.system.handplc import HandPlc
from tests.system.processes import daemon


def test_what_belongs_to_the_tray_stays_and_the_rest_is_picked(tmp_path: Path, plc: HandPlc) -> None:
    with sim_cell("--speed", "8", "--seed", "3", "--sticks", "1") as cell:
        person = Commissioner(folder=tmp_path, cell=cell)
        person.configure()
        config = tmp_path / "cell.yaml"
        (tmp_path / "calibration.json").write_bytes((DEMO / "calibration.json").read_bytes())

        refused = person.mikado("area", "empty", "cell.yaml", "--take", "--yes")
        assert refused.returncode == 2
        assert "1 of stick-100 recognised" in refused.stderr
        taken = person.mikado("area", "empty", "cell.yaml", "--take", "--yes", "--sure")
        assert taken.returncode == 0, taken.stdout + taken.stderr

        cell.ask("add_sticks", count=3)
        more = person.mikado("area", "empty", "cell.yaml")
        assert more.returncode == 1
        assert "something lies at" in more.stdout

        data = yaml.safe_load(config.read_text(encoding="utf-8"))
        data["plc"]["port"] = plc.port
        config.write_text(yaml.safe_dump(data), encoding="utf-8")
        with daemon(config) as running:
            running.started()
            plc.enable()
            codes = plc.empty(9)
            assert running.terminate()[0] == 0
        assert codes.count(ResultCode.OK) == 3
        assert cell.count("in_tray") == 1
