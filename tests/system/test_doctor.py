"""`mikado doctor` against controllers and grippers on the wire: each line, what to do, the exit code."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from tests.fakes.robotiq import RobotiqPeer, robotiq_peer
from tests.fakes.ur_controller import UrController, ur_controller
from tests.system.processes import DEMO, ROOT, Json


@pytest.fixture(scope="module")
def running() -> Iterator[UrController]:
    with ur_controller() as controller:
        yield controller


@pytest.fixture
def controller(running: UrController) -> Iterator[UrController]:
    running.mend()
    yield running
    running.mend()


@pytest.fixture(scope="module")
def hand() -> Iterator[RobotiqPeer]:
    with robotiq_peer("--speed", "8") as peer:
        yield peer


@pytest.fixture
def peer(hand: RobotiqPeer) -> Iterator[RobotiqPeer]:
    hand.mend()
    yield hand
    hand.mend()


def written(folder: Path, robot: dict[str, Json], gripper: dict[str, Json]) -> Path:
    """The demo's cell with this arm and gripper, as a file."""
    data = yaml.safe_load(DEMO.read_text(encoding="utf-8"))
    arm = yaml.safe_load((DEMO.parent / "ur.yaml").read_text(encoding="utf-8"))
    data["robot"] = {**arm["robot"], **robot}
    data["gripper"] = {**arm["gripper"], **gripper} if "driver" not in gripper else gripper
    data["allow_mixed"] = True
    data["files"] = {"calibration": str(DEMO.parent / "calibration.json"), "journal": "journal.sqlite"}
    path = folder / "cell.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return path


def doctor(path: Path) -> tuple[int, str]:
    """Exit code and what was printed, wide enough that no line is broken."""
    done = subprocess.run(
        [sys.executable, "-m", "cell", "doctor", str(path)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=60.0,
        check=False,
    )
    return done.returncode, done.stdout + done.stderr


def line_of(text: str, what: str) -> str:
    """The line about something, with the one below it."""
    lines = text.splitlines()
    at = next(i for i, line in enumerate(lines) if f" {what} " in line)
    return " ".join(lines[at : at + 2])


def test_a_cell_in_order_is_all_good_and_nothing_has_moved(controller: UrController, tmp_path: Path) -> None:
    code, text = doctor(written(tmp_path, {"host": controller.host}, {}))
    assert code == 0, text
    assert "WRONG" not in text
    for what in ("calibration", "workspace", "PolyScope", "control", "safety", "jaws", "confirm input"):
        assert "good" in line_of(text, what)
    assert "all 8 corners" in text
    assert controller.number("moves_started") == 0
    assert controller.status()["runtime"] == "STOPPED"


def test_local_control_is_told_with_what_to_do(controller: UrController, tmp_path: Path) -> None:
    controller.do("remote", on=False)
    code, text = doctor(written(tmp_path, {"host": controller.host}, {}))
    assert code == 1
    assert "WRONG" in line_of(text, "control")
    assert "switch it to remote control" in line_of(text, "control")


def test_a_controller_that_is_not_there_is_told_for_arm_and_gripper(tmp_path: Path) -> None:
    code, text = doctor(written(tmp_path, {"host": "127.200.0.9"}, {}))
    assert code == 1
    assert "WRONG" in line_of(text, "controller")
    assert "WRONG" in line_of(text, "pins")


def test_a_sensor_that_says_held_with_open_jaws_is_told(controller: UrController, tmp_path: Path) -> None:
    low_means_held: dict[str, Json] = {"holding_level": False}
    code, text = doctor(written(tmp_path, {"host": controller.host}, low_means_held))
    assert code == 1
    assert "held, with open jaws" in line_of(text, "confirm input")


def test_a_robotiq_gripper_is_looked_at_over_its_own_socket(
    controller: UrController, peer: RobotiqPeer, tmp_path: Path
) -> None:
    gripper: dict[str, Json] = {
        "driver": "robotiq",
        "host": peer.host,
        "port": peer.port,
        "open_position": 150,
        "empty_from": 225,
        "force": 10,
    }
    path = written(tmp_path, {"host": controller.host}, gripper)
    code, text = doctor(path)
    assert code == 0, text
    assert "active" in line_of(text, "activation")
    peer.do("fault", code=14)
    code, text = doctor(path)
    assert code == 1
    assert "overcurrent" in line_of(text, "fault")
    assert "teach pendant" in line_of(text, "fault")
    assert peer.do("status")["orders"] == 0


def test_what_is_wrong_in_the_file_itself_comes_with_its_line(tmp_path: Path) -> None:
    path = written(tmp_path, {"host": "127.200.0.9", "model": "UR50"}, {})
    code, text = doctor(path)
    assert code == 78
    assert "robot" in text
    assert "UR50" in text
