"""Points to touch: the corners of a board that both cameras show, in space, spread as wide as they lie."""

from __future__ import annotations

import numpy as np

from vision.boards import Corners
from vision.stereo import rectification, rectify_points, triangulate
from vision.types import Floats, Ints, StereoModel


def corners_in_space(left: Corners, right: Corners, stereo: StereoModel) -> tuple[Ints, Floats]:
    """Numbers (N,) of the corners both pictures show, and where they are, (N, 3) m, left camera frame."""
    ids, a, b = np.intersect1d(left.ids, right.ids, return_indices=True)
    rect = rectification(stereo)
    points = triangulate(
        rectify_points(left.pixels[a], rect, "left"), rectify_points(right.pixels[b], rect, "right"), rect
    )
    good = np.isfinite(points).all(axis=1)
    return np.asarray(ids[good], dtype=np.int64), points[good]


def spread_out(points_m: Floats, count: int) -> Ints:
    """Places of ``count`` points (fewer if there are fewer) that lie far from each other: first the one
    farthest from the middle, then always the one farthest from those chosen."""
    if not len(points_m):
        return np.zeros(0, dtype=np.int64)
    away = np.linalg.norm(points_m - points_m.mean(axis=0), axis=1)
    chosen = [int(np.argmax(away))]
    nearest = np.linalg.norm(points_m - points_m[chosen[0]], axis=1)
    while len(chosen) < min(count, len(points_m)):
        chosen.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, np.linalg.norm(points_m - points_m[chosen[-1]], axis=1))
    return np.array(chosen, dtype=np.int64)
