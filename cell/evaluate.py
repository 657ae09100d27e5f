"""The detector over a folder of scenes: one result file a scene, for a scoring program to read."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from cell import scenes
from cell.calibration import Calibration
from cell.config import ColourConfig, PartConfig, load_part
from cell.errors import CalibrationError, UsageError
from cell.stopwatch import StageTimes
from drivers.timing import MonotonicClock
from drivers.types import Pixels
from vision.default import warm_up
from vision.locate import locate
from vision.quality import assess
from vision.types import Candidate, Floats, Grey, Method, PartModel, Scene, Tuning

# How far a length may be off. The published method measures between skeleton ends in whole pixels of
# disparity (3.3 mm of depth each at 400 mm), so a narrow gate costs it more recall than it saves false
# couples; the figures are in the evaluation report.
STICK_TOLERANCE_M: Final[dict[Method, float]] = {"published": 0.010, "default": 0.004}
TOPOLOGY_TOLERANCE_M: Final = 0.008
# The skeleton of a wide plate has its ends and junctions up to half a width off, each.
TOPOLOGY_TOLERANCE_WIDTHS: Final = 0.9

SPUR_WIDTHS: Final = 0.8
"""The skeleton of a square end forks; its branches are 0.7 widths long and must go."""
EPIPOLAR_WIDTHS: Final = 0.3
"""Which branch of the fork is left may differ between the views; for sticks the tuning's own value counts."""

HEIGHT_M: Final = (-0.005, 0.100)
"""Scenes say nothing of heights; parts may stand on blocks or on each other."""

Json: TypeAlias = "Mapping[str, Json] | Sequence[Json] | str | float | None"
Result: TypeAlias = dict[str, Json]


def evaluate(
    scenes_dir: Path,
    out_dir: Path,
    method: Method,
    only: tuple[str, ...] = (),
    among: tuple[Path, ...] = (),
) -> int:
    """Run the detector over scenes and write ``<out_dir>/<scene>.json`` for each.

    Results are in mm in the raw left camera frame. ``time_ms`` is the work on the pair without reading files,
    ``stages_ms`` the same by stage; what is compiled is compiled before. Parts that are only covered or too
    steep to be had now are detections too, ranked behind those that are offered, with their ``refusals``.
    ``crossings`` say which rank lies on which, ``reasons`` count why candidates were refused; ``nothing``
    says in words why a scene has nothing to pick; ``others`` are parts of further products. A scene whose
    pictures cannot be used gets no detections and a ``problem``.

    Parameters
    ----------
    scenes_dir
        A set (``rigs`` and ``scenes`` inside), or its ``scenes`` folder.
    only
        Names of scenes; all when empty.
    among
        Product files: what may lie in every scene besides what it asks for. One that a scene asks for itself
        (nothing tells the two apart) is left out there.

    Returns
    -------
    int
        Number of scenes done.

    Raises
    ------
    UsageError, CalibrationError, ConfigError
        Nothing to work on, something unreadable, or other products for the published method.
    """
    if among and method == "published":
        raise UsageError("--among: the published method knows one product a look")
    others = tuple(load_part(path) for path in among)
    found = scenes.find(scenes_dir, only)
    try:
        out_dir.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{out_dir}: cannot write there: {error}") from error
    warm_up()
    rigs: dict[str, Calibration] = {}
    bar = (TextColumn("{task.description:<16}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*bar) as progress:
        task = progress.add_task("", total=len(found))
        for scene in found:
            progress.update(task, description=scene.name)
            if scene.rig not in rigs:
                rigs[scene.rig] = scenes.rig(scene)
            result = _evaluate_one(scene, rigs[scene.rig], method, others)
            (out_dir / f"{scene.name}.json").write_text(json.dumps(result), encoding="utf-8")
            progress.advance(task)
    return len(found)


def _evaluate_one(
    scene: scenes.SceneFolder, rig: Calibration, method: Method, others: tuple[PartConfig, ...]
) -> Result:
    wanted = scenes.request(scene, STICK_TOLERANCE_M[method])
    part = wanted.part
    if part.topology is not None:
        tolerance_m = max(TOPOLOGY_TOLERANCE_M, TOPOLOGY_TOLERANCE_WIDTHS * wanted.width_m)
        part = replace(part, length_tolerance_m=tolerance_m)
    left, right = scenes.grey(scene, "left"), scenes.grey(scene, "right")
    problem = _problem(left, right, rig)
    if problem is not None:
        return {"scene": scene.name, "detections": [], "segments": [], "problem": problem}
    width_px = _width_px(wanted, rig)
    tuning = Tuning(
        method=method,
        height_m=HEIGHT_M,
        spur_px=max(Tuning().spur_px, SPUR_WIDTHS * width_px),
        epipolar_px=max(Tuning().epipolar_px, EPIPOLAR_WIDTHS * width_px),
    )
    among = _besides(part, others)
    told = any(one.colour is not None for one in (part, *among))
    colour = scenes.colour(scene) if told else None
    notes = _why_no_colour(part, colour, method)
    if notes:
        part = replace(part, colour=None)
    if colour is None:
        among = tuple(replace(one, colour=None) for one in among)
    clock = MonotonicClock()
    started_at = clock.now()
    times = StageTimes(clock)
    seen = locate(left, right, rig.stereo, part, tuning, rig.table, times, colour, among)
    took_s = clock.now() - started_at
    stages_ms = {stage: round(seconds * 1e3, 2) for stage, seconds in times.durations_s.items()}
    return {
        **_result(scene.name, wanted.cls, part, seen, took_s),
        **({"others": _others(seen, part, among)} if among else {}),
        "stages_ms": stages_ms,
        "notes": notes,
    }


def _besides(part: PartModel, others: tuple[PartConfig, ...]) -> tuple[PartModel, ...]:
    """Products that may lie there too, with codes of their own; without what the scene asks for itself."""
    models = (other.model() for other in others if not _is_asked(part, other))
    return tuple(replace(model, code=code) for code, model in enumerate(models, start=part.code + 1))


def _is_asked(part: PartModel, other: PartConfig) -> bool:
    """Whether a product file is what the scene asks for, by length, thickness and colour."""
    if part.topology is not None:
        return False
    colour = ColourConfig.of(part.colour)
    asked = PartConfig(
        code=part.code,
        name=part.name,
        length_m=part.length_m,
        length_tolerance_m=part.length_tolerance_m,
        diameter_m=part.diameter_m,
        colour=colour,
    )
    return not asked.apart_from(other)


def _others(seen: Scene, part: PartModel, among: tuple[PartModel, ...]) -> list[Json]:
    """The parts of other products: which, where, and why they could not be had now."""
    names = {one.code: one.name for one in among}
    return [
        {
            "product": names[candidate.part_code],
            "p0": _mm(candidate.start),
            "p1": _mm(candidate.end),
            "score": round(candidate.score, 4),
            "offered": candidate.offered,
        }
        for candidate in seen.recognised
        if candidate.part_code != part.code
    ]


def _why_no_colour(part: PartModel, colour: Pixels | None, method: Method) -> list[str]:
    """Why the colour that was asked for is left out of account, in words; empty when it is not."""
    if part.colour is None:
        return []
    if colour is None:
        return ["colour ignored: the left picture is grey"]
    if method == "published":
        return ["colour ignored: the published method does not look at it"]
    if part.topology is not None:
        return ["colour ignored: it is told for straight parts only"]
    return []


def _width_px(wanted: scenes.Request, rig: Calibration) -> float:
    """How wide a part looks in the left picture when it lies where the camera meets the table."""
    if rig.table is None:
        raise CalibrationError(f"{rig.path}: table_plane_leftcam is missing")
    distance_m = -rig.table.offset_m / float(rig.table.normal[2])
    return wanted.width_m * float(rig.stereo.left.matrix[0, 0]) / distance_m


def _problem(left: Grey, right: Grey, rig: Calibration) -> str | None:
    """What is wrong with a pair, in words; None if it can be used."""
    for name, grey, camera in (("left", left, rig.stereo.left), ("right", right, rig.stereo.right)):
        if grey.shape != (camera.height_px, camera.width_px):
            return (
                f"{name} picture is {grey.shape[1]} x {grey.shape[0]}, "
                f"the camera is calibrated for {camera.width_px} x {camera.height_px}"
            )
        flaw = assess(grey)
        if flaw is not None:
            return f"{name} picture is {flaw.flaw.value} ({flaw.value:.3g}, limit {flaw.limit:.3g})"
    return None


def _result(name: str, cls: str, part: PartModel, seen: Scene, took_s: float) -> Result:
    recognised = tuple(one for one in seen.recognised if one.part_code == part.code)
    detections: list[Json] = [
        {
            "class": cls,
            "p0": _mm(candidate.start),
            "p1": _mm(candidate.end),
            "nodes": [_mm(node) for node in candidate.nodes],
            "rank": rank,
            "score": round(candidate.score, 4),
            "sigma_mm": _number(candidate.sigma_m * 1e3),
            "sigma_deg": _number(math.degrees(candidate.sigma_rad)),
            "refusals": [
                {
                    "reason": why.reason.name,
                    "value": _number(float(why.value)),
                    "limit": _number(float(why.limit)),
                    "unit": why.unit,
                }
                for why in candidate.refusals
            ],
        }
        for rank, candidate in enumerate(recognised, start=1)
    ]
    ranks = {id(candidate): rank for rank, candidate in enumerate(recognised, start=1)}
    crossings: list[Json] = [
        {
            "above": ranks[id(seen.candidates[crossing.above])],
            "below": ranks[id(seen.candidates[crossing.below])],
            "gap_mm": _number(crossing.gap_m * 1e3),
            "sure": _number(crossing.sure),
        }
        for crossing in seen.crossings
        if id(seen.candidates[crossing.above]) in ranks and id(seen.candidates[crossing.below]) in ranks
    ]
    ends = zip(seen.segments.start, seen.segments.end, strict=True)
    mine = tuple(one for one in seen.candidates if one.part_code == part.code)
    reasons = Counter(why.reason.name for candidate in mine for why in candidate.refusals)
    result: Result = {
        "scene": name,
        "time_ms": round(took_s * 1e3, 2),
        "detections": detections,
        "segments": [[_mm(start), _mm(end)] for start, end in ends],
        "crossings": crossings,
        "row_offset_px": _number(seen.row_offset_px),
        "reasons": dict(reasons),
    }
    if not any(one.offered for one in mine):
        result["nothing"] = _why_nothing(mine)
    return result


def _why_nothing(seen: tuple[Candidate, ...]) -> str:
    """Why nothing can be picked, in words: what stands against the candidates, the commonest first."""
    if not seen:
        return "nothing near the product's size was seen"
    reasons = Counter(why.reason.value for candidate in seen for why in candidate.refusals)
    said = ", ".join(f"{reason} ({count})" for reason, count in reasons.most_common())
    return f"{len(seen)} seen, none to be had: {said}"


def _mm(point_m: Floats) -> list[Json]:
    return [round(float(value), 4) for value in np.asarray(point_m) * 1e3]


def _number(value: float) -> float | None:
    """A number for JSON, which has no infinity and no NaN: those are null."""
    return round(value, 4) if math.isfinite(value) else None
