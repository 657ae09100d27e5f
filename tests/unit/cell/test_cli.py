"""The command `mikado`: exit codes, and one line on stderr for whatever a person can put right."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from cell.cli import main
from drivers.types import Pixels
from tests.fakes.station import DATA

REPOSITORY = Path(__file__).parents[3]
FILES = {
    "--left": str(DATA / "left.png"),
    "--right": str(DATA / "right.png"),
    "--calibration": str(DATA / "calibration.json"),
    "--product": str(DATA / "part.yaml"),
}


def look(out: Path, *more: str, **changed: str | None) -> list[str]:
    """Arguments of a look at the drawn pair; ``left=None`` leaves one out."""
    files = {**FILES, **{f"--{key}": value for key, value in changed.items()}}
    given = [word for name, value in files.items() if value is not None for word in (name, value)]
    return ["look", *given, "--out", str(out), *more]


def failed(capsys: pytest.CaptureFixture[str]) -> str:
    """The one line on stderr."""
    caught = capsys.readouterr()
    assert caught.out == ""
    assert caught.err.startswith("mikado: ")
    assert caught.err.count("\n") == 1
    return caught.err


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A copy of the drawn cell that a test may spoil."""
    for name in ("cell.yaml", "calibration.json", "left.png", "right.png", "part.yaml"):
        shutil.copy(DATA / name, tmp_path)
    return tmp_path


def spoiled(path: Path, old: str, new: str) -> Path:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    return path


# ------------------------------------------------------------------------------ check


def test_a_good_configuration_is_told_good(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(DATA / "cell.yaml")]) == 0
    said = capsys.readouterr().out
    assert f"{DATA / 'cell.yaml'}: good. Cell drawn, 2 part(s)" in said
    assert "(units m, as stated)" in said


def test_checking_opens_no_device_and_needs_no_detector() -> None:
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            "import sys; from cell.cli import main; code = main(['check', sys.argv[1]]);"
            "heavy = ('vision.locate', 'vision.default', 'pymodbus', 'drivers.sim.', 'drivers.camera.');"
            "loaded = sorted(m for m in sys.modules if (m + '.').startswith(heavy));"
            "print(loaded, file=sys.stderr); sys.exit(code)",
            str(DATA / "cell.yaml"),
        ],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        cwd=REPOSITORY,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr.strip() == "[]"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("mount: fixed", "mount: fixed\n  colour: red", "cell.yaml:9: cameras.colour: unknown key"),
        ("port: 5020", "port: 70000", "plc.port: Input should be less than or equal to 65535"),
        ("port: 5020", "port: modbus", "plc.port: Input should be a valid integer"),
        (
            "name: drawn",
            "name: drawn\nname: twice",
            "cell.yaml:4: not readable as YAML: key 'name' is given twice",
        ),
        ("version: 1", "version: [", "not readable as YAML"),
        ("max_skew_s: 0.04\n  ", "", "cameras.max_skew_s: is missing"),
        (
            "length_m: 0.120",
            "length_m: 0.900",
            "length_m 0.900 is longer than the field of view",
        ),
        ("calibration: calibration.json", "calibration: none.json", "none.json: calibration file not found"),
    ],
)
def test_a_wrong_configuration_is_code_78_and_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, said: str
) -> None:
    path = spoiled(folder / "cell.yaml", old, new)
    assert main(["check", str(path)]) == 78
    assert said in failed(capsys)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"K1"', '"K9"', "calibration.json: K1 is missing"),
        (
            '"image_width": 480',
            '"image_width": 640',
            "made for left pictures of 640x360 px, but the cameras of",
        ),
        ('"units": "m"', '"units": "mm"', "baseline of 6e-05 m is outside"),
        ('"base_from_camera"', '"hand_eye"', "base_from_camera is missing; do the hand-eye calibration"),
        ("{", "", "not readable as JSON"),
    ],
)
def test_a_wrong_calibration_is_code_78_and_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, said: str
) -> None:
    spoiled(folder / "calibration.json", old, new)
    assert main(["check", str(folder / "cell.yaml")]) == 78
    assert said in failed(capsys)


@pytest.mark.parametrize("command", ["check", "run"])
def test_the_daemon_and_the_check_refuse_a_file_in_the_same_words(
    folder: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    path = spoiled(folder / "cell.yaml", "max_skew_s: 0.04", "max_skew_s: -1")
    assert main([command, str(path)]) == 78
    assert failed(capsys) == (
        f"mikado: {path}:7: cameras.max_skew_s: Input should be greater than 0, found -1\n"
    )


def test_a_missing_configuration_is_code_78(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(tmp_path / "none.yaml")]) == 78
    assert "none.yaml: cannot be read: No such file or directory" in failed(capsys)


# ------------------------------------------------------------------------------ look


def test_a_look_writes_overlay_and_document(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(look(tmp_path / "out")) == 0
    assert (tmp_path / "out" / "overlay.png").stat().st_size > 1000
    document = json.loads((tmp_path / "out" / "look.json").read_text())
    assert any(candidate["offered"] for candidate in document["candidates"])
    assert "offered" in capsys.readouterr().out


@pytest.mark.parametrize("method", ["default", "published"])
def test_both_methods_can_be_asked_for(tmp_path: Path, method: str) -> None:
    assert main(look(tmp_path / "out", "--method", method)) == 0
    document = json.loads((tmp_path / "out" / "look.json").read_text())
    assert document["method"] == method


@pytest.mark.parametrize("missing", ["left", "right", "calibration", "product"])
def test_a_look_says_what_it_needs(tmp_path: Path, capsys: pytest.CaptureFixture[str], missing: str) -> None:
    assert main(look(tmp_path / "out", **{missing: None})) == 2
    assert failed(capsys) == f"mikado: look needs --{missing} (or --config FILE for the configured cameras)\n"


def test_a_look_takes_files_or_cameras_and_not_both(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(look(tmp_path / "out", "--config", str(DATA / "cell.yaml"))) == 2
    assert "leave out --left, --right, --calibration, --product" in failed(capsys)


def black() -> Pixels:
    return np.zeros((360, 480), dtype=np.uint8)


@pytest.mark.parametrize(
    ("picture", "said"),
    [
        (None, "odd.png: no such file"),
        (b"hello", "odd.png: not a picture OpenCV can read"),
        (black(), "odd.png: picture is black"),
        (np.full_like(black(), 255), "odd.png: picture is saturated"),
        (np.full((240, 320), 90, dtype=np.uint8), "pictures differ in size"),
    ],
    ids=["missing", "no picture", "black", "saturated", "another size"],
)
def test_an_unusable_picture_is_code_2_and_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], picture: Pixels | bytes | None, said: str
) -> None:
    path = tmp_path / "odd.png"
    if isinstance(picture, bytes):
        path.write_bytes(picture)
    elif picture is not None:
        path.write_bytes(cv2.imencode(".png", picture)[1].tobytes())
    assert main(look(tmp_path / "out", right=str(path))) == 2
    assert said in failed(capsys)
    assert not (tmp_path / "out").exists()


def test_the_same_picture_for_both_eyes_is_code_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(look(tmp_path / "out", right=FILES["--left"])) == 2
    assert "hold the same picture" in failed(capsys)


def test_a_look_with_a_wrong_product_is_code_78(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    part = spoiled(folder / "part.yaml", "diameter_m: 0.004", "diameter_mm: 4")
    assert main(look(folder / "out", product=str(part))) == 78
    assert "diameter_mm: unknown key" in failed(capsys)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--band", "200", "100"], "--band: min 200 is not below max 100"),
        (["--depth-m", "0.5", "0.5"], "--depth-m: min 0.5 is not below max 0.5"),
    ],
)
def test_a_range_the_wrong_way_round_is_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    assert main(look(tmp_path / "out", *words)) == 2
    assert said in failed(capsys)


def test_cameras_that_cannot_be_opened_are_code_1(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = spoiled(folder / "cell.yaml", 'pattern: "left*.png"', 'pattern: "west*.png"')
    assert main(["look", "--config", str(path), "--out", str(folder / "out")]) == 1
    assert "camera.left" in failed(capsys)


# ------------------------------------------------------------------------------ usage


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "COMMAND"),
        (["pick"], "invalid choice: 'pick'"),
        (["check"], "CONFIG"),
        (["look", "--band", "300", "400"], "300 is not a grey value 0..255"),
        (["look", "--depth-m", "-1", "0"], "-1"),
        (["look", "--method", "magic"], "invalid choice: 'magic'"),
        (["look", "--out"], "expected one argument"),
    ],
)
def test_a_command_line_that_makes_no_sense_is_code_2(
    capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 2
    assert said in capsys.readouterr().err


def test_the_version_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith("mikado ")


def test_a_journal_that_cannot_be_written_is_code_78(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = spoiled(folder / "cell.yaml", "journal: journal.sqlite", "journal: part.yaml/journal.sqlite")
    assert main(["run", str(path)]) == 78
    assert "part.yaml/journal.sqlite: the journal cannot be written" in capsys.readouterr().err


def test_scenes_that_are_not_there_are_code_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", str(tmp_path), "--out", str(tmp_path / "results")]) == 2
    assert "no scenes here" in failed(capsys)
