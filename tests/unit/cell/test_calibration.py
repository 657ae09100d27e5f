"""One set of numbers in every form a calibration file may have gives one model, in metres."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeAlias

import cv2
import numpy as np
import pytest

from cell import calibration
from cell.calibration import Calibration
from cell.errors import CalibrationError
from vision import transforms
from vision.types import Floats

Number: TypeAlias = "int | float | str | list[Number] | dict[str, Number] | None"
Fields: TypeAlias = dict[str, Number]

K1 = np.array([[571.6, 0.0, 314.2], [0.0, 572.4, 246.9], [0.0, 0.0, 1.0]])
K2 = np.array([[566.9, 0.0, 329.7], [0.0, 568.3, 233.8], [0.0, 0.0, 1.0]])
D1 = np.array([-0.095, 0.031, -0.0009, 0.0006, 0.004])
D2 = np.array([-0.118, 0.066, 0.0008, 0.001, -0.016])
R = transforms.matrix_from_vector(np.array([-0.025, 0.082, 0.019]))
T_M = np.array([-0.0745, -0.0026, 0.0056])
BASE = np.eye(4)
BASE[:3, :3] = transforms.matrix_from_vector(np.array([3.1, 0.05, 0.02]))
BASE[:3, 3] = [-0.04, -0.5, 0.43]
NORMAL = transforms.matrix_from_vector(np.array([0.02, 0.03, 0.0])) @ np.array([0.0, 0.0, -1.0])
OFFSET_M = 0.41


def rows(array: Floats) -> Number:
    plain: Number = array.tolist()
    return plain


def own(scale: float = 1.0, units: str | None = "m") -> Fields:
    """Mikado's own form; lengths times ``scale``."""
    pose = BASE.copy()
    pose[:3, 3] *= scale
    fields: Fields = {
        "version": 1,
        "image_width": 640,
        "image_height": 480,
        "K1": rows(K1),
        "D1": rows(D1),
        "K2": rows(K2),
        "D2": rows(D2),
        "R": rows(R),
        "T": rows(T_M * scale),
        "base_from_camera": rows(pose),
        "table_normal": rows(NORMAL),
        "table_offset": OFFSET_M * scale,
        "rms_px": 0.21,
        "cameras": {"left": "cam-a", "right": "cam-b"},
    }
    if units is not None:
        fields["units"] = units
    return fields


def rig() -> Fields:
    """The form of rendered rigs, in millimetres."""
    pose = BASE.copy()
    pose[:3, 3] *= 1000.0
    return {
        "units": "mm",
        "image_size": [640, 480],
        "left": {"K": rows(K1), "dist": rows(D1)},
        "right": {"K": rows(K2), "dist": rows(D2)},
        "R": rows(R),
        "T": rows(T_M * 1000.0),
        "T_base_cam": rows(pose),
        "table_plane_leftcam": {"normal": rows(NORMAL), "d": OFFSET_M * 1000.0},
        "rms_px": 0.21,
        "cameras": {"left": "cam-a", "right": "cam-b"},
    }


def write_json(path: Path, fields: Fields) -> Path:
    path.write_text(json.dumps(fields))
    return path


def write_opencv(path: Path, fields: Fields) -> Path:
    """As ``cv2.FileStorage`` writes it, YAML or JSON by the name of the file."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in fields.items():
        if key == "base_from_camera":
            storage.write("T_base_cam", np.array(value, dtype=np.float64))
        elif isinstance(value, list):
            storage.write(key, np.array(value, dtype=np.float64))
        elif isinstance(value, dict):
            storage.startWriteStruct(key, cv2.FileNode_MAP)
            for name, text in value.items():
                assert isinstance(text, str)
                storage.write(name, text)
            storage.endWriteStruct()
        elif isinstance(value, int | float | str):
            storage.write(key, value)
    storage.release()
    return path


def require_the_numbers(known: Calibration) -> None:
    np.testing.assert_allclose(known.stereo.left.matrix, K1)
    np.testing.assert_allclose(known.stereo.left.distortion, D1)
    np.testing.assert_allclose(known.stereo.right.matrix, K2)
    np.testing.assert_allclose(known.stereo.right.distortion, D2)
    assert (known.stereo.left.width_px, known.stereo.left.height_px) == (640, 480)
    assert (known.stereo.right.width_px, known.stereo.right.height_px) == (640, 480)
    np.testing.assert_allclose(known.stereo.right_from_left.rotation, R, atol=1e-12)
    np.testing.assert_allclose(known.stereo.right_from_left.translation, T_M, rtol=1e-12)
    assert known.base_from_camera is not None
    np.testing.assert_allclose(known.base_from_camera.rotation, BASE[:3, :3], atol=1e-12)
    np.testing.assert_allclose(known.base_from_camera.translation, BASE[:3, 3], rtol=1e-12)
    assert known.table is not None
    np.testing.assert_allclose(known.table.normal, NORMAL)
    assert known.table.offset_m == pytest.approx(OFFSET_M)
    assert known.stereo.rms_px == 0.21
    assert known.cameras == ("cam-a", "cam-b")


@pytest.mark.parametrize(
    "write",
    [
        lambda folder: write_json(folder / "own.json", own()),
        lambda folder: write_json(folder / "own-mm.json", own(1000.0, "mm")),
        lambda folder: write_json(folder / "rig.json", rig()),
        lambda folder: write_opencv(folder / "opencv.yaml", own()),
        lambda folder: write_opencv(folder / "opencv.yml", own(1000.0, "mm")),
        lambda folder: write_opencv(folder / "opencv.json", own()),
        lambda folder: write_opencv(folder / "opencv-bare.yaml", own(1000.0, None)),
    ],
    ids=["own", "own mm", "rig", "opencv yaml", "opencv yml mm", "opencv json", "opencv without units"],
)
def test_every_form_gives_the_same_model_in_metres(tmp_path: Path, write: Callable[[Path], Path]) -> None:
    require_the_numbers(calibration.load(write(tmp_path)))


@pytest.mark.parametrize("name", ["c.json", "c.yaml"])
def test_without_hand_eye_and_table_both_are_unknown(tmp_path: Path, name: str) -> None:
    fields = {k: v for k, v in own().items() if k[:5] not in ("base_", "table", "rms_p", "camer")}
    write = write_json if name.endswith("json") else write_opencv
    known = calibration.load(write(tmp_path / name, fields))
    assert known.base_from_camera is None
    assert known.table is None
    assert known.cameras is None
    assert np.isnan(known.stereo.rms_px)


def test_lists_in_an_opencv_file_are_read_like_matrices(tmp_path: Path) -> None:
    path = write_opencv(tmp_path / "c.yaml", {k: v for k, v in own().items() if k != "D1"})
    path.write_text(path.read_text() + f"D1: [ {', '.join(str(v) for v in D1)} ]\n")
    np.testing.assert_allclose(calibration.load(path).stereo.left.distortion, D1)


# ------------------------------------------------------------------------------ units


@pytest.mark.parametrize(
    ("scale", "units", "said"),
    [
        (1.0, "m", "m, as stated"),
        (1000.0, "mm", "mm, as stated"),
        (1.0, None, "m, from a baseline of 0.07"),
        (1000.0, None, "mm, from a baseline of 74.76"),
    ],
)
def test_units_are_stated_or_seen_from_the_baseline(
    tmp_path: Path, scale: float, units: str | None, said: str
) -> None:
    known = calibration.load(write_json(tmp_path / "c.json", own(scale, units)))
    assert known.units.startswith(said)
    np.testing.assert_allclose(known.stereo.right_from_left.translation, T_M, rtol=1e-12)


@pytest.mark.parametrize(
    ("scale", "units", "said"),
    [
        (1000.0, "m", "baseline of 74.76 m is outside 0.01 to 2.0 m; are the units right"),
        (1.0, "mm", "baseline of 7.476e-05 m is outside"),
        (50.0, None, "T is 3.738 long, which is no baseline of a rig in metres or millimetres"),
        (1e5, None, "no baseline of a rig"),
        (0.0, None, "T is 0 long"),
        (1.0, "inch", "units 'inch'; m or mm is expected"),
    ],
)
def test_a_baseline_that_cannot_be_is_refused(
    tmp_path: Path, scale: float, units: str | None, said: str
) -> None:
    assert said in refused(write_json(tmp_path / "c.json", own(scale, units)))


# ------------------------------------------------------------------------------ refusals


def refused(path: Path) -> str:
    with pytest.raises(CalibrationError) as caught:
        calibration.load(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return message


def changed(**changes: Number) -> Fields:
    fields = copy.deepcopy(own())
    for key, value in changes.items():
        if value is None:
            del fields[key]
        else:
            fields[key] = value
    return fields


def tilted(matrix: Floats, by: float) -> Number:
    wrong = matrix.copy()
    wrong[0, 1] += by
    return rows(wrong)


def test_a_missing_file_says_what_to_do(tmp_path: Path) -> None:
    assert "calibration file not found; calibrate the cameras first" in refused(tmp_path / "none.json")


@pytest.mark.parametrize("key", ["K1", "D1", "K2", "D2", "R", "T", "image_width", "image_height"])
@pytest.mark.parametrize("form", ["json", "yaml"])
def test_a_missing_entry_is_named(tmp_path: Path, key: str, form: str) -> None:
    fields = changed(**{key: None})
    write = write_json if form == "json" else write_opencv
    assert f"{key} is missing" in refused(write(tmp_path / f"c.{form}", fields))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"K1": [[570.0, 0.0], [0.0, 570.0]]}, "K1 has 4 numbers, expected 9"),
        ({"K1": rows(-K1)}, "K1 is no camera matrix"),
        ({"K2": rows(K2 * 2)}, "K2 is no camera matrix"),
        ({"K1": "sharp"}, "K1 is not a matrix of numbers"),
        ({"K1": [[1.0, 2.0], [3.0]]}, "K1 is not a matrix of numbers"),
        ({"K1": rows(np.full((3, 3), np.nan))}, "K1 holds a number that is not finite"),
        ({"D1": [0.1, 0.2, 0.3]}, "3 distortion numbers beside K1; 4, 5, 8, 12 or 14"),
        ({"T": [0.07, 0.0]}, "T has 2 numbers, expected 3"),
        ({"R": tilted(R, 0.01)}, "the rotation in R is none (off by 0.0"),
        ({"R": rows(R * [1, 1, -1])}, "the rotation in R is none"),
        ({"R": rows(np.zeros((3, 3)))}, "the rotation in R is none"),
        ({"base_from_camera": tilted(BASE, 0.01)}, "the rotation in T_base_cam is none"),
        ({"base_from_camera": rows(BASE.T)}, "the last row of T_base_cam is not 0 0 0 1; is it transposed?"),
        ({"base_from_camera": rows(BASE[:3])}, "T_base_cam has 12 numbers, expected 16"),
        ({"table_normal": [0.0, 0.0, -2.0]}, "table_normal is not of length 1"),
        ({"table_offset": None}, "table_offset is missing"),
        ({"image_width": 0}, "image size 0x480 is not possible"),
        ({"image_width": "wide"}, "image_width is missing or not a number"),
        ({"T": rows(-T_M)}, "left and right camera are swapped"),
        ({"T": [0.0, 0.07, 0.0]}, "cameras stand above each other"),
    ],
)
def test_a_wrong_entry_is_named(tmp_path: Path, changes: Fields, said: str) -> None:
    assert said in refused(write_json(tmp_path / "c.json", changed(**changes)))


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("c.json", "", "not readable as JSON"),
        ("c.json", "{", "not readable as JSON"),
        ("c.json", "[1]", "a JSON object is expected"),
        ("c.json", "\x00\xff", "not readable as JSON"),
        ("c.yaml", "", "not readable as an OpenCV calibration file"),
        ("c.yaml", "K1: [1, 2", "not readable as an OpenCV calibration file"),
        ("c.yaml", "hello", "not readable as an OpenCV calibration file"),
        ("c.yaml", "%YAML:1.0\n---\nimage_width: 640\n", "image_height is missing"),
    ],
)
def test_what_is_no_calibration_file_is_said(tmp_path: Path, name: str, content: str, said: str) -> None:
    path = tmp_path / name
    path.write_bytes(content.encode("latin-1"))
    assert said in refused(path)


def test_a_matrix_with_too_few_numbers_in_an_opencv_file_is_named(tmp_path: Path) -> None:
    path = write_opencv(tmp_path / "c.yaml", own())
    path.write_text(path.read_text().replace("rows: 3\n   cols: 3", "rows: 3\n   cols: 4", 1))
    assert "K1 is not a matrix of numbers" in refused(path)


@pytest.mark.parametrize("digits", [4, 5, 6])
def test_a_rotation_rounded_for_printing_is_made_exact(tmp_path: Path, digits: int) -> None:
    pose = BASE.copy()
    pose[:3, :3] = np.round(pose[:3, :3], digits)
    fields = changed(R=rows(np.round(R, digits)), base_from_camera=rows(pose))
    known = calibration.load(write_json(tmp_path / "c.json", fields))
    assert known.base_from_camera is not None
    for rotation in (known.stereo.right_from_left.rotation, known.base_from_camera.rotation):
        assert np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-12
    transforms.invert(known.base_from_camera)  # the detector's own check


# ------------------------------------------------------------------------------ fitting


def loaded(tmp_path: Path) -> Calibration:
    return calibration.load(write_json(tmp_path / "c.json", own()))


def test_pictures_of_another_size_are_refused_with_both_sizes(tmp_path: Path) -> None:
    known = loaded(tmp_path)
    calibration.fit(known, 640, 480, "these")
    with pytest.raises(
        CalibrationError, match="made for left pictures of 640x480 px, but these are 1280x960"
    ):
        calibration.fit(known, 1280, 960, "these")


@pytest.mark.parametrize("point_base", [(0.1, -0.4, 0.02), (-0.2, -0.6, 0.07), (0.0, 0.0, -0.05)])
def test_the_table_measures_heights_above_the_robots_floor(
    tmp_path: Path, point_base: Sequence[float]
) -> None:
    known = loaded(tmp_path)
    assert known.base_from_camera is not None
    table = calibration.table_of(known, 0.02)
    in_camera = transforms.apply(transforms.invert(known.base_from_camera), np.array(point_base))
    assert float(table.normal @ in_camera) + table.offset_m == pytest.approx(point_base[2] - 0.02)


def test_without_hand_eye_there_is_no_table_of_the_robot(tmp_path: Path) -> None:
    known = calibration.load(write_json(tmp_path / "c.json", changed(base_from_camera=None)))
    with pytest.raises(CalibrationError, match="base_from_camera is missing; do the hand-eye calibration"):
        calibration.table_of(known, 0.02)


def test_a_camera_that_looks_away_from_the_table_is_a_calibration_error(tmp_path: Path) -> None:
    upwards = BASE.copy()
    upwards[:3, :3] = np.eye(3)
    known = calibration.load(write_json(tmp_path / "c.json", changed(base_from_camera=rows(upwards))))
    with pytest.raises(CalibrationError, match="camera and table do not fit: the camera does not look down"):
        calibration.depth_bounds_m(known, calibration.table_of(known, 0.02), (-0.005, 0.06))


def test_the_widest_view_is_the_diagonal_of_the_smaller_field(tmp_path: Path) -> None:
    seen = calibration.widest_view_m(loaded(tmp_path).stereo, 0.5)
    assert seen == pytest.approx(0.5 * np.hypot(640 / K1[0, 0], 480 / K1[1, 1]))
