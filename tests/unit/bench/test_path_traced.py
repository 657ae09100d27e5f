"""The bench's rays against a path tracer of another make: same rods, same outlines, same truth."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from bench.families import COLOURS, look_of
from bench.heap import Rod
from bench.rigs import MIDDLE_M, TABLE_Z_M, WEBCAM, Rig, rays
from bench.truth import truth_of
from bench.views import photograph
from drivers.sim.geometry import apply, looking_at
from drivers.sim.layout import CameraLayout

SET = Path(__file__).parents[4] / "shared" / "data" / "scenes-dev"
ON_OUR_TABLE_M = np.array([*MIDDLE_M, TABLE_Z_M])

pytestmark = [
    pytest.mark.shared_data,
    pytest.mark.skipif(not SET.is_dir(), reason="no shared data here"),
]


def rig_of(name: str) -> Rig:
    """A rig of the set, moved so that its table is the bench's."""
    told = json.loads((SET / "rigs" / f"{name}.json").read_text(encoding="utf-8"))

    def camera(side: str) -> CameraLayout:
        matrix, pose = np.array(told[side]["K"]), np.array(told[side]["T_world_cam"])
        position = 0.001 * pose[:3, 3] + ON_OUR_TABLE_M
        target = position + 0.4 * pose[:3, 2]
        level = looking_at(position, target, 0.0)[:3, :3]
        roll = level.T @ pose[:3, :3]
        return CameraLayout(
            position_m=tuple(position.tolist()),
            look_at_m=tuple(target.tolist()),
            roll_rad=float(np.arctan2(roll[1, 0], roll[0, 0])),
            focal_px=(matrix[0, 0], matrix[1, 1]),
            centre_px=(matrix[0, 2], matrix[1, 2]),
            distortion=tuple(told[side]["dist"]),
        )

    width, height = told["image_size"]
    cameras = WEBCAM.cameras.model_copy(
        update={"width_px": width, "height_px": height, "left": camera("left"), "right": camera("right")}
    )
    return Rig(name=name, cameras=cameras, mono=told["mono"], stick_length_m=0.1)


@pytest.mark.parametrize("scene", ["H20-1-ind", "H40-3"])
def test_outlines_shares_and_order_are_those_of_the_path_traced_scene(scene: str) -> None:
    folder = SET / "scenes" / scene
    told = json.loads((folder / "gt.json").read_text(encoding="utf-8"))
    rig = rig_of(told["rig"])
    base_from_left = rays(rig)[0][0].base_from_camera
    rods = []
    for thing in told["objects"]:
        ends = apply(base_from_left, 0.001 * np.array([thing["p0_cam"], thing["p1_cam"]]))
        way = ends[1] - ends[0]
        rods.append(
            Rod(
                length_m=float(np.linalg.norm(way)),
                radius_m=0.001 * thing["radius_mm"],
                colour=COLOURS["wood"],
                colour_name="wood",
                material="wood",
                shade=1.0,
                gloss=0.0,
                target=True,
                centre=ends.mean(axis=0),
                axis=way / np.linalg.norm(way),
            )
        )
    rng = np.random.default_rng(1)
    views = photograph(tuple(rods), (), rig, look_of(rng), rng)
    truth = truth_of(tuple(rods), views, base_from_left)
    for k, side in enumerate(("left", "right")):
        ids = cv2.imread(str(folder / f"ids_{side}.png"), cv2.IMREAD_GRAYSCALE)
        assert ids is not None
        theirs = ids.astype(int) - 1
        either = (theirs >= 0) | (views[k].owner >= 0)
        assert (theirs == views[k].owner)[either].mean() > 0.98
        shares = [thing["visible"][side] for thing in told["objects"]]
        assert np.abs(truth.visible[:, k] - shares).max() < 0.04
        ends_px = [[node[f"px_{side}"] for node in thing["nodes"]] for thing in told["objects"]]
        assert np.abs(views[k].ends_px - np.array(ends_px)).max() < 0.01
        seen = [[node[f"visible_{side}"] for node in thing["nodes"]] for thing in told["objects"]]
        assert (truth.ends_visible[:, k] == np.array(seen)).mean() > 0.92
    ours = {(c.above, c.below) for c in truth.crossings}
    listed = {(c["above"], c["below"]) for c in told["crossings"]}
    assert listed <= ours
    assert len(ours - listed) < 0.12 * len(ours)
    assert not {(below, above) for above, below in ours} & listed
