"""A calibration board in the simulated cell: where it is, and which of its points are black.

Somebody clamps it in the jaws, lays it in the tray, or holds it before the cameras and keeps still for a
while here and there. It is paper on a plate: nothing collides with it.
"""

from __future__ import annotations

from enum import Enum
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from drivers.sim.geometry import Floats, pose_matrix, rotation_of
from drivers.sim.layout import BoardLayout, WorldLayout
from drivers.sim.optics import eyes

STILL_EXPOSURES: Final = 4
"""Whoever holds the board before the cameras moves on when so many pairs of it were taken: a slow machine
gets as many of each place as a fast one."""
TILT_RAD: Final = 0.6


class BoardPlace(Enum):
    """Where the board is. Values stand in requests and on the command line."""

    NOWHERE = "none"
    HAND = "hand"
    TRAY = "tray"
    WAVED = "waved"


def place_of(
    place: BoardPlace, world: WorldLayout, base_from_flange: Floats, exposures: int
) -> Floats | None:
    """``base_from_board`` (4, 4) at an instant; None where there is no board."""
    match place:
        case BoardPlace.NOWHERE:
            return None
        case BoardPlace.HAND:
            base_from_tool = base_from_flange @ pose_matrix(world.arm.tcp_m_rad)
            return np.asarray(base_from_tool @ pose_matrix(world.board.in_hand_m_rad))
        case BoardPlace.TRAY:
            tray = np.eye(4)
            tray[:3, 3] = world.tray.centre_m
            return np.asarray(tray @ pose_matrix(world.board.in_tray_m_rad))
        case BoardPlace.WAVED:
            return _stop(world, base_from_flange, exposures // STILL_EXPOSURES)


def _stop(world: WorldLayout, base_from_flange: Floats, number: int) -> Floats:
    """The ``number``-th place: about the point both eyes see in the middle, face towards them."""
    left, right = eyes(world.cameras)
    if world.cameras.mount == "tool":
        left, right = left.carried(base_from_flange), right.carried(base_from_flange)
    rng = np.random.default_rng(1000 + number)
    middle = 0.5 * (left.base_from_camera[:3, 3] + right.base_from_camera[:3, 3])
    width, height = (s * world.board.square_m for s in world.board.squares)
    far = rng.uniform(1.2, 2.1) * max(width, height)
    half_x, half_y = 0.5 * left.width_px / left.focal_px, 0.5 * left.height_px / left.focal_px
    # to the rim of the picture and a little beyond, in turn to all its sides
    angle = 2.399963 * number
    aside = np.array([np.cos(angle), np.sin(angle)]) * rng.uniform(0.2, 1.0)
    place = aside * np.maximum(0.0, np.array([half_x, half_y]) * far - 0.42 * np.array([width, height]))
    tilt = rng.uniform(-TILT_RAD, TILT_RAD, 2)
    turn = rotation_of(np.array([0.0, 0.0, rng.uniform(-0.4, 0.4)]))
    face = rotation_of(np.array([tilt[0], tilt[1], 0.0])) @ turn
    camera_from_board = np.eye(4)
    camera_from_board[:3, :3] = face
    camera_from_board[:3, 3] = np.array([*place, far]) - face @ np.array([0.5 * width, 0.5 * height, 0.0])
    both = left.base_from_camera.copy()
    both[:3, 3] = middle
    return np.asarray(both @ camera_from_board)


class Pattern:
    """The printed pattern. Markers by OpenCV's dictionaries, laid out as its boards are since 4.6: the first
    square black, markers in the white ones, counted along the rows."""

    def __init__(self, layout: BoardLayout) -> None:
        family: int = getattr(cv2.aruco, layout.dictionary)
        dictionary = cv2.aruco.getPredefinedDictionary(family)
        cells = int(dictionary.markerSize) + 2
        columns, rows = layout.squares
        self._layout = layout
        self._cells = cells
        self._black = np.zeros((rows, columns, cells, cells), dtype=np.bool_)
        number = 0
        for row in range(rows):
            for column in range(columns):
                if (row + column) % 2 == 0:
                    self._black[row, column] = True
                else:
                    marker = dictionary.generateImageMarker(number, cells, borderBits=1)
                    self._black[row, column] = np.asarray(marker) < 128
                    number += 1

    def black(self, x_m: Floats, y_m: Floats) -> npt.NDArray[np.bool_]:
        """Whether points of the board's plane are printed black."""
        layout = self._layout
        columns, rows = layout.squares
        column, row = np.floor(x_m / layout.square_m), np.floor(y_m / layout.square_m)
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        i = np.clip(row, 0, rows - 1).astype(np.int64)
        j = np.clip(column, 0, columns - 1).astype(np.int64)
        rim = 0.5 * (layout.square_m - layout.marker_m)
        size = layout.marker_m / self._cells
        a = np.floor((x_m - j * layout.square_m - rim) / size)
        b = np.floor((y_m - i * layout.square_m - rim) / size)
        within = (a >= 0) & (a < self._cells) & (b >= 0) & (b < self._cells)
        full = (i + j) % 2 == 0
        a = np.clip(a, 0, self._cells - 1).astype(np.int64)
        b = np.clip(b, 0, self._cells - 1).astype(np.int64)
        return np.asarray(inside & (full | (within & self._black[i, j, b, a])))
