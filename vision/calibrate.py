"""Two cameras calibrated from views of a flat board: Zhang's method, then both cameras in one adjustment.

Zhang, "A flexible new technique for camera calibration", PAMI 22 (2000), in OpenCV's hands, gives each camera
alone and a first guess of where they stand to each other. Everything is then adjusted together on the
reprojection error of all corners (`vision.adjust`): what each camera is (nine numbers), how they stand to
each other (six), where the board lay (six a view). The inverse of the normal matrix of that adjustment, times
the mean square of what remains, is the covariance of its unknowns (Triggs et al., "Bundle adjustment - a
modern synthesis", 2000).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from vision.adjust import Adjusted, CannotCalibrate, Seen, adjust, camera_matrix
from vision.boards import Board, Corners, corner_points
from vision.stereo import rectification, rectify_points
from vision.transforms import average, compose, invert, make
from vision.types import CameraModel, Floats, Ints, StereoModel, Transform, read_only

NAMES: Final = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
"""What a camera is: focal lengths and principal point in px, distortion in OpenCV's order."""

LEAST_VIEWS: Final = 3
"""Zhang's method is determined by three views of different tilt."""
_EYES: Final = ("left", "right")


class Swapped(CannotCalibrate):
    """The camera called left stands on the right."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """One placing of the board as both cameras saw it; None where one did not see it."""

    name: str
    left: Corners | None
    right: Corners | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViewFit:
    """What remains of one view: root mean square in px of each camera's corners, NaN where it saw none.

    ``rows_px`` (N,) how far apart in rows the corners lie that both cameras saw, after rectification.
    ``apart_m``: how far off the others this view alone would place the right camera; NaN if seen by one.
    """

    name: str
    left_px: float
    right_px: float
    rows_px: Floats
    apart_m: float
    left_from_board: Transform

    @property
    def worst_px(self) -> float:
        """The larger of the two, by which views are ranked."""
        return float(np.nanmax([self.left_px, self.right_px]))

    @property
    def row_rms_px(self) -> float:
        """Root mean square of ``rows_px``; NaN where no corner was seen by both."""
        return float(np.sqrt(np.mean(self.rows_px**2))) if len(self.rows_px) else float("nan")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Calibrated:
    """Both cameras, and what is known of how well they are known.

    ``left_sigma``, ``right_sigma`` (9,) one standard deviation of each of `NAMES`; ``turn_sigma_rad``,
    ``shift_sigma_m`` (3,) those of ``right_from_left``. ``left_rms_px``, ``right_rms_px``: reprojection
    error as OpenCV states it (root of the mean squared distance).
    """

    stereo: StereoModel
    left_rms_px: float
    right_rms_px: float
    left_sigma: Floats
    right_sigma: Floats
    turn_sigma_rad: Floats
    shift_sigma_m: Floats
    views: tuple[ViewFit, ...]

    @property
    def rows_px(self) -> Floats:
        """(N,) row differences of all corners both cameras saw, rectified: the epipolar residual."""
        return np.concatenate([view.rows_px for view in self.views])


def calibrate(views: Sequence[View], board: Board, *, with_k3: bool = True) -> Calibrated:
    """Calibrate a pair of cameras.

    Parameters
    ----------
    views
        At least `LEAST_VIEWS` seen by each camera, and as many by both.
    with_k3
        Whether the third radial coefficient is among the unknowns; without, it stays 0.

    Raises
    ------
    Swapped
        The right camera stands on the left of the left one.
    CannotCalibrate
        Too few views, sizes that differ, views that do not determine the cameras.
    """
    size = _size(views)
    alone = [_alone(views, board, eye, size, with_k3) for eye in (0, 1)]
    cameras = [camera for camera, _ in alone]
    shared = [i for i, view in enumerate(views) if view.left is not None and view.right is not None]
    if len(shared) < LEAST_VIEWS:
        raise CannotCalibrate(
            f"the board is seen by both cameras at once in {len(shared)} views; {LEAST_VIEWS} at least"
        )
    poses = [poses for _, poses in alone]
    steps = [compose(poses[1][i], invert(poses[0][i])) for i in shared]
    start = _middle(steps)
    from_left = [
        poses[0][i] if i in poses[0] else compose(invert(start), poses[1][i]) for i in range(len(views))
    ]
    seen = _sightings(views, board)
    solved = adjust(seen, cameras, start, from_left, with_k3)
    camera_models = [_model(solved.cameras[eye], size) for eye in (0, 1)]
    right_from_left = make(solved.step[:3], solved.step[3:])
    if right_from_left.translation[0] > abs(float(right_from_left.translation[1])):
        raise Swapped(
            "left and right are swapped: the camera called left stands "
            f"{1e3 * float(np.linalg.norm(right_from_left.translation)):.0f} mm to the right of the other "
            "(or both pictures are mirrored)"
        )
    rms = [_rms([r for s, r in zip(seen, solved.residuals, strict=True) if s.eye == eye]) for eye in (0, 1)]
    stereo = StereoModel(
        left=camera_models[0],
        right=camera_models[1],
        right_from_left=right_from_left,
        rms_px=_rms(list(solved.residuals)),
    )
    sigma = solved.sigma
    return Calibrated(
        stereo=stereo,
        left_rms_px=rms[0],
        right_rms_px=rms[1],
        left_sigma=read_only(sigma[0:9]),
        right_sigma=read_only(sigma[9:18]),
        turn_sigma_rad=read_only(sigma[18:21]),
        shift_sigma_m=read_only(sigma[21:24]),
        views=_fits(views, seen, solved, stereo, dict(zip(shared, steps, strict=True))),
    )


# ------------------------------------------------------------------------------ first guess


def _size(views: Sequence[View]) -> tuple[int, int]:
    sizes = {(c.width_px, c.height_px) for v in views for c in (v.left, v.right) if c is not None}
    if len(sizes) > 1:
        raise CannotCalibrate(
            "the pictures differ in size: " + ", ".join(f"{w}x{h}" for w, h in sorted(sizes)) + " px"
        )
    if not sizes:
        raise CannotCalibrate("the board is seen in none of the views")
    return sizes.pop()


def _of(view: View, eye: int) -> Corners | None:
    return view.left if eye == 0 else view.right


def _alone(
    views: Sequence[View], board: Board, eye: int, size: tuple[int, int], with_k3: bool
) -> tuple[Floats, dict[int, Transform]]:
    """One camera by itself: its nine numbers, and the pose of the board in each view it saw."""
    places = [i for i, view in enumerate(views) if _of(view, eye) is not None]
    if len(places) < LEAST_VIEWS:
        raise CannotCalibrate(
            f"the {_EYES[eye]} camera sees the board in {len(places)} views; {LEAST_VIEWS} at least"
        )
    points: list[npt.NDArray[np.float32]] = []
    pixels: list[npt.NDArray[np.float32]] = []
    for i in places:
        corners = _of(views[i], eye)
        assert corners is not None
        points.append(corner_points(board, corners.ids).astype(np.float32))
        pixels.append(corners.pixels.astype(np.float32))
    try:
        _, matrix, distortion, turns, shifts = cv2.calibrateCamera(
            objectPoints=points,
            imagePoints=pixels,
            imageSize=size,
            cameraMatrix=np.eye(3),
            distCoeffs=np.zeros(5),
            flags=0 if with_k3 else cv2.CALIB_FIX_K3,
        )
    except cv2.error as error:
        raise CannotCalibrate(
            f"the views of the {_EYES[eye]} camera do not determine it ({error.err}); tilt the board more"
        ) from error
    numbers = np.concatenate(
        [[matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]], np.asarray(distortion).reshape(-1)[:5]]
    )
    if not np.isfinite(numbers).all() or min(numbers[:2]) <= 0:
        raise CannotCalibrate(
            f"the views of the {_EYES[eye]} camera do not determine it; tilt the board more"
        )
    poses = {
        i: make(np.asarray(turn).reshape(3), shift)
        for i, turn, shift in zip(places, turns, shifts, strict=True)
    }
    return numbers, poses


def _middle(steps: list[Transform]) -> Transform:
    """The mean of those near the median: a view whose pictures do not belong together shall not count."""
    shifts = np.array([step.translation for step in steps])
    off = np.linalg.norm(shifts - np.median(shifts, axis=0), axis=1)
    return average([step for step, far in zip(steps, off, strict=True) if far <= 2.0 * np.median(off) + 1e-9])


def _sightings(views: Sequence[View], board: Board) -> list[Seen]:
    seen = []
    for i, view in enumerate(views):
        for eye in (0, 1):
            corners = _of(view, eye)
            if corners is not None:
                seen.append(
                    Seen(eye=eye, view=i, points=corner_points(board, corners.ids), pixels=corners.pixels)
                )
    return seen


# ------------------------------------------------------------------------------ what remains


def _fits(
    views: Sequence[View],
    seen: list[Seen],
    solved: Adjusted,
    stereo: StereoModel,
    steps: dict[int, Transform],
) -> tuple[ViewFit, ...]:
    remains = {(one.view, one.eye): res for one, res in zip(seen, solved.residuals, strict=True)}
    typical = np.median([step.translation for step in steps.values()], axis=0)
    try:
        rect = rectification(stereo)
    except ValueError as error:
        apart = {i: float(np.linalg.norm(step.translation - typical)) for i, step in steps.items()}
        worst = max(apart, key=lambda i: apart[i])
        raise CannotCalibrate(
            f"the views contradict each other ({error}); the worst is {views[worst].name}: alone it would "
            "place "
            f"the right camera {1e3 * apart[worst]:.0f} mm off the others: pictures of two moments?"
        ) from error
    fits = []
    for i, view in enumerate(views):
        rows = np.zeros(0)
        if view.left is not None and view.right is not None:
            _, first, second = _common(view.left.ids, view.right.ids)
            left = rectify_points(view.left.pixels[first], rect, "left")
            right = rectify_points(view.right.pixels[second], rect, "right")
            rows = right[:, 1] - left[:, 1]
        step = steps.get(i)
        fits.append(
            ViewFit(
                name=view.name,
                left_px=_rms([remains[i, 0]]) if (i, 0) in remains else float("nan"),
                right_px=_rms([remains[i, 1]]) if (i, 1) in remains else float("nan"),
                rows_px=read_only(rows),
                apart_m=float("nan") if step is None else float(np.linalg.norm(step.translation - typical)),
                left_from_board=make(solved.boards[i, :3], solved.boards[i, 3:]),
            )
        )
    return tuple(fits)


def _common(first: Ints, second: Ints) -> tuple[Ints, Ints, Ints]:
    both, one, other = np.intersect1d(first, second, assume_unique=True, return_indices=True)
    return both, one, other


def _rms(parts: list[Floats]) -> float:
    off = np.concatenate(parts)
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def _model(numbers: Floats, size: tuple[int, int]) -> CameraModel:
    return CameraModel(
        matrix=read_only(camera_matrix(numbers)),
        distortion=read_only(numbers[4:].copy()),
        width_px=size[0],
        height_px=size[1],
    )
