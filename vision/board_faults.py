"""What is wrong with a view of a board: not seen and why, blurred, cut, seen before, another board."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np

from vision.boards import DICTIONARIES, Board, Corners, corner_points
from vision.types import Floats, Grey, Ints

BLURRED_PX: Final = 3.5
"""Edges wider than this are out of focus or moved; sharp cameras show 1.5 to 3."""
BLURRED_BESIDE: Final = 1.7
"""So many times as wide as in the typical view of the set."""
LEAST_SHARE: Final = 0.25
"""Of a ChArUco board at least this share of its corners must be seen."""
LEAST_CONTRAST: Final = 25.0
REPEATED: Final = 0.3
"""Corners moved by less than this share of a square: the same view again."""
_FLAT: Final = 0.12
"""Corners lie off a plane's picture by less than this share of a square, lens distortion included."""
_WIDEST: Final = 30


def flaw(corners: Corners, board: Board, usual_edge_px: float | None = None) -> str | None:
    """Why a view is not to be used, by itself; None for a good one."""
    if corners.edge_px > BLURRED_PX:
        return f"blurred: edges are {corners.edge_px:.1f} px wide, {BLURRED_PX:g} allowed"
    if usual_edge_px is not None and corners.edge_px > BLURRED_BESIDE * usual_edge_px:
        return f"blurred: edges are {corners.edge_px:.1f} px wide, {usual_edge_px:.1f} in the other views"
    least = max(6, round(LEAST_SHARE * board.corner_count))
    if len(corners.ids) < least:
        return f"cut: {len(corners.ids)} of {board.corner_count} corners are seen, {least} at least"
    if corners.contrast < LEAST_CONTRAST:
        return f"dim: white is {corners.contrast:.0f} grey values over black, {LEAST_CONTRAST:g} at least"
    points = corner_points(board, corners.ids)
    if np.ptp(points[:, 0]) == 0 or np.ptp(points[:, 1]) == 0:
        return "cut: the corners seen lie on one line"
    off = off_plane(corners, board)
    if off > _FLAT:
        return (
            f"not this board: its corners lie up to {100 * off:.0f} % of a square off where a flat board of "
            f"{board.columns} x {board.rows} squares has them"
        )
    return None


def off_plane(corners: Corners, board: Board) -> float:
    """How far corners lie off the best picture of a flat board, 90th percentile, in squares."""
    points = corner_points(board, corners.ids)[:, :2] / board.pitch_m
    found, _ = cv2.findHomography(points, corners.pixels)
    if np.size(found) != 9:  # None where there is no answer, which the type does not say
        return float("inf")
    there = cv2.perspectiveTransform(points.reshape(-1, 1, 2), found).reshape(-1, 2)
    return float(np.percentile(np.linalg.norm(there - corners.pixels, axis=1), 90)) / corners.spacing_px


def moved(corners: Corners, before: Corners) -> float:
    """How far a board moved between two pictures of one camera: nine tenths of its corners at most, in "
    "squares."""
    _, one, other = np.intersect1d(corners.ids, before.ids, assume_unique=True, return_indices=True)
    if len(one) < 3:
        return float("inf")
    way = np.linalg.norm(corners.pixels[one] - before.pixels[other], axis=1)
    return float(np.percentile(way, 90)) / corners.spacing_px


def repeats(
    now: tuple[Corners | None, Corners | None], kept: Sequence[tuple[Corners | None, Corners | None]]
) -> int | None:
    """The place in ``kept`` of a view that shows the board where it stands now; None if there is none."""
    for k, before in enumerate(kept):
        ways = [moved(a, b) for a, b in zip(now, before, strict=True) if a is not None and b is not None]
        if ways and max(ways) < REPEATED:
            return k
    return None


def why_not(grey: Grey, board: Board) -> str:
    """Why a board is not seen, as far as the picture tells."""
    return _no_charuco(grey, board) if board.kind == "charuco" else _no_chessboard(grey, board)


def other_board(grey: Grey, corners: Corners, board: Board) -> str | None:
    """What tells that the board in the picture is another one than stated, though it was found; or None."""
    if board.kind == "charuco":
        pixels, ids = _markers(grey, board.dictionary)
        if off_plane(corners, board) > _FLAT:
            return _other_layout(pixels, ids, board)
        return _too_many(ids, board)
    return _goes_on(grey, corners, board)


# ------------------------------------------------------------------------------ ChArUco


def _markers(grey: Grey, family: str) -> tuple[Floats, Ints]:
    """Markers of a family in a picture: (N, 4, 2) corners and (N,) numbers."""
    known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, family))
    corners, ids, _ = cv2.aruco.ArucoDetector(known).detectMarkers(grey)
    if ids is None or not len(ids):
        return np.zeros((0, 4, 2)), np.zeros(0, dtype=np.int64)
    return np.asarray(corners, dtype=np.float64).reshape(-1, 4, 2), np.asarray(ids, np.int64).reshape(-1)


def _no_charuco(grey: Grey, board: Board) -> str:
    pixels, ids = _markers(grey, board.dictionary)
    mirrored = len(_markers(np.ascontiguousarray(grey[:, ::-1]), board.dictionary)[1])
    if mirrored > 2 * len(ids) and mirrored >= 4:
        return (
            "mirrored: the markers can be read in the mirrored picture only; print the board, or set the "
            "camera, without mirroring"
        )
    if len(ids) >= 4:
        return _other_layout(pixels, ids, board) or (
            f"{len(ids)} markers are seen, but no corner between two: too much of the board is cut or covered"
        )
    counts = {family: len(_markers(grey, family)[1]) for family in DICTIONARIES if family.endswith("_1000")}
    best = max(counts, key=lambda family: counts[family])
    if counts[best] >= 4 and best[:8] != board.dictionary[:8]:
        return f"another board: its markers are of the family {best[:8]}, not {board.dictionary}"
    return "no board is seen: not in the picture, too small, too dark, or badly blurred"


def _other_layout(pixels: Floats, ids: Ints, board: Board) -> str | None:
    """The number of columns and the layout that explain the markers, if not those stated."""
    if len(ids) < 4:
        return None
    share = board.marker_m / board.pitch_m
    best: tuple[float, int, bool] | None = None
    for columns in range(3, _WIDEST):
        for legacy in (False, True):
            off = _layout_error(pixels, ids, columns, share, legacy)
            if best is None or off < 0.5 * best[0]:
                best = (off, columns, legacy)
    stated = _layout_error(pixels, ids, board.columns, share, board.legacy and board.rows % 2 == 0)
    assert best is not None
    if stated <= _FLAT or best[0] > _FLAT:
        return _too_many(ids, board)
    turned = " in the layout of OpenCV before 4.6 (legacy: true)" if best[2] else ""
    return f"another board: its markers stand as on {best[1]} columns{turned}, not {board.columns}"


def _too_many(ids: Ints, board: Board) -> str | None:
    beyond = ids[ids >= board.marker_count]
    if len(beyond) < 3:  # one may be a marker on something else
        return None
    return (
        f"another board: it has a marker {int(beyond.max())}, the stated one ends at {board.marker_count - 1}"
    )


def _layout_error(pixels: Floats, ids: Ints, columns: int, share: float, legacy: bool) -> float:
    """How far the markers lie off a board of so many columns, 90th percentile, in squares."""
    # white squares of two rows hold `columns` markers; the first row starts at square 1, with legacy at 0
    pair, rest = ids // columns, ids % columns
    first = (columns + legacy) // 2
    below = rest >= first
    column = np.where(below, 2 * (rest - first) + legacy, 2 * rest + 1 - legacy)
    row = 2 * pair + below
    centres = np.column_stack([column, row]) + 0.5
    corners = 0.5 * share * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    model = (centres[:, None] + corners[None]).reshape(-1, 2)
    found, _ = cv2.findHomography(model, pixels.reshape(-1, 2), cv2.LMEDS)
    if np.size(found) != 9:  # None where there is no answer, which the type does not say
        return float("inf")
    there = cv2.perspectiveTransform(model.reshape(-1, 1, 2), found).reshape(-1, 2)
    side = float(np.median(np.linalg.norm(pixels[:, 0] - pixels[:, 1], axis=1))) / share
    return float(np.percentile(np.linalg.norm(there - pixels.reshape(-1, 2), axis=1), 90)) / max(side, 1e-6)


# ------------------------------------------------------------------------------ chessboards


def _no_chessboard(grey: Grey, board: Board) -> str:
    grids = []
    for least in ((3, 3), (5, 4), (7, 5)):
        found, _, meta = cv2.findChessboardCornersSBWithMeta(grey, least, cv2.CALIB_CB_LARGER)
        if found and np.ndim(meta) == 2:
            grids.append(np.shape(meta))
    if grids:
        rows, columns = max(grids, key=lambda grid: grid[0] * grid[1])
        seen, stated = sorted((columns + 1, rows + 1)), sorted((board.columns, board.rows))
        if seen[0] > stated[0] or seen[1] > stated[1]:
            return (
                f"another board: {columns + 1} x {rows + 1} squares can be counted, stated are "
                f"{board.columns} x {board.rows} (squares, not inner corners)"
            )
        return (
            f"cut: {columns + 1} x {rows + 1} of {board.columns} x {board.rows} squares can be counted; "
            "all must "
            "be in the picture (or the board has fewer than stated)"
        )
    return "no board is seen: a part is outside the picture or covered, or it is small, dark or blurred"


def _goes_on(grey: Grey, corners: Corners, board: Board) -> str | None:
    """Whether the pattern of a chessboard goes on beyond its stated edge."""
    across, down = board.columns - 1, board.rows - 1
    points = corner_points(board, corners.ids)[:, :2] / board.pitch_m
    found, _ = cv2.findHomography(points, corners.pixels)
    if np.size(found) != 9:  # None where there is no answer, which the type does not say
        return None
    outside = {
        "left": [(0.0, j + 1.0) for j in range(down)],
        "right": [(across + 1.0, j + 1.0) for j in range(down)],
        "top": [(i + 1.0, 0.0) for i in range(across)],
        "bottom": [(i + 1.0, down + 1.0) for i in range(across)],
    }
    height, width = grey.shape
    for places in outside.values():
        at = np.array(places)
        diagonals = []
        for pair in (((-0.3, -0.3), (0.3, 0.3)), ((-0.3, 0.3), (0.3, -0.3))):
            for shift in pair:
                there = cv2.perspectiveTransform((at + shift).reshape(-1, 1, 2), found).reshape(-1, 2)
                u, v = np.rint(there[:, 0]).astype(int), np.rint(there[:, 1]).astype(int)
                inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
                tone = np.full(len(at), np.nan)
                tone[inside] = grey[v[inside], u[inside]]
                diagonals.append(tone)
        first = np.minimum(diagonals[0], diagonals[1]) - np.maximum(diagonals[2], diagonals[3])
        second = np.minimum(diagonals[2], diagonals[3]) - np.maximum(diagonals[0], diagonals[1])
        saddle = np.maximum(first, second) > 0.4 * corners.contrast
        known = ~np.isnan(first)
        if known.sum() >= 3 and saddle[known].mean() > 0.7:
            return (
                f"another board: its squares go on beyond the stated {board.columns} x {board.rows} (squares "
                "are counted, not inner corners)"
            )
    return None
