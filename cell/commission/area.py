"""`mikado area`: where the arm may pick, taught by touching or by points in a picture.

The configuration keeps its comments: only the values change, and the whole file is checked before it is
written. The box gets the heights it is told; points never widen what the arm may enter beyond what was shown.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from rich.console import Console

from cell import calibration
from cell import config as configuration
from cell.commission import changed
from cell.commission.arm import PATIENCE_S, LedArm
from cell.config import CellConfig
from cell.emptiness import on_plane
from cell.errors import UsageError
from cell.frames import grey_of
from drivers.factory import Factory
from drivers.timing import Clock
from drivers.types import FramePair, Pixels
from vision import transforms
from vision.types import Floats

LEAST_POINTS: Final = 3
GRID_PX: Final = 40


def led_points(arm: LedArm, count: int, tip_m: float, line: Callable[[str], str]) -> Floats:
    """(N, 3) m, base frame: where the tips stood when the person said so; ``tip_m`` beyond the tool point."""
    points = []
    for k in range(count):
        line(f"lead the tips onto corner {k + 1} of {count} of the pick area's floor, then press Enter: ")
        tool = arm.settled().tool
        along = transforms.matrix_from_vector(np.array([tool.rx, tool.ry, tool.rz]))[:, 2]
        points.append(np.array([tool.x, tool.y, tool.z]) + tip_m * along)
    return np.array(points)


def picture_points(config: CellConfig, pixels: Sequence[tuple[float, float]], floor_z_m: float) -> Floats:
    """(N, 3) m, base frame: where the rays of raw left pixels meet the floor.

    Raises
    ------
    CalibrationError
        The calibration does not know where the robot is.
    UsageError
        A point outside the picture, or one whose ray does not meet the floor.
    """
    known = calibration.load(config.files.calibration)
    camera = known.stereo.left
    for u, v in pixels:
        if not (0 <= u < camera.width_px and 0 <= v < camera.height_px):
            raise UsageError(
                f"point {u:g},{v:g} lies outside the picture of {camera.width_px}x{camera.height_px}"
            )
    plane = calibration.table_of(known, floor_z_m)
    points = on_plane(np.array(pixels, dtype=np.float64), camera, plane)
    if not np.isfinite(points).all():
        raise UsageError("a point does not look down on the floor")
    assert known.base_from_camera is not None
    return transforms.apply(known.base_from_camera, points)


def write_area(
    path: Path, config: CellConfig, points: Floats, heights_m: float, *, floor: bool, margin_m: float
) -> int:
    """Put the box about the points, and the floor's height where it was touched, into the configuration.

    Raises
    ------
    UsageError
        Too few points, or a box without area.
    ConfigError
        The result would not be a configuration; nothing is written.
    """
    if len(points) < LEAST_POINTS:
        raise UsageError(f"{len(points)} points; at least {LEAST_POINTS} corners of the area are needed")
    low, high = points[:, :2].min(axis=0) + margin_m, points[:, :2].max(axis=0) - margin_m
    if (high - low).min() <= 0.02:
        raise UsageError("the points lie on one line, or the margin leaves nothing: show corners of the area")
    floor_z = float(np.median(points[:, 2])) if floor else config.workspace.floor_z_m
    if floor and float(np.ptp(points[:, 2])) > 0.005:
        raise UsageError(
            f"the touched corners differ by {1e3 * float(np.ptp(points[:, 2])):.1f} mm in height; the floor "
            "is level within 5 mm, or the tips did not stand on it"
        )
    below = config.workspace.floor_z_m - config.workspace.box_min_m[2]
    box_low = (*low, floor_z - below)
    box_high = (*high, floor_z + heights_m)
    values = {"box_min_m": _list(box_low), "box_max_m": _list(box_high)}
    if floor:
        values["floor_z_m"] = f"{floor_z:.4f}"
    changed.put(path, "workspace", values, configuration.load)
    return 0


def _list(values: Sequence[float]) -> str:
    return "[" + ", ".join(f"{v:.4f}" for v in values) + "]"


def look(config: CellConfig, clock: Clock) -> FramePair:
    """One pair through the configured cameras."""
    factory = Factory(clock)
    rig = factory.rig(config.cameras.left, config.cameras.right, config.cameras.max_skew_s)
    rig.open()
    try:
        return rig.grab_pair(newer_than=clock.now(), timeout_s=max(PATIENCE_S, config.cameras.look_timeout_s))
    finally:
        rig.close()


def gridded(pair: FramePair, path: Path, console: Console) -> None:
    """The left picture with a grid of pixel numbers, to read points off."""
    picture = np.asarray(cv2.cvtColor(grey_of(pair.left), cv2.COLOR_GRAY2BGR), dtype=np.uint8)
    height, width = picture.shape[:2]
    for u in range(0, width, GRID_PX):
        strong = u % (2 * GRID_PX) == 0
        cv2.line(picture, (u, 0), (u, height - 1), (90, 160, 90), 1)
        if strong:
            cv2.putText(picture, str(u), (u + 2, 10), cv2.FONT_HERSHEY_SIMPLEX, 0.35, (80, 255, 80), 1)
    for v in range(0, height, GRID_PX):
        cv2.line(picture, (0, v), (width - 1, v), (90, 160, 90), 1)
        cv2.putText(picture, str(v), (2, v + 10), cv2.FONT_HERSHEY_SIMPLEX, 0.35, (80, 255, 80), 1)
    write_picture(path, picture)
    console.print(
        f"{path}: read the corners of the pick area off its grid, then give them with --pixels U,V ..."
    )


def write_picture(path: Path, picture: Pixels) -> None:
    """Write a picture. Raises `UsageError` when that cannot be done."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        done = cv2.imwrite(str(path), picture)
    except (OSError, cv2.error) as error:
        raise UsageError(f"{path}: cannot be written: {error}") from error
    if not done:
        raise UsageError(f"{path}: cannot be written")
