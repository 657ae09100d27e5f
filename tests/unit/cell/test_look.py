"""One look without motion: what is refused before it, and what its document says."""

from __future__ import annotations

import io
import json
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NoReturn, TypeAlias

import cv2
import numpy as np
import pytest
from rich.console import Console

from cell import calibration, config
from cell.commission import look, told
from cell.commission.sight import Sight
from cell.errors import CalibrationError, UsageError
from cell.faults import PictureUnusable
from drivers.types import Pixels
from tests.data.make import CAMERA_BASE_M, FLOOR_Z_M, LENGTH_M, ends_base_m
from tests.fakes.station import DATA
from vision.locate import locate
from vision.types import Scene, Tuning

Json: TypeAlias = "dict[str, Json] | list[Json] | str | float | int | bool | None"
LEFT, RIGHT = DATA / "left.png", DATA / "right.png"
CALIBRATION, PART = DATA / "calibration.json", DATA / "part.yaml"


def sight(
    left: Path = LEFT,
    right: Path = RIGHT,
    calibration_path: Path = CALIBRATION,
    part: Path = PART,
    tuning: Tuning | None = None,
) -> Sight:
    return look.from_files(left, right, calibration_path, part, tuning or Tuning())


def saved(path: Path, picture: Pixels) -> Path:
    done, encoded = cv2.imencode(".png", picture)
    assert done
    path.write_bytes(encoded.tobytes())
    return path


def grey() -> Pixels:
    picture = cv2.imread(str(LEFT), cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    return np.asarray(picture, dtype=np.uint8)


def changed(tmp_path: Path, **changes: Json) -> Path:
    """The calibration with some entries changed, None to leave one out."""
    fields = json.loads(CALIBRATION.read_text())
    for key, value in changes.items():
        if value is None:
            del fields[key]
        else:
            fields[key] = value
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(fields))
    return path


def said(error: pytest.ExceptionInfo[Exception]) -> str:
    assert "\n" not in str(error.value)
    return str(error.value)


# ------------------------------------------------------------------------------ refusals


def test_a_missing_picture_is_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError) as error:
        sight(left=tmp_path / "none.png")
    assert said(error) == f"{tmp_path / 'none.png'}: no such file"


@pytest.mark.parametrize("content", [b"", b"hello", b"\x89PNG\r\n\x1a\n broken"])
def test_a_file_that_is_no_picture_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "odd.png"
    path.write_bytes(content)
    with pytest.raises(UsageError) as error:
        sight(right=path)
    assert said(error).startswith(f"{path}: not a picture OpenCV can read")


def test_pictures_of_two_sizes_are_told_with_both(tmp_path: Path) -> None:
    small = saved(tmp_path / "small.png", cv2.resize(grey(), (240, 180)).astype(np.uint8))
    with pytest.raises(UsageError) as error:
        sight(right=small)
    assert f"{LEFT} is 480x360 px, {small} is 240x180 px" in said(error)


def test_pictures_of_another_size_than_the_calibration_are_refused(tmp_path: Path) -> None:
    big = saved(tmp_path / "big.png", cv2.resize(grey(), (960, 720)).astype(np.uint8))
    with pytest.raises(CalibrationError) as error:
        sight(left=big, right=big)
    assert "made for left pictures of 480x360 px" in said(error)
    assert "are 960x720" in said(error)


def test_the_same_picture_twice_is_refused(tmp_path: Path) -> None:
    copied = Path(shutil.copy(LEFT, tmp_path / "copy.png"))
    with pytest.raises(UsageError, match="hold the same picture; give the left and the right one"):
        sight(right=copied)


@pytest.mark.parametrize(
    ("level", "word"), [(2, "black"), (255, "saturated"), (90, "without contrast")], ids=str
)
def test_an_unusable_picture_names_its_file_and_flaw(tmp_path: Path, level: int, word: str) -> None:
    path = saved(tmp_path / "odd.png", np.full((360, 480), level, dtype=np.uint8))
    with pytest.raises(PictureUnusable) as error:
        sight(left=path)
    assert said(error).startswith(f"{path}: picture is {word}")


def test_without_a_table_the_distance_has_to_be_given(tmp_path: Path) -> None:
    bare = changed(tmp_path, table_normal=None)
    with pytest.raises(
        UsageError, match=r"does not say where the table is; give the distance .* --depth-m MIN MAX"
    ):
        sight(calibration_path=bare)
    assert sight(calibration_path=bare, tuning=Tuning(depth_m=(0.25, 0.35))).table is None


def test_a_camera_that_looks_along_the_table_is_a_calibration_error(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="camera and table do not fit"):
        sight(calibration_path=changed(tmp_path, table_normal=[0.0, -1.0, 0.0]))


def test_swapped_cameras_are_told_before_anything_is_looked_at(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="left and right camera are swapped"):
        sight(calibration_path=changed(tmp_path, T=[0.06, 0.0, 0.0]))


@pytest.mark.parametrize("depth_m", [None, (0.25, 0.30)])
def test_a_product_longer_than_the_view_is_told_with_both_lengths(
    tmp_path: Path, depth_m: tuple[float, float] | None
) -> None:
    part = tmp_path / "part.yaml"
    part.write_text(PART.read_text().replace("length_m: 0.080", "length_m: 0.800"))
    with pytest.raises(UsageError) as error:
        sight(part=part, tuning=Tuning(depth_m=depth_m))
    view = 0.3 if depth_m else CAMERA_BASE_M[2] - FLOOR_Z_M + 0.005
    diagonal = math.hypot(480 / 430 * view, 360 / 430 * view)
    assert f"length_m 0.800 is longer than the field of view ({diagonal:.3f} m" in said(error)


# ------------------------------------------------------------------------------ the document


def looked(of: Sight, out: Path) -> tuple[dict[str, Json], str]:
    text = io.StringIO()
    assert look.look(of, out, Console(file=text, width=200)) == 0
    document = json.loads((out / "look.json").read_text(), parse_constant=_no_constant)
    assert isinstance(document, dict)
    return document, text.getvalue()


def _no_constant(name: str) -> NoReturn:
    raise AssertionError(f"{name} is not JSON")


def candidates(document: dict[str, Json]) -> list[dict[str, Json]]:
    entries = document["candidates"]
    assert isinstance(entries, list)
    return [entry for entry in entries if isinstance(entry, dict)]


def points(entry: dict[str, Json], *keys: str) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.array([entry[key] for key in keys], dtype=np.float64)


def test_every_drawn_stick_is_in_the_document_where_it_was_drawn(tmp_path: Path) -> None:
    document, _ = looked(sight(), tmp_path / "out")
    found = candidates(document)
    assert len(found) == len(ends_base_m())
    for ends in ends_base_m():
        gaps = [
            min(
                np.abs(points(entry, "start_base_m", "end_base_m") - order).max()
                for order in (ends, ends[::-1])
            )
            for entry in found
        ]
        assert min(gaps) < 0.0015, "an end is off by more than 1.5 mm"
    for entry in found:
        assert entry["length_m"] == pytest.approx(LENGTH_M, abs=0.001)


def test_the_document_names_its_frame_units_files_and_times(tmp_path: Path) -> None:
    document, _ = looked(sight(), tmp_path / "out")
    assert document["version"] == told.FORMAT_VERSION
    assert document["frame"] == "raw left camera, metres; x right, y down, z forward"
    assert document["calibration"] == {"file": str(CALIBRATION), "units": "m, as stated"}
    assert document["part"] == {"code": 1, "name": "stick-80", "length_m": 0.08}
    views = document["views"]
    assert isinstance(views, dict)
    left = views["left"]
    assert isinstance(left, dict)
    assert left["picture"] == str(LEFT)
    assert document["durations_s"]


def test_the_document_says_how_sure_it_is_and_what_lies_on_what(tmp_path: Path) -> None:
    document, printed = looked(sight(), tmp_path / "out")
    for entry in candidates(document):
        assert 0 < points(entry, "sigma_m")[0] < 0.005
        assert 0 < points(entry, "sigma_rad")[0] < 0.1
    crossings = document["crossings"]
    assert isinstance(crossings, list)
    orders = {entry["order"] for entry in candidates(document)}
    for crossing in crossings:
        assert isinstance(crossing, dict)
        assert crossing["above"] in orders
        assert crossing["below"] in orders
    assert document["row_offset_px"] == 0.0
    assert "± mm" in printed
    assert "rows of the right picture" not in printed


def test_rows_that_had_to_be_corrected_are_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def corrected(*arguments: object, **named: object) -> Scene:
        return replace(locate(*arguments, **named), row_offset_px=-1.7)  # type: ignore[arg-type]  # passed on

    monkeypatch.setattr(look, "locate", corrected)
    document, printed = looked(sight(), tmp_path / "out")
    assert document["row_offset_px"] == -1.7
    assert "the rows of the right picture are -1.70 px off the calibration" in printed


def test_every_refusal_has_a_name_a_number_and_a_limit(tmp_path: Path) -> None:
    part = tmp_path / "part.yaml"
    part.write_text(PART.read_text().replace("length_m: 0.080", "length_m: 0.070"))
    document, printed = looked(sight(part=part), tmp_path / "out")
    refusals = [r for entry in candidates(document) for r in _list(entry["refusals"])]
    assert refusals
    for refusal in refusals:
        assert isinstance(refusal, dict)
        assert set(refusal) == {"reason", "value", "limit", "unit"}
    assert not any(entry["offered"] for entry in candidates(document))
    assert "0 offered" in printed
    assert "mm (limit" in printed


def _list(value: Json) -> list[Json]:
    assert isinstance(value, list)
    return value


def test_an_empty_table_is_no_error(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    bright = np.linspace(60, 120, 480)[None, :]  # a lamp at one side
    empty = [
        saved(tmp_path / f"{eye}.png", (bright + rng.normal(0, 2, (360, 480))).astype(np.uint8))
        for eye in ("left", "right")
    ]
    document, printed = looked(sight(left=empty[0], right=empty[1]), tmp_path / "out")
    assert not any(entry["offered"] for entry in candidates(document))
    assert printed.count("0 offered") == 1


def test_the_overlay_is_a_picture_at_least_as_large_as_the_view(tmp_path: Path) -> None:
    looked(sight(), tmp_path / "out")
    overlay = cv2.imread(str(tmp_path / "out" / "overlay.png"))
    assert overlay is not None
    assert overlay.shape[1] >= 480


def test_a_folder_that_cannot_be_made_is_told(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")
    with pytest.raises(UsageError, match="out: cannot be written: File exists"):
        look.look(sight(), tmp_path / "out", Console(file=io.StringIO()))


def test_what_is_printed_keeps_a_long_path_in_one_piece(tmp_path: Path) -> None:
    out = tmp_path / ("a-long-name" * 8) / "[bold]"
    text = io.StringIO()
    look.look(sight(), out, Console(file=text, width=80))
    assert str(out / "look.json") in text.getvalue()


# ------------------------------------------------------------------------------ through cameras


@pytest.fixture
def recorded(tmp_path: Path) -> Callable[[int], Path]:
    """A cell whose cameras replay ``count`` pairs of the drawn scene, each with its own noise."""

    def make(count: int) -> Path:
        rng = np.random.default_rng(5)
        for eye in ("left", "right"):
            picture = cv2.imread(str(DATA / f"{eye}.png"), cv2.IMREAD_GRAYSCALE)
            assert picture is not None
            for n in range(count):
                noisy = np.clip(picture.astype(np.int16) + rng.integers(-1, 2, picture.shape), 0, 255)
                saved(tmp_path / f"{eye}-{n}.png", noisy.astype(np.uint8))
        for name in ("cell.yaml", "calibration.json"):
            shutil.copy(DATA / name, tmp_path)
        return tmp_path / "cell.yaml"

    return make


def test_a_look_through_the_cameras_plans_grasps_and_moves_nothing(
    tmp_path: Path, recorded: Callable[[int], Path]
) -> None:
    # nobody listens at the configured arm, gripper and PLC: a look does not ask them
    document, _ = looked(look.from_cameras(recorded(3), None, None), tmp_path / "out")
    offered = [entry for entry in candidates(document) if entry["offered"]]
    assert offered
    settings = config.load(tmp_path / "cell.yaml")
    known = calibration.load(tmp_path / "calibration.json")
    assert known.base_from_camera is not None
    for entry in offered:
        x, y, z, *_ = (float(v) for v in points(entry, "grasp_base")[0])
        middle = points(entry, "start_base_m", "end_base_m").mean(axis=0)
        assert math.hypot(x - middle[0], y - middle[1]) <= 0.25 * LENGTH_M + 0.001
        assert settings.workspace.floor_z_m < z < 0.05


def test_a_lone_part_has_room_without_end_and_that_is_null(tmp_path: Path) -> None:
    alone = sight()
    settings = config.load(DATA / "cell.yaml")
    with_robot = replace(alone, config=settings)
    # cover all but the first stick with the table's grey and a sensor's noise
    kept = [np.array(p) for p in (alone.left, alone.right)]
    rng = np.random.default_rng(3)
    for picture in kept:
        table = (np.median(picture) + rng.normal(0, 2, picture.shape)).astype(np.uint8)
        picture[:, 210:] = table[:, 210:]
        picture[:170] = table[:170]
    document, _ = looked(replace(with_robot, left=kept[0], right=kept[1]), tmp_path / "out")
    rooms = [entry["clearance_m"] for entry in candidates(document) if "clearance_m" in entry]
    assert rooms == [None]


def test_an_unknown_part_is_told_with_those_there_are(recorded: Callable[[int], Path]) -> None:
    with pytest.raises(UsageError, match="has no part with code 9; it has 1, 2"):
        look.from_cameras(recorded(2), 9, None)


def test_a_camera_that_repeats_its_picture_is_frozen(tmp_path: Path, recorded: Callable[[int], Path]) -> None:
    path = recorded(1)
    for eye in ("left", "right"):
        shutil.copy(tmp_path / f"{eye}-0.png", tmp_path / f"{eye}-1.png")
    with pytest.raises(PictureUnusable, match=r"camera\.left: picture 2 is bit for bit the same"):
        look.from_cameras(path, None, None)
