"""Calibration boards as a pair of cameras sees them, with projection code of their own."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from vision.boards import Board
from vision.types import CameraModel, Floats, Grey, StereoModel, Transform

FINE = 3
"""Rays per pixel, along each side."""
TONES = (60.0, 25.0, 215.0)
"""Ground, black, white."""
WIDTH, HEIGHT = 360, 270


def camera(fx: float, fy: float, cx: float, cy: float, distortion: tuple[float, ...]) -> CameraModel:
    """A small camera."""
    return CameraModel(
        matrix=np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]),
        distortion=np.array(distortion),
        width_px=WIDTH,
        height_px=HEIGHT,
    )


def rotation(x: float, y: float, z: float) -> Floats:
    """(3, 3) of turns about the axes, degrees."""
    a, b, c = np.deg2rad([x, y, z])
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    about_z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x, dtype=np.float64)


STEREO = StereoModel(
    left=camera(352.0, 353.0, 181.5, 132.0, (-0.09, 0.03, 0.0006, -0.0004, 0.0)),
    right=camera(348.0, 349.0, 176.0, 137.5, (-0.11, 0.05, -0.0005, 0.0007, 0.0)),
    right_from_left=Transform(
        rotation=rotation(0.8, -9.0, 0.5), translation=np.array([-0.074, 0.001, 0.006])
    ),
)

CHARUCO = Board(kind="charuco", columns=8, rows=6, pitch_m=0.022, marker_m=0.0165, dictionary="DICT_4X4_50")
CHESSBOARD = Board(kind="chessboard", columns=8, rows=7, pitch_m=0.020)


@dataclass(frozen=True, slots=True, kw_only=True)
class Placed:
    """A board in front of the cameras: tilts in degrees, the place of its middle in metres."""

    tilt: tuple[float, float, float]
    middle: tuple[float, float, float]


PLACES = tuple(
    Placed(tilt=tilt, middle=middle)
    for tilt, middle in (
        ((0, 0, 0), (0.035, 0.0, 0.34)),
        ((30, 0, 5), (0.035, 0.02, 0.35)),
        ((-32, 4, -4), (0.05, -0.02, 0.35)),
        ((0, 31, 3), (0.03, 0.02, 0.34)),
        ((3, -33, -6), (0.04, -0.01, 0.36)),
        ((22, 22, 8), (0.02, -0.03, 0.40)),
        ((-20, 24, -9), (0.08, -0.03, 0.41)),
        ((18, -25, 20), (0.02, 0.03, 0.42)),
        ((-24, -18, -15), (0.08, 0.04, 0.39)),
        ((5, 8, 90), (0.035, 0.0, 0.31)),
    )
)


def left_from_board(board: Board, placed: Placed) -> Floats:
    """(4, 4) of a placed board."""
    pose = np.eye(4)
    pose[:3, :3] = rotation(*placed.tilt)
    wide, high = board.size_m
    pose[:3, 3] = np.array(placed.middle) - pose[:3, :3] @ np.array([wide / 2, high / 2, 0.0])
    return pose


@lru_cache(maxsize=8)
def pattern(board: Board) -> tuple[Floats, float]:
    """The print with white around it, and its pixels per metre."""
    side = 80
    black = np.add.outer(np.arange(board.rows), np.arange(board.columns)) % 2 == 0
    flat = np.kron(np.where(black, 0.0, 255.0), np.ones((side, side)))
    if board.kind == "charuco":
        family = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
        wide = round(side * board.marker_m / board.pitch_m)
        edge = (side - wide) // 2
        # markers count along the rows, over the white squares
        for number, (row, column) in enumerate(zip(*np.nonzero(~black), strict=True)):
            y, x = row * side + edge, column * side + edge
            flat[y : y + wide, x : x + wide] = cv2.aruco.generateImageMarker(family, number, wide)
    around = side // 2
    return np.pad(flat, around, constant_values=255.0), side / board.pitch_m


@lru_cache(maxsize=4)
def _rays(eye: str) -> Floats:
    """(FH, FW, 2) slopes of the rays of a camera."""
    model = STEREO.left if eye == "left" else STEREO.right
    u, v = np.meshgrid(
        (np.arange(WIDTH * FINE) + 0.5) / FINE - 0.5, (np.arange(HEIGHT * FINE) + 0.5) / FINE - 0.5
    )
    m, (k1, k2, p1, p2, k3) = model.matrix, model.distortion
    x0, y0 = (u - m[0, 2]) / m[0, 0], (v - m[1, 2]) / m[1, 1]
    x, y = x0, y0
    for _ in range(12):
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        x = (x0 - 2 * p1 * x * y - p2 * (r2 + 2 * x * x)) / radial
        y = (y0 - p1 * (r2 + 2 * y * y) - 2 * p2 * x * y) / radial
    return np.stack([x, y], axis=-1)


def picture(board: Board, placed: Placed, eye: str, seed: int = 0, noise: float = 1.0) -> Grey:
    """What one camera sees of a placed board."""
    pose = left_from_board(board, placed)
    if eye == "right":
        step = np.eye(4)
        step[:3, :3], step[:3, 3] = STEREO.right_from_left.rotation, STEREO.right_from_left.translation
        pose = step @ pose
    rays = np.concatenate([_rays(eye), np.ones((HEIGHT * FINE, WIDTH * FINE, 1))], axis=-1)
    normal = pose[:3, 2]
    reach = (normal @ pose[:3, 3]) / (rays @ normal)
    at = (rays * reach[..., None] - pose[:3, 3]) @ pose[:3, :2]
    flat, per_m = pattern(board)
    shift = 40 - 0.5
    u, v = (at[..., 0] * per_m + shift).astype(np.float32), (at[..., 1] * per_m + shift).astype(np.float32)
    tone = cv2.remap(flat.astype(np.float32), u, v, cv2.INTER_LINEAR, borderValue=-1.0)
    outside = (u < 0) | (v < 0) | (u > flat.shape[1] - 1) | (v > flat.shape[0] - 1) | (reach <= 0)
    grey = np.where(outside, TONES[0], TONES[1] + tone / 255.0 * (TONES[2] - TONES[1]))
    small = grey.reshape(HEIGHT, FINE, WIDTH, FINE).mean(axis=(1, 3))
    blurred = cv2.GaussianBlur(small, (0, 0), 0.5)
    rough = blurred + np.random.default_rng([seed, eye == "left"]).normal(0.0, noise, blurred.shape)
    return np.asarray(np.clip(np.rint(rough), 0, 255), dtype=np.uint8)


@lru_cache(maxsize=64)
def pair(board: Board, number: int) -> tuple[Grey, Grey]:
    """Both pictures of a place of `PLACES`."""
    left, right = (picture(board, PLACES[number], eye, seed=number) for eye in ("left", "right"))
    return left, right
