"""Candidates to grasps in the robot's base frame; why one is not taken, with its number.

The tool goes straight down; where that has no room and the product allows it, it leans about the part's own
axis. Its jaws close across the part, along the tool's x axis; the tool centre point lies between the fingers,
near their tips. A part is gripped as near to its middle as the jaws have room.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from typing import Final, Literal, TypeAlias

import numpy as np

from cell import fingers, frames
from cell.config import JawsConfig, WorkspaceConfig
from cell.missed import MissedParts
from cell.products import GraspConfig
from cell.types import Pick
from vision import transforms
from vision.types import Candidate, Floats, Refusal, Scene, Transform

_STEP_M: Final = 0.002
"""Grip positions are tried every 2 mm along the part, obstacles sampled as finely."""
_OFF_CENTRE: Final = 0.4
"""A grip may be this share of the length away from the middle."""
_ASIDE_MARGIN_M: Final = 0.002
"""A part that is not in the middle of the jaws stays this far from the finger: nothing is seen exactly."""
_ASIDE_STEPS: Final = 4
_LEAN_STEP_RAD: Final = math.radians(10.0)
_SAME_PART: Final = 0.9
"""A segment within this many diameters of the candidate's own axis is the candidate itself: the axes of two
parts that lie side by side are a whole diameter apart."""


class PlanRefusal(Enum):
    """Why a candidate the detector offers is not picked. Values are what a person reads."""

    WORKSPACE = "outside the workspace"
    TILT = "too steep for the gripper"
    CLEARANCE = "no room for the jaws"
    REACH = "the arm cannot reach it"
    JOINT = "a joint of the arm at its limit"
    SINGULARITY = "the arm too near a singularity"
    POSTURE = "the arm cannot go there in one posture"


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanRefused:
    """One reason with its number, ``value`` against ``limit``."""

    reason: PlanRefusal
    value: float
    limit: float
    unit: Literal["m", "rad", "1"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plan:
    """What planning made of one candidate: a pick, or why not."""

    candidate: Candidate
    pick: Pick | None
    refused: tuple[PlanRefused, ...] = ()


Reach: TypeAlias = Callable[[Pick], Pick | PlanRefused]


def plan_picks(
    scene: Scene,
    base_from_camera: Transform,
    workspace: WorkspaceConfig,
    jaws: JawsConfig,
    diameter_m: float,
    tool: Transform,
    missed: MissedParts,
    reach: Reach,
    code: int | None = None,
    thickest_m: float | None = None,
    grasp: GraspConfig | None = None,
) -> tuple[Plan, ...]:
    """Plan every offered candidate of a product, in the detector's order.

    Where none of them gives a pick and ``workspace.take_covered`` is set, the parts that are only covered by
    others are planned too: the least bad way to get on with a heap in which each lies on the next.

    Parameters
    ----------
    scene
        What was seen; all its segments are obstacles, offered or not.
    base_from_camera
        Raw left camera to robot base.
    workspace, jaws
        Where the fingers may go, and how big they are.
    diameter_m
        Of the parts: the thickness of every obstacle, unless ``thickest_m`` is given.
    tool
        ``base_from_tool`` now; of the two equal jaw directions the nearer one is taken.
    missed
        Where grips failed lately: another place on the same part is preferred.
    reach
        What is known of the arm: takes a pick, gives it back (perhaps with the hand turned) or says what
        stands against it.
    code
        The product that is asked for, where several lie in one heap; None: every candidate is.
    thickest_m
        Of the heap's products, where they differ: what an obstacle is taken for.
    grasp
        Where the product is gripped, if not near its middle, and from how high.
    """
    obstacles = _obstacles(scene, base_from_camera)
    thickest = diameter_m if thickest_m is None else thickest_m
    plans: list[Plan] = []
    for candidates in (scene.offered, _only_covered(scene) if workspace.take_covered else ()):
        if any(plan.pick is not None for plan in plans):
            break
        for candidate in candidates:
            if code is not None and candidate.part_code != code:
                continue
            start, end = transforms.apply(base_from_camera, np.stack([candidate.start, candidate.end]))
            near = _sampled(_others(start, end, obstacles, diameter_m))
            plan = _plan(
                candidate, start, end, near, workspace, jaws, diameter_m, thickest, tool, missed,
                grasp or GraspConfig(),
            )  # fmt: skip
            plans.append(_judged(plan, reach))
    return _ranked(plans)


def _judged(plan: Plan, reach: Reach) -> Plan:
    """The plan as far as the arm can carry it out."""
    if plan.pick is None:
        return plan
    judged = reach(plan.pick)
    if isinstance(judged, Pick):
        return replace(plan, pick=judged)
    return replace(plan, pick=None, refused=(judged,))


def _ranked(plans: list[Plan]) -> tuple[Plan, ...]:
    """In the detector's order, but grips that would hold a second part too come after those that do not."""
    ordered = sorted(plans, key=lambda plan: plan.pick is not None and not plan.pick.gap_free)
    ranks = itertools.count(1)
    return tuple(
        plan if plan.pick is None else replace(plan, pick=replace(plan.pick, rank=next(ranks)))
        for plan in ordered
    )


def _only_covered(scene: Scene) -> tuple[Candidate, ...]:
    """Parts with nothing against them but that others lie over them."""
    return tuple(
        c for c in scene.candidates if c.refusals and all(r.reason is Refusal.CROSSED for r in c.refusals)
    )


def _obstacles(scene: Scene, base_from_camera: Transform) -> Floats:
    """(K, 2, 3) m end points of everything seen, base frame."""
    pairs = (
        [np.stack([scene.segments.start, scene.segments.end], axis=1)] if len(scene.segments.start) else []
    )
    pairs += [np.stack([c.start, c.end])[None] for c in scene.candidates]
    if not pairs:
        return np.zeros((0, 2, 3))
    return transforms.apply(base_from_camera, np.concatenate(pairs))


def _plan(
    candidate: Candidate,
    start: Floats,
    end: Floats,
    points: Floats,
    workspace: WorkspaceConfig,
    jaws: JawsConfig,
    diameter_m: float,
    thickest_m: float,
    tool: Transform,
    missed: MissedParts,
    wanted: GraspConfig,
) -> Plan:
    length = float(np.linalg.norm(end - start))
    axis = (end - start) / max(length, 1e-9)
    tilt = math.asin(min(1.0, abs(float(axis[2]))))
    if tilt > workspace.max_tilt_rad:
        return Plan(
            candidate=candidate,
            pick=None,
            refused=(
                PlanRefused(reason=PlanRefusal.TILT, value=tilt, limit=workspace.max_tilt_rad, unit="rad"),
            ),
        )
    down = frames.looking_down(_nearest_yaw(math.atan2(float(axis[1]), float(axis[0])) + math.pi / 2, tool))
    best_room = -math.inf
    outside = math.inf
    chosen: tuple[int, Pick] | None = None
    for lean, (aside, along) in itertools.product(_leans(wanted), _offsets(length, jaws, diameter_m, wanted)):
        if lean and chosen is not None:
            break
        hand = transforms.matrix_from_vector(lean * axis) @ down if lean else down
        tool_point = (start + end) / 2 + along * axis + aside * hand[:, 0] + jaws.below_axis_m * hand[:, 2]
        if not lean:
            lowest = workspace.floor_z_m + workspace.floor_clearance_m + jaws.tip_beyond_tool_m
            tool_point[2] = max(tool_point[2], lowest)
        tips = tool_point + jaws.tip_beyond_tool_m * hand[:, 2]
        beyond = fingers.beyond_box(tips, hand, workspace, jaws)
        if beyond > 0:
            outside = min(outside, beyond)
            continue
        near = fingers.seen_from(tips, hand, points)
        room = fingers.clearance(near, tips, hand, workspace, jaws) - thickest_m / 2
        best_room = max(best_room, room)
        if room < jaws.min_clearance_m:
            continue
        gap_free = fingers.gap(near, jaws) > thickest_m / 2
        pick = _pick(candidate, tool_point, hand, room, gap_free, workspace, wanted)
        doubts = 2 * missed.grip(pick.grasp) + (not gap_free)
        if chosen is None or doubts < chosen[0]:
            chosen = doubts, pick
        if doubts == 0:
            break
    if chosen is not None:
        return Plan(candidate=candidate, pick=chosen[1])
    if best_room == -math.inf:
        why = PlanRefused(reason=PlanRefusal.WORKSPACE, value=outside, limit=0.0, unit="m")
    else:
        why = PlanRefused(reason=PlanRefusal.CLEARANCE, value=best_room, limit=jaws.min_clearance_m, unit="m")
    return Plan(candidate=candidate, pick=None, refused=(why,))


def _pick(
    candidate: Candidate,
    tool_point: Floats,
    hand: Floats,
    room: float,
    gap_free: bool,
    workspace: WorkspaceConfig,
    wanted: GraspConfig,
) -> Pick:
    approach_m = wanted.approach_height_m or workspace.approach_height_m
    retreat_m = wanted.retreat_height_m or approach_m
    z = float(tool_point[2])
    return Pick(
        rank=1,
        approach=frames.backed_out(tool_point, hand, z + approach_m),
        grasp=frames.tool_at(tool_point, hand),
        retreat=frames.backed_out(tool_point, hand, max(workspace.travel_z_m, z + retreat_m)),
        clearance_m=room,
        gap_free=gap_free,
        score=candidate.score,
        candidate=candidate,
    )


def _leans(wanted: GraspConfig) -> list[float]:
    """Turns of the hand about the part's axis, rad: straight down, then the smallest first."""
    most = wanted.free_rotation_rad
    steps = math.ceil(round(most / _LEAN_STEP_RAD, 6))
    return [0.0] + [side * most * k / steps for k in range(1, steps + 1) for side in (1, -1)]


def _nearest_yaw(yaw_rad: float, tool: Transform) -> float:
    """Of the two directions half a turn apart, the one nearer to the tool's x axis now."""
    now = math.atan2(float(tool.rotation[1, 0]), float(tool.rotation[0, 0]))
    turn = (yaw_rad - now + math.pi / 2) % math.pi - math.pi / 2
    return now + turn


def _offsets(
    length_m: float, jaws: JawsConfig, diameter_m: float, wanted: GraspConfig
) -> list[tuple[float, float]]:
    """Grip positions (aside, along) m from the part's middle: those nearest to the wanted place first.

    Those with the part in the middle between the jaws come first. After them the hand stands aside, the part
    nearer to one finger, by as much as the opening leaves after `_ASIDE_MARGIN_M`.
    """
    slack = _OFF_CENTRE * length_m if wanted.slack_m is None else wanted.slack_m
    reach = int(slack / _STEP_M)
    sides = (1, -1) if wanted.from_middle_m > 0 else (1,)
    farthest = max(_OFF_CENTRE * length_m, wanted.from_middle_m)
    along = sorted(
        {
            round(side * wanted.from_middle_m + k * _STEP_M, 9)
            for side in sides
            for k in range(-reach, reach + 1)
            if abs(side * wanted.from_middle_m + k * _STEP_M) <= farthest
        },
        key=lambda at: (abs(abs(at) - wanted.from_middle_m), at),
    )
    room = max(0.0, (jaws.opening_m - diameter_m) / 2 - _ASIDE_MARGIN_M)
    aside = sorted(
        (side * k * room / _ASIDE_STEPS for k in range(1, _ASIDE_STEPS + 1) for side in (-1, 1)), key=abs
    )
    coarse = along[::_ASIDE_STEPS] if room > 0 else []
    return [(0.0, a) for a in along] + [(x, a) for x in aside for a in coarse]


def _others(start: Floats, end: Floats, obstacles: Floats, diameter_m: float) -> Floats:
    """(K, 2, 3) the obstacles that are not the part itself."""
    if not len(obstacles):
        return obstacles
    axis = end - start
    length = float(np.linalg.norm(axis))
    unit = axis / max(length, 1e-9)
    offset = obstacles - start
    along = np.clip(offset @ unit, -2 * diameter_m, length + 2 * diameter_m)
    distance = np.linalg.norm(offset - along[..., None] * unit, axis=-1)
    return np.asarray(obstacles[(distance > _SAME_PART * diameter_m).any(axis=1)], dtype=np.float64)


def _sampled(obstacles: Floats) -> Floats:
    """(P, 3) points every `_STEP_M` along the obstacles' axes."""
    pieces = [np.zeros((0, 3))]
    for first, last in obstacles:
        count = max(2, math.ceil(float(np.linalg.norm(last - first)) / _STEP_M) + 1)
        pieces.append(first + np.linspace(0.0, 1.0, count)[:, None] * (last - first))
    return np.concatenate(pieces)
