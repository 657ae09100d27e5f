"""The daemon keeps its own book: state, alarms and counters in a file, modes by command, looks ahead."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from statistics import median

import pytest
import yaml

from cell import drift
from drivers.types import PlcCommand, ResultCode
from tests.fakes.simcell import SimCell, sim_cell
from tests.system.handplc import HandPlc
from tests.system.processes import DEMO, ROOT, SPEED, daemon, orders, until, write_config
from vision.drift import SETTLED_LOOKS, Drift, Trend


def told(config: Path) -> dict[str, object]:
    """``mikado state CONFIG --json``."""
    got = subprocess.run(
        [sys.executable, "-m", "cell", "state", str(config), "--json"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    document: dict[str, object] = json.loads(got.stdout)
    return document


def command(plc: HandPlc, code: PlcCommand, parameter: int) -> int:
    return plc.run(code, attempts=parameter).result_code


def test_the_file_tells_state_mode_alarms_and_counts_across_a_kill(
    tmp_path: Path, plc: HandPlc, cell: SimCell
) -> None:
    config = write_config(tmp_path, cell.port, plc.port)
    if cell.count("in_tray") < 3:
        cell.ask("add_sticks", count=6)
    with daemon(config) as running:
        running.started()
        plc.enable()
        assert plc.run().result_code == ResultCode.OK
        assert command(plc, PlcCommand.SET_MODE, 4) == ResultCode.OK
        before = cell.count("grasps")
        assert plc.run().result_code == ResultCode.OK
        assert cell.count("grasps") == before, "a dry run has closed the jaws"
        plc.wait(lambda s: s.unit_mode == 4 and s.first_alarm == 912, "mode and alarm in the registers")
        until(lambda: told(config).get("mode") == "DRY_RUN", 12.0, "the file knows the mode")
        running.kill()
    with daemon(config) as again:
        again.started()
        plc.wait(lambda s: s.unit_mode == 4, "the mode is kept", 30.0)
        cell.fault("emergency_stop")
        plc.wait(lambda s: s.fault_code == 413, "the fault")
        until(lambda: _codes(config) == {413, 912}, 12.0, "both alarms")
        document = told(config)
        figures = document["figures"]
        assert isinstance(figures, dict)
        assert figures["produced"] == 1
        assert figures["first_out"]["code"] == 413
        assert document["devices"]["arm"] == "check function"  # type: ignore[index]
        cell.mend()
        plc.reset()
        assert again.terminate()[0] == 0
    assert told(config)["state"] == "STOPPED"


def _codes(config: Path) -> set[int]:
    found = told(config)["alarms"]
    assert isinstance(found, list)
    return {alarm["code"] for alarm in found}


def test_a_calibration_that_drifts_is_an_alarm_and_the_cell_goes_on(
    tmp_path: Path, plc: HandPlc, cell: SimCell
) -> None:
    """A trend that was on its way before the daemon began gets its say with the next look."""
    config = write_config(tmp_path, cell.port, plc.port)
    data = yaml.safe_load(config.read_text(encoding="utf-8"))
    data["commissioning"] = {"drift": {"memory_looks": 2.0, "length_limit": 0.06}}
    config.write_text(yaml.safe_dump(data), encoding="utf-8")
    before = drift.Watched(
        calibration=drift.fingerprint(DEMO.parent / "calibration.json"),
        drift=Drift(length=Trend(value=1.2, looks=SETTLED_LOOKS - 1)),
    )
    drift.save(tmp_path / "drift.json", before)
    if cell.count("in_tray") < 3:
        cell.ask("add_sticks", count=6)

    def alarm() -> tuple[object, object] | None:
        found = told(config)["alarms"]
        assert isinstance(found, list)
        return next(((a["state"], a["priority"]) for a in found if a["code"] == 104), None)

    with daemon(config) as running:
        running.started()
        plc.enable()
        assert alarm() is None
        plc.wait(lambda s: s.ready, "ready")
        plc.run(PlcCommand.VISION_ONLY)  # 1.2 and a good look make 1.1
        plc.wait(lambda s: s.first_alarm == 104, "the alarm in the registers")
        until(lambda: alarm() == ("unacknowledged", "medium"), 12.0, "the alarm in the file")
        assert told(config)["devices"]["cameras"] == "maintenance required"  # type: ignore[index]
        subprocess.run(
            [sys.executable, "-m", "cell", "alarms", str(config), "--acknowledge", "104"],
            cwd=ROOT,
            check=True,
        )
        until(lambda: alarm() == ("acknowledged", "medium"), 12.0, "somebody has seen it")
        plc.wait(lambda s: s.ready, "ready again")
        assert plc.run(PlcCommand.VISION_ONLY).result_code == ResultCode.OK  # 1.05
        until(lambda: alarm() is None, 12.0, "the alarm has gone")
        assert running.terminate()[0] == 0
    assert [line["code"] for line in running.events("alarm_came")] == [104]
    assert [line["code"] for line in running.events("alarm_gone")] == [104]


@pytest.mark.parametrize("ahead", [False, True], ids=["look when asked", "look while placing"])
def test_a_tray_is_emptied_with_and_without_looking_ahead(tmp_path: Path, plc: HandPlc, ahead: bool) -> None:
    sticks = 5
    with sim_cell("--speed", SPEED, "--seed", "7", "--sticks", str(sticks)) as cell:
        config = write_config(tmp_path, cell.port, plc.port)
        data = yaml.safe_load(config.read_text(encoding="utf-8"))
        strategy = {"look_while_placing": ahead, "clear_q_rad": data["workspace"]["drop_q_rad"]}
        data["operation"] = {"strategy": strategy}
        config.write_text(yaml.safe_dump(data), encoding="utf-8")
        with daemon(config) as running:
            running.started()
            plc.enable()
            codes = plc.empty(3 * sticks)
            assert codes.count(ResultCode.OK) == sticks
            used = len(running.events("prepared_look_used"))
            assert (used > sticks // 2) if ahead else (used == 0)
            took = [float(str(line["took_s"])) for line in running.events("pick_finished")]
            sys.stdout.write(f"ahead {ahead}: median {median(took):.2f} s, {used} looks ahead used\n")
            assert len(orders(tmp_path)) == len(codes)
            assert plc.violations == []
            assert cell.count("collisions") == 0
            assert running.terminate()[0] == 0
