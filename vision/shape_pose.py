"""Where the edge of a known shape lies in two raw pictures, and the pose in space that fits it best.

A pose takes the part's plane to the left camera frame: three columns of a rotation and an origin, and
``lift_m``, how far the visible edge lies above the plane of the nodes, towards the cameras. The picture is
read through its slopes: across every sample of the edge the steepest slope of the right sign and direction
is searched, so that of two touching parts each finds its own flank. Six parameters are fitted to the
perpendicular residuals in both pictures at once (Gauss-Newton with Tukey's weights).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from vision.jit import compiled, lean
from vision.sampling import Picture, sample
from vision.types import CameraModel, Floats, Grey, StereoModel, Transform, read_only

SMOOTH_PX, SMOOTH_WIDTHS = 0.7, 0.15
NEAR_PX, NEAR_WIDTHS = 1.3, 0.15
ALIGNED_COSINE = 0.85
"""Slopes that point elsewhere belong to somebody else's edge."""
_STEP_PX = 0.5
_TUKEY = 4.685
_LEAST_SCALE_PX = 0.12
_LEAST_SEEN = 12
_MARGIN = 4
_SATURATED = 3.0
"""A slope this many times the floor is as good as any."""
_TINY = 1e-6
_DELTA_M = 1e-4
_LONGEST_STEP_M = 0.02


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Slopes:
    """One raw picture as slopes: ``rise_u``, ``rise_v`` (H, W) grey per px, ``floor`` the least steepness
    of an edge, ``near_px`` how far an edge may be from where a pose puts it, ``camera`` (24,) for the
    compiled functions."""

    rise_u: Picture
    rise_v: Picture
    floor: float
    near_px: float
    camera: Floats


def slopes(
    grey: Grey, camera: CameraModel, motion: Transform | None, floor: float, round_px: float
) -> Slopes:
    """The slopes of a picture; ``motion`` takes the left camera frame to its camera's.

    ``round_px`` is the width of round parts, 0 for flat ones: metal shows a bright core between dark flanks,
    two edges that are to be one.
    """
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), max(SMOOTH_PX, SMOOTH_WIDTHS * round_px))
    # Scharr's kernel sums to 32 for a slope of one per px
    rise = [cv2.Scharr(smooth, cv2.CV_32F, dx, dy, scale=1.0 / 32.0) for dx, dy in ((1, 0), (0, 1))]
    return Slopes(
        rise_u=read_only(np.ascontiguousarray(rise[0], np.float32)),
        rise_v=read_only(np.ascontiguousarray(rise[1], np.float32)),
        floor=floor,
        near_px=max(NEAR_PX, NEAR_WIDTHS * round_px),
        camera=flat_camera(camera, motion),
    )


def flat_camera(camera: CameraModel, motion: Transform | None) -> Floats:
    """(24,) focal lengths, centre, k1 k2 p1 p2 k3 k4 k5 k6, rotation by rows, translation.

    Raises
    ------
    ValueError
        Distortion beyond OpenCV's rational model.
    """
    distortion = np.zeros(8)
    given = camera.distortion.reshape(-1)
    if np.any(given[8:] != 0):
        raise ValueError("only the first eight coefficients of OpenCV's distortion are known here")
    distortion[: min(8, len(given))] = given[:8]
    turn = np.eye(3) if motion is None else motion.rotation
    shift = np.zeros(3) if motion is None else motion.translation
    m = camera.matrix
    return read_only(
        np.concatenate([[m[0, 0], m[1, 1], m[0, 2], m[1, 2]], distortion, turn.reshape(-1), shift])
    )


def both_slopes(
    greys: tuple[Grey, Grey], stereo: StereoModel, floors: tuple[float, float], round_px: float
) -> tuple[Slopes, Slopes]:
    """The slopes of both pictures of a pair."""
    return (
        slopes(greys[0], stereo.left, None, floors[0], round_px),
        slopes(greys[1], stereo.right, stereo.right_from_left, floors[1], round_px),
    )


@lean
def project_one(camera: Floats, x: float, y: float, z: float) -> tuple[float, float]:
    """A point of the left camera frame as raw pixel of a flat camera; OpenCV's formula."""
    cx = camera[12] * x + camera[13] * y + camera[14] * z + camera[21]
    cy = camera[15] * x + camera[16] * y + camera[17] * z + camera[22]
    cz = max(camera[18] * x + camera[19] * y + camera[20] * z + camera[23], _TINY)
    a = cx / cz
    b = cy / cz
    r2 = a * a + b * b
    radial = 1.0 + r2 * (camera[4] + r2 * (camera[5] + r2 * camera[8]))
    radial /= 1.0 + r2 * (camera[9] + r2 * (camera[10] + r2 * camera[11]))
    u = a * radial + 2.0 * camera[6] * a * b + camera[7] * (r2 + 2.0 * a * a)
    v = b * radial + camera[6] * (r2 + 2.0 * b * b) + 2.0 * camera[7] * a * b
    return camera[0] * u + camera[2], camera[1] * v + camera[3]


@lean
def in_space(pose: Floats, lift: float, x: float, y: float) -> tuple[float, float, float]:
    """A point of the part's plane, lifted, in the left camera frame."""
    return (
        pose[9] + pose[0] * x + pose[3] * y + pose[6] * lift,
        pose[10] + pose[1] * x + pose[4] * y + pose[7] * lift,
        pose[11] + pose[2] * x + pose[5] * y + pose[8] * lift,
    )


@lean
def seek(
    rise_u: Picture, rise_v: Picture, u: float, v: float, nu: float, nv: float, window: float, floor: float,
    falls: Floats,
) -> tuple[float, float]:  # fmt: skip
    """Place along the normal and steepness of the edge that falls outwards; steepness 0 for none.

    Of several, a clear one near the sample is preferred to a steeper one far away. ``falls`` is scratch of
    `scratch_size` numbers.
    """
    half = int(np.ceil(window / _STEP_PX))
    count = 2 * (half + _MARGIN) + 1
    first = -_STEP_PX * (half + _MARGIN)
    for k in range(count):
        s = first + k * _STEP_PX
        falls[k] = -sample(rise_u, u + s * nu, v + s * nv) * nu - sample(rise_v, u + s * nu, v + s * nv) * nv
    best = 0.0
    where = -1
    for k in range(_MARGIN, count - _MARGIN):
        fall = falls[k]
        if fall < floor or falls[k - 1] > fall or falls[k + 1] > fall:
            continue
        s = first + k * _STEP_PX
        worth = min(fall, _SATURATED * floor) * (1.0 - 0.6 * abs(s) / window)
        if worth <= best:
            continue
        gu = sample(rise_u, u + s * nu, v + s * nv)
        gv = sample(rise_v, u + s * nu, v + s * nv)
        if fall * fall < ALIGNED_COSINE * ALIGNED_COSINE * (gu * gu + gv * gv):
            continue
        best = worth
        where = k
    if where < 0:
        return 0.0, 0.0
    # a parabola through the peak is drawn to whole pixels; the centroid of the slope is not
    place = float(where)
    for _ in range(2):
        total = 0.0
        moment = 0.0
        for k in range(-3, 4):
            at = min(max(place + k, 0.0), count - 1.001)
            i = int(at)
            fall = falls[i] + (at - i) * (falls[i + 1] - falls[i])
            if fall > 0.0:
                total += fall
                moment += fall * k
        place += moment / max(total, _TINY)
    return first + place * _STEP_PX, falls[where]


@lean
def scratch_size(window: float) -> int:
    """Numbers that `seek` needs to work with."""
    return 2 * (int(np.ceil(window / _STEP_PX)) + _MARGIN) + 1


@lean
def on_picture(
    camera: Floats, pose: Floats, lift: float, x: float, y: float, nx: float, ny: float, step: float
) -> tuple[float, float, float, float]:
    """Raw pixel of a sample of edge and its unit normal there."""
    px, py, pz = in_space(pose, lift, x, y)
    u, v = project_one(camera, px, py, pz)
    # the normal is that of the projected edge, not the projected normal
    qx, qy, qz = in_space(pose, lift, x - step * ny, y + step * nx)
    au, av = project_one(camera, qx, qy, qz)
    qx, qy, qz = in_space(pose, lift, x + step * nx, y + step * ny)
    ou, ov = project_one(camera, qx, qy, qz)
    nu = av - v
    nv = u - au
    if nu * (ou - u) + nv * (ov - v) < 0.0:
        nu = -nu
        nv = -nv
    size = max(np.sqrt(nu * nu + nv * nv), _TINY)
    return u, v, nu / size, nv / size


@compiled
def look_along(
    pose: Floats, lift: float, grown: float, points: Floats, normals: Floats, grows: Floats, camera: Floats,
    rise_u: Picture, rise_v: Picture, floor: float, window: float,
) -> Floats:  # fmt: skip
    """(P, 6) of samples of edge in one picture: pixel u, v, normal, residual in px, steepness (0: none).

    Pixels are ``grown`` px outside the edge of the pose where ``grows`` (P,) is 1.
    """
    found = np.empty((len(points), 6))
    falls = np.empty(scratch_size(window))
    for k in range(len(points)):
        u, v, nu, nv = on_picture(
            camera, pose, lift, points[k, 0], points[k, 1], normals[k, 0], normals[k, 1], 1e-3
        )
        u += grown * grows[k] * nu
        v += grown * grows[k] * nv
        place, steep = seek(rise_u, rise_v, u, v, nu, nv, window, floor, falls)
        found[k, 0] = u
        found[k, 1] = v
        found[k, 2] = nu
        found[k, 3] = nv
        found[k, 4] = place
        found[k, 5] = steep
    return found


@compiled
def _moved(pose: Floats, step: Floats, cx: float, cy: float, cz: float) -> Floats:
    """The pose after a shift and a turn (rotation vector) about a point, both in the left camera frame."""
    angle = np.sqrt(step[3] ** 2 + step[4] ** 2 + step[5] ** 2)
    out = pose.copy()
    if angle > 1e-12:
        kx = step[3] / angle
        ky = step[4] / angle
        kz = step[5] / angle
        c = np.cos(angle)
        s = np.sin(angle)
        for column in range(4):
            i = 3 * column
            x = pose[i]
            y = pose[i + 1]
            z = pose[i + 2]
            if column == 3:
                x -= cx
                y -= cy
                z -= cz
            dot = (kx * x + ky * y + kz * z) * (1.0 - c)
            out[i] = x * c + (ky * z - kz * y) * s + kx * dot
            out[i + 1] = y * c + (kz * x - kx * z) * s + ky * dot
            out[i + 2] = z * c + (kx * y - ky * x) * s + kz * dot
        out[9] += cx
        out[10] += cy
        out[11] += cz
    out[9] += step[0]
    out[10] += step[1]
    out[11] += step[2]
    return out


@compiled
def refine(
    pose: Floats, lift: float, grown: float, points: Floats, normals: Floats, grows: Floats,
    weights: Floats, cameras: Floats,
    left_u: Picture, left_v: Picture, right_u: Picture, right_v: Picture, floors: Floats,
    windows: Floats, up: Floats, tilt_sigma: float, grown_sigma: float,
) -> tuple[Floats, float, Floats, float, int]:  # fmt: skip
    """(pose, growth, normal matrix (7, 7) of the fit at unit weight, robust spread in px, samples used).

    ``grown`` px is how far edges lie outside the model's where ``grows`` (P,) is 1: light blooms, the flanks
    of metal are dark. It is the seventh unknown, about zero to within ``grown_sigma``. ``weights`` (P,) of
    samples; ``windows`` px of the rounds; ``up`` unit normal of the table, from which the part's plane is
    tilted by about ``tilt_sigma``. Each prior is worth one sample of edge.
    """
    count = len(points)
    pose = pose.copy()
    middle_x = points[:, 0].mean()
    middle_y = points[:, 1].mean()
    rows = np.empty((2 * count, 8))
    off = np.empty(2 * count)
    weight = np.empty(2 * count)
    falls = np.empty(scratch_size(windows.max()))
    matrix = np.zeros((7, 7))
    right = np.zeros(7)
    spread = np.inf
    used = 0
    for turn in range(len(windows)):
        cx, cy, cz = in_space(pose, 0.0, middle_x, middle_y)
        used = 0
        for view in range(2):
            rise_u = left_u if view == 0 else right_u
            rise_v = left_v if view == 0 else right_v
            for k in range(count):
                if _row(
                    rows[used], pose, lift, grown, points[k], normals[k], grows[k], cameras[view],
                    rise_u, rise_v, floors[view], windows[turn], falls, cx, cy, cz,
                ):  # fmt: skip
                    weight[used] = weights[k]
                    used += 1
        if used < _LEAST_SEEN:
            return pose, grown, matrix, np.inf, used
        step = np.zeros(7)
        for _ in range(3):
            for k in range(used):
                r = rows[k, 7]
                for i in range(7):
                    r -= rows[k, i] * step[i]
                off[k] = abs(r)
            spread = max(1.4826 * np.median(off[:used]), _LEAST_SCALE_PX)
            matrix[:, :] = 0.0
            right[:] = 0.0
            for k in range(used):
                ratio = off[k] / (_TUKEY * spread)
                w = weight[k] * (1.0 - ratio * ratio) ** 2 if ratio < 1.0 else 0.0
                for i in range(7):
                    right[i] += w * rows[k, i] * rows[k, 7]
                    for j in range(i + 1):
                        matrix[i, j] += w * rows[k, i] * rows[k, j]
            for i in range(7):
                for j in range(i):
                    matrix[j, i] = matrix[i, j]
            _weigh_tilt(matrix, right, pose, up, spread / tilt_sigma)
            matrix[6, 6] += (spread / grown_sigma) ** 2
            right[6] -= (spread / grown_sigma) ** 2 * grown
            for i in range(7):
                matrix[i, i] *= 1.0 + 1e-9
            step[:] = np.linalg.solve(matrix, right)
        if not np.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2) < _LONGEST_STEP_M:
            return pose, grown, matrix, np.inf, used
        pose = _moved(pose, step, cx, cy, cz)
        grown += step[6]
    return pose, grown, matrix, spread, used


@lean
def _row(
    row: Floats, pose: Floats, lift: float, grown: float, point: Floats, normal: Floats, grows: float,
    camera: Floats, rise_u: Picture, rise_v: Picture, floor: float, window: float, falls: Floats,
    cx: float, cy: float, cz: float,
) -> bool:  # fmt: skip
    """Fills in how a sample's edge moves, in px along its normal, with shift, turn and growth, and how far
    off it is; False where no edge is seen."""
    u, v, nu, nv = on_picture(camera, pose, lift, point[0], point[1], normal[0], normal[1], 1e-3)
    outside = grown * grows
    place, steep = seek(rise_u, rise_v, u + outside * nu, v + outside * nv, nu, nv, window, floor, falls)
    if steep <= 0.0:
        return False
    x, y, z = in_space(pose, lift, point[0], point[1])
    gx, gy = project_one(camera, x + _DELTA_M, y, z)
    dx = ((gx - u) * nu + (gy - v) * nv) / _DELTA_M
    gx, gy = project_one(camera, x, y + _DELTA_M, z)
    dy = ((gx - u) * nu + (gy - v) * nv) / _DELTA_M
    gx, gy = project_one(camera, x, y, z + _DELTA_M)
    dz = ((gx - u) * nu + (gy - v) * nv) / _DELTA_M
    row[0] = dx
    row[1] = dy
    row[2] = dz
    row[3] = (y - cy) * dz - (z - cz) * dy
    row[4] = (z - cz) * dx - (x - cx) * dz
    row[5] = (x - cx) * dy - (y - cy) * dx
    row[6] = grows
    row[7] = place
    return True


@compiled
def _weigh_tilt(matrix: Floats, right: Floats, pose: Floats, up: Floats, weight: float) -> None:
    """Adds the prior that the part's plane is parallel to the table: normal times up, x and y, near zero."""
    sign = 1.0 if pose[6] * up[0] + pose[7] * up[1] + pose[8] * up[2] > 0 else -1.0
    nx = sign * pose[6]
    ny = sign * pose[7]
    nz = sign * pose[8]
    # a small turn w takes the normal to n + w x n; wanted: up
    jac = np.array([[0.0, nz, -ny], [-nz, 0.0, nx], [ny, -nx, 0.0]])
    gap = np.array([up[0] - nx, up[1] - ny, up[2] - nz])
    for i in range(3):
        for j in range(3):
            right[3 + i] += weight * weight * jac[j, i] * gap[j]
            for k in range(3):
                matrix[3 + i, 3 + k] += weight * weight * jac[j, i] * jac[j, k]
