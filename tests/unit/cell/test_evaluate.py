"""The detector over scene folders: what is read, what is written, what is said when something is wrong."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from cell import scenes
from cell.errors import CalibrationError, UsageError
from cell.evaluate import evaluate
from vision.types import Floats, Grey, NodeKind

RIG = {
    "image_size": [640, 480],
    "units": "mm",
    "left": {"K": [[600, 0, 320], [0, 600, 240], [0, 0, 1]], "dist": [0, 0, 0, 0, 0]},
    "right": {"K": [[600, 0, 320], [0, 600, 240], [0, 0, 1]], "dist": [0, 0, 0, 0, 0]},
    "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "T": [-80, 0, 0],
    "table_plane_leftcam": {"normal": [0, 0, -1], "d": 400},
}
STICK = {"cls": "stick", "length_mm": 100, "diameter_mm": 4, "threshold_hint": [186, 255]}


def bars(shift_px: float, ends: Floats) -> Grey:
    """Bars of 5 px between ends (S, 2, 2) px, at a column shift."""
    picture = np.random.default_rng(3).normal(45, 4, (480, 640))
    for (a, b), (c, d) in ends.tolist():
        layer = np.zeros(picture.shape, np.uint8)
        points = [round(16 * x) for x in (a - shift_px, b, c - shift_px, d)]
        cv2.line(layer, (points[0], points[1]), (points[2], points[3]), 170, 5, cv2.LINE_AA, 4)
        picture = picture + layer
    return np.asarray(np.clip(picture, 0, 255), np.uint8)


def write_scene(root: Path, name: str, left: Grey, right: Grey, request: object = None) -> Path:
    folder = root / "scenes" / name
    folder.mkdir(parents=True)
    cv2.imwrite(str(folder / "left.png"), left)
    cv2.imwrite(str(folder / "right.png"), right)
    wanted = {"scene": name, "rig": "bench", "request": STICK if request is None else request}
    (folder / "request.json").write_text(json.dumps(wanted), encoding="utf-8")
    return folder


@pytest.fixture
def root(tmp_path: Path) -> Path:
    (tmp_path / "rigs").mkdir()
    (tmp_path / "rigs" / "bench.json").write_text(json.dumps(RIG), encoding="utf-8")
    # 150 px at 0.4 m are 100 mm; a disparity of 120 px is 0.4 m
    ends = np.array([[[300, 200], [450, 200]], [[250, 300], [340, 420]]], np.float64)
    write_scene(tmp_path, "two", bars(0, ends), bars(120, ends))
    white = np.full((480, 640), 255, np.uint8)
    write_scene(tmp_path, "white", white, white)
    return tmp_path


def result(out: Path, name: str) -> dict[str, object]:
    found: dict[str, object] = json.loads((out / f"{name}.json").read_text(encoding="utf-8"))
    return found


@pytest.mark.parametrize("inside", ["", "scenes"])
def test_results_are_millimetres_in_the_form_of_the_scoring_program(root: Path, inside: str) -> None:
    out = root / "out"
    assert evaluate(root / inside, out, "published") == 2
    found = result(out, "two")
    assert found["scene"] == "two"
    detections = found["detections"]
    assert isinstance(detections, list)
    assert [d["rank"] for d in detections] == [1, 2]
    first = next(d for d in detections if abs(d["p0"][1] - d["p1"][1]) < 5)
    ends = np.array(sorted([first["p0"], first["p1"]]))
    np.testing.assert_allclose(ends, [[-13.3, -26.7, 400], [86.7, -26.7, 400]], atol=6.0)
    assert first["class"] == "stick"
    assert isinstance(found["time_ms"], float)
    assert found["segments"]


def test_results_say_how_sure_what_lies_on_what_and_how_long_each_stage_took(root: Path) -> None:
    ends = np.array([[[320, 256], [410, 157]], [[340, 150], [400, 270]]], np.float64)
    write_scene(root, "cross", bars(0, ends), bars(120, ends))
    evaluate(root, root / "out", "default", only=("cross",))
    found = result(root / "out", "cross")
    detections = found["detections"]
    assert isinstance(detections, list)
    assert len(detections) == 2
    for detection in detections:
        assert 0 < detection["sigma_mm"] < 5
        assert 0 < detection["sigma_deg"] < 5
    crossings = found["crossings"]
    assert isinstance(crossings, list)
    (crossing,) = crossings
    assert {crossing["above"], crossing["below"]} == {1, 2}
    assert isinstance(crossing["gap_mm"], float)
    under = next(d for d in detections if d["rank"] == crossing["below"])
    assert [why["reason"] for why in under["refusals"]] == ["CROSSED"]
    reasons = found["reasons"]
    assert isinstance(reasons, dict)
    assert reasons["CROSSED"] == 1
    assert found["row_offset_px"] == 0.0
    stages = found["stages_ms"]
    assert isinstance(stages, dict)
    assert {"binarize", "explain", "polish"} <= set(stages)
    assert isinstance(found["time_ms"], float)
    assert sum(stages.values()) <= found["time_ms"] + 1.0
    assert "nothing" not in found


def test_a_scene_with_nothing_to_pick_says_why_in_words(root: Path) -> None:
    ends = np.array([[[300, 120], [330, 290]]], np.float64)  # 115 mm
    write_scene(root, "long", bars(0, ends), bars(120, ends))
    empty = np.zeros((0, 2, 2))
    write_scene(root, "empty", bars(0, empty), bars(120, empty) + np.uint8(1))
    evaluate(root, root / "out", "default", only=("long", "empty"))
    long = result(root / "out", "long")
    assert long["detections"] == []
    assert str(long["nothing"]).startswith("1 seen, none to be had: ")
    assert "length does not fit the product (1)" in str(long["nothing"])
    assert result(root / "out", "empty")["nothing"] == "nothing near the product's size was seen"


def test_a_bad_picture_gives_no_detection_and_says_why(root: Path) -> None:
    evaluate(root, root / "out", "published", only=("white",))
    found = result(root / "out", "white")
    assert found["detections"] == []
    assert "saturated" in str(found["problem"])
    assert not (root / "out" / "two.json").exists()


def test_pictures_of_another_size_give_a_problem(root: Path) -> None:
    small = bars(0, np.zeros((0, 2, 2)))[:240]
    write_scene(root, "small", small, small)
    evaluate(root, root / "out", "published", only=("small",))
    assert "calibrated for 640 x 480" in str(result(root / "out", "small")["problem"])


def test_a_folder_without_scenes_is_a_usage_error(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no scenes here"):
        evaluate(tmp_path, tmp_path / "out", "published")


def test_an_unknown_scene_is_named(root: Path) -> None:
    with pytest.raises(UsageError, match="no scene named three"):
        evaluate(root, root / "out", "published", only=("two", "three"))


def test_a_missing_rig_is_a_calibration_error(root: Path) -> None:
    (root / "rigs" / "bench.json").unlink()
    with pytest.raises(CalibrationError, match=r"bench\.json"):
        evaluate(root, root / "out", "published")


@pytest.mark.parametrize(
    ("request_fields", "complaint"),
    [
        ({"cls": "stick", "diameter_mm": 4}, "length_mm"),
        ({"cls": "stick", "length_mm": -3, "diameter_mm": 4}, "length_mm"),
        ({"length_mm": 100, "diameter_mm": 4}, "cls"),
        (
            {**STICK, "nodes_model": [{"p": [0, 0], "type": "end"}], "edges_model": [], "axis_model": [0, 0]},
            "graph",
        ),
        (
            {
                **STICK,
                "nodes_model": [{"p": [0, 0, 0], "type": "end"}],
                "edges_model": [[0, 1]],
                "axis_model": [0, 0],
            },
            "node it does not have",
        ),
    ],
)
def test_a_broken_request_is_named(root: Path, request_fields: object, complaint: str) -> None:
    picture = bars(0, np.zeros((0, 2, 2)))
    write_scene(root, "broken", picture, picture, request_fields)
    with pytest.raises(UsageError, match=complaint):
        evaluate(root, root / "out", "published", only=("broken",))


def test_a_request_with_a_graph_becomes_a_topology_in_metres(root: Path) -> None:
    fields = {
        "cls": "L",
        "length_mm": 78,
        "diameter_mm": 4.5,
        "nodes_model": [
            {"p": [64, -5, 0], "type": "end"},
            {"p": [-14, -5, 0], "type": "corner"},
            {"p": [-14, 23, 0], "type": "end"},
        ],
        "edges_model": [[0, 1], [1, 2]],
        "axis_model": [0, 1],
    }
    picture = bars(0, np.zeros((0, 2, 2)))
    write_scene(root, "bent", picture, picture, fields)
    (folder,) = scenes.find(root, ("bent",))
    wanted = scenes.request(folder, 0.008)
    topology = wanted.part.topology
    assert topology is not None
    assert topology.kinds == (NodeKind.END, NodeKind.CORNER, NodeKind.END)
    np.testing.assert_allclose(topology.points[0], [0.064, -0.005, 0.0])
    assert wanted.part.length_m == pytest.approx(0.078)
    assert wanted.width_m == pytest.approx(0.0045)
