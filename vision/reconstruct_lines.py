"""Two strands of one part, one in each picture, to its two ends in space.

Unknown are column u, row v and disparity d of either end in rectified pixels. Each picture says where
an end lies across its line (well) and along it (well for a free tip, hardly for a hidden one). All of
it is linear in the six unknowns, so many pairs are solved at once. Two weak beliefs, that parts lie
near the table and not steeply, decide only what the pictures leave open: a part along the baseline
with hidden tips.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vision.stereo import Rectification
from vision.strands import Strands
from vision.types import Floats, Ints, Plane, read_only

ROW_SIGMA_PX = 0.15
"""What calibration and lens leave between the rows of the two pictures."""
TILT_SHARES = (0.3, 0.06)
"""Parts whose ends differ in height by more than the first share of their length are rare; the second is
what is usual, and is believed where the pictures say next to nothing."""
UNKNOWN_DISPARITY_PX = 1.5
CAP_AWAY, CAP_TOWARDS = 0.7, 0.35
"""Where five lanes see an end, beyond the axis' end in units of ``R |cos(axis, ray)|``: for an end face that
looks away from the camera its far rim, less what blur takes; for one that looks towards it something between
the near rim of a dark face and the far rim of a bright one. Medians over 534 rendered tips, spread 0.17 px.
"""
DETERMINED_PX = 2.0
"""An end whose place along the axis is known better than this counts as seen."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Level:
    """Disparity of a height above the table: ``d = slope @ (u, v) + offset`` in rectified left pixels.

    ``slope`` (2,), ``offset`` px at the middle of the height range; ``half_px`` half the range in
    disparity; ``px_per_m`` disparity per metre of height there.
    """

    slope: Floats
    offset: float
    half_px: float
    px_per_m: float

    def disparity_px(self, points_px: Floats) -> Floats:
        """(...,) of points (..., 2)."""
        return np.asarray(points_px @ self.slope + self.offset, np.float64)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solved:
    """P pairs in space.

    ``left``, ``right`` (P,) strand indices; ``flipped`` (P,) True where the right strand runs the other
    way; ``ends_px`` (P, 2, 3) u, v, d; ``ends_m`` (P, 2, 3) raw left camera frame; ``end_sigma_px``
    (P, 2) how well the ends are known along the axis; ``depth_sigma_m`` (P,) deviation of the worse
    end's depth; ``chi2`` (P,); ``residual_px`` (P,) root mean
    square of what the well-known measurements miss by.
    """

    left: Ints
    right: Ints
    flipped: Ints
    ends_px: Floats
    ends_m: Floats
    end_sigma_px: Floats
    depth_sigma_m: Floats
    chi2: Floats
    residual_px: Floats


def level_of_table(rect: Rectification, table: Plane, height_m: tuple[float, float]) -> Level:
    """The height range over a table plane as a plane of disparities.

    For a point X = Z x with x = ((u - cu) / f, (v - cv) / f, 1) and Z = f B / d, its height is
    ``n @ X + o``; so at height h the disparity is ``f B (n @ x) / (h - o)``, linear in u and v.
    """
    normal = rect.rect_from_left @ table.normal
    f, b = rect.focal_px, rect.baseline_m
    bounds = []
    for height in (height_m[0], 0.5 * (height_m[0] + height_m[1]), height_m[1]):
        scale = f * b / (height - table.offset_m)
        slope = scale * normal[:2] / f
        bounds.append((slope, float(scale * normal[2] - slope @ rect.left_centre_px)))
    slope, offset = bounds[1]
    middle = np.array([0.5 * rect.width_px, 0.5 * rect.height_px])
    low, high = (float(s @ middle + o) for s, o in (bounds[0], bounds[2]))
    return Level(
        slope=read_only(slope),
        offset=offset,
        half_px=0.5 * abs(high - low),
        px_per_m=(high - low) / (height_m[1] - height_m[0]),
    )


def level_of_depths(rect: Rectification, depth_m: tuple[float, float]) -> Level:
    """A range of distances as a constant range of disparities."""
    near, far = (rect.focal_px * rect.baseline_m / depth for depth in depth_m)
    return Level(
        slope=read_only(np.zeros(2)),
        offset=0.5 * (near + far),
        half_px=0.5 * (near - far),
        px_per_m=(near - far) / (depth_m[1] - depth_m[0]),
    )


def solve(
    left: Strands,
    right: Strands,
    pairs: Ints,
    flipped: Ints,
    level: Level,
    rect: Rectification,
    length_m: float,
    radius_m: float,
) -> Solved:
    """Both ends of every pair.

    Parameters
    ----------
    left, right : Strands
    pairs : (P, 2)
        Strand indices.
    flipped : (P,)
        1 where the first tip of the left strand is the second of the right one.
    level : Level
    length_m, radius_m : float
        Of the part; the radius because a silhouette ends beyond the axis by ``R |cos(axis, ray)|``.
    """
    count = len(pairs)
    order = np.stack([flipped, 1 - flipped], axis=1)
    first, second = pairs[:, 0], pairs[:, 1]
    shift = np.array([rect.left_centre_px[0] - rect.right_centre_px[0], 0.0])
    tips_l = left.tips[first]
    tips_r = np.take_along_axis(right.tips[second], order[:, :, None], axis=1) + shift
    axis_l = left.direction[first]
    axis_r = right.direction[second] * (1 - 2 * flipped)[:, None]
    across_l = np.hypot(left.line_sigma_px[first], ROW_SIGMA_PX)
    across_r = np.hypot(np.take_along_axis(right.line_sigma_px[second], order, axis=1), ROW_SIGMA_PX)
    along_l = left.tip_sigma_px[first]
    along_r = np.take_along_axis(right.tip_sigma_px[second], order, axis=1)

    rows = np.zeros((count, 11, 6))
    value = np.zeros((count, 11))
    outward = np.array([-1.0, 1.0])
    normal_l = np.stack([-axis_l[:, 1], axis_l[:, 0]], axis=1)
    normal_r = np.stack([-axis_r[:, 1], axis_r[:, 0]], axis=1)
    belief = max(level.half_px, 1.0)
    for end in (0, 1):
        at = 5 * end
        u = 3 * end
        for row, vector, tip, sigma, is_right in (
            (at, normal_l, tips_l, across_l, False),
            (at + 1, axis_l, tips_l, along_l, False),
            (at + 2, normal_r, tips_r, across_r, True),
            (at + 3, axis_r, tips_r, along_r, True),
        ):
            rows[:, row, u : u + 2] = vector / sigma[:, end, None]
            if is_right:
                rows[:, row, u + 2] = -vector[:, 0] / sigma[:, end]
            value[:, row] = np.einsum("pk,pk->p", vector, tip[:, end]) / sigma[:, end]
        rows[:, at + 4, u : u + 2] = -level.slope / belief
        rows[:, at + 4, u + 2] = 1.0 / belief
        value[:, at + 4] = level.offset / belief
    wide, usual = (max(share * length_m * abs(level.px_per_m), 0.5) for share in TILT_SHARES)
    difference = belief * (rows[:, 9] - rows[:, 4])
    rows[:, 10] = difference / wide
    matrix = np.einsum("pri,prj->pij", rows, rows)
    if count:
        spread = np.linalg.inv(matrix)[:, (2, 5), (2, 5)].max(axis=1)
        rows[:, 10] = difference / np.where(spread > UNKNOWN_DISPARITY_PX**2, usual, wide)[:, None]
        matrix = np.einsum("pri,prj->pij", rows, rows)

    found = np.zeros((count, 6))
    moved = value
    for _ in range(2):
        target = np.einsum("pri,pr->pi", rows, moved)
        found = np.linalg.solve(matrix, target[:, :, None])[:, :, 0]
        caps = _cap_px(found, rect, radius_m)
        moved = value.copy()
        for end in (0, 1):
            moved[:, 5 * end + 1] -= outward[end] * caps[0][:, end] / along_l[:, end]
            moved[:, 5 * end + 3] -= outward[end] * caps[1][:, end] / along_r[:, end]
    miss = moved - np.einsum("pri,pi->pr", rows, found)
    ends_px = found.reshape(count, 2, 3)
    sigmas = np.stack([across_l[:, 0], along_l[:, 0], across_r[:, 0], along_r[:, 0],
                       across_l[:, 1], along_l[:, 1], across_r[:, 1], along_r[:, 1]], axis=1)  # fmt: skip
    measured = miss[:, (0, 1, 2, 3, 5, 6, 7, 8)]
    well = sigmas < DETERMINED_PX
    square = np.where(well, (measured * sigmas) ** 2, 0.0)
    return Solved(
        left=read_only(first.copy()),
        right=read_only(second.copy()),
        flipped=read_only(flipped.copy()),
        ends_px=read_only(ends_px),
        ends_m=read_only(in_space(ends_px, rect)),
        end_sigma_px=read_only(np.minimum(along_l, along_r)),
        depth_sigma_m=read_only(_depth_sigma_m(matrix, ends_px, rect)),
        chi2=read_only((measured**2).sum(axis=1)),
        residual_px=read_only(np.sqrt(square.sum(axis=1) / np.maximum(well.sum(axis=1), 1))),
    )


def _depth_sigma_m(matrix: Floats, ends_px: Floats, rect: Rectification) -> Floats:
    """(P,) of the worse end: ``Z^2 / (f B)`` times the deviation of its disparity."""
    variance = np.linalg.inv(matrix)[:, (2, 5), (2, 5)]
    per_px = rect.focal_px * rect.baseline_m / np.maximum(ends_px[..., 2], 1e-3) ** 2
    return np.asarray((per_px * np.sqrt(variance)).max(axis=1, initial=0.0), np.float64)


def in_space(points: Floats, rect: Rectification) -> Floats:
    """(..., 3) u, v, d in rectified px to metres, raw left camera frame; NaN where d <= 0."""
    d = np.where(points[..., 2] > 1e-6, points[..., 2], np.nan)
    depth = rect.focal_px * rect.baseline_m / d
    ray = (points[..., :2] - rect.left_centre_px) / rect.focal_px
    rectified = np.concatenate([ray * depth[..., None], depth[..., None]], axis=-1)
    return np.asarray(rectified @ rect.rect_from_left, np.float64)


def from_space(points_m: Floats, rect: Rectification) -> Floats:
    """The inverse of `in_space`."""
    rectified = points_m @ rect.rect_from_left.T
    depth = rectified[..., 2:3]
    pixels = rect.focal_px * rectified[..., :2] / depth + rect.left_centre_px
    return np.concatenate([pixels, rect.focal_px * rect.baseline_m / depth], axis=-1)


def _cap_px(found: Floats, rect: Rectification, radius_m: float) -> tuple[Floats, Floats]:
    """How far the silhouette reaches beyond the axis' end, (P, 2) px of the left and right picture."""
    ends = found.reshape(-1, 2, 3)
    depth = rect.focal_px * rect.baseline_m / np.maximum(ends[..., 2], 1e-3)
    ray = np.concatenate(
        [(ends[..., :2] - rect.left_centre_px) / rect.focal_px, np.ones((*ends.shape[:2], 1))], axis=-1
    )
    points = ray * depth[..., None]
    axis = points[:, 1] - points[:, 0]
    axis = axis / np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-9)
    caps = []
    for camera in (np.zeros(3), np.array([rect.baseline_m, 0.0, 0.0])):
        view = points - camera
        view = view / np.linalg.norm(view, axis=-1, keepdims=True)
        away = np.einsum("pek,pk->pe", view, axis) * np.array([-1.0, 1.0])
        reach = np.where(away > 0.0, CAP_AWAY * away, -CAP_TOWARDS * away)
        caps.append(radius_m * rect.focal_px / depth * reach)
    return caps[0], caps[1]
