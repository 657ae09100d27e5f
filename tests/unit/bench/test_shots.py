"""What the bench's pictures show is what its truth says; and scene folders come back as they went."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from bench.families import FAMILIES
from bench.meet import BLOCK_OWNER
from bench.piles import draw, write_rig, write_scene
from bench.rigs import INDUSTRIAL, RIGS, WEBCAM, Rig, known
from bench.scenes import dense, grey_of
from bench.shots import Shot
from cell import scenes
from vision.types import CameraModel, Floats


@pytest.fixture(scope="module")
def shot() -> Shot:
    return draw("H20", WEBCAM, seed=11, number=0)


def pixels(points: Floats, camera: CameraModel) -> Floats:
    """Points (K, 3) m in a camera's frame through OpenCV's own projection."""
    found, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.matrix, camera.distortion)
    return np.asarray(found[:, 0], np.float64)


@pytest.mark.parametrize("rig", RIGS.values(), ids=sorted(RIGS))
def test_true_ends_project_onto_the_drawn_ends_in_both_pictures(rig: Rig) -> None:
    taken = draw("A", rig, seed=3, number=0)
    stereo = known(rig).stereo
    back = stereo.right_from_left
    for n, ends in enumerate(taken.truth.ends):
        for k, (view, camera) in enumerate(zip(taken.views, (stereo.left, stereo.right), strict=True)):
            points = ends if k == 0 else ends @ back.rotation.T + back.translation
            expected = pixels(points, camera)
            assert np.abs(expected - view.ends_px[n]).max() < 0.01
            rows, columns = np.nonzero(view.owner == n)
            way = (expected[1] - expected[0]) / np.linalg.norm(expected[1] - expected[0])
            along = (np.column_stack([columns, rows]) - expected[0]) @ way
            width = 2.0 * taken.scenery.rods[n].radius_m * camera.matrix[0, 0] / float(points[:, 2].mean())
            assert -0.6 * width < along.min() < 1.5
            assert -1.5 < along.max() - np.linalg.norm(expected[1] - expected[0]) < 0.6 * width


def test_a_rod_is_in_the_picture_as_often_as_its_ends_are(shot: Shot) -> None:
    for k, view in enumerate(shot.views):
        height, width = view.pixels.shape[:2]
        inside = ((view.ends_px >= 0.0) & (view.ends_px <= [width - 1, height - 1])).all(axis=(1, 2))
        assert (shot.truth.in_frame[:, k] <= inside).all()
        assert shot.truth.in_frame[:, k].all()


def meeting(a: Floats, b: Floats) -> tuple[float, float] | None:
    """Places 0..1 on two segments (2, 2) where they cross, None if they do not."""
    solved = np.linalg.solve(np.column_stack([a[1] - a[0], b[0] - b[1]]), b[0] - a[0])
    return (float(solved[0]), float(solved[1])) if np.all((solved > 0.0) & (solved < 1.0)) else None


@pytest.mark.parametrize("k", [0, 1])
def test_where_two_axes_cross_in_a_picture_the_truth_knows_it_and_the_upper_one_is_drawn(
    shot: Shot, k: int
) -> None:
    stereo, ends, view = known(shot.rig).stereo, shot.truth.ends, shot.views[k]
    back = stereo.right_from_left
    depths = ends[..., 2] if k == 0 else (ends @ back.rotation.T + back.translation)[..., 2]
    order = {frozenset((c.above, c.below)): c.above for c in shot.truth.crossings}
    clear = 0
    for i in range(len(ends)):
        for j in range(i):
            places = meeting(view.ends_px[i], view.ends_px[j])
            if places is None:
                continue
            # perspective: the inverse of depth is what changes evenly along a line in the picture
            near_i, near_j = (
                (1.0 - t) / depths[n, 0] + t / depths[n, 1] for n, t in zip((i, j), places, strict=True)
            )
            upper, lower = (i, j) if near_i > near_j else (j, i)
            u, v = np.round(view.ends_px[i, 0] + places[0] * (view.ends_px[i, 1] - view.ends_px[i, 0]))
            assert view.owner[int(v), int(u)] != lower
            clear += int(view.owner[int(v), int(u)] == upper)
            if frozenset((i, j)) in order:
                assert order[frozenset((i, j))] == upper
    assert clear > 0.6 * len(order)


def test_what_lies_on_nothing_is_wholly_seen_and_what_is_seen_is_counted(shot: Shot) -> None:
    truth = shot.truth
    assert (truth.visible[truth.free] > 0.985).all()
    assert (truth.visible[~truth.pickable].max(axis=1) < 0.99).all()
    assert truth.free.any()
    assert (truth.pickable >= truth.free).all()
    for k, view in enumerate(shot.views):
        areas = np.bincount(view.owner[view.owner >= 0].astype(int), minlength=len(truth.ends))
        whole = areas / np.maximum(truth.visible[:, k], 1e-9)
        # outlines of equal sticks at nearly equal depth are equally large where all of them is in the picture
        flat = np.array([abs(rod.axis[2]) < 0.1 for rod in shot.scenery.rods])
        assert np.ptp(whole[flat]) < 0.2 * whole[flat].mean()


def test_sticks_are_bright_the_table_is_dark_and_one_flank_is_lit() -> None:
    taken = draw("A", WEBCAM, seed=5, number=1)
    grey = grey_of(taken.views[0].pixels).astype(float)
    owner = taken.views[0].owner
    assert np.median(grey[owner >= 0]) > 160.0
    assert np.percentile(grey[owner < 0], 99) < 120.0
    inside = cv2.erode((owner >= 0).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    assert np.ptp(np.percentile(grey[inside], [5, 95])) > 15.0


@pytest.mark.parametrize("family", FAMILIES)
def test_a_scene_folder_comes_back_as_it_went(family: str, tmp_path: Path) -> None:
    number = 2
    rig = INDUSTRIAL if family == "N" else WEBCAM
    taken = draw(family, rig, seed=2, number=number)
    write_rig(tmp_path, rig)
    write_scene(tmp_path, "one", taken, family, 2)
    (folder,) = scenes.find(tmp_path)
    calibration = scenes.rig(folder)
    assert calibration.table is not None
    assert calibration.table.offset_m == pytest.approx(rig.cameras.left.position_m[2] - 0.02)
    request = scenes.request(folder, 0.004)
    assert request.part.length_m == pytest.approx(taken.scenery.wish.length_m)
    assert request.part.diameter_m == pytest.approx(taken.scenery.wish.diameter_m)
    for side, view in zip(("left", "right"), taken.views, strict=True):
        assert np.abs(scenes.grey(folder, side).astype(int) - grey_of(view.pixels)).max() <= 1
        ids = cv2.imread(str(folder.path / f"ids_{side}.png"), cv2.IMREAD_GRAYSCALE)
        assert ids is not None
        assert np.array_equal(ids == BLOCK_OWNER, view.owner >= BLOCK_OWNER)
        assert np.array_equal(ids == 1, view.owner == 0)
    told = json.loads((folder.path / "gt.json").read_text(encoding="utf-8"))
    assert told["expected_picks"] == ("none" if family == "N" else "some")
    assert len(told["objects"]) == len(taken.truth.ends)
    for n, thing in enumerate(told["objects"]):
        ends = np.array([thing["p0_cam"], thing["p1_cam"]])
        assert np.abs(ends - 1000.0 * taken.truth.ends[n]).max() < 1e-3
        lying_over = {c["above"] for c in told["crossings"] if c["below"] == n}
        assert set(thing["covered_by"]) == lying_over
        assert thing["free"] == (not lying_over)


def test_piles_in_memory_are_one_per_seed_and_do_not_hang_together() -> None:
    piles = dense(10, [4, 9]).piles
    (again,) = dense(10, [9]).piles
    assert np.array_equal(again.left, piles[1].left)
    assert np.array_equal(again.ends, piles[1].ends)
    assert not np.array_equal(piles[0].ends, piles[1].ends)
    assert again.truth is not None
    assert again.left.shape == (480, 640)
