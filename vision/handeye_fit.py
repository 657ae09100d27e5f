"""Hand-eye by least squares on what is measured: corners in both pictures, and the arm's own poses.

The unknowns are the camera's mounting and the board's place (6 numbers each). What an arm does not repeat
moves all corners of a pose together, so they are weighed by their common covariance (generalised least
squares): without that, a tenth of a millimetre of the arm is taken for an error of forty corners at once.
Rotations are small turns about the start, so nothing is singular. Robust first (Cauchy's loss, corners by
themselves), then plain with the weights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from scipy.optimize import least_squares

from vision import transforms
from vision.handeye import HandEye, Mount, Sighting, mount_from_held
from vision.handeye_steps import cross, moved, pixel_slopes, project_any, right_jacobian, turn_back
from vision.types import Floats, Ints, StereoModel, Transform, read_only

STEP: Final = 1e-6
"""Of the differences that make the Jacobian, in m and rad: rounding and curvature are both below 1e-6 px."""
LEAST_CORNERS: Final = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class Noise:
    """What corners and arm are good for, standard deviations. Defaults: sub-pixel corners of a printed board;
    an arm that repeats within 0.1 mm (makers state 0.03 to 0.1 mm for arms of this size)."""

    corner_px: float = 0.12
    arm_m: float = 6e-5
    arm_rad: float = 8e-5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fit:
    """A fitted hand-eye with what is left.

    ``pose_px`` (N,) root mean square of each pose's corners, px, with the arm taken at its word; ``rms_px``
    of all; ``covariance`` (6, 6) of a turn (rad) and a shift (m) of the camera in its own frame;
    ``board_scale`` how much larger the board is than told, ``rig_scale`` how much longer the baseline, and
    their deviations, where these were fitted (1 and NaN where not).
    """

    found: HandEye
    pose_px: Floats
    rms_px: float
    covariance: Floats
    board_scale: float = 1.0
    rig_scale: float = 1.0
    board_scale_sigma: float = float("nan")
    rig_scale_sigma: float = float("nan")


class _Problem:
    """All corners of all poses in one array, and the residuals of a step from a start."""

    def __init__(self, sightings: Sequence[Sighting], stereo: StereoModel, mount: Mount, scales: int) -> None:
        self.stereo, self.mount, self.scales = stereo, mount, scales
        self.poses = len(sightings)
        held = [mount_from_held(s, mount) for s in sightings]
        self.rotation = np.stack([h.rotation for h in held])
        self.shift = np.stack([h.translation for h in held])
        self.points, self.pixels, self.pose = [], [], []
        for eye in (0, 1):
            boards = [(s.board_left_m, s.board_right_m)[eye] for s in sightings]
            pixels = [(s.left_px, s.right_px)[eye] for s in sightings]
            self.points.append(np.concatenate([np.zeros((0, 3)), *boards]))
            self.pixels.append(np.concatenate([np.zeros((0, 2)), *pixels]))
            self.pose.append(np.repeat(np.arange(self.poses), [len(p) for p in pixels]))
        self.corners = sum(len(p) for p in self.pixels)
        self.size = 12 + scales

    def seen(self, start: HandEye, step: Floats, arm: Floats | None = None) -> list[Floats]:
        """Pixels (N, 2) in each eye. ``step`` (12 + scales,): turn and shift of the camera, of the board,
        then what board and baseline are longer; ``arm`` (6,): turn and shift of every tool pose in its own
        frame."""
        camera = moved(start.mount_from_camera, step[:6])
        board = moved(start.held_from_board, step[6:12])
        scale = step[12] if self.scales else 0.0
        rig = step[13] if self.scales > 1 else 0.0
        rotation, shift = self.rotation, self.shift
        if arm is not None:
            turn = transforms.matrix_from_vector(arm[:3])
            if self.mount == "fixed":
                rotation, shift = rotation @ turn, shift + rotation @ arm[3:]
            else:
                rotation, shift = turn @ rotation, shift @ turn.T + arm[3:]
        pixels = []
        for eye, model in enumerate((self.stereo.left, self.stereo.right)):
            if not len(self.points[eye]):
                pixels.append(np.zeros((0, 2)))
                continue
            held = (1.0 + scale) * self.points[eye] @ board.rotation.T + board.translation
            which = self.pose[eye]
            mounted = np.einsum("nij,nj->ni", rotation[which], held) + shift[which]
            points = (mounted - camera.translation) @ camera.rotation
            if eye == 1:
                motion = self.stereo.right_from_left
                points = points @ motion.rotation.T + (1.0 + rig) * motion.translation
            pixels.append(project_any(points, model))
        return pixels

    def apart(self, start: HandEye, step: Floats) -> Floats:
        """(2 corners,) px, seen where the fit has them minus found."""
        seen = self.seen(start, step)
        return np.concatenate([(a - b).ravel() for a, b in zip(seen, self.pixels, strict=True)])

    def slopes(self, start: HandEye, step: Floats) -> Floats:
        """(2 corners, 12 + scales) px per unit of ``step``: the derivative of `apart`."""
        turned, board = moved(start.mount_from_camera, step[:6]), moved(start.held_from_board, step[6:12])
        size = 1.0 + (step[12] if self.scales else 0.0)
        rig = 1.0 + (step[13] if self.scales > 1 else 0.0)
        back, at_turn, at_board = turn_back(step[:3]), right_jacobian(step[:3]), right_jacobian(step[6:9])
        blocks = []
        for eye, model in enumerate((self.stereo.left, self.stereo.right)):
            points, which = self.points[eye], self.pose[eye]
            if not len(points):
                continue
            held = size * points @ board.rotation.T + board.translation
            mounted = np.einsum("nij,nj->ni", self.rotation[which], held) + self.shift[which]
            seen = (mounted - turned.translation) @ turned.rotation
            by = np.zeros((len(points), 3, self.size))
            by[:, :, :3] = cross(seen) @ at_turn
            by[:, :, 3:6] = -back
            lead = np.einsum("ji,njk->nik", turned.rotation, self.rotation[which])
            by[:, :, 6:9] = lead @ (-size * board.rotation @ cross(points) @ at_board)
            by[:, :, 9:12] = lead @ start.held_from_board.rotation
            if self.scales:
                by[:, :, 12] = np.einsum("nij,nj->ni", lead, points @ board.rotation.T)
            if eye == 1:
                motion = self.stereo.right_from_left
                by = motion.rotation @ by
                if self.scales > 1:
                    by[:, :, 13] = motion.translation
                seen = seen @ motion.rotation.T + rig * motion.translation
            blocks.append((pixel_slopes(seen, model) @ by).reshape(-1, self.size))
        return np.concatenate(blocks)

    def arm_slopes(self, start: HandEye) -> Floats:
        """(2 corners, 6) px per rad and m of each corner's own tool pose."""
        columns = []
        for k in range(6):
            ahead, behind = (
                np.concatenate([p.ravel() for p in self.seen(start, np.zeros(self.size), sign * _unit(k))])
                for sign in (STEP, -STEP)
            )
            columns.append((ahead - behind) / (2.0 * STEP))
        return np.stack(columns, axis=1)

    def weights(self, start: HandEye, noise: Noise) -> list[tuple[Ints, Floats]]:
        """For each pose its rows and the (n, n) matrix that makes them independent and of unit deviation."""
        pose = np.repeat(np.concatenate(self.pose), 2)
        slopes = self.arm_slopes(start) * np.array([noise.arm_rad] * 3 + [noise.arm_m] * 3)
        weights = []
        for n in range(self.poses):
            rows = np.flatnonzero(pose == n)
            spread = slopes[rows] @ slopes[rows].T + noise.corner_px**2 * np.eye(len(rows))
            weights.append((rows, np.linalg.inv(np.linalg.cholesky(spread))))
        return weights


def fit(
    sightings: Sequence[Sighting],
    stereo: StereoModel,
    mount: Mount,
    start: HandEye,
    noise: Noise,
    *,
    robust: bool = True,
    scales: int = 0,
) -> Fit:
    """The hand-eye that explains all corners best, from a start that is about right.

    ``scales`` 1 fits the board's size as well, 2 also the baseline's.
    """
    problem = _Problem(sightings, stereo, mount, scales)
    begin = start
    if robust:

        def plain(step: Floats) -> Floats:
            return problem.apart(start, step) / noise.corner_px

        def plain_slopes(step: Floats) -> Floats:
            return problem.slopes(start, step) / noise.corner_px

        solved = least_squares(
            plain,
            np.zeros(problem.size),
            jac=plain_slopes,
            loss="cauchy",
            f_scale=3.0,
            x_scale="jac",
            max_nfev=60,
        )
        begin = _stepped(start, np.asarray(solved.x, dtype=np.float64))
    weights = problem.weights(begin, noise)

    def weighed(step: Floats) -> Floats:
        apart = problem.apart(begin, step)
        return np.concatenate([weight @ apart[rows] for rows, weight in weights])

    def weighed_slopes(step: Floats) -> Floats:
        slopes = problem.slopes(begin, step)
        return np.concatenate([weight @ slopes[rows] for rows, weight in weights])

    solved = least_squares(weighed, np.zeros(problem.size), jac=weighed_slopes, x_scale="jac", max_nfev=30)
    step = np.asarray(solved.x, dtype=np.float64)
    found = _stepped(begin, step)
    jacobian = np.asarray(solved.jac, dtype=np.float64)
    freedom = max(1, 2 * problem.corners - problem.size)
    inflate = max(1.0, float(2.0 * solved.cost) / freedom)
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * inflate
    sizes = step[12:]
    sigmas = np.sqrt(np.maximum(np.diag(covariance)[12:], 0.0))
    pose_px = _pose_px(problem, found, sizes)
    counts = np.array([s.corners for s in sightings])
    return Fit(
        found=found,
        pose_px=read_only(pose_px),
        rms_px=float(np.sqrt(np.sum(pose_px**2 * counts) / max(1, counts.sum()))),
        covariance=read_only(covariance[:6, :6].copy()),
        board_scale=1.0 + float(sizes[0]) if scales else 1.0,
        rig_scale=1.0 + float(sizes[1]) if scales > 1 else 1.0,
        board_scale_sigma=float(sigmas[0]) if scales else float("nan"),
        rig_scale_sigma=float(sigmas[1]) if scales > 1 else float("nan"),
    )


def _stepped(start: HandEye, step: Floats) -> HandEye:
    return HandEye(
        mount_from_camera=moved(start.mount_from_camera, step[:6]),
        held_from_board=moved(start.held_from_board, step[6:12]),
    )


def _unit(k: int) -> Floats:
    return np.asarray(np.arange(6) == k, dtype=np.float64)


def pose_residuals_px(
    sightings: Sequence[Sighting], stereo: StereoModel, mount: Mount, found: HandEye
) -> Floats:
    """(N,) root mean square of each pose's corners, px, with the arm taken at its word."""
    return _pose_px(_Problem(sightings, stereo, mount, 0), found, np.zeros(0))


def _pose_px(problem: _Problem, found: HandEye, sizes: Floats) -> Floats:
    step = np.concatenate([np.zeros(12), sizes])
    square, count = np.zeros(problem.poses), np.zeros(problem.poses)
    for seen, told, pose in zip(problem.seen(found, step), problem.pixels, problem.pose, strict=True):
        np.add.at(square, pose, np.sum((seen - told) ** 2, axis=1))
        np.add.at(count, pose, 1.0)
    return np.asarray(np.sqrt(square / np.maximum(count, 1.0)), dtype=np.float64)


# ------------------------------------------------------------------------------ one look


def board_pose(sighting: Sighting, stereo: StereoModel) -> Transform | None:
    """``camera_from_board`` of one look from both its pictures; None with too few corners.

    A flat board has two poses that look nearly alike from one side (Schweighofer and Pinz 2006); both are
    refined on the corners of both cameras, and the better one counts.
    """
    best: tuple[float, Transform] | None = None
    problem = _Problem((_alone(sighting),), stereo, "fixed", 0)
    for start in _board_starts(sighting, stereo):
        still = HandEye(mount_from_camera=transforms.identity(), held_from_board=start)

        def apart(step: Floats, still: HandEye = still) -> Floats:
            return problem.apart(still, _board_only(step))

        def slopes(step: Floats, still: HandEye = still) -> Floats:
            return problem.slopes(still, _board_only(step))[:, 6:12]

        solved = least_squares(
            apart,
            np.zeros(6),
            jac=slopes,
            method="lm",
            ftol=1e-10,
            xtol=1e-10,
            max_nfev=100,
        )
        pose = moved(start, np.asarray(solved.x))
        if pose.translation[2] > 0 and (best is None or solved.cost < best[0]):
            best = (float(solved.cost), pose)
    return None if best is None else best[1]


def _alone(sighting: Sighting) -> Sighting:
    return Sighting(
        name=sighting.name,
        base_from_tool=transforms.identity(),
        board_left_m=sighting.board_left_m,
        left_px=sighting.left_px,
        board_right_m=sighting.board_right_m,
        right_px=sighting.right_px,
    )


def _board_only(step: Floats) -> Floats:
    return np.concatenate([np.zeros(6), step])


def _board_starts(sighting: Sighting, stereo: StereoModel) -> list[Transform]:
    if len(sighting.left_px) >= LEAST_CORNERS:
        points, pixels, model, motion = sighting.board_left_m, sighting.left_px, stereo.left, None
    elif len(sighting.right_px) >= LEAST_CORNERS:
        points, pixels, model = sighting.board_right_m, sighting.right_px, stereo.right
        motion = transforms.invert(stereo.right_from_left)
    else:
        return []
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(
            points.reshape(-1, 1, 3),
            pixels.reshape(-1, 1, 2),
            model.matrix,
            model.distortion,
            flags=cv2.SOLVEPNP_IPPE,
        )
    except cv2.error:
        return []
    starts = []
    for turn, shift in zip(turns, shifts, strict=True):
        if not (np.isfinite(turn).all() and np.isfinite(shift).all()):
            continue
        pose = transforms.make(np.asarray(turn).reshape(3), np.asarray(shift).reshape(3))
        starts.append(pose if motion is None else transforms.compose(motion, pose))
    return starts
