"""One look without motion: a picture pair in; overlay, candidates and every refusal with its number out."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, TypeAlias

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from cell import calibration, frames, wiring
from cell import config as configuration
from cell.calibration import Calibration
from cell.colours import in_colour
from cell.config import CellConfig, PartConfig
from cell.errors import CalibrationError, UsageError
from cell.missed import MissedParts
from cell.pictures import PictureCheck, refuse_flawed
from cell.planning import Plan, plan_picks
from cell.reaching import reach_of
from cell.stopwatch import StageTimes
from drivers.factory import Factory
from drivers.timing import MonotonicClock
from drivers.types import JointAngles, Pixels
from vision import transforms
from vision.draw import draw
from vision.locate import locate
from vision.types import Candidate, Floats, Plane, Refused, Scene, Tuning

Json: TypeAlias = "dict[str, Json] | list[Json] | str | float | int | bool | None"
FORMAT_VERSION: Final = 2
"""2: ``residual_px`` of a segment that nobody explains is null; sigmas, crossings, row offset."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sight:
    """What a look needs, wherever it came from. ``left``, ``right`` (H, W[, 3]) uint8; names for people."""

    left: Pixels
    right: Pixels
    left_name: str
    right_name: str
    known: Calibration
    part: PartConfig
    tuning: Tuning
    table: Plane | None
    config: CellConfig | None


def from_files(left: Path, right: Path, calibration_path: Path, part_path: Path, tuning: Tuning) -> Sight:
    """A look at two picture files.

    Raises
    ------
    UsageError
        A file that is no picture, sizes that differ, no way to know the depth, a part too long to be seen.
    ConfigError, CalibrationError
        The product or calibration file cannot be used, or belongs to another picture size.
    PictureUnusable
        Black, saturated, flat.
    """
    part = configuration.load_part(part_path)
    known = calibration.load(calibration_path)
    pixels = [_picture(path) for path in (left, right)]
    sizes = [(p.shape[1], p.shape[0]) for p in pixels]
    if sizes[0] != sizes[1]:
        raise UsageError(
            f"pictures differ in size: {left} is {sizes[0][0]}x{sizes[0][1]} px, "
            f"{right} is {sizes[1][0]}x{sizes[1][1]} px; give the two pictures of one pair"
        )
    calibration.fit(known, *sizes[0], f"{left} and {right}")
    for name, picture in ((left, pixels[0]), (right, pixels[1])):
        refuse_flawed(_grey(picture), str(name))
    if np.array_equal(pixels[0], pixels[1]):
        raise UsageError(f"{left} and {right} hold the same picture; give the left and the right one")
    if tuning.depth_m is None and known.table is None:
        raise UsageError(
            f"{calibration_path} does not say where the table is; give the distance of the parts from the "
            "left camera with --depth-m MIN MAX (metres)"
        )
    depth = tuning.depth_m
    if depth is None and known.table is not None:
        depth = calibration.depth_bounds_m(known, known.table, tuning.height_m)
    _refuse_too_long(part, known, depth)
    _refuse_colour(part, pixels[0], str(left), tuning)
    return Sight(
        left=pixels[0],
        right=pixels[1],
        left_name=str(left),
        right_name=str(right),
        known=known,
        part=part,
        tuning=tuning,
        table=known.table,
        config=None,
    )


def from_cameras(config_path: Path, part_code: int | None, method: str | None) -> Sight:
    """A look through the configured cameras; nothing moves, the arm is not asked.

    Raises
    ------
    ConfigError, CalibrationError, UsageError, DriverError, PictureUnusable
    """
    config = configuration.load(config_path)
    known = wiring.check(config, str(config_path))
    part = config.parts[0] if part_code is None else config.part(part_code)
    if part is None:
        codes = ", ".join(str(p.code) for p in config.parts)
        raise UsageError(f"{config_path} has no part with code {part_code}; it has {codes}")
    clock = MonotonicClock()
    rig = Factory(clock).rig(config.cameras.left, config.cameras.right, config.cameras.max_skew_s)
    check = PictureCheck()
    rig.open()
    try:
        # twice, because only the second can show that a camera is frozen
        check.check(rig.grab_pair(newer_than=clock.now(), timeout_s=config.cameras.look_timeout_s))
        pair = rig.grab_pair(newer_than=clock.now(), timeout_s=config.cameras.look_timeout_s)
        check.check(pair)
    finally:
        rig.close()
    tuning = config.tuning.tuning()
    if method is not None:
        tuning = replace(tuning, method="published" if method == "published" else "default")
    _refuse_colour(part, pair.left.pixels, pair.left.camera, tuning)
    return Sight(
        left=pair.left.pixels,
        right=pair.right.pixels,
        left_name=pair.left.camera,
        right_name=pair.right.camera,
        known=known,
        part=part,
        tuning=tuning,
        table=calibration.table_of(known, config.workspace.floor_z_m),
        config=config,
    )


def look(sight: Sight, out: Path, console: Console) -> int:
    """Find, draw, write ``overlay.png`` and ``look.json`` into ``out``, print a table; exit code 0.

    In the table ± is one standard deviation, "under" the order of whatever lies over a part.
    """
    times = StageTimes(MonotonicClock())
    scene = locate(
        _grey(sight.left),
        _grey(sight.right),
        sight.known.stereo,
        sight.part.model(),
        sight.tuning,
        sight.table,
        observe=times,
        colour_left=None if sight.part.colour is None else in_colour(sight.left),
    )
    plans = _plans(sight, scene)
    overlay = draw(sight.left, scene, sight.known.stereo, sight.part.model())
    try:
        out.mkdir(parents=True, exist_ok=True)
        done, encoded = cv2.imencode(".png", overlay)
        if not done:
            raise UsageError(f"{out / 'overlay.png'}: the picture could not be encoded")
        (out / "overlay.png").write_bytes(encoded.tobytes())
        document = _document(sight, scene, plans, times)
        (out / "look.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{out}: cannot be written: {error.strerror}") from error
    console.print(_table(scene, plans))
    if scene.row_offset_px:
        console.print(
            f"the rows of the right picture are {scene.row_offset_px:+.2f} px off the calibration "
            "(corrected for this look): calibrate the cameras again",
            soft_wrap=True,
        )
    console.print(
        f"{len(scene.offered)} offered, {len(scene.candidates) - len(scene.offered)} refused; "
        f"method {scene.method}; {out / 'overlay.png'}, {out / 'look.json'}",
        soft_wrap=True,
        markup=False,
    )
    return 0


# ------------------------------------------------------------------------------ parts of it


def _picture(path: Path) -> Pixels:
    if not path.is_file():
        raise UsageError(f"{path}: no such file")
    picture = cv2.imdecode(np.frombuffer(path.read_bytes() or b"\0", dtype=np.uint8), cv2.IMREAD_COLOR)
    if picture is None:
        raise UsageError(f"{path}: not a picture OpenCV can read (PNG, JPEG, BMP, TIFF ...)")
    return np.asarray(picture, dtype=np.uint8)


def _grey(pixels: Pixels) -> Pixels:
    if pixels.ndim == 2:
        return pixels
    return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def _refuse_too_long(part: PartConfig, known: Calibration, depth: tuple[float, float] | None) -> None:
    if depth is None:
        return
    seen = calibration.widest_view_m(known.stereo, depth[1])
    if part.length_m > seen:
        raise UsageError(
            f"part {part.name}: length_m {part.length_m:.3f} is longer than the field of view "
            f"({seen:.3f} m along the diagonal at {depth[1]:.3f} m); correct length_m or the depth"
        )


def _refuse_colour(part: PartConfig, left: Pixels, left_name: str, tuning: Tuning) -> None:
    """Raise `UsageError` where the part is told by its colour and colour cannot be told."""
    if part.colour is None:
        return
    if tuning.method == "published":
        raise UsageError(
            f"part {part.name}: the published method does not look at colour; leave out --method"
        )
    if in_colour(left) is None:
        raise UsageError(
            f"{left_name}: the picture is grey, but part {part.name} is told by its colour; give a picture "
            "in colour or leave out the part's colour"
        )


def _plans(sight: Sight, scene: Scene) -> dict[int, Plan]:
    """Plans by the identity of their candidate, where the robot's place is known from a configuration."""
    if sight.config is None:
        return {}
    base = sight.known.base_from_camera
    if base is None:
        raise CalibrationError(
            f"{sight.known.path}: base_from_camera is missing; do the hand-eye calibration"
        )
    watch = JointAngles(q_rad=sight.config.workspace.watch_q_rad)
    kinematics = Factory(MonotonicClock()).kinematics(sight.config.robot)
    plans = plan_picks(
        scene,
        base,
        sight.config.workspace,
        sight.config.jaws,
        sight.part.diameter_m,
        frames.transform_of(frames.tool_down(np.zeros(3), 0.0)),
        MissedParts(),
        reach_of(kinematics, watch),
    )
    return {id(plan.candidate): plan for plan in plans}


def _why(candidate: Candidate, plan: Plan | None) -> list[tuple[str, float, float, str]]:
    """Every reason against a candidate: name, value, limit, unit."""
    reasons: list[Refused] = list(candidate.refusals)
    listed = [(r.reason.name, r.value, r.limit, str(r.unit)) for r in reasons]
    if plan is not None:
        listed += [(r.reason.name, r.value, r.limit, str(r.unit)) for r in plan.refused]
    return listed


def _number(value: float, digits: int = 6) -> float | None:
    """A number for JSON, which has no infinity and no NaN: those are null."""
    return round(value, digits) if math.isfinite(value) else None


def _numbers(array: Floats) -> list[Json]:
    return [round(float(v), 6) for v in array]


def _document(sight: Sight, scene: Scene, plans: dict[int, Plan], times: StageTimes) -> dict[str, Json]:
    base = sight.known.base_from_camera
    candidates: list[Json] = []
    for order, candidate in enumerate(scene.candidates, start=1):
        plan = plans.get(id(candidate))
        entry: dict[str, Json] = {
            "order": order,
            "offered": candidate.offered and (plan is None or plan.pick is not None),
            "start_m": _numbers(candidate.start),
            "end_m": _numbers(candidate.end),
            "nodes_m": [_numbers(node) for node in candidate.nodes],
            "length_m": round(candidate.length_m, 6),
            "score": round(candidate.score, 4),
            "residual_px": _number(candidate.residual_px, 4),
            "sigma_m": _number(candidate.sigma_m),
            "sigma_rad": _number(candidate.sigma_rad),
            "refusals": [
                {"reason": name, "value": round(value, 6), "limit": round(limit, 6), "unit": unit}
                for name, value, limit, unit in _why(candidate, plan)
            ],
        }
        if base is not None:
            entry["start_base_m"] = _numbers(transforms.apply(base, candidate.start))
            entry["end_base_m"] = _numbers(transforms.apply(base, candidate.end))
        if plan is not None and plan.pick is not None:
            entry["grasp_base"] = [round(v, 6) for v in plan.pick.grasp.six()]
            entry["clearance_m"] = _number(plan.pick.clearance_m)  # null where nothing else is seen
        candidates.append(entry)
    segments: list[Json] = [
        {
            "start_m": _numbers(scene.segments.start[i]),
            "end_m": _numbers(scene.segments.end[i]),
            "residual_px": _number(float(scene.segments.residual_px[i]), 4),
        }
        for i in range(len(scene.segments.start))
    ]
    crossings: list[Json] = [
        {
            "above": crossing.above + 1,  # the candidates' order
            "below": crossing.below + 1,
            "point_m": _numbers(crossing.point),
            "gap_m": _number(crossing.gap_m),
            "sure": _number(crossing.sure, 4),
        }
        for crossing in scene.crossings
    ]
    views: dict[str, Json] = {
        name: {
            "picture": picture,
            "band": list(view.band),
            "nodes_px": [_numbers(p) for p in view.graph.points],
            "degree": [int(d) for d in view.graph.degree],
            "edges": [[int(a), int(b)] for a, b in view.graph.edges],
        }
        for name, picture, view in (
            ("left", sight.left_name, scene.left),
            ("right", sight.right_name, scene.right),
        )
    }
    return {
        "version": FORMAT_VERSION,
        "frame": "raw left camera, metres; x right, y down, z forward",
        "method": scene.method,
        "part": {"code": sight.part.code, "name": sight.part.name, "length_m": sight.part.length_m},
        "calibration": {"file": str(sight.known.path), "units": sight.known.units},
        "views": views,
        "segments": segments,
        "candidates": candidates,
        "crossings": crossings,
        "row_offset_px": _number(scene.row_offset_px, 4),
        "durations_s": {name: round(seconds, 5) for name, seconds in times.durations_s.items()},
    }


def _table(scene: Scene, plans: dict[int, Plan]) -> Table:
    table = Table(title=None)
    for heading, justify in (("order", "right"), ("length mm", "right"), ("centre mm (left camera)", "left")):
        table.add_column(heading, justify="right" if justify == "right" else "left")
    for heading in ("score", "± mm", "± °", "under"):
        table.add_column(heading, justify="right")
    table.add_column("offered, or why not")
    under: dict[int, list[int]] = {}
    for crossing in scene.crossings:
        under.setdefault(crossing.below + 1, []).append(crossing.above + 1)
    for order, candidate in enumerate(scene.candidates, start=1):
        why = _why(candidate, plans.get(id(candidate)))
        x, y, z = (1000 * float(v) for v in candidate.centre)
        table.add_row(
            str(order),
            f"{1000 * candidate.length_m:.1f}",
            f"{x:.1f}, {y:.1f}, {z:.1f}",
            f"{candidate.score:.2f}",
            _shown(1000 * candidate.sigma_m, 2),
            _shown(math.degrees(candidate.sigma_rad), 2),
            ", ".join(str(above) for above in sorted(under.get(order, ()))),
            "; ".join(_said(*reason) for reason in why) if why else "[green]offered[/green]",
        )
    return table


def _shown(value: float, digits: int) -> str:
    """A number for people; nothing where the method does not tell it."""
    return f"{value:.{digits}f}" if math.isfinite(value) else ""


def _said(name: str, value: float, limit: float, unit: str) -> str:
    """A refusal as people read it: millimetres and degrees."""
    scale, shown = {"m": (1000.0, " mm"), "rad": (57.29578, "°"), "px": (1.0, " px")}.get(unit, (1.0, ""))
    return f"{name} {value * scale:.3g}{shown} (limit {limit * scale:.3g}{shown})"
