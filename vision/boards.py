"""Calibration boards in pictures: where the corners of the squares are, how sharp, where the board lies.

The frame of a board: origin at the outer top-left corner of the printed squares, x along the columns, y down
the rows, z into the board; the square at the origin is black. Inner corner k stands at
``((k % (columns - 1) + 1) * pitch, (k // (columns - 1) + 1) * pitch, 0)``: the numbering of OpenCV's
`CharucoBoard`, which a chessboard shares here.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from vision.transforms import make, rotation_distance_rad
from vision.types import CameraModel, Floats, Grey, Ints, Transform, read_only

Kind = Literal["charuco", "chessboard"]

DICTIONARIES: Final[tuple[str, ...]] = tuple(
    f"DICT_{bits}X{bits}_{count}" for bits in (4, 5, 6, 7) for count in (50, 100, 250, 1000)
)
"""Marker families a board may be printed with, by OpenCV's names."""

_SETTLED_PX: Final = 1e-4
_SAME_POSE_RAD: Final = 0.01
_ALONG: Final = np.linspace(0.3, 0.7, 9)
"""Where along the side of a square its edge is looked at: away from the corners."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """A flat board of black and white squares; a ChArUco board has a marker in each white one.

    ``columns``, ``rows`` count squares, not inner corners; ``pitch_m`` is the side of a square, ``marker_m``
    of a marker. ``legacy``: the layout OpenCV printed before 4.6 (differs where the number of rows is even).
    """

    kind: Kind
    columns: int
    rows: int
    pitch_m: float
    marker_m: float = 0.0
    dictionary: str = ""
    legacy: bool = False

    def __post_init__(self) -> None:
        if self.columns < 3 or self.rows < 3:
            raise ValueError(f"a board of {self.columns} x {self.rows} squares is too small; 3 x 3 at least")
        if not 0.0 < self.pitch_m < 1.0:
            raise ValueError(f"a pitch of {self.pitch_m} m is none of a board; metres are expected")
        if self.kind == "charuco":
            if self.dictionary not in DICTIONARIES:
                raise ValueError(f"no marker family {self.dictionary!r}; one of {', '.join(DICTIONARIES)}")
            if not 0.0 < self.marker_m < self.pitch_m:
                raise ValueError(
                    f"a marker of {self.marker_m} m does not fit a square of {self.pitch_m} m with a margin"
                )
            if self.marker_count > (held := int(self.dictionary.rsplit("_", 1)[1])):
                raise ValueError(
                    f"{self.columns} x {self.rows} squares need {self.marker_count} markers, "
                    f"{self.dictionary} has {held}"
                )

    @property
    def marker_count(self) -> int:
        """Markers on a ChArUco board: one in each white square."""
        return self.columns * self.rows // 2

    @property
    def corner_count(self) -> int:
        """Inner corners."""
        return (self.columns - 1) * (self.rows - 1)

    @property
    def half_turn(self) -> bool:
        """Whether the board looks the same upside down: its corners cannot be told from view to view."""
        return self.kind == "chessboard" and (self.columns + self.rows) % 2 == 0

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height of the squares together."""
        return self.columns * self.pitch_m, self.rows * self.pitch_m


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Corners:
    """Inner corners of a board found in one picture.

    ``ids`` (N,) rising; ``pixels`` (N, 2) to a fraction of a pixel. ``spacing_px``: median distance of
    neighbours. ``edge_px``: how many pixels the edge of a square takes from black to white, in the worse of
    the two directions; about 1.5 to 2.5 in a sharp picture. ``contrast``: white minus black, in grey values.
    ``width_px``, ``height_px`` of the picture.
    """

    ids: Ints
    pixels: Floats
    spacing_px: float
    edge_px: float
    contrast: float
    width_px: int
    height_px: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardPose:
    """Where a board lies: ``camera_from_board``, and the error ``rms_px`` of its corners there.

    ``rival_rms_px`` is the error of the other pose a flat board may be seen in (its mirror image in depth);
    near ``rms_px`` the tilt is not certain. Infinite where there is no other.
    """

    camera_from_board: Transform
    rms_px: float
    rival_rms_px: float


def corner_points(board: Board, ids: npt.ArrayLike | None = None) -> Floats:
    """(N, 3) m in the frame of the board, of the corners named, or of all."""
    numbers = np.arange(board.corner_count) if ids is None else np.asarray(ids, np.int64).reshape(-1)
    across = board.columns - 1
    points = np.zeros((len(numbers), 3))
    points[:, 0] = (numbers % across + 1) * board.pitch_m
    points[:, 1] = (numbers // across + 1) * board.pitch_m
    return points


def detect(grey: Grey, board: Board) -> Corners | None:
    """The inner corners of a board in a picture, None where it is not seen.

    Of a ChArUco board some corners are enough; of a chessboard all must be in the picture.
    """
    found = _charuco(grey, board) if board.kind == "charuco" else _chessboard(grey, board)
    if found is None:
        return None
    ids, pixels = found
    spacing = spacing_px(ids, pixels, board)
    if spacing is None:
        return None
    # As wide a window as fits between the corners: noise falls with its area. But beside the corners of a
    # ChArUco board stand those of the markers, which draw corners to themselves when they are in the window.
    if board.kind == "charuco":
        half = int(np.clip(0.4 * (1.0 - board.marker_m / board.pitch_m) * spacing, 2, 5))
    else:
        half = int(np.clip(0.3 * spacing, 2, 7))
    fine = cv2.cornerSubPix(
        grey,
        np.ascontiguousarray(pixels.reshape(-1, 1, 2), dtype=np.float32),
        (half, half),
        (-1, -1),
        (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 50, _SETTLED_PX),
    )
    pixels = np.asarray(fine, dtype=np.float64).reshape(-1, 2)
    height, width = grey.shape
    edge, contrast = _edges(grey, ids, pixels, board, spacing)
    return Corners(
        ids=read_only(ids),
        pixels=read_only(pixels),
        spacing_px=spacing,
        edge_px=edge,
        contrast=contrast,
        width_px=width,
        height_px=height,
    )


def board_pose(corners: Corners, board: Board, camera: CameraModel) -> BoardPose:
    """The pose of a board from its corners in one picture of a calibrated camera.

    Both solutions of the flat problem (Collins and Bartoli, "Infinitesimal plane-based pose estimation",
    2014) are refined on the reprojection error; the better one is returned.

    Raises
    ------
    ValueError
        Fewer than four corners, or all on a line.
    """
    points = corner_points(board, corners.ids)
    if len(points) < 4 or np.ptp(points[:, 0]) == 0 or np.ptp(points[:, 1]) == 0:
        raise ValueError("the pose of a board needs at least four corners that are not on one line")
    pixels = corners.pixels
    _, turns, shifts, _ = cv2.solvePnPGeneric(
        points, pixels, camera.matrix, camera.distortion, flags=cv2.SOLVEPNP_IPPE
    )
    answers: list[tuple[float, Transform]] = []
    for turn, shift in zip(turns, shifts, strict=True):
        turn, shift = cv2.solvePnPRefineLM(points, pixels, camera.matrix, camera.distortion, turn, shift)
        seen, _ = cv2.projectPoints(points, turn, shift, camera.matrix, camera.distortion)
        off = pixels - np.asarray(seen, dtype=np.float64).reshape(-1, 2)
        rms = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
        if np.isfinite(rms) and float(np.asarray(shift).reshape(-1)[2]) > 0:
            answers.append((rms, make(np.asarray(turn).reshape(3), shift)))
    if not answers:
        raise ValueError("no pose of the board explains its corners")
    answers.sort(key=lambda answer: answer[0])
    rms, pose = answers[0]
    rivals = [
        answer[0]
        for answer in answers[1:]
        if rotation_distance_rad(answer[1].rotation, pose.rotation) > _SAME_POSE_RAD
    ]
    return BoardPose(
        camera_from_board=pose,
        rms_px=rms,
        rival_rms_px=min(rivals, default=float("inf")),
    )


def neighbours(ids: Ints, board: Board) -> tuple[Ints, Ints]:
    """Places in ``ids`` of corners that stand side by side: (P, 2) along rows, (Q, 2) along columns."""
    across = board.columns - 1
    place = np.full(board.corner_count, -1, dtype=np.int64)
    place[ids] = np.arange(len(ids))
    grid = place.reshape(board.rows - 1, across)
    pairs = []
    for first, second in ((grid[:, :-1], grid[:, 1:]), (grid[:-1], grid[1:])):
        both = np.column_stack([first.ravel(), second.ravel()])
        pairs.append(both[(both >= 0).all(axis=1)])
    return pairs[0], pairs[1]


def spacing_px(ids: Ints, pixels: Floats, board: Board) -> float | None:
    """Median distance of neighbouring corners; None where no two are."""
    pairs = np.concatenate(neighbours(ids, board))
    if not len(pairs):
        return None
    return float(np.median(np.linalg.norm(pixels[pairs[:, 0]] - pixels[pairs[:, 1]], axis=1)))


@lru_cache(maxsize=16)
def charuco(board: Board) -> cv2.aruco.CharucoBoard:
    """The board as OpenCV knows it, in metres."""
    family = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    known = cv2.aruco.CharucoBoard((board.columns, board.rows), board.pitch_m, board.marker_m, family)
    known.setLegacyPattern(board.legacy)
    return known


def _charuco(grey: Grey, board: Board) -> tuple[Ints, Floats] | None:
    pixels, ids, _, _ = cv2.aruco.CharucoDetector(charuco(board)).detectBoard(grey)
    if ids is None or len(ids) < 4:
        return None
    numbers = np.asarray(ids, dtype=np.int64).reshape(-1)
    order = np.argsort(numbers)
    return numbers[order], np.asarray(pixels, dtype=np.float64).reshape(-1, 2)[order]


def _chessboard(grey: Grey, board: Board) -> tuple[Ints, Floats] | None:
    size = (board.columns - 1, board.rows - 1)
    found, pixels = cv2.findChessboardCorners(
        grey, size, flags=cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    )
    if not found:
        found, pixels = cv2.findChessboardCornersSB(grey, size)
    if not found:
        return None
    grid: Floats = np.asarray(pixels, dtype=np.float64).reshape(size[1], size[0], 2)
    return np.arange(board.corner_count), _upright(grey, grid, board).reshape(-1, 2)


def _upright(grey: Grey, grid: Floats, board: Board) -> Floats:
    """Corners (rows, columns, 2) numbered from the black end of the board, seen from its front."""
    along: Floats = (grid[:, -1] - grid[:, 0]).mean(axis=0)
    down: Floats = (grid[-1] - grid[0]).mean(axis=0)
    if float(np.linalg.det(np.stack([along, down]))) < 0:
        grid = grid[:, ::-1]
        along = -along
    if board.half_turn:
        # nothing tells the two ends apart; two cameras side by side at least agree on this
        return grid[::-1, ::-1] if along[0] < 0 else grid
    # squares between four corners, black where their place is even counted from the black end
    middles = (grid[:-1, :-1] + grid[:-1, 1:] + grid[1:, :-1] + grid[1:, 1:]) / 4.0
    high, wide = board.rows - 2, board.columns - 2
    tones = _sample(grey, middles.reshape(-1, 2)).reshape(high, wide)
    even = np.add.outer(np.arange(high), np.arange(wide)) % 2 == 0
    return grid if tones[even].mean() < tones[~even].mean() else grid[::-1, ::-1]


def _edges(grey: Grey, ids: Ints, pixels: Floats, board: Board, spacing: float) -> tuple[float, float]:
    """Width in px of the edges between neighbours, worse direction, and contrast in grey values.

    Of an edge that is a step under a blur, contrast over steepest slope is 2.5 times the blur's sigma, which
    is what it takes from a tenth to nine tenths.
    """
    reach = max(2.0, min(8.0, 0.35 * spacing))
    step = 0.5
    offsets = np.arange(-reach, reach + step / 2, step)
    widths, contrasts = [], []
    for pairs in neighbours(ids, board):
        if not len(pairs):
            continue
        start, end = pixels[pairs[:, 0]], pixels[pairs[:, 1]]
        along = end - start
        normal = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
        at = start[:, None] + along[:, None] * _ALONG[None, :, None]
        points = at[:, :, None] + normal[:, None, None] * offsets[None, None, :, None]
        tones = _sample(grey, points.reshape(-1, 2)).reshape(len(pairs), len(_ALONG), len(offsets))
        profile = tones.mean(axis=1)
        near = np.abs(offsets) <= max(2.0, min(reach, 0.2 * spacing))
        slope = np.abs(np.diff(profile, axis=1)).max(axis=1) / step
        contrast = np.ptp(profile[:, near], axis=1)
        contrasts.append(contrast)
        widths.append(float(np.median(contrast / np.maximum(slope, 1e-6))))
    return max(widths), float(np.median(np.concatenate(contrasts)))


def _sample(grey: Grey, points: Floats) -> Floats:
    """Grey values at (N, 2) px, between pixels linearly."""
    at = np.asarray(points, dtype=np.float64)
    values = ndimage.map_coordinates(grey, at[:, ::-1].T, output=np.float64, order=1, mode="nearest")
    return np.asarray(values, dtype=np.float64)
