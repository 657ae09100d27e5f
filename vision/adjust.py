"""Both cameras of a pair and every pose of the board in one least squares adjustment, with its covariance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve

from vision.types import Floats, Transform

_ROUNDS: Final = 60


class CannotCalibrate(Exception):
    """The views do not determine the cameras; the text says why."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Seen:
    """The corners of one camera in one view. ``points`` (N, 3) m, ``pixels`` (N, 2)."""

    eye: int
    view: int
    points: Floats
    pixels: Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Adjusted:
    """``cameras`` (2, 9), ``step`` (6,) and ``boards`` (V, 6) as rotation vector and shift; ``residuals`` one
    (N, 2) a sighting; ``sigma`` (24,) of both cameras and the step."""

    cameras: Floats
    step: Floats
    boards: Floats
    residuals: tuple[Floats, ...]
    sigma: Floats


def adjust(
    seen: list[Seen], cameras: list[Floats], start: Transform, boards: list[Transform], with_k3: bool
) -> Adjusted:
    """Levenberg-Marquardt on all unknowns; the poses of the board are eliminated (Schur complement)."""
    common = np.concatenate([cameras[0], cameras[1], six(start)])
    poses = np.array([six(pose) for pose in boards])
    free = np.ones(24, dtype=bool)
    if not with_k3:
        free[[8, 17]] = False
    damping = 1e-4
    cost, rows = _linear(seen, common, poses)
    for _ in range(_ROUNDS):
        system = _normal(rows, len(poses))
        while True:
            step_common, step_poses = _step(system, free, damping)
            new_common, new_poses = common + step_common, poses + step_poses
            new_cost, new_rows = _linear(seen, new_common, new_poses)
            if new_cost < cost or damping > 1e8:
                break
            damping *= 10.0
        gain = cost - new_cost
        if gain > 0:
            common, poses, cost, rows = new_common, new_poses, new_cost, new_rows
            damping = max(damping / 10.0, 1e-12)
        if gain <= 1e-10 * cost:
            break
    if not np.isfinite(cost):
        raise CannotCalibrate("the adjustment of both cameras did not end; drop the worst views")
    return Adjusted(
        cameras=common[:18].reshape(2, 9),
        step=common[18:],
        boards=poses,
        residuals=tuple(row.residual.reshape(-1, 2) for row in rows),
        sigma=_sigma(_normal(rows, len(poses)), free, cost, sum(r.residual.size for r in rows), len(poses)),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Row:
    """One sighting, linear: ``residual`` (2N,), slopes by the common unknowns (2N, 24), the pose (2N, 6)."""

    view: int
    residual: Floats
    by_common: Floats
    by_pose: Floats


def _linear(seen: list[Seen], common: Floats, poses: Floats) -> tuple[float, list[_Row]]:
    rows = []
    for one in seen:
        numbers = common[9 * one.eye : 9 * one.eye + 9]
        pose = poses[one.view]
        by_pose: Floats
        by_common = np.zeros((2 * len(one.points), 24))
        turn, shift = pose[:3], pose[3:]
        if one.eye == 1:
            # right_from_board = right_from_left after left_from_board, with the slopes of both
            composed = cv2.composeRT(turn, shift, common[18:21], common[21:24])
            slopes = [np.asarray(part, dtype=np.float64) for part in composed]
            turn, shift = slopes[0].reshape(3), slopes[1].reshape(3)
        expected, slope = cv2.projectPoints(
            one.points, turn, shift, camera_matrix(numbers), np.ascontiguousarray(numbers[4:])
        )
        jacobian = np.asarray(slope, dtype=np.float64)[:, :15]
        by_turn, by_shift = jacobian[:, 0:3], jacobian[:, 3:6]
        by_common[:, 9 * one.eye : 9 * one.eye + 9] = jacobian[:, 6:15]
        if one.eye == 0:
            by_pose = jacobian[:, 0:6]
        else:
            turn_t1, turn_s1, turn_t2, turn_s2, shift_t1, shift_s1, shift_t2, shift_s2 = slopes[2:]
            by_pose = np.hstack(
                [by_turn @ turn_t1 + by_shift @ shift_t1, by_turn @ turn_s1 + by_shift @ shift_s1]
            )
            by_common[:, 18:21] = by_turn @ turn_t2 + by_shift @ shift_t2
            by_common[:, 21:24] = by_turn @ turn_s2 + by_shift @ shift_s2
        residual = one.pixels.reshape(-1) - np.asarray(expected, dtype=np.float64).reshape(-1)
        rows.append(_Row(view=one.view, residual=residual, by_common=by_common, by_pose=by_pose))
    return float(sum(row.residual @ row.residual for row in rows)), rows


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Normal:
    """Normal equations in blocks: common (24, 24), poses (V, 6, 6), between them (V, 24, 6), right sides."""

    common: Floats
    poses: Floats
    between: Floats
    right_common: Floats
    right_poses: Floats


def _normal(rows: list[_Row], views: int) -> _Normal:
    common, right = np.zeros((24, 24)), np.zeros(24)
    poses, between, right_poses = np.zeros((views, 6, 6)), np.zeros((views, 24, 6)), np.zeros((views, 6))
    for row in rows:
        common += row.by_common.T @ row.by_common
        right += row.by_common.T @ row.residual
        poses[row.view] += row.by_pose.T @ row.by_pose
        between[row.view] += row.by_common.T @ row.by_pose
        right_poses[row.view] += row.by_pose.T @ row.residual
    return _Normal(common=common, poses=poses, between=between, right_common=right, right_poses=right_poses)


def _step(system: _Normal, free: npt.NDArray[np.bool_], damping: float) -> tuple[Floats, Floats]:
    poses = system.poses + damping * np.einsum("vii->vi", system.poses)[:, :, None] * np.eye(6)
    common = system.common + damping * np.diag(np.diag(system.common))
    solved = np.linalg.solve(poses, np.swapaxes(system.between, 1, 2))  # (V, 6, 24)
    reduced = common - np.einsum("vij,vjk->ik", system.between, solved)
    right = system.right_common - np.einsum("vji,vj->i", solved, system.right_poses)
    step = np.zeros(24)
    step[free] = _solve(reduced[np.ix_(free, free)], right[free])
    back = system.right_poses - np.einsum("vij,i->vj", system.between, step)
    return step, np.linalg.solve(poses, back[:, :, None])[:, :, 0]


def _scaled(matrix: Floats) -> tuple[Floats, Floats]:
    """The matrix with ones on its diagonal, and the scale: the unknowns differ by many powers of ten."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return matrix * np.outer(scale, scale), scale


def _solve(matrix: Floats, right: Floats) -> Floats:
    scaled, scale = _scaled(matrix)
    try:
        return np.asarray(cho_solve(cho_factor(scaled), right * scale) * scale, dtype=np.float64)
    except np.linalg.LinAlgError as error:
        raise CannotCalibrate(
            "the views do not determine both cameras; show the board at more tilts and distances"
        ) from error


def _sigma(system: _Normal, free: npt.NDArray[np.bool_], cost: float, residuals: int, views: int) -> Floats:
    """One standard deviation of the 24 common unknowns; 0 for those that were not free."""
    spare = residuals - int(free.sum()) - 6 * views
    if spare <= 0:
        raise CannotCalibrate("there are fewer corners than unknowns; take more views")
    solved = np.linalg.solve(system.poses, np.swapaxes(system.between, 1, 2))
    reduced = system.common - np.einsum("vij,vjk->ik", system.between, solved)
    scaled, scale = _scaled(reduced[np.ix_(free, free)])
    variance = np.diag(np.linalg.inv(scaled)) * scale**2 * cost / spare
    if (variance <= 0).any():
        raise CannotCalibrate(
            "the views do not determine both cameras; show the board at more tilts and distances"
        )
    sigma = np.zeros(24)
    sigma[free] = np.sqrt(variance)
    return sigma


def six(pose: Transform) -> Floats:
    turn = np.asarray(cv2.Rodrigues(pose.rotation)[0], dtype=np.float64).reshape(3)
    return np.concatenate([turn, pose.translation])


def camera_matrix(numbers: Floats) -> Floats:
    fx, fy, cx, cy = numbers[:4]
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
