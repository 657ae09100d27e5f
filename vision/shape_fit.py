"""From places in one picture to poses in space: height by the other picture, then all parameters in both."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from vision.shape_evidence import Evidence, evidence, shares
from vision.shape_model import ShapeModel
from vision.shape_pose import Slopes, refine
from vision.shape_search import judge_heights
from vision.types import Floats, Mask, Plane, StereoModel, read_only

MOST_FITS: Final = 48
HEIGHT_STEP_PX: Final = 2.5
"""Steps of disparity in which heights over the table are tried; the search bridges more to either side."""
COARSE_WINDOWS_PX: Final = read_only(np.array([4.0, 2.5]))
FINE_WINDOWS_SHARE: Final = 1.15
GROWN_SIGMA_PX: Final = 0.6
GROWN_SIGMA_WIDTHS: Final = 0.15
"""How much light and dark flanks move the edges of flat parts, and of round ones."""
TILT_SIGMA_RAD: Final = 0.15
SUNK_SIGMA_M: Final = 0.002
UNLIKELY_WEIGHT: Final = 0.05
SAME_WIDTHS: Final = 1.0
"""Fits whose nodes all lie closer are one."""
START_WIDTHS: Final = 0.8
FAR_WIDTHS: Final = 0.3
"""Starts, and fits on the way, whose nodes all lie closer come to the same end."""
LEAST_SEEN: Final = 0.4
MOST_BARE: Final = 0.12
_LEAST_BOTH: Final = 0.3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fit:
    """A shape at a place: ``pose`` (12,) columns x, y, z of the rotation and the origin, left camera frame;
    ``lift_m`` of the edge along z; ``grown_px`` how far edges lie
    outside the model's; ``matrix`` (7, 7) normal matrix of shift, turn about the middle and growth, at
    unit weight; ``spread_px`` robust spread of the residuals; ``middle_m`` (3,) that
    middle; ``unlikely`` what a tilt and a place below the table count against it, as a share of the edge."""

    pose: Floats
    lift_m: float
    grown_px: float
    matrix: Floats
    spread_px: float
    middle_m: Floats
    unlikely: float
    evidence: Evidence

    def at(self, points: Floats) -> Floats:
        """(N, 3) m of points (N, 2) or (N, 3) of the part's own frame."""
        turn = self.pose[:9].reshape(3, 3).T
        flat = points if points.shape[1] == 3 else np.column_stack([points, np.zeros(len(points))])
        return np.asarray(flat @ turn.T + self.pose[9:])


def fit(
    rough: Floats,
    shapes: tuple[ShapeModel, ShapeModel],
    views: tuple[Slopes, Slopes],
    masks: tuple[Mask, Mask],
    stereo: StereoModel,
    table: Plane,
    height_m: tuple[float, float],
) -> list[Fit]:
    """The best rough poses, each refined in both pictures; doubles left out, best first.

    Parameters
    ----------
    rough : (K, 13)
        Of `shape_search.search`, best first.
    shapes
        The part sampled for the search and for the fit.
    height_m
        Range of heights over the table in which parts may lie.
    """
    coarse, fine = shapes
    cameras = np.stack([view.camera for view in views])
    floors = np.array([view.floor for view in views])
    grown_sigma_px = _grown_sigma_px(coarse, stereo, table)
    fine_windows = np.full(2, FINE_WINDOWS_SHARE * views[0].near_px)
    fits: list[Fit] = []
    started: list[Floats] = []
    ended: list[Floats] = []
    for row in rough:
        if len(fits) >= MOST_FITS:
            break
        nodes = _corners(row[:12], coarse)
        if _among(nodes, started, START_WIDTHS * coarse.width_m):
            continue
        started.append(nodes)
        lift = coarse.lift_m * float(np.sign(row[6:9] @ table.normal))
        start = _raised(row[:12], lift, coarse, views, masks, stereo, cameras, floors, table, height_m)
        if start is None:
            continue
        pose, grown = start, 0.0
        for shape, windows in ((coarse, COARSE_WINDOWS_PX), (fine, fine_windows)):
            pose, grown, matrix, spread, _ = refine(
                pose, lift, grown, shape.points, shape.normals, shape.grows, shape.weights, cameras,
                views[0].rise_u, views[0].rise_v, views[1].rise_u, views[1].rise_v, floors, windows,
                np.array(table.normal, np.float64), TILT_SIGMA_RAD, grown_sigma_px,
            )  # fmt: skip
            if not np.isfinite(spread) or not _promising(pose, lift, grown, coarse, views, masks):
                break
            nodes = _corners(pose, coarse)
            if _among(nodes, ended, FAR_WIDTHS * coarse.width_m):
                break
        else:
            ended.append(nodes)
            fits.append(_fit(pose, lift, grown, matrix, spread, fine, views, masks, table))
    fits.sort(key=lambda one: one.unlikely - float(one.evidence.seen.mean()))
    kept: list[Fit] = []
    places: list[Floats] = []
    for one in fits:
        nodes = _corners(one.pose, coarse)
        if not _among(nodes, places, SAME_WIDTHS * coarse.width_m):
            kept.append(one)
            places.append(nodes)
    return kept


def _fit(
    pose: Floats,
    lift: float,
    grown: float,
    matrix: Floats,
    spread: float,
    shape: ShapeModel,
    views: tuple[Slopes, Slopes],
    masks: tuple[Mask, Mask],
    table: Plane,
) -> Fit:
    heights = _corners(pose, shape) @ table.normal + table.offset_m - shape.rest_m
    tilt = float(np.arccos(min(1.0, abs(float(pose[6:9] @ table.normal)))))
    sunk = max(0.0, -float(heights.min()))
    return Fit(
        pose=read_only(pose),
        lift_m=lift,
        grown_px=grown,
        matrix=read_only(matrix),
        spread_px=spread,
        unlikely=UNLIKELY_WEIGHT * ((tilt / TILT_SIGMA_RAD) ** 2 + (sunk / SUNK_SIGMA_M) ** 2),
        middle_m=read_only(pose[9:12] + shape.points.mean(axis=0) @ pose[:6].reshape(2, 3)),
        evidence=evidence(shape, pose, lift, grown, views, masks),
    )


def _promising(
    pose: Floats,
    lift: float,
    grown: float,
    shape: ShapeModel,
    views: tuple[Slopes, Slopes],
    masks: tuple[Mask, Mask],
) -> bool:
    """Whether enough of the edge is seen, and little enough of the inside is background, to go on."""
    seen = bare = 0.0
    for view, mask in zip(views, masks, strict=True):
        share, background = shares(
            pose, lift, grown, shape.points, shape.normals, shape.grows, shape.body, view.camera,
            view.rise_u, view.rise_v, mask, view.floor, view.near_px,
        )  # fmt: skip
        seen += 0.5 * share
        bare += 0.5 * background
    return bool(seen >= LEAST_SEEN and bare <= MOST_BARE)


def _grown_sigma_px(shape: ShapeModel, stereo: StereoModel, table: Plane) -> float:
    if shape.lift_m > 0:
        return GROWN_SIGMA_PX
    distance_m = -table.offset_m / float(table.normal[2])
    width_px = shape.width_m * float(stereo.left.matrix[0, 0]) / distance_m
    return max(GROWN_SIGMA_PX, GROWN_SIGMA_WIDTHS * width_px)


def _among(nodes: Floats, others: list[Floats], within_m: float) -> bool:
    """Whether nodes (N, 3) all lie close to those of one of the others."""
    if not others:
        return False
    return bool(np.abs(np.stack(others) - nodes).max(axis=(1, 2)).min() < within_m)


def _corners(pose: Floats, shape: ShapeModel) -> Floats:
    """(2 B, 3) m ends of the straight runs, in space."""
    ends = shape.lines[:, :4].reshape(-1, 2)
    return np.asarray(ends @ pose[:6].reshape(2, 3) + pose[9:12])


def _raised(
    pose: Floats,
    lift: float,
    shape: ShapeModel,
    views: tuple[Slopes, Slopes],
    masks: tuple[Mask, Mask],
    stereo: StereoModel,
    cameras: Floats,
    floors: Floats,
    table: Plane,
    height_m: tuple[float, float],
) -> Floats | None:
    """The pose moved along its viewing ray to the height at which both pictures agree with it."""
    middle = shape.points.mean(axis=0)
    at = pose[9:12] + middle @ pose[:6].reshape(2, 3)
    baseline_m = float(np.linalg.norm(stereo.right_from_left.translation))
    step_m = HEIGHT_STEP_PX * at[2] ** 2 / (stereo.left.matrix[0, 0] * baseline_m)
    lowest = float(table.normal @ at + table.offset_m) - shape.rest_m
    per_depth = float(table.normal @ at) / at[2]
    # going up the ray by a share of it changes the height by that share of its own fall
    shares = (np.arange(min(height_m[0], 0.0), height_m[1], step_m) - lowest) / (per_depth * at[2])
    scores = judge_heights(
        pose, lift, at, shares, shape.points, shape.normals, shape.body, cameras, views[0].rise_u,
        views[0].rise_v, views[1].rise_u, views[1].rise_v, masks[0], masks[1], floors,
    )  # fmt: skip
    best = int(np.argmax(scores))
    if scores[best] < _LEAST_BOTH:
        return None
    moved = pose.copy()
    moved[9:12] += shares[best] * at
    return moved
