"""Matched strands to candidates: what fits the product and may be picked, each refusal with its number.

A part is refused as crossed when another part lies over its middle third, where a gripper would hold
it. Which of two is above is told by their depths where their pictures cross; a strand that only one
camera sees has no depth, and there the flanks decide: what lies above shows both of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vision.lines import flanks
from vision.look import Look
from vision.match import Placed
from vision.reconstruct_lines import from_space
from vision.retrieve import fit_score, tilt_rad
from vision.stereo import project, unrectify_points
from vision.strands import Strands, Tip
from vision.types import (
    Bools,
    Candidate,
    Floats,
    Ints,
    PartModel,
    Plane,
    Refusal,
    Refused,
    Tuning,
    read_only,
)

WIDTH_SHARE = (0.6, 1.6)
"""Seen width over expected width; light that only grazes a part, or blur, changes it by a third."""
LEAST_COVER = 0.85
MIDDLE = (1.0 / 3.0, 2.0 / 3.0)
MIDDLE_SAMPLES = 48
HIDDEN_WIDTHS = 1.4
"""A longer stretch of the middle third without both flanks means that something lies there, known or not;
a crossing below the part leaves its flanks visible."""
DOUBTFUL_WIDTHS = 0.8
SURE_SCORE = 0.6
"""A longer hidden stretch, or a lower score, weighs in the order like one more part on top."""
COMPLETED_CERTAINTY = (1.0, 0.8, 0.6)
"""Factor on the score by the number of ends that only the known length tells."""
VAGUE_DEPTH = 1.5
"""In diameters of the part."""
NEAR_LENGTHS = 1.5
"""Parts longer or shorter than this many times the product's length are somebody else's, not refused ones."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Crossings:
    """What lies over each of P placed parts.

    ``over_middle`` (P,) how many parts and lone strands lie over the middle third of i; ``over_any``
    (P,) how many lie over i anywhere; ``known`` P lists of crossings with other placed parts, above or
    below: place along i and half the reach of the crossing, as shares of its length.
    """

    over_middle: Ints
    over_any: Ints
    known: list[list[tuple[float, float]]]


def candidates(
    placed: Placed,
    left: Strands,
    right: Strands,
    looks: tuple[Look, Look],
    part: PartModel,
    tuning: Tuning,
    table: Plane | None,
) -> tuple[Candidate, ...]:
    """Every placed part near the product's length: offered ones first, what nothing lies on before others.

    Refused ones follow, best first.
    """
    crossings = _crossings(placed, left, looks[0], part.length_m)
    doubles = _doubles(placed, part)
    found: list[tuple[int, Candidate]] = []
    for row in range(len(placed.cost)):
        length_m = float(placed.length_m[row])
        if not part.length_m / NEAR_LENGTHS < length_m < part.length_m * NEAR_LENGTHS:
            continue
        hidden = _hidden_widths(placed.ends_m[row], crossings.known[row], looks)
        candidate = _candidate(
            row, placed, left, right, looks, part, tuning, table, crossings, doubles, hidden
        )
        doubts = int(hidden > DOUBTFUL_WIDTHS) + int(candidate.score < SURE_SCORE)
        found.append((int(crossings.over_any[row]) + doubts, candidate))
    found.sort(key=lambda item: (not item[1].offered, item[0] if item[1].offered else 0, -item[1].score))
    return tuple(candidate for _, candidate in found)


def _candidate(
    row: int,
    placed: Placed,
    left: Strands,
    right: Strands,
    looks: tuple[Look, Look],
    part: PartModel,
    tuning: Tuning,
    table: Plane | None,
    crossings: Crossings,
    doubles: Floats,
    hidden_widths: float,
) -> Candidate:
    start, end = placed.ends_m[row].copy()
    way = end - start
    length_m = float(np.linalg.norm(way))
    axis = way / length_m
    score = _score(row, placed, left, right, looks, part, tuning)
    tilt = tilt_rad(axis, table)
    reasons: list[Refused] = []
    error = length_m - part.length_m
    if abs(error) > part.length_tolerance_m:
        limit = part.length_m + float(np.copysign(part.length_tolerance_m, error))
        reasons.append(Refused(reason=Refusal.LENGTH, value=length_m, limit=limit, unit="m"))
    reasons += _outside(np.stack([start, end]), part, tuning, table)
    if tilt > tuning.max_tilt_rad:
        reasons.append(Refused(reason=Refusal.TILT, value=tilt, limit=tuning.max_tilt_rad, unit="rad"))
    reasons += _wrong_width(row, placed, left, right, looks, part)
    if crossings.over_middle[row] > 0:
        reasons.append(
            Refused(reason=Refusal.CROSSED, value=float(crossings.over_middle[row]), limit=0.0, unit="1")
        )
    elif hidden_widths > HIDDEN_WIDTHS:
        reasons.append(Refused(reason=Refusal.CROSSED, value=hidden_widths, limit=HIDDEN_WIDTHS, unit="1"))
    if placed.slack_m[row] > part.length_tolerance_m:
        reasons.append(
            Refused(
                reason=Refusal.AMBIGUOUS,
                value=float(placed.slack_m[row]),
                limit=part.length_tolerance_m,
                unit="m",
            )
        )
    i, j = int(placed.solved.left[row]), int(placed.solved.right[row])
    borders = int((left.kind[i] == Tip.BORDER).sum() + (right.kind[j] == Tip.BORDER).sum())
    if borders and not placed.completed[row].any():
        reasons.append(Refused(reason=Refusal.EDGE, value=float(borders), limit=0.0, unit="1"))
    if np.isfinite(doubles[row]):
        reasons.append(
            Refused(reason=Refusal.DUPLICATE, value=float(doubles[row]), limit=2 * part.diameter_m, unit="m")
        )
    if placed.cover[row] < LEAST_COVER:
        reasons.append(
            Refused(reason=Refusal.UNMATCHED, value=float(placed.cover[row]), limit=LEAST_COVER, unit="1")
        )
    if score < tuning.min_score:
        reasons.append(Refused(reason=Refusal.LOW_SCORE, value=score, limit=tuning.min_score, unit="1"))
    return Candidate(
        part_code=part.code,
        start=read_only(start),
        end=read_only(end),
        centre=read_only(0.5 * (start + end)),
        axis=read_only(axis),
        length_m=length_m,
        nodes=read_only(np.stack([start, end])),
        score=score,
        residual_px=float(placed.solved.residual_px[row]),
        refusals=tuple(reasons),
    )


def _score(
    row: int,
    placed: Placed,
    left: Strands,
    right: Strands,
    looks: tuple[Look, Look],
    part: PartModel,
    tuning: Tuning,
) -> float:
    """Fit of size and views, times the root of what is seen of the part, times certainty of ends and depth.

    A depth known only to `VAGUE_DEPTH` halves the score: a gripper would close above or below the part.
    """
    ends = from_space(placed.ends_m[row], looks[0].rect)
    left_px = float(np.hypot(*(ends[1, :2] - ends[0, :2])))
    right_px = float(np.hypot(ends[1, 0] - ends[1, 2] - ends[0, 0] + ends[0, 2], ends[1, 1] - ends[0, 1]))
    i, j = int(placed.solved.left[row]), int(placed.solved.right[row])
    shown = min(
        left.length_px[i] * left.seen[i] / max(left_px, 1.0),
        right.length_px[j] * right.seen[j] / max(right_px, 1.0),
    )
    error = (float(placed.length_m[row]) - part.length_m) / part.length_tolerance_m
    fit = fit_score(error, float(placed.solved.residual_px[row]) / tuning.epipolar_px)
    certainty = COMPLETED_CERTAINTY[int(placed.completed[row].sum())]
    depth = 1.0 / (1.0 + (float(placed.solved.depth_sigma_m[row]) / (VAGUE_DEPTH * part.diameter_m)) ** 2)
    return float(np.clip(fit * np.sqrt(min(shown, 1.0)) * certainty * depth, 0.0, 1.0))


def _outside(ends_m: Floats, part: PartModel, tuning: Tuning, table: Plane | None) -> list[Refused]:
    """Ends out of the depth range, or out of the height range where only a table is known."""
    if tuning.depth_m is not None:
        values, (low, high) = ends_m[:, 2], tuning.depth_m
    elif table is not None:
        values, (low, high) = ends_m @ table.normal + table.offset_m, tuning.height_m
        low, high = low - part.diameter_m, high + part.diameter_m
    else:
        return []
    if values.min() < low:
        return [Refused(reason=Refusal.DEPTH, value=float(values.min()), limit=low, unit="m")]
    if values.max() > high:
        return [Refused(reason=Refusal.DEPTH, value=float(values.max()), limit=high, unit="m")]
    return []


def _wrong_width(
    row: int, placed: Placed, left: Strands, right: Strands, looks: tuple[Look, Look], part: PartModel
) -> list[Refused]:
    rect = looks[0].rect
    depth = float(np.mean(placed.ends_m[row] @ rect.rect_from_left.T[:, 2]))
    expected = part.diameter_m * rect.focal_px / depth
    i, j = int(placed.solved.left[row]), int(placed.solved.right[row])
    seen = 0.5 * float(left.width_px[i] + right.width_px[j])
    low, high = (share * expected for share in WIDTH_SHARE)
    if low < seen < high:
        return []
    return [Refused(reason=Refusal.WIDTH, value=seen, limit=low if seen <= low else high, unit="px")]


def _doubles(placed: Placed, part: PartModel) -> Floats:
    """(P,) distance in m to a better part whose place it shares; NaN for none."""
    found = np.full(len(placed.cost), np.nan)
    order = np.argsort(placed.cost)
    share = np.linspace(0.05, 0.95, 10)[:, None]
    lines = [a + share * (b - a) for a, b in placed.ends_m]
    for rank, row in enumerate(order.tolist()):
        for better in order[:rank].tolist():
            if np.isfinite(found[better]):
                continue
            start, end = placed.ends_m[better]
            way = end - start
            along = np.clip((lines[row] - start) @ way / (way @ way), 0.0, 1.0)
            off = np.linalg.norm(lines[row] - start - along[:, None] * way, axis=1)
            if float(np.median(off)) < 0.6 * part.diameter_m:
                found[row] = float(np.median(off))
    return found


def _crossings(placed: Placed, left: Strands, look: Look, length_m: float) -> Crossings:
    count = len(placed.cost)
    middle, anywhere = np.zeros(count, np.int64), np.zeros(count, np.int64)
    known: list[list[tuple[float, float]]] = [[] for _ in range(count)]
    ends = from_space(placed.ends_m, look.rect)
    # what is too short may go on unseen below others, as far as the length of a part
    beyond = np.maximum(length_m / placed.length_m - 1.0, 0.0)
    taken = set(placed.solved.left.tolist())
    lone = [n for n in range(len(left)) if n not in taken]
    for i in range(count):
        over: list[float] = []
        for j in range(count):
            met = None if i == j else _meet(ends[i, :, :2], ends[j, :, :2], beyond[j])
            if met is None:
                continue
            mine = ends[i, 0, 2] + met[0] * (ends[i, 1, 2] - ends[i, 0, 2])
            other = ends[j, 0, 2] + met[1] * (ends[j, 1, 2] - ends[j, 0, 2])
            within = 0.0 <= met[1] <= 1.0
            if within or other <= mine:
                known[i].append((met[0], _reach(look, ends[i, :, :2], ends[j, :, :2])))
            if within and other > mine:
                over.append(met[0])
        for n in lone:
            met = _meet(ends[i, :, :2], left.tips[n])
            if met is not None and _hides(look, ends[i, :, :2], left.tips[n], met):
                over.append(met[0])
        anywhere[i] = len(over)
        middle[i] = sum(MIDDLE[0] < place < MIDDLE[1] for place in over)
    return Crossings(over_middle=middle, over_any=anywhere, known=known)


def _reach(look: Look, mine: Floats, other: Floats) -> float:
    """Half of what a crossing covers of the first segment, as a share of it."""
    return (0.7 * look.width_px / max(_sine(mine, other), 0.1)) / max(
        float(np.hypot(*(mine[1] - mine[0]))), 1.0
    )


def _sine(mine: Floats, other: Floats) -> float:
    a, b = mine[1] - mine[0], other[1] - other[0]
    return abs(float(a[0] * b[1] - a[1] * b[0])) / float(np.linalg.norm(a) * np.linalg.norm(b))


def _meet(first: Floats, second: Floats, beyond: float = 0.0) -> tuple[float, float] | None:
    """Where two segments (2, 2) cross, as shares along each; None where they do not.

    The second may be longer at both ends by the share `beyond` of itself.
    """
    a, b = first[1] - first[0], second[1] - second[0]
    cross = float(a[0] * b[1] - a[1] * b[0])
    if abs(cross) < 1e-9:
        return None
    gap = second[0] - first[0]
    s = float(gap[0] * b[1] - gap[1] * b[0]) / cross
    t = float(gap[0] * a[1] - gap[1] * a[0]) / cross
    return (s, t) if 0.0 <= s <= 1.0 and -beyond <= t <= 1.0 + beyond else None


def _hides(look: Look, mine: Floats, other: Floats, met: tuple[float, float]) -> bool:
    """True where the other's flanks go on through the crossing and mine do not."""
    reach_px = 0.5 * look.width_px / max(_sine(mine, other), 0.2)
    shares = [_flank_share(look, line, place, reach_px) for line, place in ((mine, met[0]), (other, met[1]))]
    return shares[1] >= shares[0]


def _flank_share(look: Look, line: Floats, place: float, reach_px: float) -> float:
    """Share of flanks seen along a rectified line within a crossing."""
    way = line[1] - line[0]
    way = way / np.linalg.norm(way)
    at = line[0] + place * (line[1] - line[0]) + np.arange(-reach_px, reach_px + 0.5)[:, None] * way
    low, high = _flanks_seen(look, unrectify_points(at, look.rect, look.side))
    return float(0.5 * (low.mean() + high.mean()))


def _hidden_widths(ends_m: Floats, known: list[tuple[float, float]], looks: tuple[Look, Look]) -> float:
    """Longest stretch of the middle third without both flanks, in part widths, in the better picture.

    `known` crossings, place along the part and reach as shares of its length, are left out: depth has
    already told which part is above.
    """
    share = np.linspace(MIDDLE[0], MIDDLE[1], MIDDLE_SAMPLES)[:, None]
    points = ends_m[0] + share * (ends_m[1] - ends_m[0])
    explained = np.zeros(MIDDLE_SAMPLES, np.bool_)
    for place, reach in known:
        explained |= np.abs(share[:, 0] - place) < reach
    longest = []
    for look, raw in zip(looks, project(points, looks[0].rect.stereo), strict=True):
        low, high = _flanks_seen(look, raw)
        step_px = float(np.hypot(*(raw[-1] - raw[0]))) / (MIDDLE_SAMPLES - 1)
        run = most = 0
        for seen in (explained | (low & high)).tolist():
            run = 0 if seen else run + 1
            most = max(most, run)
        longest.append(most * step_px / look.width_px)
    return min(longest)


def _flanks_seen(look: Look, raw_px: Floats) -> tuple[Bools, Bools]:
    """Whether either flank of a part is where it should be, along raw points in order."""
    along = np.gradient(raw_px, axis=0)
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    half, window = 0.5 * look.width_px, max(1.2, 0.25 * look.width_px)
    seen = flanks(look.grey, raw_px, normal, half, window)
    low = (seen.low_slope > look.slope_floor) & (np.abs(seen.low_px + half) < window - 0.25)
    high = (seen.high_slope > look.slope_floor) & (np.abs(seen.high_px - half) < window - 0.25)
    return low, high
