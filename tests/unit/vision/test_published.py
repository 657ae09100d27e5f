"""The published method as a whole, on drawn pictures of a rig, and on a rendered scene when there is one."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from cell import scenes
from vision import stereo, transforms
from vision.locate import locate
from vision.published import locate_published
from vision.types import CameraModel, Floats, Grey, PartModel, Plane, Refusal, StereoModel, Tuning

DATA = Path(__file__).parents[4] / "shared" / "data" / "scenes-dev"
CAMERA = CameraModel(
    matrix=np.array([[600.0, 0, 320], [0, 600.0, 240], [0, 0, 1]]),
    distortion=np.array([-0.08, 0.02, 0.0, 0.0, 0.0]),
    width_px=640,
    height_px=480,
)
RIG = StereoModel(
    left=CAMERA, right=CAMERA, right_from_left=transforms.make([0.01, 0.08, -0.01], [-0.0798, 0.001, 0.003])
)
TABLE = Plane(normal=np.array([0.0, 0.0, -1.0]), offset_m=0.4)
STICK = PartModel(code=1, name="rod-100", length_m=0.100, length_tolerance_m=0.008, diameter_m=0.005)
TUNING = Tuning(method="published", epipolar_px=2.5)


def pictures(sticks_m: Floats) -> tuple[Grey, Grey]:
    """Sticks (S, 2, 3) m drawn as bright bars with OpenCV on a dark noisy ground."""
    grounds = []
    noise = np.random.default_rng(5)
    for side in (0, 1):
        bars = np.zeros((480, 640), np.uint8)
        for stick in sticks_m:
            ends = stereo.project(stick, RIG)[side]
            (a, b), (c, d) = np.rint(ends * 16).astype(int).tolist()
            cv2.line(bars, (a, b), (c, d), 170, 7, cv2.LINE_AA, 4)
        grounds.append(np.clip(bars + noise.normal(45, 4, bars.shape), 0, 255).astype(np.uint8))
    return grounds[0], grounds[1]


def bar(u_m: float, v_m: float, angle: float, length_m: float = 0.100) -> Floats:
    half = 0.5 * length_m * np.array([np.cos(angle), np.sin(angle), 0.0])
    centre = np.array([u_m, v_m, 0.395])
    return np.stack([centre - half, centre + half])


SPREAD = np.stack([bar(0.02, -0.07, 0.2), bar(-0.02, 0.05, 1.1), bar(0.06, 0.03, 1.8)])


def test_spread_sticks_are_found_where_they_are() -> None:
    left, right = pictures(SPREAD)
    scene = locate_published(left, right, RIG, STICK, TUNING, TABLE)
    assert len(scene.offered) == 3
    for truth in SPREAD:
        away = [np.linalg.norm(c.centre - truth.mean(axis=0)) for c in scene.offered]
        assert min(away) < 0.004


def test_other_lengths_are_not_offered_but_named() -> None:
    left, right = pictures(np.stack([bar(0.0, 0.0, 0.3, 0.112), bar(0.0, 0.06, 0.3, 0.06)]))
    scene = locate_published(left, right, RIG, STICK, TUNING, TABLE)
    assert scene.offered == ()
    assert [c.refusals[0].reason for c in scene.candidates] == [Refusal.LENGTH]


def test_an_empty_table_gives_an_empty_scene() -> None:
    left, right = pictures(np.zeros((0, 2, 3)))
    scene = locate_published(left, right, RIG, STICK, TUNING, TABLE)
    assert scene.candidates == ()
    assert not scene.left.mask.any()


def test_every_stage_tells_the_observer_in_order() -> None:
    told: list[str] = []
    left, right = pictures(SPREAD)
    locate(left, right, RIG, STICK, TUNING, TABLE, observe=lambda stage, product: told.append(stage))
    assert told == ["rectify", "binarize", "thin", "graph", "match", "reconstruct", "retrieve"]


def test_the_same_pictures_give_the_same_scene_and_stay_as_they_were() -> None:
    left, right = pictures(SPREAD)
    before = left.copy(), right.copy()
    first = locate(left, right, RIG, STICK, TUNING, TABLE)
    second = locate(left, right, RIG, STICK, TUNING, TABLE)
    for one, other in zip(first.candidates, second.candidates, strict=True):
        np.testing.assert_array_equal(one.nodes, other.nodes)
    np.testing.assert_array_equal(left, before[0])
    np.testing.assert_array_equal(right, before[1])


def test_unfit_pictures_are_refused_in_words() -> None:
    left, right = pictures(SPREAD)
    with pytest.raises(ValueError, match="differ in size"):
        locate(left, right[:-2], RIG, STICK, TUNING, TABLE)
    with pytest.raises(ValueError, match="calibrated for"):
        locate(left[:-2], right[:-2], RIG, STICK, TUNING, TABLE)
    with pytest.raises(ValueError, match="uint8"):
        locate(left.astype(np.float64), right, RIG, STICK, TUNING, TABLE)
    with pytest.raises(ValueError, match="depth range"):
        locate(left, right, RIG, STICK, TUNING)


@pytest.mark.shared_data
@pytest.mark.skipif(not DATA.is_dir(), reason="no shared data here")
@pytest.mark.parametrize("name", ["A1", "T15", "F3"])
def test_most_sticks_of_an_easy_rendered_scene_are_found(name: str) -> None:
    (folder,) = scenes.find(DATA, (name,))
    rig = scenes.rig(folder)
    wanted = scenes.request(folder, 0.010)
    scene = locate_published(
        scenes.grey(folder, "left"),
        scenes.grey(folder, "right"),
        rig.stereo,
        wanted.part,
        Tuning(method="published"),
        rig.table,
    )
    truth = json.loads((folder.path / "gt.json").read_text(encoding="utf-8"))
    centres = [np.mean([o["p0_cam"], o["p1_cam"]], axis=0) * 1e-3 for o in truth["objects"] if o["target"]]
    found = [c for c in centres if any(np.linalg.norm(c - o.centre) < 0.008 for o in scene.offered)]
    assert len(found) >= 0.7 * len(centres)
