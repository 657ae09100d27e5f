"""The simulated UR controller on the wire, met by the unmodified ur-rtde in a process of its own.

Time is real: library and controller are processes of their own, and the library has no other.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.sim.geometry import rotvec_of
from tests.fakes.simcell import sim_cell
from tests.fakes.urcontroller import ROOT, UrController, free_host, ur_controller

LIBRARY = Path(__file__).with_name("ur_library.py")
WITHIN_S = 60.0


@contextmanager
def library(story: str, ur: UrController, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """A story in its own process, which is gone at the end."""
    command = [sys.executable, str(LIBRARY), story, ur.host, *arguments]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def told(story: str, ur: UrController, *arguments: str) -> dict[str, Any]:
    """What a story tells."""
    with library(story, ur, *arguments) as process:
        out, _ = process.communicate(timeout=WITHIN_S)
    assert process.returncode == 0, f"{story} ended with {process.returncode}: {out}"
    answer = json.loads(out.splitlines()[-1])
    assert isinstance(answer, dict)
    return answer


def test_the_unmodified_library_does_everything_the_driver_needs() -> None:
    with ur_controller("--model", "UR10e", "--polyscope", "5.15.0", "--serial", "20231234567") as ur:
        found = told("tour", ur)
    assert found["dashboard"] == [
        "Robotmode: RUNNING",
        "Safetystatus: NORMAL",
        "5.15.0.0",
        True,
        "20231234567",
    ]
    assert found["line"] is found["async"] is found["path"] is found["custom"] is found["after"] is True
    assert 0.1 / 0.25 + 0.25 / 1.2 <= found["line_s"] < 2.0
    assert found["line_error"] < 1e-6
    assert found["async_s"] < 0.3
    assert found["operation"] == 1
    assert found["async_error"] < 1e-6
    assert 0.1 / 2.0 <= found["stop_s"] < 1.0
    assert 0.03 < found["stopped_after_m"] < 0.08
    assert found["path_error"] < 1e-5  # the library writes paths with six digits
    assert found["ik_error"] < 1e-6
    assert found["has_solution"] == [True, False]
    assert found["limits"] == [True, False]
    assert found["steady"] is True
    assert found["tcp"] == [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]
    assert found["payload"] == [True, 0.9]
    assert found["outputs"] == 1 | 1 << 3 | 1 << 17
    assert found["slider"] == 0.5
    assert found["upload"] == [True, True]


# 5.23 changes the recipe the library asks for; 10.10 is PolyScope X, which has no dashboard
@pytest.mark.parametrize("polyscope", ["5.5.0", "5.11.0", "5.22.0", "5.23.0", "10.10.0"])
def test_it_connects_to_every_polyscope_and_moves(polyscope: str) -> None:
    with ur_controller("--polyscope", polyscope, "--model", "UR3e") as ur:
        assert told("connect", ur) == {"moved": True}


def test_the_upper_registers_can_be_used_while_a_fieldbus_holds_the_lower_ones() -> None:
    with ur_controller() as ur:
        ur.do("registers", taken="lower")
        assert "already in use" in told("connect", ur)["error"]
        assert told("connect", ur, "9") == {"moved": True}  # 1 upload, 8 upper range


def test_in_local_control_it_is_turned_away() -> None:
    with ur_controller() as ur:
        ur.do("remote", on=False)
        assert "remote control" in told("connect", ur)["error"]


def test_a_script_that_is_ignored_or_dies_is_noticed_as_by_a_real_controller() -> None:
    with ur_controller() as ur:
        ur.do("script", how="ignore")
        assert "Failed to start control script" in told("connect", ur)["error"]
        ur.do("script", how="die")
        assert told("later", ur) == {"running": False}


def test_a_protective_stop_at_an_instant_of_the_motion_fails_the_move_and_all_after_it() -> None:
    with ur_controller() as ur:
        ur.do("protective_stop", at={"moving_s": 0.3})
        found = told("blocking", ur)
        assert found["first"] is found["second"] is False
        assert found["second_s"] < 1.0
        status = ur.status()
        assert (status["safety"], status["runtime"]) == ("PROTECTIVE_STOP", "PAUSED")
        assert status["moves_started"] == 1
        assert 0.03 < status["distance_m"] < 0.1


def test_an_emergency_stop_in_a_motion_leaves_the_arm_without_power() -> None:
    with ur_controller() as ur:
        ur.do("emergency_stop", at={"moving_s": 0.3})
        assert told("blocking", ur)["first"] is False
        status = ur.wait(safety="ROBOT_EMERGENCY_STOP", runtime="STOPPED", robot_mode="POWER_OFF")
        assert status["moving"] is False


def test_the_arm_stands_when_the_process_that_feeds_its_watchdog_is_killed() -> None:
    with ur_controller() as ur:
        with library("watched", ur) as process:
            ur.wait(10.0, moving=True)
            time.sleep(0.5)
            assert ur.status()["moving"] is True
            process.send_signal(signal.SIGKILL)
            process.wait(5.0)
            killed_s = ur.status()["time_s"]
            assert ur.wait(2.0, moving=False)["time_s"] - killed_s < 0.3
        assert ur.status()["counts"]["watchdog"] == 1


def test_slow_motion_and_the_slider_of_somebody_else_stretch_a_move() -> None:
    with ur_controller() as ur:
        ur.do("slow", factor=0.5)
        ur.do("speed_slider", fraction=0.5)
        with library("blocking", ur) as process:
            ur.wait(10.0, moving=True)
            began_s = ur.status()["time_s"]
            ur.wait(20.0, moves_finished=1)
            took_s = ur.status()["time_s"] - began_s
            process.kill()
    assert took_s == pytest.approx(4.0 * (0.25 / 0.25 + 0.25 / 1.2), abs=0.2)


def test_time_can_be_scaled() -> None:
    with ur_controller("--time-scale", "5") as ur:
        began_s, began_at = ur.status()["time_s"], time.monotonic()
        told("connect", ur)
        passed_s = time.monotonic() - began_at
        assert ur.status()["time_s"] - began_s == pytest.approx(5.0 * passed_s, rel=0.1)


def test_it_picks_a_stick_in_the_simulated_cell() -> None:
    with (
        sim_cell("--sticks", "1", "--seed", "3") as cell,
        ur_controller("--world-port", str(cell.port), "--tcp", "0,0,0.165,0,0,0") as ur,
    ):
        truth: Any = cell.ask("truth").values
        first, second = np.array(truth["sticks"][0]["ends_m"])
        middle, along = (first + second) / 2.0, (second - first) / np.linalg.norm(second - first)
        along = np.array([along[0], along[1], 0.0]) / np.hypot(along[0], along[1])
        down = np.array([0.0, 0.0, -1.0])
        attitude = rotvec_of(np.column_stack([np.cross(along, down), along, down]))
        below = [*middle, *attitude]
        above = [*(middle - 0.1 * down), *attitude]
        assert ur.status()["q"] == pytest.approx(cell.ask("state").six("q_rad"))
        found = told("pick", ur, json.dumps(above), json.dumps(below))
        assert found == {"held": [False, True, True], "moved": [True, True, True]}
        world = cell.ask("status").values
        assert (world["in_tray"], world["holding"], world["collisions"]) == (0, True, 0)
        cell.fault("protective_stop")
        ur.wait(safety="PROTECTIVE_STOP")
        # the controller tells the cell in its next message, and one from before may still be on its way
        ends_at = time.monotonic() + 2.0
        while cell.ask("state").text("safety") != "protective_stop":
            assert time.monotonic() < ends_at, "the cell was not told of the stop"
            time.sleep(0.005)


def test_a_lost_cell_is_a_cut_cable_and_a_new_one_is_found() -> None:
    with sim_cell("--sticks", "1") as cell:
        port = cell.port
        with ur_controller("--world-port", str(port)) as ur:
            ur.wait(world="up")
            cell.ask("set_input", pin=3, on=True)
            ur.wait(inputs=1 << 3)
            cell.process.kill()
            cell.process.wait(5.0)
            ur.wait(world="down", inputs=0)
            assert told("connect", ur) == {"moved": True}  # the arm goes on without a world
            with sim_cell("--sticks", "1", "--port", str(port)) as new:
                ur.wait(world="up")
                ur.wait(inputs=0)
                q = ur.status()["q"]
                # the new cell is told in the controller's next message, which may still be on its way
                ends_at = time.monotonic() + 2.0
                while new.ask("state").six("q_rad") != pytest.approx(q, abs=1e-9):
                    assert time.monotonic() < ends_at, "the new cell was not told where the arm stands"
                    time.sleep(0.005)


def test_a_cell_that_hangs_holds_up_no_cycle_of_the_controller() -> None:
    with sim_cell("--sticks", "1") as cell, ur_controller("--world-port", str(cell.port)) as ur:
        ur.wait(world="up")
        cell.process.send_signal(signal.SIGSTOP)
        try:
            before, began_at = ur.status()["time_s"], time.monotonic()
            assert told("connect", ur) == {"moved": True}
            passed_s = time.monotonic() - began_at
            assert ur.status()["time_s"] - before == pytest.approx(passed_s, rel=0.1)
        finally:
            cell.process.send_signal(signal.SIGCONT)


def test_it_needs_nothing_but_the_standard_library() -> None:
    look = "import sys, drivers.sim.ur_controller; print({'numpy', 'pydantic'} & set(sys.modules))"
    run = subprocess.run([sys.executable, "-c", look], cwd=ROOT, capture_output=True, text=True, check=True)
    assert run.stdout == "set()\n"


def test_its_arguments_are_checked() -> None:
    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "drivers.sim.ur_controller", *arguments]
        return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=30, check=False)

    with ur_controller() as ur:
        taken = run("--host", ur.host)
        assert (taken.returncode, taken.stdout) == (2, "")
        assert f"cannot listen on {ur.host}:29999" in taken.stderr
    for arguments, said in (
        (("--polyscope", "five"), "PolyScope version"),
        (("--start-q", "1,2"), "six numbers"),
        (("--model", "UR99"), "invalid choice"),
        (("--model", "UR10e", "--world-port", "1"), "draws a UR5e"),
        (("--host", free_host(), "--world-port", "1"), "no simulated cell"),
    ):
        refused = run(*arguments)
        assert refused.returncode == 2
        assert said in refused.stderr
        assert refused.stderr.count("\n") == 1


def test_a_signal_ends_it_and_its_last_line_counts() -> None:
    with ur_controller() as ur:
        assert told("connect", ur) == {"moved": True}
        last = ur.end()
    assert (last["ended"], last["moves_started"], last["moves_finished"]) == (True, 1, 1)
    assert last["distance_m"] == pytest.approx(0.02, abs=1e-4)
