"""The whole cell over the wire: two GigE Vision cameras in networks of their own, the arm over RTDE, the PLC
over Modbus TCP; the tray is emptied. The cameras show what the simulated cell looks like at each exposure."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from tests.fakes.simcell import sim_cell
from tests.fakes.ur_controller import ur_controller
from tests.lab import gige
from tests.system.processes import DEMO, ROOT, START_S, daemon, free_port

STICKS = 12
MOST_S = 900.0


def written(folder: Path, host: str, plc_port: int) -> Path:
    """The demo's cell with cameras, arm and gripper that are reached by their own protocols."""
    data = yaml.safe_load(DEMO.read_text(encoding="utf-8"))
    arm = yaml.safe_load((DEMO.parent / "ur.yaml").read_text(encoding="utf-8"))
    data["cameras"].update(
        {
            eye: {
                "driver": "gige",
                "address": gige.ADDRESSES[eye],
                "width_px": 640,
                "height_px": 480,
                "exposure_us": 5000,
                "trigger": "software",
                "lost_s": 5.0,
                "lag_s": 0.2,
                "packet_size": 8000,
            }
            for eye in gige.EYES
        }
    )
    data["cameras"]["look_timeout_s"] = 40.0
    data["robot"], data["gripper"] = {**arm["robot"], "host": host}, arm["gripper"]
    data["plc"]["port"] = plc_port
    data["files"] = {"calibration": str(DEMO.parent / "calibration.json"), "journal": "journal.sqlite"}
    path = folder / "cell.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return path


def test_a_tray_is_emptied_with_every_device_on_a_wire(tmp_path: Path) -> None:
    gige.require()
    with (
        gige.network() as net,
        sim_cell("--sticks", str(STICKS), "--seed", "7") as cell,
        gige.peers(net, ("--cell", str(cell.port)), ("--cell", str(cell.port))),
        ur_controller("--payload", "0.9", "--world-port", str(cell.port)) as arm,
    ):
        gige.first_in_line(cell.process.pid)
        gige.first_in_line(arm.process.pid)
        port, out = free_port(), tmp_path / "plc.json"
        plc = subprocess.Popen(
            [
                *(sys.executable, "-m", "drivers.sim.plc", "--port", str(port)),
                *("--orders", "until-empty", "--deadline-s", "300", "--out", str(out)),
            ],
            cwd=ROOT,
            stdout=subprocess.DEVNULL,
        )
        try:
            with daemon(written(tmp_path, arm.host, port)) as running:
                running.wait_for("state_changed", 4 * START_S, after="IDLE")
                assert plc.wait(MOST_S) == 0, out.read_text()
                picked = [line for line in running.events("pick_finished") if line["outcome"] == "PICKED"]
                skews = [float(str(line["skew_s"])) for line in running.events("look_finished")]
                assert running.terminate()[0] == 0
        finally:
            if plc.poll() is None:
                plc.kill()
                plc.wait(5.0)
        assert cell.count("in_box") == STICKS
        assert len(picked) == STICKS
        assert json.loads(out.read_text())["handshake_errors"] == []
    print(f"\n{len(picked)} of {STICKS} picked; skew of {len(skews)} pairs: {sorted(skews)}")


def test_a_look_over_the_wire_finds_the_sticks_of_the_scene(tmp_path: Path) -> None:
    gige.require()
    with (
        gige.network() as net,
        sim_cell("--sticks", "5", "--seed", "3") as cell,
        gige.peers(net, ("--cell", str(cell.port)), ("--cell", str(cell.port))),
    ):
        data = yaml.safe_load(DEMO.read_text(encoding="utf-8"))
        for eye in gige.EYES:
            wanted = gige.settings(eye, trigger="software", lost_s=20.0)
            data["cameras"][eye] = wanted.model_dump(mode="json", exclude_none=True)
        data["cameras"]["look_timeout_s"] = 40.0
        data["allow_mixed"] = True
        data["files"]["calibration"] = str(DEMO.parent / "calibration.json")
        config = tmp_path / "cell.yaml"
        config.write_text(yaml.safe_dump(data), encoding="utf-8")
        done = subprocess.run(
            [sys.executable, "-m", "cell", "look", "--config", str(config), "--out", str(tmp_path)],
            cwd=gige.ROOT,
            capture_output=True,
            text=True,
            check=False,
        )
    assert done.returncode == 0, done.stdout + done.stderr
    candidates = json.loads((tmp_path / "look.json").read_text())["candidates"]
    lengths = [c["length_m"] for c in candidates if c["offered"]]
    print(f"\noffered over the wire, lengths in m: {lengths}")
    assert len(lengths) >= 4
    assert all(length == pytest.approx(0.100, abs=0.004) for length in lengths)
