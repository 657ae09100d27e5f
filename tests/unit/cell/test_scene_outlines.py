"""A request's dimensions of a flat part become its outline."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from cell import scenes
from cell.errors import UsageError

Json = dict[str, object]
BRACKET: Json = {
    "cls": "bracket", "length_mm": 66.0, "thickness_mm": 3.0,
    "dims": {"a": 84.0, "b": 64.0, "w": 18.0, "hole": 3.2},
    "nodes_model": [
        {"p": [45, -12, 0], "type": "end"}, {"p": [-21, -12, 0], "type": "corner"},
        {"p": [-21, 34, 0], "type": "end"}, {"p": [44, -12, 0], "type": "loop_centre"},
    ],
    "edges_model": [[0, 1], [1, 2]], "axis_model": [0, 1],
}  # fmt: skip
SPANNER: Json = {
    "cls": "spanner", "length_mm": 79.0, "thickness_mm": 5.0,
    "dims": {"L": 112.0, "w": 12.0, "head": 14.0, "gap": 13.0, "ro": 12.5, "ri": 7.0},
    "nodes_model": [
        {"p": [-52, 9, 0], "type": "end"}, {"p": [-52, -9, 0], "type": "end"},
        {"p": [-36, 0, 0], "type": "junction"}, {"p": [34, 0, 0], "type": "junction"},
        {"p": [43.5, 0, 0], "type": "loop_centre"},
    ],
    "edges_model": [[0, 2], [1, 2], [2, 3]], "axis_model": [2, 4],
}  # fmt: skip


def request_of(fields: Json, folder: Path) -> scenes.Request:
    scene = folder / "scenes" / "one"
    scene.mkdir(parents=True)
    (scene / "request.json").write_text(json.dumps({"scene": "one", "rig": "r", "request": fields}))
    return scenes.request(scenes.find(folder)[0], 0.008)


def test_arms_of_a_bracket_reach_half_a_width_past_the_nodes_of_its_skeleton(tmp_path: Path) -> None:
    wanted = request_of(BRACKET, tmp_path)
    outline = wanted.part.outline
    assert outline is not None

    np.testing.assert_allclose(outline.bars[0], [[0.054, -0.012], [-0.030, -0.012]])
    np.testing.assert_allclose(np.linalg.norm(outline.bars[0][1] - outline.bars[0][0]), 0.084)
    np.testing.assert_allclose(outline.holes, [[0.044, -0.012, 0.0032]])
    assert wanted.width_m == pytest.approx(0.018)


def test_a_spanner_is_a_handle_a_ring_and_a_head_with_a_mouth(tmp_path: Path) -> None:
    outline = request_of(SPANNER, tmp_path).part.outline
    assert outline is not None

    # ring and head reach the stated length over all
    np.testing.assert_allclose(outline.discs, [[0.0435, 0.0, 0.0125], [-0.042, 0.0, 0.014]])
    np.testing.assert_allclose(outline.holes, [[0.0435, 0.0, 0.007]])
    np.testing.assert_allclose(outline.slots, [[-0.042, 0.0, -1.0, 0.0, 0.013]], atol=1e-12)


def test_a_spanner_without_its_ring_is_refused(tmp_path: Path) -> None:
    nodes = SPANNER["nodes_model"]
    assert isinstance(nodes, list)
    with pytest.raises(UsageError, match="one loop centre"):
        request_of({**SPANNER, "nodes_model": nodes[:4], "axis_model": [2, 3]}, tmp_path)


def test_round_rods_have_no_outline_of_their_own(tmp_path: Path) -> None:
    fields = {key: value for key, value in BRACKET.items() if key not in ("dims", "thickness_mm")}
    wanted = request_of({**fields, "dims": [78, 28], "diameter_mm": 4.5}, tmp_path)

    assert wanted.part.outline is None
    assert wanted.width_m == pytest.approx(0.0045)
