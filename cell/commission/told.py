"""What one look says: a document for programs, a table for people."""

from __future__ import annotations

import math
from typing import Final, TypeAlias

from rich.table import Table

from cell.commission.sight import Sight
from cell.config import PartConfig
from cell.planning import Plan
from cell.stopwatch import StageTimes
from vision import transforms
from vision.types import Candidate, Floats, Refused, Scene

Json: TypeAlias = "dict[str, Json] | list[Json] | str | float | int | bool | None"
FORMAT_VERSION: Final = 3
"""3: candidates say which ``part`` they are, ``among`` what else was looked for. 2: ``residual_px`` of a
segment that nobody explains is null; sigmas, crossings, row offset."""


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


def _product(part: PartConfig) -> dict[str, Json]:
    return {"code": part.code, "name": part.name, "length_m": part.length_m}


def document_of(sight: Sight, scene: Scene, plans: dict[int, Plan], times: StageTimes) -> dict[str, Json]:
    """Everything a look gave, for a program to read."""
    base = sight.base_from_camera
    candidates: list[Json] = []
    for order, candidate in enumerate(scene.candidates, start=1):
        plan = plans.get(id(candidate))
        entry: dict[str, Json] = {
            "order": order,
            "part": candidate.part_code,
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
        "part": _product(sight.part),
        "among": [_product(part) for part in sight.among],
        "calibration": {"file": str(sight.known.path), "units": sight.known.units},
        "views": views,
        "segments": segments,
        "candidates": candidates,
        "crossings": crossings,
        "row_offset_px": _number(scene.row_offset_px, 4),
        "durations_s": {name: round(seconds, 5) for name, seconds in times.durations_s.items()},
    }


def table_of(sight: Sight, scene: Scene, plans: dict[int, Plan]) -> Table:
    """The candidates for a person; ± is one standard deviation, "under" the order of what lies over one."""
    table = Table(title=None)
    names = {part.code: part.name for part in sight.parts} if sight.among else {}
    table.add_column("order", justify="right")
    if names:
        table.add_column("part")
    table.add_column("length mm", justify="right")
    table.add_column("centre mm (left camera)")
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
            *([names[candidate.part_code]] if names else []),
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
