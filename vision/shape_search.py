"""Where a known flat shape could lie, from straight ribbons of one picture.

Every ribbon of about the right width may be any straight run of the part, either way round, on either face.
That leaves one freedom, the place along the run; it is slid through in steps of about a pixel at table
height and judged by the slopes of the picture along the whole edge of the part.
"""

from __future__ import annotations

import numpy as np

from vision.jit import compiled, lean
from vision.ribbons import Ribbons
from vision.sampling import Picture
from vision.shape_model import ShapeModel
from vision.shape_pose import ALIGNED_COSINE, Slopes, in_space, on_picture, project_one
from vision.types import Floats, Mask

_SLACK_WIDTHS = 2.5
"""How far a ribbon may seem to go on past the end of its run: into a crossing, or a neighbour."""
_REACH_PX = 3
"""Coarse search: a shape above the table looks larger, and a tilted one bent by as much."""
_BACKGROUND_SHARE = 0.3
_LEAST_SCORE = 0.35
_MOST = 20000


def search(
    shape: ShapeModel,
    pieces: Ribbons,
    seen: Slopes,
    mask: Mask,
    normal: Floats,
    offset_m: float,
    step_px: float,
) -> Floats:
    """(K, 13) hypotheses, best first: pose (12,) in the left camera frame and score 0..1.

    Parameters
    ----------
    pieces
        Ribbons in raw pixels of the left picture, undistorted beforehand to rays by the caller: see
        `rays_of`; ``start`` and ``end`` are (K, 2) at focal length one.
    normal, offset_m
        Plane on which the nodes lie: ``normal @ x + offset_m`` is zero there.
    step_px
        Of the sliding.
    """
    found = _slide(
        np.ascontiguousarray(pieces.start), np.ascontiguousarray(pieces.end), shape.lines, shape.points,
        shape.normals, shape.body, shape.two_faced, shape.lift_m, shape.width_m, seen.camera, seen.rise_u,
        seen.rise_v, mask, seen.floor, np.array(normal, np.float64), float(offset_m), float(step_px),
    )  # fmt: skip
    return np.asarray(found[np.argsort(-found[:, 12], kind="stable")])


@lean
def _on_plane(u: float, v: float, normal: Floats, offset: float) -> tuple[float, float, float]:
    depth = -offset / (normal[0] * u + normal[1] * v + normal[2])
    return u * depth, v * depth, depth


@compiled
def _slide(
    starts: Floats, ends: Floats, lines: Floats, points: Floats, normals: Floats, body: Floats,
    two_faced: bool, lift: float, width: float, camera: Floats, rise_u: Picture, rise_v: Picture, mask: Mask,
    floor: float, up: Floats, offset: float, step_px: float,
) -> Floats:  # fmt: skip
    found = np.empty((_MOST, 13))
    count = 0
    pose = np.empty(12)
    for piece in range(len(starts)):
        ax, ay, az = _on_plane(starts[piece, 0], starts[piece, 1], up, offset)
        bx, by, bz = _on_plane(ends[piece, 0], ends[piece, 1], up, offset)
        length = np.sqrt((bx - ax) ** 2 + (by - ay) ** 2 + (bz - az) ** 2)
        if length < 1e-6:
            continue
        dx = (bx - ax) / length
        dy = (by - ay) / length
        dz = (bz - az) / length
        step = step_px * 0.5 * (az + bz) / camera[0]
        for line in range(len(lines)):
            run_x = lines[line, 2] - lines[line, 0]
            run_y = lines[line, 3] - lines[line, 1]
            run = np.sqrt(run_x * run_x + run_y * run_y)
            run_x /= run
            run_y /= run
            slack = _SLACK_WIDTHS * width
            low = 0.5 * length - slack
            high = run - 0.5 * length + slack
            if high < low:
                # longer than the run: two parts may lie in one line
                low, high = min(0.5 * run, high), max(0.5 * run, low)
            steps = int((high - low) / step) + 1
            scores = np.empty(steps)
            for way in range(2):
                sign = 1.0 if way == 0 else -1.0
                for face in range(2 if two_faced else 1):
                    turned = 1.0 if face == 0 else -1.0
                    _lay(pose, sign * dx, sign * dy, sign * dz, up, run_x, run_y, turned)
                    for k in range(steps):
                        s = low + k * step
                        x = lines[line, 0] + s * run_x
                        y = lines[line, 1] + s * run_y
                        _place(pose, x, y, 0.5 * (ax + bx), 0.5 * (ay + by), 0.5 * (az + bz))
                        scores[k] = judge(
                            pose, turned * lift, points, normals, body, camera, rise_u, rise_v, mask, floor
                        )
                    for k in range(steps):
                        if scores[k] < _LEAST_SCORE or count >= _MOST:
                            continue
                        if (k > 0 and scores[k - 1] > scores[k]) or (
                            k + 1 < steps and scores[k + 1] >= scores[k]
                        ):
                            continue
                        s = low + k * step
                        x = lines[line, 0] + s * run_x
                        y = lines[line, 1] + s * run_y
                        _place(pose, x, y, 0.5 * (ax + bx), 0.5 * (ay + by), 0.5 * (az + bz))
                        found[count, :12] = pose
                        found[count, 12] = scores[k]
                        count += 1
    return found[:count]


@lean
def _lay(
    pose: Floats, dx: float, dy: float, dz: float, up: Floats, run_x: float, run_y: float, face: float
) -> None:
    """Turns the pose so that the run (unit, in the part's plane) points along d, its z up (or down)."""
    nx = face * up[0]
    ny = face * up[1]
    nz = face * up[2]
    # e1 = d, e2 = n x d span the part's plane; the part's x and y are turned against the run
    ex = ny * dz - nz * dy
    ey = nz * dx - nx * dz
    ez = nx * dy - ny * dx
    pose[0] = run_x * dx - run_y * ex
    pose[1] = run_x * dy - run_y * ey
    pose[2] = run_x * dz - run_y * ez
    pose[3] = run_y * dx + run_x * ex
    pose[4] = run_y * dy + run_x * ey
    pose[5] = run_y * dz + run_x * ez
    pose[6] = nx
    pose[7] = ny
    pose[8] = nz


@lean
def _place(pose: Floats, x: float, y: float, mx: float, my: float, mz: float) -> None:
    """Shifts the pose so that (x, y) of the part lies at m."""
    pose[9] = mx - pose[0] * x - pose[3] * y
    pose[10] = my - pose[1] * x - pose[4] * y
    pose[11] = mz - pose[2] * x - pose[5] * y


@lean
def judge(
    pose: Floats, lift: float, points: Floats, normals: Floats, body: Floats, camera: Floats,
    rise_u: Picture, rise_v: Picture, mask: Mask, floor: float,
) -> float:  # fmt: skip
    """Share of the edge with a slope that fits, less the share of the inside that is background; -1 for
    what mostly is."""
    rows, columns = mask.shape
    bare = 0
    most = int(_BACKGROUND_SHARE * len(body))
    for k in range(len(body)):
        x, y, z = in_space(pose, lift, body[k, 0], body[k, 1])
        u, v = project_one(camera, x, y, z)
        iu = int(np.rint(u))
        iv = int(np.rint(v))
        if iu < 1 or iv < 1 or iu >= columns - 1 or iv >= rows - 1 or not mask[iv, iu]:
            bare += 1
            if bare > most:
                return -1.0
    total = 0.0
    for k in range(len(points)):
        u, v, nu, nv = on_picture(
            camera, pose, lift, points[k, 0], points[k, 1], normals[k, 0], normals[k, 1], 1e-3
        )
        best = 0.0
        for s in range(-_REACH_PX, _REACH_PX + 1):
            iu = int(np.rint(u + s * nu))
            iv = int(np.rint(v + s * nv))
            if iu < 0 or iv < 0 or iu >= columns or iv >= rows:
                continue
            gu = rise_u[iv, iu]
            gv = rise_v[iv, iu]
            fall = -(gu * nu + gv * nv)
            if fall < floor or fall < ALIGNED_COSINE * np.sqrt(gu * gu + gv * gv):
                continue
            worth = 1.0 - 0.15 * abs(s)
            if worth > best:
                best = worth
        total += best
    return total / len(points) - bare / len(body)


@compiled
def judge_heights(
    pose: Floats, lift: float, middle: Floats, shares: Floats, points: Floats, normals: Floats, body: Floats,
    cameras: Floats, left_u: Picture, left_v: Picture, right_u: Picture, right_v: Picture, left_mask: Mask,
    right_mask: Mask, floors: Floats,
) -> Floats:  # fmt: skip
    """(N,) mean score of both pictures after moving the pose along the viewing ray of ``middle`` (3,) by
    shares of it; -1 where the shape is background in either."""
    scores = np.full(len(shares), -1.0)
    moved = pose.copy()
    for n in range(len(shares)):
        for i in range(3):
            moved[9 + i] = pose[9 + i] + shares[n] * middle[i]
        # the other picture first: it is the one that tells heights apart
        right = judge(moved, lift, points, normals, body, cameras[1], right_u, right_v, right_mask, floors[1])
        if right < 0.0:
            continue
        left = judge(moved, lift, points, normals, body, cameras[0], left_u, left_v, left_mask, floors[0])
        if left >= 0.0:
            scores[n] = 0.5 * (left + right)
    return scores
