"""Geometry of the camera pair: rectify pictures or points, triangulate, project, depth bounds.

Rectified pixels belong to two ideal cameras that look the same way with one focal length, so that a point of
space has the same row in both. Results in space are in the raw (not rectified) left camera frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from vision.types import CameraModel, Floats, Grey, Plane, StereoModel, read_only

Side = Literal["left", "right"]

MAX_GROWTH = 2.0
"""A rectified picture larger than this many times the raw one means cameras that look too far apart."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rectification:
    """Everything that turns the raw pair into the ideal one.

    ``rect_from_left``, ``rect_from_right`` (3, 3) rotations from the raw camera frames to the common
    rectified orientation; ``focal_px`` of both ideal cameras; ``left_centre_px``, ``right_centre_px`` (2,)
    principal points (same row); ``baseline_m`` > 0; ``width_px``, ``height_px`` of the rectified pictures;
    ``left_maps``, ``right_maps`` the look-up tables of ``cv2.remap``.
    """

    stereo: StereoModel
    rect_from_left: Floats
    rect_from_right: Floats
    focal_px: float
    left_centre_px: Floats
    right_centre_px: Floats
    baseline_m: float
    width_px: int
    height_px: int
    left_maps: tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]
    right_maps: tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]


# A pure function of a frozen record: remembering its answer is not shared state anybody can see.
@lru_cache(maxsize=4)
def rectification(stereo: StereoModel) -> Rectification:
    """Rectify a calibrated pair, losing nothing of either raw picture.

    The rotations are those of ``cv2.stereoRectify``. The canvas is our own: OpenCV's ``alpha`` either cuts
    the corners off (0) or shrinks the picture to fit (1), which loses resolution; here the scale stays that
    of the raw pictures and the canvas grows instead until the border of both raw pictures lies inside.

    Raises
    ------
    ValueError
        Pictures of two sizes, cameras above each other, swapped, or looking too far apart.
    """
    left, right = stereo.left, stereo.right
    size = (left.width_px, left.height_px)
    if size != (right.width_px, right.height_px):
        raise ValueError(
            f"the two cameras are calibrated for different sizes: {size} and "
            f"{(right.width_px, right.height_px)}"
        )
    shift = stereo.right_from_left.translation
    r1, r2, _, p2, *_ = cv2.stereoRectify(
        left.matrix, left.distortion, right.matrix, right.distortion, size,
        stereo.right_from_left.rotation, shift.reshape(3, 1), flags=0, alpha=0,
    )  # fmt: skip
    along_u, along_v = float(p2[0, 3]), float(p2[1, 3])
    if abs(along_v) > abs(along_u):
        raise ValueError("the cameras stand above each other; they must stand side by side")
    if along_u >= 0:
        raise ValueError("left and right camera are swapped")
    focal = float(np.mean([left.matrix[0, 0], left.matrix[1, 1], right.matrix[0, 0], right.matrix[1, 1]]))
    rotations = (np.asarray(r1, dtype=np.float64), np.asarray(r2, dtype=np.float64))
    boxes = [_border_box(camera, turn) for camera, turn in zip((left, right), rotations, strict=True)]
    top = min(box[1] for box in boxes) * focal
    bottom = max(box[3] for box in boxes) * focal
    width = int(np.ceil(max(box[2] - box[0] for box in boxes) * focal)) + 1
    height = int(np.ceil(bottom - top)) + 1
    if width > MAX_GROWTH * size[0] or height > MAX_GROWTH * size[1]:
        raise ValueError(f"the cameras look too far apart: rectified pictures would be {width} x {height}")
    centres = [np.array([-box[0] * focal, -top]) for box in boxes]
    maps = []
    for camera, turn, centre in zip((left, right), rotations, centres, strict=True):
        ideal = _ideal_matrix(focal, centre)
        map_u, map_v = cv2.initUndistortRectifyMap(
            camera.matrix, camera.distortion, turn, ideal, (width, height), cv2.CV_32FC1
        )
        maps.append((np.asarray(map_u, dtype=np.float32), np.asarray(map_v, dtype=np.float32)))
    return Rectification(
        stereo=stereo,
        rect_from_left=read_only(rotations[0]),
        rect_from_right=read_only(rotations[1]),
        focal_px=focal,
        left_centre_px=read_only(centres[0]),
        right_centre_px=read_only(centres[1]),
        baseline_m=float(np.linalg.norm(shift)),
        width_px=width,
        height_px=height,
        left_maps=maps[0],
        right_maps=maps[1],
    )


def rectify_pictures(left: Grey, right: Grey, rect: Rectification) -> tuple[Grey, Grey]:
    """Both grey pictures (H, W) as the ideal cameras see them; black where a raw picture shows nothing."""
    pictures = []
    for grey, maps in ((left, rect.left_maps), (right, rect.right_maps)):
        moved = cv2.remap(
            grey, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0
        )
        pictures.append(np.asarray(moved, dtype=np.uint8))
    return pictures[0], pictures[1]


def rectify_points(points_px: npt.ArrayLike, rect: Rectification, side: Side) -> Floats:
    """Raw pixels (N, 2) of one camera as rectified pixels (N, 2)."""
    points = np.asarray(points_px, dtype=np.float64).reshape(-1, 2)
    left = side == "left"
    camera = rect.stereo.left if left else rect.stereo.right
    turn = rect.rect_from_left if left else rect.rect_from_right
    ideal = _ideal_matrix(rect.focal_px, rect.left_centre_px if left else rect.right_centre_px)
    return _undistort(points, camera, turn, ideal)


def unrectify_points(points_px: npt.ArrayLike, rect: Rectification, side: Side) -> Floats:
    """Rectified pixels (N, 2) of one camera as raw pixels (N, 2), distortion included."""
    points = np.asarray(points_px, dtype=np.float64).reshape(-1, 2)
    left = side == "left"
    turn = rect.rect_from_left if left else rect.rect_from_right
    centre = rect.left_centre_px if left else rect.right_centre_px
    rays = np.column_stack([(points - centre) / rect.focal_px, np.ones(len(points))]) @ turn
    return _project(rays, rect.stereo.left if left else rect.stereo.right)


def triangulate(left_px: npt.ArrayLike, right_px: npt.ArrayLike, rect: Rectification) -> Floats:
    """Points seen by both cameras, in space.

    Parameters
    ----------
    left_px, right_px : (N, 2) float
        Rectified pixels, row i of both showing the same point. The row used is the mean of both.

    Returns
    -------
    (N, 3) float
        Metres, raw left camera frame. Rows whose disparity is not positive are NaN.
    """
    left = np.asarray(left_px, dtype=np.float64).reshape(-1, 2)
    right = np.asarray(right_px, dtype=np.float64).reshape(-1, 2)
    depth = rectified_depth(left[:, 0], right[:, 0], rect)
    centre = rect.left_centre_px
    row = 0.5 * (left[:, 1] + right[:, 1])
    rays = np.column_stack(
        [(left[:, 0] - centre[0]) / rect.focal_px, (row - centre[1]) / rect.focal_px, np.ones(len(left))]
    )
    return np.asarray((rays * depth[:, None]) @ rect.rect_from_left, dtype=np.float64)


def rectified_depth(left_u_px: npt.ArrayLike, right_u_px: npt.ArrayLike, rect: Rectification) -> Floats:
    """Distance in m along the rectified viewing direction from two columns (any shape); NaN if not in front.

    Z = f B / d with d the column difference measured from the two principal points.
    """
    disparity = (np.asarray(left_u_px, dtype=np.float64) - rect.left_centre_px[0]) - (
        np.asarray(right_u_px, dtype=np.float64) - rect.right_centre_px[0]
    )
    depth = np.full(disparity.shape, np.nan)
    np.divide(rect.focal_px * rect.baseline_m, disparity, out=depth, where=disparity > 0)
    return depth


def project(points_m: npt.ArrayLike, stereo: StereoModel) -> tuple[Floats, Floats]:
    """Points (N, 3) m of the raw left camera frame as raw pixels (N, 2) of both cameras, with distortion.

    Points that are not in front of a camera are NaN there.
    """
    points = np.asarray(points_m, dtype=np.float64).reshape(-1, 3)
    motion = stereo.right_from_left
    return _project(points, stereo.left), _project(
        points @ motion.rotation.T + motion.translation, stereo.right
    )


def disparity_bounds_px(depth_m: tuple[float, float], rect: Rectification) -> tuple[float, float]:
    """Smallest and largest column difference, measured from the principal points, for rectified depths."""
    near, far = depth_m
    _check_range(near, far)
    return rect.focal_px * rect.baseline_m / far, rect.focal_px * rect.baseline_m / near


def depth_bounds_m(disparity_px: tuple[float, float], rect: Rectification) -> tuple[float, float]:
    """The inverse of `disparity_bounds_px`."""
    small, large = disparity_px
    _check_range(small, large)
    return rect.focal_px * rect.baseline_m / large, rect.focal_px * rect.baseline_m / small


def depth_range(stereo: StereoModel, table: Plane, height_m: tuple[float, float]) -> tuple[float, float]:
    """Least and greatest z in the left camera frame of anything in the picture within the heights.

    The rays through the border of the left picture meet the two planes at the given heights above the table;
    between them z is bounded by its values on the border, because a plane has its extremes at its rim.

    Raises
    ------
    ValueError
        The heights are out of order, or a ray of the picture does not meet the table in front of the camera.
    """
    low, high = height_m
    if not low < high:
        raise ValueError(f"heights must be given low, high: {height_m}")
    camera = stereo.left
    border = _undistort(_border_points(camera), camera, np.eye(3), np.eye(3))
    rays = np.column_stack([border, np.ones(len(border))])
    falling = rays @ table.normal
    if not np.all(falling < 0):
        raise ValueError("the camera does not look down on the whole table: the horizon is in the picture")
    depths = np.concatenate([(height - table.offset_m) / falling for height in (low, high)])
    if not np.all(depths > 0):
        raise ValueError(f"the height range {height_m} m reaches the camera")
    return float(depths.min()), float(depths.max())


def _check_range(low: float, high: float) -> None:
    if not 0 < low < high:
        raise ValueError(f"bounds must be positive and in order: ({low}, {high})")


def _ideal_matrix(focal_px: float, centre_px: Floats) -> Floats:
    return np.array([[focal_px, 0.0, centre_px[0]], [0.0, focal_px, centre_px[1]], [0.0, 0.0, 1.0]])


def _border_points(camera: CameraModel, count: int = 33) -> Floats:
    u = np.linspace(0, camera.width_px - 1, count)
    v = np.linspace(0, camera.height_px - 1, count)
    top, side = np.zeros(count), np.zeros(count)
    rim = [(u, top), (u, top + camera.height_px - 1), (side, v), (side + camera.width_px - 1, v)]
    return np.concatenate([np.column_stack(pair) for pair in rim])


def _border_box(camera: CameraModel, rect_from_camera: Floats) -> tuple[float, float, float, float]:
    """Left, top, right, bottom of the raw picture in rectified coordinates at focal length one."""
    rim = _undistort(_border_points(camera), camera, rect_from_camera, np.eye(3))
    (left, top), (right, bottom) = rim.min(axis=0), rim.max(axis=0)
    return float(left), float(top), float(right), float(bottom)


def _undistort(points_px: Floats, camera: CameraModel, turn: Floats, ideal: Floats) -> Floats:
    if len(points_px) == 0:
        return np.zeros((0, 2))
    # the default of five rounds leaves hundredths of a pixel in the corners
    until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-9)
    moved = cv2.undistortPointsIter(
        points_px.reshape(-1, 1, 2), camera.matrix, camera.distortion, turn, ideal, until
    )
    return np.asarray(moved, dtype=np.float64).reshape(-1, 2)


def _project(points_m: Floats, camera: CameraModel) -> Floats:
    if len(points_m) == 0:
        return np.zeros((0, 2))
    seen = points_m[:, 2] > 0
    still = np.zeros((3, 1))
    pixels = np.full((len(points_m), 2), np.nan)
    if seen.any():
        found = cv2.projectPoints(
            points_m[seen].reshape(-1, 1, 3), still, still, camera.matrix, camera.distortion
        )
        pixels[seen] = np.asarray(found[0], dtype=np.float64).reshape(-1, 2)
    return pixels
