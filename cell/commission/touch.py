"""`mikado verify touch`: the arm goes to points the cameras measured; how far off it is decides.

Small residuals prove nothing about the place of the camera: a wrong tool, a wrong pitch and a moved rig leave
them as they are. Touching shows all of it at once. The arm hovers first, each descent is asked, and the
person tells how far the point lies from the tip, or leads the tip onto it and lets the arm say so.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np
from rich.console import Console
from rich.table import Table

from cell import calibration
from cell.calibration_file import Json
from cell.commission.arm import PATIENCE_S, SlowArm
from cell.config import CellConfig
from cell.errors import CalibrationError, UsageError
from cell.frames import grey_of, raised, tool_down, transform_of
from drivers.interfaces import StereoRig
from drivers.types import ToolPose
from vision import transforms
from vision.boards import Board, detect
from vision.touching import corners_in_space, spread_out
from vision.types import Floats

LEAST_POINTS: Final = 5
LEAST_SPAN: Final = 0.5
"""The points must span this share of the pick area, along both its sides."""
TOUCH_M_S: Final = 0.02
COMMON_SHARE: Final = 0.7
"""From this share of the error on, that all points have in common, it is a shift."""
EXIT_PASSED: Final = 0
EXIT_FAILED: Final = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """A point to touch: its number on the board, and where the cameras say it is, base frame, m."""

    number: int
    base_m: tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """How to touch. ``gap_m`` the tip stops this far above the point."""

    count: int
    hover_m: float
    gap_m: float
    tolerance_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Touched:
    """What one touch showed: where the point lies from the tip, less the gap, base frame, m."""

    point: Point
    off_m: tuple[float, float, float]

    @property
    def error_m(self) -> float:
        """How far."""
        return float(np.linalg.norm(self.off_m))


def points_of(config: CellConfig, rig: StereoRig, board: Board, count: int, clock_now: float) -> list[Point]:
    """Points of the board in the tray, spread, inside the workspace box.

    Raises
    ------
    UsageError
        The board is not seen by both cameras, or too few of its corners lie in the box.
    CalibrationError
        The calibration does not know where the robot is.
    """
    known = calibration.load(config.files.calibration)
    if known.base_from_camera is None:
        raise CalibrationError(f"{known.path}: base_from_camera is missing; do the hand-eye calibration")
    pair = rig.grab_pair(newer_than=clock_now, timeout_s=max(config.cameras.look_timeout_s, PATIENCE_S))
    left, right = (detect(grey_of(frame), board) for frame in (pair.left, pair.right))
    if left is None or right is None:
        who = "left" if left is None else "right"
        raise UsageError(f"the {who} camera does not see the board; lay it flat into the pick area")
    numbers, points = corners_in_space(left, right, known.stereo)
    base = transforms.apply(known.base_from_camera, points)
    low, high = np.array(config.workspace.box_min_m), np.array(config.workspace.box_max_m)
    inside = ((base[:, :2] >= low[:2]) & (base[:, :2] <= high[:2])).all(axis=1) & (base[:, 2] <= high[2])
    numbers, base = numbers[inside], base[inside]
    if len(base) < LEAST_POINTS:
        raise UsageError(
            f"{len(base)} corners lie in the workspace box; at least {LEAST_POINTS} are needed: move "
            f"the board"
        )
    span = np.ptp(base[:, :2], axis=0) / (high - low)[:2]
    if span.min() < LEAST_SPAN:
        raise UsageError(
            f"the corners span {100 * span[0]:.0f} % and {100 * span[1]:.0f} % of the pick area; at least "
            f"{100 * LEAST_SPAN:.0f} % of both sides are needed: lay the board in the middle, or use a "
            f"larger one"
        )
    chosen = spread_out(base, max(count, LEAST_POINTS))
    return [
        Point(number=int(numbers[k]), base_m=(float(base[k, 0]), float(base[k, 1]), float(base[k, 2])))
        for k in chosen
    ]


def touch(
    config: CellConfig,
    arm: SlowArm,
    points: list[Point],
    wish: Wish,
    ask: Callable[[str], bool],
    line: Callable[[str], str],
    console: Console,
) -> list[Touched]:
    """Hover over each point, touch it if that is confirmed, take the person's word on it."""
    touched = []
    beyond = config.jaws.tip_beyond_tool_m
    for k, point in enumerate(points):
        x, y, z = point.base_m
        target = tool_down(np.array([x, y, z + beyond + wish.gap_m]), 0.0)
        hover = raised(target, max(z + wish.hover_m, config.workspace.floor_z_m + wish.hover_m))
        console.print(
            f"point {k + 1} of {len(points)}, corner {point.number}: x {1e3 * x:.1f}, y {1e3 * y:.1f}, "
            f"z {1e3 * z:.1f} mm"
        )
        if not arm.robot.reachable(target) or not arm.robot.reachable(hover):
            console.print("  out of the arm's reach, left out")
            continue
        _over(arm, hover, config.workspace.travel_z_m)
        if not ask(f"  the tip hovers {1e3 * wish.hover_m:.0f} mm above. Go down?"):
            continue
        arm.line(transform_of(target), TOUCH_M_S)
        at = arm.settled().tool
        off = _told(arm, at, wish.gap_m, line)
        arm.line(transform_of(raised(at, hover.z)), TOUCH_M_S)
        if off is None:
            console.print("  left out")
            continue
        touched.append(Touched(point=point, off_m=off))
        console.print(f"  off by {1e3 * touched[-1].error_m:.2f} mm")
    if touched:
        _raise(arm, config.workspace.travel_z_m)
    return touched


def _over(arm: SlowArm, hover: ToolPose, travel_z_m: float) -> None:
    """At travel height to above the point, then down to the hover."""
    _raise(arm, travel_z_m)
    arm.line(transform_of(raised(hover, max(travel_z_m, hover.z))))
    arm.line(transform_of(hover))


def _raise(arm: SlowArm, travel_z_m: float) -> None:
    here = arm.robot.state().tool
    if here.z < travel_z_m:
        arm.line(transform_of(raised(here, travel_z_m)))


def _told(
    arm: SlowArm, at: ToolPose, gap_m: float, line: Callable[[str], str]
) -> tuple[float, float, float] | None:
    """Where the point lies from the tip, in mm by the person or by the arm that was led onto it."""
    while True:
        answer = line(
            f"  the tip should be {1e3 * gap_m:.1f} mm above the point. Where is the point from the "
            f"tip, mm in "
            "the robot's x y z? (or 'led' once the tip was led onto it by hand, 'skip'): "
        )
        if answer == "skip":
            return None
        if answer == "led":
            now = arm.settled().tool
            # the tip now stands on the point; it was meant to stand the gap above it
            return (now.x - at.x, now.y - at.y, now.z - at.z + gap_m)
        try:
            x, y, z = (1e-3 * float(v) for v in answer.replace(",", " ").split())
        except ValueError:
            continue
        if max(abs(x), abs(y), abs(z)) < 0.1:
            return (x, y, z + gap_m)


def conclude(config: CellConfig, touched: list[Touched], wish: Wish, console: Console) -> int:
    """Table, verdict, a line of history; 0 when every point is within the tolerance."""
    if len(touched) < LEAST_POINTS:
        raise UsageError(f"{len(touched)} points were touched; at least {LEAST_POINTS} are needed")
    table = Table(title="touched points, mm", title_justify="left")
    for name in ("corner", "x", "y", "z", "off x", "off y", "off z", "error"):
        table.add_column(name, justify="right")
    for each in touched:
        values = [f"{1e3 * v:.1f}" for v in each.point.base_m] + [f"{1e3 * v:+.2f}" for v in each.off_m]
        bad = each.error_m > wish.tolerance_m
        table.add_row(
            str(each.point.number), *values, f"{1e3 * each.error_m:.2f}", style="red" if bad else None
        )
    console.print(table)
    errors = np.array([each.error_m for each in touched])
    passed = bool(errors.max() <= wish.tolerance_m)
    off = np.array([each.off_m for each in touched])
    _hint(off, errors, passed, console)
    _history(config, touched, wish, passed)
    word = "[green]passed[/green]" if passed else "[red]failed[/red]"
    console.print(
        f"{word}: {1e3 * float(np.median(errors)):.2f} mm median, {1e3 * float(errors.max()):.2f} mm at "
        f"worst, "
        f"tolerance {1e3 * wish.tolerance_m:.2f} mm; history in {config.commissioning.touch_history}"
    )
    return EXIT_PASSED if passed else EXIT_FAILED


def _hint(off: Floats, errors: Floats, passed: bool, console: Console) -> None:
    mean = off.mean(axis=0)
    if not passed and float(np.linalg.norm(mean)) > COMMON_SHARE * float(errors.mean()):
        x, y, z = 1e3 * mean
        console.print(
            f"all points are off alike, by {x:+.2f}, {y:+.2f}, {z:+.2f} mm: is the tool (TCP) the one "
            f"that is "
            "mounted, was the rig moved? Nothing is corrected here: calibrate hand-eye again"
        )


def _history(config: CellConfig, touched: list[Touched], wish: Wish, passed: bool) -> None:
    path = config.commissioning.touch_history
    entry: dict[str, Json] = {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "cell": config.name,
        "calibration": _checksum(config.files.calibration),
        "tolerance_m": wish.tolerance_m,
        "passed": passed,
        "points": [
            {"corner": t.point.number, "base_m": list(t.point.base_m), "off_m": list(t.off_m)}
            for t in touched
        ],
    }
    try:
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry) + "\n")
    except OSError as error:
        raise UsageError(f"{path}: the history cannot be written: {error.strerror}") from error


def _checksum(path: Path) -> str:
    """Which calibration was touched: its stated checksum, or nothing."""
    try:
        data: Json = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return ""
    stated = data.get("checksum") if isinstance(data, dict) else None
    return stated if isinstance(stated, str) else ""
