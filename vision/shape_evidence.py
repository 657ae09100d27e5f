"""What two pictures show of a shape at a pose: its edge, its ends, its inside, and what goes on beyond."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vision.jit import compiled
from vision.sampling import Picture
from vision.shape_model import ShapeModel
from vision.shape_pose import Slopes, in_space, look_along, project_one
from vision.types import Bools, Floats, Ints, Mask

FAINT = 0.4
"""Share of the usual steepness that still is a flank: parts that lie on others of their own brightness."""
_OUTSIDE_PX = 2.5
_CLAIM_PX = 1.6
_CLAIM_COSINE = 0.9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evidence:
    """Of both views: ``pixel``, ``normal`` (2, P, 2) of the edge samples; ``seen`` (2, P) whether the edge
    is there; ``off_px`` (2, P) how far outwards; ``body`` (2, Q) foreground inside, ``outside`` (2, P)
    foreground just outside; ``beyond`` (2, K) flanks go on past ends, ``beyond_px`` (2, K) how far outwards;
    ``faint`` (2, P) whether at least a faint edge is there; ``in_picture`` (2,) share of the edge
    in the picture; ``lines`` (2, B, 2, 2) ends of the straight runs in pixels."""

    pixel: Floats
    normal: Floats
    seen: Bools
    off_px: Floats
    body: Bools
    outside: Bools
    beyond: Bools
    beyond_px: Floats
    faint: Bools
    in_picture: Floats
    lines: Floats

    @property
    def denied(self) -> Bools:
        """(2, P) samples without an edge where nothing that could hide it lies outside."""
        return ~self.seen & ~self.outside


def evidence(
    shape: ShapeModel,
    pose: Floats,
    lift_m: float,
    grown_px: float,
    views: tuple[Slopes, Slopes],
    masks: tuple[Mask, Mask],
) -> Evidence:
    """Read both pictures along the shape at a pose (12,)."""
    looks, bodies, outsides, pasts, faints, inside = [], [], [], [], [], []
    ones = np.ones(len(shape.beyond))
    for view, mask in zip(views, masks, strict=True):
        rises = (view.camera, view.rise_u, view.rise_v)
        at = (shape.points, shape.normals, shape.grows)
        look = look_along(pose, lift_m, grown_px, *at, *rises, view.floor, view.near_px)
        faint = look_along(pose, lift_m, grown_px, *at, *rises, FAINT * view.floor, view.near_px)
        past_at = (shape.beyond, shape.beyond_normals, ones)
        past = look_along(pose, lift_m, grown_px, *past_at, *rises, view.floor, view.near_px)
        looks.append(look)
        pasts.append(past)
        faints.append(_found(faint, view.near_px))
        bodies.append(on_mask(pixels_of(pose, lift_m, shape.body, view.camera), mask))
        outsides.append(on_mask(look[:, :2] + _OUTSIDE_PX * look[:, 2:4], mask))
        rows, columns = mask.shape
        held = (look[:, 0] >= 0) & (look[:, 0] < columns) & (look[:, 1] >= 0) & (look[:, 1] < rows)
        inside.append(held.mean())
    both = np.stack(looks)
    ends = np.ascontiguousarray(shape.lines[:, :4].reshape(-1, 2))
    return Evidence(
        pixel=both[:, :, :2],
        normal=both[:, :, 2:4],
        seen=np.stack([_found(look, view.near_px) for look, view in zip(looks, views, strict=True)]),
        off_px=both[:, :, 4],
        body=np.stack(bodies),
        outside=np.stack(outsides),
        beyond=np.stack([_found(past, view.near_px) for past, view in zip(pasts, views, strict=True)]),
        beyond_px=np.stack([past[:, 4] for past in pasts]),
        faint=np.stack(faints),
        in_picture=np.array(inside),
        lines=np.stack([pixels_of(pose, lift_m, ends, view.camera) for view in views]).reshape(2, -1, 2, 2),
    )


def _found(look: Floats, near_px: float) -> Bools:
    return np.asarray((look[:, 5] > 0) & (np.abs(look[:, 4]) < near_px), np.bool_)


@compiled
def shares(
    pose: Floats, lift: float, grown: float, points: Floats, normals: Floats, grows: Floats, body: Floats,
    camera: Floats, rise_u: Picture, rise_v: Picture, mask: Mask, floor: float, near: float,
) -> tuple[float, float]:  # fmt: skip
    """Share of the edge that is seen in one picture, and of the inside that is background."""
    look = look_along(pose, lift, grown, points, normals, grows, camera, rise_u, rise_v, floor, near)
    seen = 0
    for k in range(len(points)):
        if look[k, 5] > 0.0:
            seen += 1
    rows, columns = mask.shape
    bare = 0
    for k in range(len(body)):
        x, y, z = in_space(pose, lift, body[k, 0], body[k, 1])
        u, v = project_one(camera, x, y, z)
        iu = int(np.rint(u))
        iv = int(np.rint(v))
        if iu < 0 or iv < 0 or iu >= columns or iv >= rows or not mask[iv, iu]:
            bare += 1
    return seen / len(points), bare / len(body)


@compiled
def pixels_of(pose: Floats, lift: float, points: Floats, camera: Floats) -> Floats:
    """(N, 2) raw pixels of points (N, 2) of the part's plane."""
    found = np.empty((len(points), 2))
    for k in range(len(points)):
        x, y, z = in_space(pose, lift, points[k, 0], points[k, 1])
        u, v = project_one(camera, x, y, z)
        found[k, 0] = u
        found[k, 1] = v
    return found


def on_mask(pixel: Floats, mask: Mask) -> Bools:
    """(N,) the mask at the nearest pixel; outside the picture False."""
    column, row = np.rint(pixel[:, 0]).astype(np.int64), np.rint(pixel[:, 1]).astype(np.int64)
    rows, columns = mask.shape
    held = (column >= 0) & (row >= 0) & (column < columns) & (row < rows)
    return np.asarray(held & mask[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)], np.bool_)


def claimed(evidence: Evidence, by: list[Evidence]) -> Bools:
    """(2, P) samples whose edge others already explain: on their edge and in its direction."""
    taken = np.zeros(evidence.seen.shape, np.bool_)
    for other in by:
        for view in (0, 1):
            taken[view] |= _near(
                np.ascontiguousarray(
                    evidence.pixel[view] + evidence.off_px[view][:, None] * evidence.normal[view]
                ),
                np.ascontiguousarray(evidence.normal[view]),
                np.ascontiguousarray(other.pixel[view] + other.off_px[view][:, None] * other.normal[view]),
                np.ascontiguousarray(other.normal[view]),
                np.ascontiguousarray(other.seen[view]),
            )
    return taken


@compiled
def _near(pixel: Floats, normal: Floats, others: Floats, other_normals: Floats, other_seen: Bools) -> Bools:
    found = np.zeros(len(pixel), np.bool_)
    for k in range(len(pixel)):
        for n in range(len(others)):
            if not other_seen[n]:
                continue
            du = pixel[k, 0] - others[n, 0]
            dv = pixel[k, 1] - others[n, 1]
            if du * du + dv * dv > _CLAIM_PX * _CLAIM_PX:
                continue
            if normal[k, 0] * other_normals[n, 0] + normal[k, 1] * other_normals[n, 1] > _CLAIM_COSINE:
                found[k] = True
                break
    return found


def by_group(values: Bools, group: Ints, count: int) -> Floats:
    """(2, count) mean of values (2, N) by group; NaN for empty ones; groups below 0 are left out."""
    use = group >= 0
    size = np.bincount(group[use], minlength=count).astype(np.float64)
    sums = [np.bincount(group[use], weights=row[use], minlength=count) for row in values.astype(np.float64)]
    return np.asarray(
        np.divide(np.stack(sums), size, out=np.full((2, count), np.nan), where=size > 0),
        np.float64,
    )
