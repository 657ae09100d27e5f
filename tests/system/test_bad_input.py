"""Bad input as a person meets it: one line that says where and what to do, an exit code, no traceback."""

from __future__ import annotations

import shutil
import socket
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Final, TypeAlias

import cv2
import numpy as np
import pytest

from tests.system.processes import ROOT

DATA = ROOT / "tests" / "data"
USAGE, CONFIG = 2, 78
Case: TypeAlias = tuple[tuple[str, ...], int, list[str]]
"""Arguments, exit code, what the line must say."""
WORLD = str(ROOT / "configs" / "demo" / "world.yaml")


def _look(
    left: str, right: str, calibration: str = "calibration.json", part: str = "part.yaml"
) -> tuple[str, ...]:
    pictures = ("--left", left, "--right", right)
    return ("look", *pictures, "--calibration", calibration, "--product", part, "--depth-m", "0.2", "0.4")


COMMANDS: Final[list[Case]] = [
    (("check", "nothing.yaml"), CONFIG, ["nothing.yaml", "No such file"]),
    (("check", "cell-key.yaml"), CONFIG, ["cell-key.yaml:4", "colour", "unknown key"]),
    (("run", "cell-key.yaml", "--json"), CONFIG, ["cell-key.yaml:4", "colour", "unknown key"]),
    (("check", "cell-type.yaml"), CONFIG, ["cell-type.yaml:7", "cameras.max_skew_s", "number", "'fast'"]),
    (("check", "cell-lost.yaml"), CONFIG, ["nowhere.json", "not found", "calibrate the cameras"]),
    (
        ("check", "cell-size.yaml"),
        CONFIG,
        ["calibration.json", "480x360", "cell-size.yaml", "640x480", "use the calibration of"],
    ),
    (("run", "cell-long.yaml"), CONFIG, ["cell-long.yaml", "stick-80", "0.900", "correct length_m"]),
    (("run", "cell-journal.yaml"), CONFIG, ["part.yaml/journal.sqlite", "cannot be written"]),
    (_look("left.png", "small.png"), USAGE, ["left.png is 480x360", "small.png is 480x200"]),
    (_look("left.png", "text.png"), USAGE, ["text.png", "not a picture"]),
    (_look("black.png", "right.png"), USAGE, ["black.png", "black", "limit 16", "check the camera"]),
    (_look("left.png", "saturated.png"), USAGE, ["saturated.png", "saturated", "exposure"]),
    (
        _look("left.png", "right.png", calibration=str(ROOT / "configs/demo/calibration.json")),
        CONFIG,
        ["calibration.json", "640x480", "480x360", "use the calibration of these cameras"],
    ),
    (
        _look("left.png", "right.png", part="part-long.yaml"),
        USAGE,
        ["stick-80", "0.900", "field of view"],
    ),
    (("look", "--config", "cell-frozen.yaml"), USAGE, ["camera.left", "picture 2", "frozen"]),
    (("evaluate", "empty", "--out", "results"), USAGE, ["empty", "no scenes"]),
    (("demo",), USAGE, ["configs/demo/cell.yaml", "not found", "--config"]),
    (("demo", "--speed", "nan"), USAGE, ["--speed", "nan"]),
    (("demo", "--sticks", "many"), USAGE, ["--sticks", "many"]),
    (("dance",), USAGE, ["dance", "run"]),
    (("run",), USAGE, ["CONFIG"]),
    ((), USAGE, ["COMMAND"]),
]

DEVICES: Final[list[Case]] = [
    (("cell", "--world", "gone.yaml"), CONFIG, ["gone.yaml", "No such file"]),
    (("cell", "--world", "part.yaml"), CONFIG, ["part.yaml", "tray"]),
    (("cell", "--world", WORLD, "--port", "99999"), USAGE, ["--port", "99999"]),
    (("cell", "--world", WORLD, "--sticks", "-1"), USAGE, ["--sticks", "-1"]),
    (("cell", "--world", WORLD, "--speed", "inf"), USAGE, ["--speed", "inf"]),
    (("cell", "--world", WORLD, "--host", "192.0.2.1"), USAGE, ["192.0.2.1", "cannot listen"]),
    (("plc", "--port", "x"), USAGE, ["--port", "'x'"]),
    (("plc", "--orders", "0"), USAGE, ["--orders", "'0'"]),
    (("plc", "--host", "192.0.2.1"), USAGE, ["192.0.2.1", "cannot listen"]),
    (("plc", "--command-base", "90"), USAGE, ["90", "100", "overlap"]),
    (("plc", "--status-base", "65530"), USAGE, ["65530"]),
    (("plc", "--out", "part.yaml/out.json"), USAGE, ["part.yaml/out.json", "folder that exists"]),
]


def _name(value: object) -> str | None:
    return " ".join(value).replace(str(ROOT), "") if isinstance(value, tuple) else None


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A good cell, and beside it everything that can be wrong."""
    made = tmp_path_factory.mktemp("bad")
    for name in ("left.png", "right.png", "calibration.json", "cell.yaml", "part.yaml"):
        shutil.copy(DATA / name, made)
    good = (made / "cell.yaml").read_text()
    for name, old, new in (
        ("key", "name: drawn", "name: drawn\ncolour: red"),
        ("type", "max_skew_s: 0.04", "max_skew_s: fast"),
        ("lost", "calibration: calibration.json", "calibration: nowhere.json"),
        ("size", "width_px: 480, height_px: 360", "width_px: 640, height_px: 480"),
        ("long", "length_m: 0.080", "length_m: 0.900"),
        ("frozen", "height_px: 360", "height_px: 360, repeat: true"),
        ("journal", "journal: journal.sqlite", "journal: part.yaml/journal.sqlite"),
    ):
        assert old in good, name
        (made / f"cell-{name}.yaml").write_text(good.replace(old, new))
    part = (made / "part.yaml").read_text()
    (made / "part-long.yaml").write_text(part.replace("length_m: 0.080", "length_m: 0.900"))
    left = cv2.imread(str(made / "left.png"))
    assert left is not None
    for name, picture in (
        ("small", left[:200]),
        ("black", np.zeros_like(left)),
        ("saturated", np.full_like(left, 255)),
    ):
        cv2.imwrite(str(made / f"{name}.png"), picture)
    (made / "text.png").write_text("this is no picture")
    (made / "empty").mkdir()
    return made


def _ended(folder: Path, module_and_arguments: tuple[str, ...]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", *module_and_arguments],
        check=False,
        cwd=folder,
        env={"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "HOME": str(folder)},
        capture_output=True,
        text=True,
        timeout=60.0,
    )


def refusal(ended: subprocess.CompletedProcess[str]) -> tuple[int, str]:
    """Exit code and the one line of a command that must refuse; it prints nothing else."""
    assert ended.stdout == ""
    assert "Traceback" not in ended.stderr
    lines = ended.stderr.splitlines()
    assert len(lines) == 1, ended.stderr
    return ended.returncode, lines[0]


@pytest.fixture(scope="module")
def ended(folder: Path) -> dict[tuple[str, ...], subprocess.CompletedProcess[str]]:
    """Every command of the tables, run two at a time because most of it is waiting for imports."""
    commands = [("cell", *arguments) for arguments, _, _ in COMMANDS]
    commands += [(f"drivers.sim.{arguments[0]}", *arguments[1:]) for arguments, _, _ in DEVICES]
    with ThreadPoolExecutor(2) as pool:
        return dict(zip(commands, pool.map(lambda c: _ended(folder, c), commands), strict=True))


@pytest.mark.parametrize(("arguments", "code", "said"), COMMANDS, ids=_name)
def test_a_command_refuses_in_one_line(
    ended: dict[tuple[str, ...], subprocess.CompletedProcess[str]],
    arguments: tuple[str, ...],
    code: int,
    said: list[str],
) -> None:
    got, line = refusal(ended["cell", *arguments])
    assert got == code, line
    assert line.startswith("mikado"), line
    for words in said:
        assert words in line


@pytest.mark.parametrize(("arguments", "code", "said"), DEVICES, ids=_name)
def test_a_simulated_device_refuses_in_one_line(
    ended: dict[tuple[str, ...], subprocess.CompletedProcess[str]],
    arguments: tuple[str, ...],
    code: int,
    said: list[str],
) -> None:
    got, line = refusal(ended[f"drivers.sim.{arguments[0]}", *arguments[1:]])
    assert got == code, line
    for words in said:
        assert words in line


@pytest.mark.parametrize("device", [("cell", "--world", WORLD), ("plc",)], ids=["cell", "plc"])
def test_a_port_in_use_is_named(folder: Path, device: tuple[str, ...]) -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as taken:
        port = str(taken.getsockname()[1])
        code, line = refusal(_ended(folder, (f"drivers.sim.{device[0]}", *device[1:], "--port", port)))
    assert code == USAGE
    assert port in line
    assert "in use" in line
    assert "--port" in line


def test_a_summary_is_not_written_over_a_folder(folder: Path) -> None:
    code, line = refusal(_ended(folder, ("drivers.sim.plc", "--out", "empty")))
    assert code == USAGE
    assert "--out empty" in line
