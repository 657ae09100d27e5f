"""One look of one method at a case, timed; settings of each method as `mikado evaluate` has them."""

from __future__ import annotations

import statistics
from dataclasses import dataclass, replace

import numpy as np
from skimage.morphology import skeletonize

from bench.cases import Case
from bench.machine import worked_ms
from bench.scoring import Answer, LookScore, answer_of, score
from cell.evaluate import EPIPOLAR_WIDTHS, HEIGHT_M, SPUR_WIDTHS, STICK_TOLERANCE_M
from drivers.timing import MonotonicClock
from vision.locate import locate
from vision.quality import assess
from vision.types import Candidate, Method, Refusal, Scene, Tuning

METHODS: tuple[Method, ...] = ("published", "default")
FIRST = "first"
"""The stage at which a detector that answers in steps tells its first pick (or a scene not yet complete)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Look:
    """One look at one case: its score, and medians of its times and of a known thinning on the same masks.

    ``refused``: why the pictures were not looked at; then nothing was found.
    """

    family: str
    name: str
    method: Method
    refused: str | None
    score: LookScore
    first_ms: float
    whole_ms: float
    wall_ms: float
    skeletonize_ms: float

    @property
    def ratio(self) -> float:
        """Time of the whole scene over that of ``skimage.morphology.skeletonize`` of both masks."""
        return self.whole_ms / self.skeletonize_ms


class FirstTold:
    """An observer that notes when the first pick was told, and which."""

    def __init__(self) -> None:
        self.at_ms: float | None = None
        self.pick: Candidate | None = None

    def __call__(self, stage: str, product: object) -> None:
        match product:
            case Candidate() if stage == FIRST:
                self.pick = product
            case Scene(complete=False) if product.offered:
                self.pick = product.offered[0]
            case _:
                return
        self.at_ms = worked_ms()


def tuning_for(case: Case, method: Method) -> Tuning:
    """What `mikado evaluate` sets."""
    distance_m = -case.table.offset_m / float(case.table.normal[2])
    width_px = case.width_m * float(case.stereo.left.matrix[0, 0]) / distance_m
    return Tuning(
        method=method,
        height_m=HEIGHT_M,
        spur_px=max(Tuning().spur_px, SPUR_WIDTHS * width_px),
        epipolar_px=max(Tuning().epipolar_px, EPIPOLAR_WIDTHS * width_px),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Seen:
    """One run of a detector. ``told``: its first pick, if it told that before the rest; processor time until
    then and to the end, and the wall clock's whole, ms.
    """

    scene: Scene
    told: Candidate | None
    first_ms: float
    whole_ms: float
    wall_ms: float


def see(case: Case, method: Method) -> Seen:
    """Run a method once."""
    part = case.part
    if part.topology is None:
        part = replace(part, length_tolerance_m=STICK_TOLERANCE_M[method])
    clock, told = MonotonicClock(), FirstTold()
    tuning = tuning_for(case, method)
    began_at, began_ms = clock.now(), worked_ms()
    scene = locate(case.left, case.right, case.stereo, part, tuning, case.table, told, case.colour_left)
    whole_ms, wall_s = worked_ms() - began_ms, clock.now() - began_at
    return Seen(
        scene=scene,
        told=told.pick,
        first_ms=whole_ms if told.at_ms is None else told.at_ms - began_ms,
        whole_ms=whole_ms,
        wall_ms=1000.0 * wall_s,
    )


def thinned_ms(scene: Scene) -> float:
    """How long scikit-image takes to thin the two masks of a scene."""
    masks = [view.mask.copy() for view in (scene.left, scene.right)]  # it wants to be able to write
    began_ms = worked_ms()
    for mask in masks:
        skeletonize(mask)  # type: ignore[no-untyped-call]  # the library has no types
    return worked_ms() - began_ms


def unusable(case: Case) -> str | None:
    """Why the cell would not look for parts in these pictures; None if it would."""
    for side, grey in (("left", case.left), ("right", case.right)):
        flaw = assess(grey)
        if flaw is not None:
            return f"{side} picture {flaw.flaw.value} ({flaw.value:.3g}, limit {flaw.limit:.3g})"
    return None


def rows_disagree(scene: Scene) -> str | None:
    """Why the detector offers nothing of what it found: the rows of the two pictures do not agree."""
    reasons = [
        refused
        for candidate in scene.candidates
        for refused in candidate.refusals
        if refused.reason is Refusal.ROWS
    ]
    if scene.offered or not reasons:
        return None
    return f"{reasons[0].reason.value} ({reasons[0].value:.3g} {reasons[0].unit})"


def look(case: Case, method: Method, repeats: int = 1) -> Look:
    """Look ``repeats`` times, the known thinning in between; times are medians, the answer is the last."""
    refused = unusable(case)
    if refused is not None:
        nothing = Answer(found=(), segments=np.zeros((0, 2, 3)))
        unknown = float("nan")
        return Look(
            family=case.family,
            name=case.name,
            method=method,
            refused=refused,
            score=score(nothing, case.truth),
            first_ms=unknown,
            whole_ms=unknown,
            wall_ms=unknown,
            skeletonize_ms=unknown,
        )
    seen, thinned = [], []
    for _ in range(max(1, repeats)):
        seen.append(see(case, method))
        thinned.append(thinned_ms(seen[-1].scene))
    return Look(
        family=case.family,
        name=case.name,
        method=method,
        refused=rows_disagree(seen[-1].scene),
        score=score(answer_of(seen[-1].scene, seen[-1].told), case.truth),
        first_ms=statistics.median(one.first_ms for one in seen),
        whole_ms=statistics.median(one.whole_ms for one in seen),
        wall_ms=statistics.median(one.wall_ms for one in seen),
        skeletonize_ms=statistics.median(thinned),
    )


def median_of(values: list[float]) -> float:
    """The median of those that are numbers, NaN of none."""
    some = [value for value in values if not np.isnan(value)]
    return float(np.median(some)) if some else float("nan")
