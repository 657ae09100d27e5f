"""`mikado calibrate hand-eye`: a session to a verdict in plain words, a picture, and the calibration file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np
from rich.console import Console
from rich.table import Table

from cell import calibration, calibration_file
from cell.calibration_file import Json
from cell.commission.hand_eye_plot import write_plot
from cell.errors import UsageError
from vision import transforms
from vision.handeye import Mount, Sighting
from vision.handeye_checks import Verdict, calibrate
from vision.handeye_trouble import ADVISED_POSES, Finding, Trouble
from vision.types import Floats, StereoModel, Transform

EXIT_GOOD: Final = 0
EXIT_REFUSED: Final = 1

MOUNTED: Final[dict[Mount, str]] = {
    "fixed": "scene-mounted (the cameras stand beside the robot; the arm held the board)",
    "tool": "robot-mounted (the cameras ride on the arm; the board lay still)",
}

DO: Final[dict[Trouble, str]] = {
    Trouble.TOO_FEW: f"take more poses; {ADVISED_POSES} are advised",
    Trouble.WEAK_MOTION: "tilt the tool by 20 to 40 degrees to several sides; poses that only shift say "
    "nothing of the camera's place",
    Trouble.ONE_AXIS: "turn about a second axis too: tilt forward and back as well as to the sides",
    Trouble.WRONG_POSE: "was the arm still moving, or the pose file mixed up? Take it anew, or leave it out "
    "with --drop NAME",
    Trouble.WRONG_PITCH: "measure the printed bar and enter it: mikado calibrate board --board FILE "
    "--measured-bar-mm LENGTH",
    Trouble.WRONG_RIG: "the cameras were calibrated with a wrong pitch: correct the board file, calibrate "
    "the cameras again",
    Trouble.MIRRORED: "corners are numbered the wrong way round: is a driver flipping pictures, is the board "
    "printed mirrored or described with rows and columns exchanged?",
    Trouble.SWAPPED: "exchange cameras.left and cameras.right (or the pictures' names)",
    Trouble.NOT_A_PAIR: "is this the calibration of these cameras, were they moved since, are the pictures "
    "of a pair of one instant?",
    Trouble.INVERTED: "or the poses are tool_from_base instead of base_from_tool: export them the other way "
    "round",
    Trouble.OTHER_MOUNT: "is the camera on the arm or beside it? Give --mount the other way",
    Trouble.NO_FIT: "are poses and pictures in the same order, is the board fixed to what holds it, are the "
    "poses of the tool that was active all the time?",
}
"""What a person does about each."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """What to do with a session. ``distance_m`` from the left camera to the pick area; None: where the board
    was. ``drop`` names of poses to leave out; ``out`` None: the calibration file itself."""

    calibration: Path
    mount: Mount
    drop: tuple[str, ...]
    distance_m: float | None
    out: Path | None
    plot: Path | None
    tool: str


def area_points(stereo: StereoModel, distance_m: float) -> Floats:
    """(25, 3) m, left camera frame: a grid over what the left camera sees at a distance."""
    camera = stereo.left
    half = 0.4 * np.array([camera.width_px / camera.matrix[0, 0], camera.height_px / camera.matrix[1, 1]])
    x, y = np.meshgrid(np.linspace(-1, 1, 5) * half[0], np.linspace(-1, 1, 5) * half[1])
    return np.stack([x.ravel(), y.ravel(), np.ones(25)], axis=1) * distance_m


def conclude(sightings: Sequence[Sighting], wish: Wish, console: Console) -> int:
    """Solve, say, draw, and write if it is good.

    Raises
    ------
    CalibrationError, UsageError
    """
    known = calibration.load(wish.calibration)
    target = wish.out or wish.calibration
    if target.suffix.lower() != ".json":
        raise UsageError(
            f"{target}: calibration files are JSON; import others with mikado calibrate import, or "
            "give --out FILE.json"
        )
    unknown = set(wish.drop) - {s.name for s in sightings}
    if unknown:
        raise UsageError(f"--drop {', '.join(sorted(unknown))}: there is no such pose")
    kept = tuple(s for s in sightings if s.name not in wish.drop)
    distance = wish.distance_m or _board_distance(kept, known.stereo)
    verdict = calibrate(kept, known.stereo, wish.mount, area_points(known.stereo, distance))
    _say(kept, verdict, distance, console)
    if wish.plot is not None:
        write_plot(wish.plot, kept, verdict)
        console.print(f"picture of the poses: {wish.plot}")
    if not verdict.good or verdict.fit is None:
        console.print("[red]refused: nothing was written[/red]")
        return EXIT_REFUSED
    _write(wish, target, verdict, len(kept), distance)
    console.print(f"[green]written to {target}[/green]")
    return EXIT_GOOD


def _board_distance(sightings: Sequence[Sighting], stereo: StereoModel) -> float:
    """Median distance of the board by how large its squares look."""
    focal, far = float(stereo.left.matrix[0, 0]), []
    for s in sightings:
        board, pixels = (s.board_left_m, s.left_px) if len(s.left_px) >= 2 else (s.board_right_m, s.right_px)
        if len(pixels) >= 2:
            spread = float(np.linalg.norm(pixels.std(axis=0)))
            far.append(focal * float(np.linalg.norm(board.std(axis=0))) / max(spread, 1e-6))
    return float(np.median(far)) if far else 0.4


def _say(sightings: Sequence[Sighting], verdict: Verdict, distance_m: float, console: Console) -> None:
    motion = verdict.motion
    console.print(f"[bold]{MOUNTED[verdict.mount]}[/bold]")
    console.print(
        f"{len(sightings)} poses; largest turn {np.rad2deg(motion.largest_rad):.0f} degrees, about a "
        f"second axis "
        f"{np.rad2deg(motion.second_rad):.0f} degrees rms, tool over {1e3 * motion.reach_m:.0f} mm"
    )
    if len(sightings) < ADVISED_POSES and not verdict.findings:
        console.print(f"[yellow]{ADVISED_POSES} poses are advised[/yellow]")
    if verdict.fit is not None:
        _say_forms(verdict, distance_m, console)
        _say_poses(sightings, verdict, console)
        _say_result(verdict, distance_m, console)
    for finding in verdict.findings:
        names = ", ".join(sightings[k].name for k in finding.poses)
        who = f"pose {names}: " if names else ""
        console.print(f"[red]{who}{finding.trouble.value}: {told(finding)}[/red]\n  {DO[finding.trouble]}")


def told(finding: Finding) -> str:
    """The number of a finding in the units of people."""
    value, limit = finding.value, finding.limit
    match finding.trouble:
        case Trouble.WRONG_PITCH:
            return f"by the arm it is {value:.4f} times as large ({100 * (value - 1):+.2f} %)"
        case Trouble.WRONG_RIG:
            return f"by the arm it is {value:.4f} times as long ({100 * (value - 1):+.2f} %)"
        case Trouble.TOO_FEW:
            return f"{value:.0f}, at least {limit:.0f} are needed"
        case Trouble.MIRRORED:
            return f"{100 * value:.0f} % of the poses show its back"
    if finding.unit == "rad":
        return f"{np.rad2deg(value):.1f} degrees, at least {np.rad2deg(limit):.0f} are needed"
    return f"{value:.2f} px are left, limit {limit:.2f} px"


def _say_forms(verdict: Verdict, distance_m: float, console: Console) -> None:
    assert verdict.fit is not None
    table = Table(title="how it was solved", title_justify="left")
    for name in ("method", "left over, px", f"away from the fit at {1e3 * distance_m:.0f} mm, mm"):
        table.add_column(name, justify="left" if name == "method" else "right")
    here = transforms.apply(verdict.fit.found.mount_from_camera, np.array([[0.0, 0.0, distance_m]]))
    for each in verdict.forms:
        found = each.form.found
        if found is None:
            table.add_row(each.form.name, "gave up", "")
            continue
        there = transforms.apply(found.mount_from_camera, np.array([[0.0, 0.0, distance_m]]))
        table.add_row(
            each.form.name, f"{each.rms_px:.3f}", f"{1e3 * float(np.linalg.norm(there - here)):.3f}"
        )
    table.add_row("joint fit, both cameras", f"{verdict.fit.rms_px:.3f}", "0")
    console.print(table)


def _say_poses(sightings: Sequence[Sighting], verdict: Verdict, console: Console) -> None:
    table = Table(title="poses", title_justify="left")
    for name in ("pose", "corners", "left over, px", "left out once, mm"):
        table.add_column(name, justify="right")
    for k, sighting in enumerate(sightings):
        mark = "" if k in verdict.used else " (not used)"
        held = verdict.held_out_m[k]
        table.add_row(
            sighting.name + mark,
            f"{len(sighting.left_px)} + {len(sighting.right_px)}",
            f"{verdict.pose_px[k]:.3f}",
            "" if np.isnan(held) else f"{1e3 * held:.3f}",
            style=None if k in verdict.used else "red",
        )
    console.print(table)


def _say_result(verdict: Verdict, distance_m: float, console: Console) -> None:
    assert verdict.fit is not None
    pose = verdict.fit.found.mount_from_camera
    what = (
        "left camera in the robot's base" if verdict.mount == "fixed" else "left camera in the tool's frame"
    )
    x, y, z = 1e3 * pose.translation
    rx, ry, rz = np.rad2deg(transforms.vector_from_matrix(pose.rotation))
    console.print(
        f"{what}: x {x:.2f}, y {y:.2f}, z {z:.2f} mm; rotation vector {rx:.3f}, {ry:.3f}, {rz:.3f} degrees"
    )
    if len(verdict.area_m):
        console.print(
            f"[bold]error to expect at the pick area ({1e3 * distance_m:.0f} mm before the camera), "
            f"each pose "
            f"left out once: {1e3 * float(np.median(verdict.area_m)):.3f} mm median, "
            f"{1e3 * float(verdict.area_m.max()):.3f} mm at worst[/bold]"
        )
    console.print(
        f"sizes by the arm: board {verdict.fit.board_scale:.4f} ± {verdict.fit.board_scale_sigma:.4f}"
        + (
            f", baseline {verdict.fit.rig_scale:.4f} ± {verdict.fit.rig_scale_sigma:.4f}"
            if np.isfinite(verdict.fit.rig_scale_sigma)
            else ""
        )
        + " of what was told"
    )


def _write(wish: Wish, target: Path, verdict: Verdict, poses: int, distance_m: float) -> None:
    assert verdict.fit is not None
    key = "base_from_camera" if wish.mount == "fixed" else "tool_from_camera"
    pose = verdict.fit.found.mount_from_camera
    about: dict[str, Json] = {
        "mounting": "scene-mounted" if wish.mount == "fixed" else "robot-mounted",
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "poses": poses,
        "poses_used": len(verdict.used),
        "rms_px": round(verdict.fit.rms_px, 4),
        "distance_m": round(distance_m, 4),
        "expected_error_m": round(float(np.median(verdict.area_m)), 7),
        "expected_error_worst_m": round(float(verdict.area_m.max()), 7),
        "board_scale_by_arm": round(verdict.fit.board_scale, 5),
        "tool": wish.tool,
    }
    fields = _fields(wish.calibration)
    scale = 1e3 if fields.get("units") == "mm" else 1.0
    for other in ("base_from_camera", "tool_from_camera", "T_base_cam"):
        fields.pop(other, None)
    fields |= {key: _matrix(pose, scale), "hand_eye": about}
    calibration_file.write(target, fields)


def _fields(path: Path) -> dict[str, Json]:
    """The calibration as our own file has it, whatever form it came in."""
    if path.suffix.lower() == ".json":
        return calibration_file.read(path)
    known = calibration.load(path)
    stereo = known.stereo
    return {
        "version": 1,
        "units": "m",
        "image_width": stereo.left.width_px,
        "image_height": stereo.left.height_px,
        "K1": stereo.left.matrix.tolist(),
        "D1": stereo.left.distortion.tolist(),
        "K2": stereo.right.matrix.tolist(),
        "D2": stereo.right.distortion.tolist(),
        "R": stereo.right_from_left.rotation.tolist(),
        "T": stereo.right_from_left.translation.tolist(),
    }


def _matrix(pose: Transform, scale: float) -> Json:
    matrix = np.eye(4)
    matrix[:3, :3] = pose.rotation
    matrix[:3, 3] = scale * pose.translation
    rows: list[list[float]] = np.round(matrix, 12).tolist()
    return [list(row) for row in rows]
