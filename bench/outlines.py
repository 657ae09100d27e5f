"""The truth about a pile of straight parts, from where they lie: what shows, and who lies on whom."""

from __future__ import annotations

from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from bench.scoring import Crossing, TruePart, Truth
from vision.types import Bools, CameraModel, Floats, Plane, StereoModel

Ids: TypeAlias = npt.NDArray[np.int32]
"""(H, W): number of the part that a pixel shows, counted from 1; 0 where there is none."""

OVERLAP_DIAMETERS = 0.95
"""Parts whose axes come nearer than this in plan lie over each other; side by side on the table they are a
whole diameter apart."""
RISE_DIAMETERS = 0.25
"""The upper one is at least this much higher there."""
MARKS = 61
"""Points along an axis at which that is looked at."""


def truth_of(ends: Floats, diameter_m: float, stereo: StereoModel, table: Plane) -> tuple[Truth, Ids, Ids]:
    """The truth about straight parts.

    Parameters
    ----------
    ends
        (N, 2, 3) m, axis ends in the left camera frame.
    diameter_m
        Of all of them.

    Returns
    -------
    tuple
        The truth and which part each pixel of the left and the right picture shows.
    """
    shows, whole, inside = [], [], []
    moved = ends @ stereo.right_from_left.rotation.T + stereo.right_from_left.translation
    for camera, seen_from in ((stereo.left, ends), (stereo.right, moved)):
        ids, outline = draw_ids(seen_from, 0.5 * diameter_m, camera)
        shows.append(ids)
        whole.append(np.bincount(ids.ravel(), minlength=len(ends) + 1)[1:] / np.maximum(outline, 1))
        inside.append(_in_frame(seen_from, camera))
    over, at = lies_over(ends, diameter_m, table)
    above, below = np.nonzero(over.any(axis=2))
    middle = (np.linspace(0.0, 1.0, MARKS) > 1 / 3) & (np.linspace(0.0, 1.0, MARKS) < 2 / 3)
    parts = tuple(
        TruePart(
            ends=ends[j],
            edges=ends[j][None],
            visible=float(min(whole[0][j], whole[1][j])),
            in_frame=bool(inside[0][j] and inside[1][j]),
            pickable=not bool((over[:, j] & middle).any()),
            free=not bool(over[:, j].any()),
        )
        for j in range(len(ends))
    )
    crossings = tuple(
        Crossing(above=int(i), below=int(j), at=float(at[i, j]))
        for i, j in zip(above.tolist(), below.tolist(), strict=True)
    )
    return Truth(parts=parts, crossings=crossings), shows[0], shows[1]


def lies_over(ends: Floats, diameter_m: float, table: Plane) -> tuple[Bools, Floats]:
    """Where parts lie over others, seen along the table's normal.

    Returns
    -------
    tuple
        (N, N, MARKS) bool: part i lies over mark k of part j; and (N, N) float: the middle of those
        marks along part j, 0..1 (NaN: none).
    """
    count = len(ends)
    marks = np.linspace(0.0, 1.0, MARKS)
    height = ends @ table.normal + table.offset_m
    plan = ends - height[..., None] * table.normal
    over = np.zeros((count, count, MARKS), dtype=np.bool_)
    at = np.full((count, count), np.nan)
    for j in range(count):
        points = plan[j, 0] + marks[:, None] * (plan[j, 1] - plan[j, 0])
        heights = height[j, 0] + marks * (height[j, 1] - height[j, 0])
        way = plan[:, 1] - plan[:, 0]
        share = np.einsum("kic,ic->ik", points[:, None] - plan[None, :, 0], way)
        share = np.clip(share / np.einsum("ic,ic->i", way, way)[:, None], 0.0, 1.0)
        nearest = plan[:, None, 0] + share[..., None] * way[:, None]
        apart = np.linalg.norm(nearest - points, axis=2)
        rise = height[:, :1] + share * (height[:, 1:] - height[:, :1]) - heights
        over[:, j] = (apart < OVERLAP_DIAMETERS * diameter_m) & (rise > RISE_DIAMETERS * diameter_m)
        over[j, j] = False
        some = over[:, j].any(axis=1)
        at[some, j] = (over[some, j] * marks).sum(axis=1) / over[some, j].sum(axis=1)
    return over, at


def draw_ids(ends: Floats, radius_m: float, camera: CameraModel) -> tuple[Ids, npt.NDArray[np.int64]]:
    """Which straight part each pixel shows, and how many pixels each would show alone, (N,).

    ``ends`` (N, 2, 3) m in that camera's own frame. Outlines are straight between the projected ends: a lens
    bends a part by less than half a pixel.
    """
    height, width = camera.height_px, camera.width_px
    ids = np.zeros((height, width), np.int32)
    depth = np.full((height, width), np.inf)
    outline = np.zeros(len(ends), np.int64)
    for number, (start, end) in enumerate(ends, start=1):
        seen = project(np.stack([start, end]), camera)
        along = seen[1] - seen[0]
        length_px = max(float(np.linalg.norm(along)), 1e-6)
        along = along / length_px
        radius_px = radius_m * 0.5 * (camera.matrix[0, 0] + camera.matrix[1, 1]) / (0.5 * (start[2] + end[2]))
        low = np.maximum(np.floor(seen.min(axis=0) - radius_px), 0).astype(int)
        high = np.minimum(np.ceil(seen.max(axis=0) + radius_px) + 1, (width, height)).astype(int)
        if (low >= high).any():
            continue
        u, v = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
        du, dv = u - seen[0, 0], v - seen[0, 1]
        t = (du * along[0] + dv * along[1]) / length_px
        across = (dv * along[0] - du * along[1]) / radius_px
        covered = (t >= 0.0) & (t <= 1.0) & (np.abs(across) <= 1.0)
        outline[number - 1] = int(covered.sum())
        near = start[2] + t * (end[2] - start[2]) - radius_m * np.sqrt(np.maximum(0.0, 1.0 - across**2))
        patch = (slice(low[1], high[1]), slice(low[0], high[0]))
        nearer = covered & (near < depth[patch])
        ids[patch][nearer] = number
        depth[patch][nearer] = near[nearer]
    return ids, outline


def project(points: Floats, camera: CameraModel) -> Floats:
    """(N, 3) m in a camera's own frame to (N, 2) px of its raw picture."""
    seen, _ = cv2.projectPoints(
        points.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), camera.matrix, camera.distortion
    )
    return np.asarray(seen, np.float64).reshape(-1, 2)


def _in_frame(ends: Floats, camera: CameraModel) -> Bools:
    seen = project(ends.reshape(-1, 3), camera).reshape(-1, 2, 2)
    limit = np.array([camera.width_px - 1, camera.height_px - 1])
    return np.asarray(((seen >= 0.0) & (seen <= limit)).all(axis=(1, 2)))
