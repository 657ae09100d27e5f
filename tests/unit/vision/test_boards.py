"""Boards in drawn pictures: corners where they are, numbered from the right end, poses, and what is wrong."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.reference.boards import CHARUCO, CHESSBOARD, PLACES, STEREO, left_from_board, pair
from vision.board_faults import flaw, other_board, repeats, why_not
from vision.boards import Board, board_pose, corner_points, detect
from vision.types import Floats, Grey, Ints


def expected_px(board: Board, number: int, ids: Ints) -> Floats:
    pose = left_from_board(board, PLACES[number])
    points, _ = cv2.projectPoints(
        corner_points(board, ids), cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3],
        STEREO.left.matrix, STEREO.left.distortion,
    )  # fmt: skip
    return np.asarray(points, dtype=np.float64).reshape(-1, 2)


@pytest.mark.parametrize(("board", "limit_px"), [(CHARUCO, 0.15), (CHESSBOARD, 0.10)])
@pytest.mark.parametrize("number", [0, 2, 9])
def test_corners_are_where_the_board_has_them_and_numbered_from_its_origin(
    board: Board, limit_px: float, number: int
) -> None:
    corners = detect(pair(board, number)[0], board)

    assert corners is not None
    off = np.linalg.norm(corners.pixels - expected_px(board, number, corners.ids), axis=1)
    assert np.sqrt(np.mean(off**2)) < limit_px
    assert 1.0 < corners.edge_px < 2.5
    assert corners.contrast > 100


def test_the_pose_of_a_board_is_found_and_its_rival_told() -> None:
    corners = detect(pair(CHESSBOARD, 3)[0], CHESSBOARD)
    assert corners is not None

    pose = board_pose(corners, CHESSBOARD, STEREO.left)

    true = left_from_board(CHESSBOARD, PLACES[3])
    assert np.linalg.norm(pose.camera_from_board.translation - true[:3, 3]) < 0.0005
    assert pose.rms_px < 0.15
    assert pose.rival_rms_px > 5 * pose.rms_px


def test_the_pose_of_corners_on_one_line_is_refused() -> None:
    corners = detect(pair(CHESSBOARD, 0)[0], CHESSBOARD)
    assert corners is not None
    line = replace(corners, ids=corners.ids[:7], pixels=corners.pixels[:7])

    with pytest.raises(ValueError, match="not on one line"):
        board_pose(line, CHESSBOARD, STEREO.left)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"columns": 2}, "too small"),
        ({"pitch_m": 22.0}, "metres are expected"),
        ({"marker_m": 0.03}, "does not fit a square"),
        ({"dictionary": "DICT_9X9"}, "no marker family"),
        ({"columns": 20, "rows": 20}, "need 200 markers"),
    ],
)
def test_a_board_that_cannot_be_is_refused(change: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        replace(CHARUCO, **change)  # type: ignore[arg-type]


def test_a_mirrored_board_is_named() -> None:
    mirrored = np.ascontiguousarray(pair(CHARUCO, 0)[0][:, ::-1])

    assert detect(mirrored, CHARUCO) is None
    assert why_not(mirrored, CHARUCO).startswith("mirrored")


@pytest.mark.parametrize("columns", [7, 9])
def test_another_number_of_columns_is_named(columns: int) -> None:
    stated = replace(CHARUCO, columns=columns)
    grey = pair(CHARUCO, 0)[0]

    corners = detect(grey, stated)
    said = why_not(grey, stated) if corners is None else other_board(grey, corners, stated)

    assert said == f"another board: its markers stand as on 8 columns, not {columns}"


def test_another_marker_family_is_named() -> None:
    stated = replace(CHARUCO, dictionary="DICT_5X5_50")

    assert "family DICT_4X4, not DICT_5X5_50" in why_not(pair(CHARUCO, 0)[0], stated)


@pytest.mark.parametrize("change", [{"columns": 7}, {"rows": 6}])
def test_a_chessboard_that_goes_on_is_named(change: dict[str, int]) -> None:
    stated = replace(CHESSBOARD, **change)  # type: ignore[arg-type]
    grey = pair(CHESSBOARD, 0)[0]

    corners = detect(grey, stated)
    said = why_not(grey, stated) if corners is None else other_board(grey, corners, stated)

    assert said is not None
    assert said.startswith("another board")


def test_a_blurred_view_is_refused() -> None:
    blurred: Grey = np.asarray(cv2.GaussianBlur(pair(CHESSBOARD, 0)[0], (0, 0), 1.8), np.uint8)

    corners = detect(blurred, CHESSBOARD)

    assert corners is not None
    assert str(flaw(corners, CHESSBOARD)).startswith("blurred")


def test_a_view_that_moved_is_refused() -> None:
    moved: Grey = np.asarray(cv2.blur(pair(CHESSBOARD, 0)[0], (7, 1)), np.uint8)

    corners = detect(moved, CHESSBOARD)

    assert corners is not None
    assert str(flaw(corners, CHESSBOARD)).startswith("blurred")


def test_a_cut_board_is_refused() -> None:
    charuco = detect(np.ascontiguousarray(pair(CHARUCO, 0)[0][:120]), CHARUCO)
    chessboard = np.ascontiguousarray(pair(CHESSBOARD, 0)[0][:150])

    assert charuco is not None
    assert str(flaw(charuco, CHARUCO)).startswith("cut")
    assert detect(chessboard, CHESSBOARD) is None
    assert "cut" in why_not(chessboard, CHESSBOARD) or "outside" in why_not(chessboard, CHESSBOARD)


def test_the_same_view_again_is_told_and_a_new_one_is_not() -> None:
    first, other = (tuple(detect(p, CHARUCO) for p in pair(CHARUCO, n)) for n in (0, 1))
    nearly = [np.roll(p, 2, axis=1) for p in pair(CHARUCO, 0)]
    again = tuple(detect(p, CHARUCO) for p in nearly)

    assert repeats((again[0], again[1]), [(other[0], other[1]), (first[0], first[1])]) == 1
    assert repeats((other[0], other[1]), [(first[0], first[1])]) is None
