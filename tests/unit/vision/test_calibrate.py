"""Two cameras from drawn and from rendered views, each unknown within what is said of its doubt."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from cell import calibration
from tests.reference.boards import CHARUCO, CHESSBOARD, PLACES, STEREO, pair
from vision.adjust import CannotCalibrate
from vision.boards import Board, detect
from vision.calibrate import Calibrated, Swapped, View, calibrate
from vision.coverage import coverage
from vision.stereo import project, rectification, rectify_points, triangulate
from vision.types import Floats, StereoModel

SHARED = Path(__file__).parents[4] / "shared" / "data" / "scenes-dev"


def views(board: Board) -> list[View]:
    return [
        View(name=f"{n:02d}", left=detect(left, board), right=detect(right, board))
        for n, (left, right) in enumerate(pair(board, n) for n in range(len(PLACES)))
    ]


@pytest.fixture(scope="module")
def seen() -> list[View]:
    return views(CHESSBOARD)


def numbers(stereo: StereoModel, side: str) -> Floats:
    camera = stereo.left if side == "left" else stereo.right
    m = camera.matrix
    return np.array([m[0, 0], m[1, 1], m[0, 2], m[1, 2], *camera.distortion])


def apart_mm(found: StereoModel, true: StereoModel, points_m: Floats) -> Floats:
    """How far off the computed cameras place points that the true ones see."""
    rect = rectification(found)
    left, right = project(points_m, true)
    there = triangulate(rectify_points(left, rect, "left"), rectify_points(right, rect, "right"), rect)
    return np.asarray(1e3 * np.linalg.norm(there - points_m, axis=1), dtype=np.float64)


def test_drawn_cameras_are_found_and_their_doubt_is_honest(seen: list[View]) -> None:
    answer = calibrate(seen, CHESSBOARD, with_k3=False)

    assert answer.stereo.rms_px < 0.12
    for side, sigma in (("left", answer.left_sigma), ("right", answer.right_sigma)):
        off = np.abs(numbers(answer.stereo, side) - numbers(STEREO, side))
        # pinhole only: what is left of distortion is shared among coefficients that go together
        assert (off[:4] < 5 * sigma[:4]).all()
        assert (sigma[:8] > 0).all()
        assert sigma[8] == 0
    shift = answer.stereo.right_from_left.translation - STEREO.right_from_left.translation
    assert (np.abs(shift) < 5 * answer.shift_sigma_m + 2e-5).all()
    assert np.abs(answer.rows_px).mean() < 0.1


def test_fewer_views_are_known_less_well(seen: list[View]) -> None:
    few, all_of_them = calibrate(seen[:6], CHESSBOARD), calibrate(seen, CHESSBOARD)

    assert (few.left_sigma[:4] > all_of_them.left_sigma[:4]).all()


def test_a_view_seen_by_one_camera_counts_for_that_camera(seen: list[View]) -> None:
    one = [replace(seen[0], right=None), *seen[1:]]

    answer = calibrate(one, CHESSBOARD)

    assert np.isnan(answer.views[0].right_px)
    assert len(answer.views[0].rows_px) == 0
    assert answer.views[0].left_px < 0.2


def test_swapped_cameras_are_named(seen: list[View]) -> None:
    swapped = [replace(view, left=view.right, right=view.left) for view in seen]

    with pytest.raises(Swapped, match="left and right are swapped"):
        calibrate(swapped, CHESSBOARD)


def test_pictures_of_two_moments_stand_out(seen: list[View]) -> None:
    other = seen[4].right
    assert other is not None
    moved = replace(other, pixels=other.pixels + 3.0)
    mixed = [*seen[:4], replace(seen[4], right=moved), *seen[5:]]

    answer = calibrate(mixed, CHESSBOARD)

    worst = max(answer.views, key=lambda view: view.worst_px)
    assert worst.name == "04"
    assert worst.worst_px > 3 * np.median([view.worst_px for view in answer.views])


def test_too_few_views_are_refused(seen: list[View]) -> None:
    with pytest.raises(CannotCalibrate, match="in 2 views; 3 at least"):
        calibrate([v for v in seen if v.left is not None and v.right is not None][:2], CHESSBOARD)


def test_charuco_views_with_parts_of_the_board_are_enough() -> None:
    answer = calibrate(views(CHARUCO), CHARUCO, with_k3=False)

    assert answer.stereo.rms_px < 0.25
    grid = np.stack(np.meshgrid([-0.05, 0.0, 0.05], [-0.04, 0.04], [0.34, 0.38]), axis=-1).reshape(-1, 3)
    assert np.median(apart_mm(answer.stereo, STEREO, grid)) < 2.0


def covered(answer: Calibrated, seen: list[View]) -> tuple[str, ...]:
    return coverage(
        [view.left.pixels for view in seen if view.left is not None],
        [view.right.pixels for view in seen if view.right is not None],
        [fit.left_from_board for fit in answer.views],
        np.array([0.08, 0.07, 0.0]),
        (answer.stereo.left.width_px, answer.stereo.left.height_px),
    ).missing


def test_what_is_missing_is_said(seen: list[View]) -> None:
    answer = calibrate(seen, CHESSBOARD)
    right_half = [
        replace(view, left=None) if view.left is not None and view.left.pixels[:, 0].min() < 122 else view
        for view in seen
    ]

    said = covered(answer, right_half)

    assert "no view in the upper left of the left picture" in said
    assert not any("upper left of the right" in words for words in said)


def test_flat_views_get_the_advice_to_tilt(seen: list[View]) -> None:
    answer = calibrate(seen, CHESSBOARD)
    flat = replace(answer, views=tuple(answer.views[0] for _ in range(10)))

    said = covered(flat, [seen[0]] * 10)

    assert any(words.startswith("tilt more: 0 views") for words in said)
    assert any("nearer and farther" in words for words in said)


@pytest.mark.shared_data
@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared scenes are not here")
@pytest.mark.parametrize(("kind", "at_least"), [("webcam", 500), ("industrial", 50)])
def test_rendered_views_give_cameras_that_place_every_true_point(kind: str, at_least: int) -> None:
    folder = SHARED / "calibration" / f"calib-{kind}"
    told = json.loads((folder / "board.json").read_text(encoding="utf-8"))
    board = Board(
        kind=told["type"],
        columns=told["squares"][0],
        rows=told["squares"][1],
        pitch_m=told["square"] / 1e3,
        marker_m=told.get("marker", 0.0) / 1e3,
        dictionary=told.get("dict", ""),
    )
    rendered = []
    for left in sorted(folder.glob("left_*.png")):
        right = left.with_name(left.name.replace("left", "right"))
        both = [detect(np.asarray(cv2.imread(str(p), cv2.IMREAD_GRAYSCALE)), board) for p in (left, right)]
        rendered.append(View(name=left.stem[-2:], left=both[0], right=both[1]))
    true = calibration.load(SHARED / "rigs" / f"dev-{kind}.json").stereo
    points = []
    for file in sorted(SHARED.glob("scenes/*/gt.json")):
        scene = json.loads(file.read_text(encoding="utf-8"))
        if scene["rig"] == f"dev-{kind}":
            points += [node["cam"] for thing in scene["objects"] for node in thing["nodes"]]
    points_m = np.array(points) / 1e3

    answer = calibrate(rendered, board)

    off = apart_mm(answer.stereo, true, points_m)
    assert len(points_m) > at_least
    assert answer.left_rms_px < 0.15
    assert answer.right_rms_px < 0.15
    assert np.median(off) < 0.3
    assert np.max(off) < 0.5
