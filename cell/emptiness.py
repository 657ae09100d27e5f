"""Is the bin empty, or does something lie there that the detector cannot make a part of?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from cell.config import WorkspaceConfig
from vision import transforms
from vision.stereo import project, rectification, unrectify_points
from vision.types import Bools, CameraModel, Candidate, Floats, Plane, Refusal, Scene, StereoModel, Transform

_RIM_M: Final = 0.005
"""Nearer to the edge of the workspace box than this, a line may be the rim of the tray."""
_SHARE: Final = 0.5
"""What is shorter than this share of a part is a speck."""
_STEPS: Final = 200


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Where:
    """Cameras, table and box of one cell."""

    stereo: StereoModel
    table: Plane
    base_from_camera: Transform
    workspace: WorkspaceConfig


def is_empty(
    scene: Scene,
    length_m: float,
    stereo: StereoModel,
    table: Plane,
    base_from_camera: Transform,
    workspace: WorkspaceConfig,
) -> bool:
    """True when nothing was seen that could be a part of this length.

    That is: inside the workspace box no candidate of which both flanks are seen, no segment in space of half
    a part's length, and no line of the left skeleton graph that would be half as long if it lay on the table.
    The last is what a heap shows in which no part could be told from the next. Edges of the tray and of its
    shadow have one flank: they make candidates, but not of anything that can be picked.
    """
    least_m = _SHARE * length_m
    where = _Where(stereo=stereo, table=table, base_from_camera=base_from_camera, workspace=workspace)
    if any(
        not _edge_only(candidate) and _box_share(candidate.start, candidate.end, where) >= _SHARE
        for candidate in scene.candidates
    ):
        return False
    edges = [np.stack([c.start, c.end]) for c in scene.candidates if _edge_only(c)]
    for start, end in zip(scene.segments.start, scene.segments.end, strict=True):
        ends = np.stack([start, end])
        if any(np.allclose(ends, edge, atol=1e-9) for edge in edges):
            continue
        if _box_share(start, end, where) * float(np.linalg.norm(end - start)) >= least_m:
            return False
    return not any(
        _inside_m(path, scene, stereo, table, base_from_camera, workspace) >= least_m
        for path in scene.left.graph.paths
    )


def _edge_only(candidate: Candidate) -> bool:
    return any(refused.reason is Refusal.FLANKS for refused in candidate.refusals)


def _box_share(start: Floats, end: Floats, where: _Where) -> float:
    """Share of a line in space, left camera frame, that is seen in front of the table inside the box.

    The rim of the tray is seen in front of what lies outside it, however badly its depth is known.
    """
    share = np.linspace(0.0, 1.0, _STEPS + 1)[:, None]
    pixels = project(start + share * (end - start), where.stereo)[0]
    met = on_plane(pixels, where.stereo.left, where.table)
    inside = in_box(transforms.apply(where.base_from_camera, met)[:, :2], where.workspace)
    return float(np.count_nonzero(inside[:-1] & inside[1:])) / _STEPS


def in_box(points_m: Floats, workspace: WorkspaceConfig) -> Bools:
    """(N,) of points (N, 2) m, base frame: inside the box and not at its rim."""
    low = np.array(workspace.box_min_m[:2]) + _RIM_M
    high = np.array(workspace.box_max_m[:2]) - _RIM_M
    return np.asarray(((points_m >= low) & (points_m <= high)).all(axis=1), dtype=np.bool_)


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
    inside = in_box(points, workspace)
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
