"""The simulated cell as a process: its command line, its end, strangers on its port."""

from __future__ import annotations

import json
import signal
import socket
import struct
import subprocess
import sys
from pathlib import Path

import pytest

from drivers.camera_settings import SimCameraSettings
from drivers.errors import CommandRejected
from drivers.sim.devices import SimCamera
from drivers.timing import MonotonicClock
from tests.fakes.simcell import ROOT, WORLD, sim_cell

CLOCK = MonotonicClock()


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "drivers.sim.cell", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=30, check=False)


@pytest.mark.parametrize("ending", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_at_once_with_exit_code_0(ending: signal.Signals) -> None:
    with sim_cell("--sticks", "1") as cell:
        asked_at = CLOCK.now()
        cell.process.send_signal(ending)
        assert cell.process.wait(5.0) == 0
        assert CLOCK.now() - asked_at < 2.0


def test_seed_and_count_of_the_command_line_make_the_pile() -> None:
    ends = []
    for seed in ("3", "3", "4"):
        with sim_cell("--sticks", "5", "--seed", seed) as cell:
            ends.append(json.dumps(cell.ask("truth").values["sticks"]))
    assert len(json.loads(ends[0])) == 5
    assert ends[0] == ends[1] != ends[2]


def test_faults_can_be_there_from_the_start() -> None:
    with sim_cell("--sticks", "1", "--faults", "protective_stop,camera_black:left") as cell:
        assert cell.ask("status").text("safety") == "protective_stop"
        means = []
        for eye in ("left", "right"):
            settings = SimCameraSettings.model_validate(
                {"driver": "sim", "port": cell.port, "eye": eye, "width_px": 640, "height_px": 480}
            )
            camera = SimCamera(eye, settings, CLOCK)
            camera.open()
            means.append(float(camera.grab(newer_than=CLOCK.now(), timeout_s=3.0).pixels.mean()))
            camera.close()
        assert means[0] < 5.0 < means[1]


def _hung_up_on(stranger: socket.socket, nonsense: bytes) -> bool:
    """Say it, and be hung up on without an answer, before or after the last word."""
    try:
        stranger.sendall(nonsense)
        stranger.shutdown(socket.SHUT_WR)
        return stranger.recv(10) == b""
    except TimeoutError:
        return False
    except OSError:  # reset, or not connected any more
        return True


def test_strangers_and_nonsense_cost_nothing_but_their_own_connection() -> None:
    with sim_cell("--sticks", "1") as cell:
        for nonsense in (b"GET / HTTP/1.1\r\n\r\n", struct.pack(">II", 0xFFFFFFF0, 4), b"\x00"):
            with socket.create_connection(("127.0.0.1", cell.port), timeout=2.0) as stranger:
                assert _hung_up_on(stranger, nonsense)
        with pytest.raises(CommandRejected, match="no operation 'dance'"):
            cell.ask("dance")
        with pytest.raises(CommandRejected, match="not a number"):
            cell.ask("grab", eye="left", newer_than="now", timeout_s=1.0)
        with pytest.raises(CommandRejected, match="no eye"):
            cell.ask("grab", eye="third", newer_than=0.0, timeout_s=1.0)
        with pytest.raises(CommandRejected, match="no fault"):
            cell.fault("earthquake")
        assert cell.count("in_tray") == 1


def test_more_parts_can_be_thrown_in_while_it_runs() -> None:
    with sim_cell("--sticks", "2") as cell:
        cell.ask("add_sticks", count=3)
        assert cell.count("in_tray") == 5


def test_a_world_file_that_is_wrong_ends_with_78_and_says_where(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(WORLD.read_text(encoding="utf-8").replace("opening_m:", "opening_mm:"), encoding="utf-8")
    ended = run("--world", str(wrong))
    assert ended.returncode == 78
    assert "gripper.opening_mm" in ended.stderr
    assert "Traceback" not in ended.stderr


@pytest.mark.parametrize("arguments", [("--speed", "0"), ("--faults", "earthquake"), ("--port", "x")])
def test_wrong_arguments_end_with_2(arguments: tuple[str, str]) -> None:
    ended = run("--world", str(WORLD), *arguments)
    assert ended.returncode == 2
    assert "Traceback" not in ended.stderr


def test_the_calibration_is_written_on_request(tmp_path: Path) -> None:
    target = tmp_path / "calibration.json"
    assert run("--world", str(WORLD), "--calibration-out", str(target)).returncode == 0
    assert target.read_text(encoding="utf-8") == (WORLD.parent / "calibration.json").read_text(
        encoding="utf-8"
    )
