"""Is the bin empty, or does something lie there that the detector cannot make a part of?"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from cell.config import WorkspaceConfig
from vision import transforms
from vision.stereo import rectification, unrectify_points
from vision.types import CameraModel, Floats, Plane, Scene, StereoModel, Transform

_RIM_M: Final = 0.005
"""Nearer to the edge of the workspace box than this, a line may be the rim of the tray."""
_SHARE: Final = 0.5
"""What is shorter than this share of a part is a speck."""


def is_empty(
    scene: Scene,
    length_m: float,
    stereo: StereoModel,
    table: Plane,
    base_from_camera: Transform,
    workspace: WorkspaceConfig,
) -> bool:
    """True when nothing was seen that could be a part of this length.

    That is: no candidate, no segment in space of half its length, and no line of the left skeleton graph
    that would be half as long if it lay on the table inside the workspace box. The last is what a heap shows
    in which no part could be told from the next.
    """
    if scene.candidates:
        return False
    least_m = _SHARE * length_m
    lengths = np.linalg.norm(scene.segments.end - scene.segments.start, axis=1)
    if bool((lengths >= least_m).any()):
        return False
    return not any(
        _inside_m(path, scene, stereo, table, base_from_camera, workspace) >= least_m
        for path in scene.left.graph.paths
    )


def _inside_m(
    path_px: Floats,
    scene: Scene,
    stereo: StereoModel,
    table: Plane,
    base_from_camera: Transform,
    workspace: WorkspaceConfig,
) -> float:
    """Length (m) of the part of a line that lies in the box, were it on the table."""
    if scene.method == "published":
        path_px = unrectify_points(path_px, rectification(stereo), "left")
    points = transforms.apply(base_from_camera, on_plane(path_px, stereo.left, table))[:, :2]
    low = np.array(workspace.box_min_m[:2]) + _RIM_M
    high = np.array(workspace.box_max_m[:2]) - _RIM_M
    inside = np.asarray(((points >= low) & (points <= high)).all(axis=1), dtype=np.bool_)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return float(steps[inside[:-1] & inside[1:]].sum())


def on_plane(points_px: Floats, camera: CameraModel, plane: Plane) -> Floats:
    """Where the rays of raw pixels (N, 2) meet a plane; (N, 3) m, that camera's frame.

    Rays that do not meet it in front of the camera give NaN.
    """
    slopes = cv2.undistortPoints(points_px.reshape(-1, 1, 2), camera.matrix, camera.distortion).reshape(-1, 2)
    rays = np.column_stack([slopes, np.ones(len(slopes))])
    towards = rays @ plane.normal
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = -plane.offset_m / towards
    depth[~(depth > 0)] = np.nan
    return np.asarray(rays * depth[:, None], dtype=np.float64)
