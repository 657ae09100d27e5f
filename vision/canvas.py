"""One drawing area for both pictures of a pair, in rectified pixels with the same principal column.

On it a point of space has the same row in both pictures and its columns differ by the disparity
``d = x_left - x_right = f B / Z``. Pictures are not resampled: edges are found in raw pixels and their
places are moved here through coarse grids, because lens distortion is smooth and interpolated grey is
blurred grey.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from vision.jit import lean
from vision.stereo import Rectification, Side, rectification, rectify_points, unrectify_points
from vision.types import Floats, Plane, StereoModel, read_only

GRID_PX = 8
"""Spacing of the grids; bilinear between: right to 0.01 px for a webcam of ``k1 = -0.1``."""
LEAST_DISPARITY_PX = 0.5
SIDES: tuple[Side, Side] = ("left", "right")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Canvas:
    """The common drawing area and the way to it.

    ``focal_px``, ``baseline_m``, ``centre_px`` (2,) principal point of both ideal cameras; ``width_px``,
    ``height_px``; ``from_raw`` for each side (rows, columns, 2) where raw grid points lie on the canvas,
    ``to_raw`` the way back (canvas grid points in raw pixels); ``rect`` where it comes from.
    """

    rect: Rectification
    focal_px: float
    baseline_m: float
    centre_px: Floats
    width_px: int
    height_px: int
    from_raw: tuple[Floats, Floats]
    to_raw: tuple[Floats, Floats]


@lru_cache(maxsize=4)
def canvas(stereo: StereoModel) -> Canvas:
    """The canvas of a calibrated pair; see `vision.stereo.rectification` for the errors it raises."""
    rect = rectification(stereo)
    apart = float(rect.left_centre_px[0] - rect.right_centre_px[0])
    # rectified column + shift = canvas column, so that both principal points fall together
    shifts = (max(0.0, -apart), max(0.0, apart))
    width = rect.width_px + int(np.ceil(abs(apart)))
    from_raw, to_raw = [], []
    for side, shift in zip(SIDES, shifts, strict=True):
        camera = stereo.left if side == "left" else stereo.right
        raw = _grid(camera.width_px, camera.height_px)
        aside = np.array([shift, 0.0])
        moved = rectify_points(raw.reshape(-1, 2), rect, side) + aside
        from_raw.append(read_only(moved.reshape(raw.shape)))
        here = _grid(width, rect.height_px)
        back = unrectify_points(here.reshape(-1, 2) - aside, rect, side)
        to_raw.append(read_only(back.reshape(here.shape)))
    return Canvas(
        rect=rect,
        focal_px=rect.focal_px,
        baseline_m=rect.baseline_m,
        centre_px=read_only(rect.left_centre_px + np.array([shifts[0], 0.0])),
        width_px=width,
        height_px=rect.height_px,
        from_raw=(from_raw[0], from_raw[1]),
        to_raw=(to_raw[0], to_raw[1]),
    )


def _grid(width_px: int, height_px: int) -> Floats:
    columns = np.arange(0, width_px + 2 * GRID_PX, GRID_PX, dtype=np.float64)
    rows = np.arange(0, height_px + 2 * GRID_PX, GRID_PX, dtype=np.float64)
    return np.stack(np.meshgrid(columns, rows), axis=-1)


@lean
def through_grid(grid: Floats, x: float, y: float) -> tuple[float, float]:
    """A point through one of the canvas' grids; outside the picture the border cell is continued."""
    gx, gy = x / GRID_PX, y / GRID_PX
    i = min(max(int(gx), 0), grid.shape[1] - 2)
    j = min(max(int(gy), 0), grid.shape[0] - 2)
    fx, fy = gx - i, gy - j
    a, b, c, e = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy
    return (
        a * grid[j, i, 0] + b * grid[j, i + 1, 0] + c * grid[j + 1, i, 0] + e * grid[j + 1, i + 1, 0],
        a * grid[j, i, 1] + b * grid[j, i + 1, 1] + c * grid[j + 1, i, 1] + e * grid[j + 1, i + 1, 1],
    )


def points_through_grid(grid: Floats, points_px: Floats) -> Floats:
    """`through_grid` for (N, 2) points."""
    moved = np.array(points_px, np.float64, order="C")
    _move_through_grid(grid, moved)
    return moved


@lean
def _move_through_grid(grid: Floats, points_px: Floats) -> None:
    for row in range(len(points_px)):
        points_px[row] = through_grid(grid, points_px[row, 0], points_px[row, 1])


def in_space(ends_px: Floats, on: Canvas) -> Floats:
    """Canvas points with disparity (..., 3) as (x, y, d) to metres in the raw left camera frame."""
    depth = on.focal_px * on.baseline_m / np.maximum(ends_px[..., 2], LEAST_DISPARITY_PX)
    ray = np.empty_like(ends_px)
    ray[..., :2] = (ends_px[..., :2] - on.centre_px) / on.focal_px
    ray[..., 2] = 1.0
    return np.asarray((ray * depth[..., None]) @ on.rect.rect_from_left, np.float64)


def on_canvas(points_m: Floats, on: Canvas) -> Floats:
    """The inverse of `in_space`: (..., 3) m, raw left camera frame, to (x, y, d)."""
    turned = points_m @ on.rect.rect_from_left.T
    depth = turned[..., 2]
    pixels = np.empty_like(turned)
    pixels[..., :2] = on.focal_px * turned[..., :2] / depth[..., None] + on.centre_px
    pixels[..., 2] = on.focal_px * on.baseline_m / depth
    return pixels


def disparity_planes(
    on: Canvas, heights_m: tuple[float, ...], table: Plane | None, depth_m: tuple[float, float] | None
) -> Floats:
    """Disparity as a plane ``a x + b y + c`` of canvas pixels, one row for each height above the table.

    For X = Z x with x = ((x - cx) / f, (y - cy) / f, 1) and Z = f B / d its height is ``n @ X + o``; so at
    height h the disparity is ``f B (n @ x) / (h - o)``, linear in x and y. With a depth range instead of
    a table the rows are the constants of its far and near end and of what lies between.

    Returns
    -------
    (len(heights_m), 3) float
    """
    f, b = on.focal_px, on.baseline_m
    rows = []
    for place, height in enumerate(heights_m):
        if table is not None and depth_m is None:
            normal = on.rect.rect_from_left @ table.normal
            scale = f * b / (height - table.offset_m)
            slope = scale * normal[:2] / f
            rows.append([slope[0], slope[1], scale * normal[2] - float(slope @ on.centre_px)])
        else:
            assert depth_m is not None
            near, far = f * b / depth_m[0], f * b / depth_m[1]
            share = place / max(1, len(heights_m) - 1)
            rows.append([0.0, 0.0, far + share * (near - far)])
    return np.array(rows)
