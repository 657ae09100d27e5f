"""A rig that sees a board from known poses: exact projections with noise, and the rendered data set."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cell import calibration
from cell.commission import session
from vision import transforms
from vision.boards import Board
from vision.handeye import HandEye, Mount, Sighting
from vision.stereo import project
from vision.types import CameraModel, Floats, StereoModel, Transform

BOARD = Board(kind="charuco", columns=9, rows=7, pitch_m=0.020, marker_m=0.015, dictionary="DICT_4X4_50")
SHARED = Path(__file__).parents[3] / "shared" / "data" / "scenes-dev"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Session:
    """A session with its truth."""

    sightings: tuple[Sighting, ...]
    stereo: StereoModel
    mount: Mount
    truth: Transform


def stereo() -> StereoModel:
    camera = CameraModel(
        matrix=np.array([[571.0, 0, 318.0], [0, 572.0, 243.0], [0, 0, 1.0]]),
        distortion=np.array([-0.046, 0.082, 0.0007, -0.0011, -0.021]),
        width_px=640,
        height_px=480,
    )
    turn = transforms.matrix_from_vector([0.01, 0.12, 0.005])
    return StereoModel(
        left=camera, right=camera, right_from_left=transforms.make(turn, [-0.075, 0.001, 0.004])
    )


def points_of(board: Board = BOARD) -> Floats:
    across, down = board.columns - 1, board.rows - 1
    x, y = np.meshgrid(np.arange(1.0, across + 1), np.arange(1.0, down + 1))
    return board.pitch_m * np.stack([x.ravel(), y.ravel(), np.zeros(across * down)], axis=1)


def made(
    mount: Mount, poses: int = 15, tilt_rad: float = 0.5, spin_rad: float = 0.6, seed: int = 1
) -> Session:
    """A session by projection: corners good to 0.05 px, an arm that repeats within 0.05 mm."""
    rng = np.random.default_rng(seed)
    rig, points = stereo(), points_of()
    eye = np.diag([1.0, -1.0, -1.0])
    if mount == "fixed":
        truth = transforms.make(transforms.matrix_from_vector([0.1, 0.05, 0.02]) @ eye, [0.45, 0.03, 0.42])
        held = transforms.make(transforms.matrix_from_vector([0.03, 0.02, 0.1]), [-0.09, 0.05, 0.01])
    else:
        truth = transforms.make(transforms.matrix_from_vector([0.02, -0.03, 0.3]), [0.05, -0.02, 0.06])
        held = transforms.make(transforms.matrix_from_vector([0.02, 0.01, 0.4]) @ eye, [0.4, 0.1, 0.02])
    sightings: list[Sighting] = []
    while len(sightings) < poses:
        direction = rng.uniform(0, 2 * np.pi)
        tilt = tilt_rad * rng.uniform(0.4, 1.0)
        turn = transforms.matrix_from_vector([tilt * np.cos(direction), tilt * np.sin(direction), 0.0])
        turn = turn @ transforms.matrix_from_vector([0.0, 0.0, spin_rad * rng.uniform(-1, 1)])
        middle = np.array([*rng.uniform(-0.03, 0.03, 2), rng.uniform(0.32, 0.42)])
        seen = transforms.make(turn, middle - turn @ points.mean(axis=0))
        pixels = project(transforms.apply(seen, points), rig)
        if any(not ((p > 5) & (p < [634, 474])).all() for p in pixels):
            continue
        if mount == "fixed":
            tool = transforms.compose(truth, seen, transforms.invert(held))
        else:
            tool = transforms.compose(held, transforms.invert(seen), transforms.invert(truth))
        off = transforms.make(rng.normal(0, 4e-5, 3), rng.normal(0, 3e-5, 3))
        left, right = (p + rng.normal(0, 0.05, p.shape) for p in pixels)
        sightings.append(
            Sighting(
                name=f"{len(sightings):02d}",
                base_from_tool=transforms.compose(tool, off),
                board_left_m=points,
                left_px=left,
                board_right_m=points if mount == "fixed" else np.zeros((0, 3)),
                right_px=right if mount == "fixed" else np.zeros((0, 2)),
            )
        )
    return Session(sightings=tuple(sightings), stereo=rig, mount=mount, truth=truth)


def rendered(mode: str) -> Session:
    """A set of the rendered data: ``eye_to_hand`` or ``eye_in_hand``."""
    folder = SHARED / "calibration" / f"handeye-webcam-{mode}"
    told = json.loads((folder / "board.json").read_text())
    board = Board(
        kind="charuco",
        columns=told["squares"][0],
        rows=told["squares"][1],
        pitch_m=1e-3 * told["square"],
        marker_m=1e-3 * told["marker"],
        dictionary=told["dict"],
    )
    rig = calibration.load(SHARED / "rigs" / "dev-webcam.yaml").stereo
    sightings, _ = session.seen_in(folder, session.read(folder / "robot_poses.json"), board)
    mount: Mount = "fixed" if mode == "eye_to_hand" else "tool"
    true = json.loads((folder / "truth.json").read_text())
    matrix = np.array(true["T_base_cam" if mount == "fixed" else "T_flange_cam"])
    truth = transforms.make(transforms.nearest_rotation(matrix[:3, :3]), 1e-3 * matrix[:3, 3])
    return Session(sightings=sightings, stereo=rig, mount=mount, truth=truth)


def errors_mm(found: HandEye | None, truth: Transform, area_m: Floats) -> Floats:
    """How far points (K, 3) of the left camera's frame land from the truth, mm."""
    if found is None:
        return np.full(len(area_m), np.nan)
    away = transforms.apply(found.mount_from_camera, area_m) - transforms.apply(truth, area_m)
    return np.asarray(1e3 * np.linalg.norm(away, axis=1), dtype=np.float64)


def swapped(sighting: Sighting) -> Sighting:
    return replace(
        sighting,
        board_left_m=sighting.board_right_m,
        left_px=sighting.right_px,
        board_right_m=sighting.board_left_m,
        right_px=sighting.left_px,
    )


def scaled(sighting: Sighting, factor: float) -> Sighting:
    return replace(
        sighting,
        board_left_m=factor * sighting.board_left_m,
        board_right_m=factor * sighting.board_right_m,
    )


def mirrored(sighting: Sighting, width_m: float = 0.18) -> Sighting:
    flip, shift = np.array([-1.0, 1.0, 1.0]), np.array([width_m, 0.0, 0.0])
    return replace(
        sighting,
        board_left_m=flip * sighting.board_left_m + shift,
        board_right_m=flip * sighting.board_right_m + shift,
    )
