"""What a result is worth: the one definition of right, recall, precision, first pick and honest doubt.

The definitions are those of the photorealistic scenes' own evaluator (FORMAT.md beside them); a test holds
the two against each other where the scenes are there. Metres, radians, raw left camera frame.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import chain

import numpy as np
from scipy.optimize import linear_sum_assignment

from vision.types import Candidate, Floats, Scene

MIN_VISIBLE = 0.5
"""Parts of which less is to be seen, in either picture, are not asked for."""
SIGMAS = 2.0
EXPECTED_INSIDE = 0.95
"""An honest detector has this share of its errors inside that many sigmas."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerance:
    """How far off a right one may be: across and along the sight of the camera, in direction, in length."""

    lateral_m: float
    depth_m: float
    axis_rad: float
    length: float


THIN = Tolerance(lateral_m=0.005, depth_m=0.008, axis_rad=float(np.radians(5.0)), length=0.10)
PLATE = Tolerance(lateral_m=0.008, depth_m=0.010, axis_rad=float(np.radians(6.0)), length=0.15)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TruePart:
    """One true part. ``ends`` (2, 3) m of its axis; ``visible`` the smaller share of both pictures.

    ``target``: is it one of those asked for; ``alike``: is it at least of their class; ``pickable``: nothing
    over its central third; ``free``: nothing over it at all; ``edges`` (E, 2, 3) m: its graph in space, for a
    stick its axis.
    """

    ends: Floats
    edges: Floats
    visible: float
    in_frame: bool
    pickable: bool
    free: bool
    target: bool = True
    alike: bool = True
    tolerance: Tolerance = THIN

    @property
    def asked(self) -> bool:
        """Whether a detector is expected to find it."""
        return self.target and self.in_frame and self.visible >= MIN_VISIBLE


@dataclass(frozen=True, slots=True, kw_only=True)
class Crossing:
    """Part ``above`` lies over part ``below`` (indices); ``at``: where along the lower one, 0..1."""

    above: int
    below: int
    at: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Truth:
    """What is really there. ``negative``: nothing of what is asked for, every pick is false."""

    parts: tuple[TruePart, ...]
    crossings: tuple[Crossing, ...] = ()
    negative: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Found:
    """One part a detector came up with. ``ends`` (2, 3) m; sigmas NaN where it states none.

    ``offered``: to be picked now; the others are recognised, but covered or too steep.
    """

    ends: Floats
    sigma_m: float = float("nan")
    sigma_rad: float = float("nan")
    offered: bool = True


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Answer:
    """A detector's answer to one pair, first pick first.

    ``over``: pairs of indices into ``found``, the first lies on the second; None: it does not say.
    ``segments`` (S, 2, 3) m: what it took for parts before it chose; the parts themselves when empty.
    ``told``: the pick it told before it knew the rest; None: the first of ``found``.
    """

    found: tuple[Found, ...]
    segments: Floats
    over: tuple[tuple[int, int], ...] | None = None
    told: Found | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Error:
    """How far one found part is from its true one, and the sigmas it was stated with."""

    lateral_m: float
    depth_m: float
    middle_m: float
    axis_rad: float
    length: float
    ends_m: tuple[float, float]
    sigma_m: float = float("nan")
    sigma_rad: float = float("nan")

    def within(self, tolerance: Tolerance) -> bool:
        """Is it that part, as far as the score is concerned."""
        return (
            self.lateral_m <= tolerance.lateral_m
            and self.depth_m <= tolerance.depth_m
            and self.axis_rad <= tolerance.axis_rad
            and abs(self.length) <= tolerance.length
        )

    @property
    def cost(self) -> float:
        """By which the best assignment is chosen: millimetres and degrees, depth counts a little less."""
        return 1000.0 * (self.lateral_m + 0.6 * self.depth_m) + float(np.degrees(self.axis_rad))


@dataclass(frozen=True, slots=True, kw_only=True)
class LookScore:
    """Counts of one look. ``first``: is the first one right and pickable; ``free``: is the first one
    *offered* right with nothing on it. Both None where there was no such part to be had.

    ``ranked``: pairs of found parts of which one lies over the middle of the other, and ``misranked`` of them
    the lower one first. ``told``: true relations between found parts that the answer should state, ``truly``
    those it does state the right way round, ``inverted`` those the wrong way.
    """

    targets: int
    found: int
    right: int
    asked: int
    asked_hit: int
    pickable: int
    pickable_hit: int
    first: bool | None
    free: bool | None
    ranked: int
    misranked: int
    told: int
    truly: int
    inverted: int
    segments: int
    segments_right: int
    negative: bool
    errors: tuple[Error, ...] = ()


def error(found: Found, part: TruePart) -> Error:
    """Compare a found part with a true one; the order of the ends does not matter."""
    there = np.linalg.norm(found.ends - part.ends, axis=1)
    back = np.linalg.norm(found.ends[::-1] - part.ends, axis=1)
    ends = there if there.sum() <= back.sum() else back
    off = found.ends.mean(axis=0) - part.ends.mean(axis=0)
    u, v = found.ends[1] - found.ends[0], part.ends[1] - part.ends[0]
    long_u, long_v = float(np.linalg.norm(u)), float(np.linalg.norm(v))
    cosine = abs(float(u @ v)) / max(long_u * long_v, 1e-15)
    return Error(
        lateral_m=float(np.hypot(off[0], off[1])),
        depth_m=abs(float(off[2])),
        middle_m=float(np.linalg.norm(off)),
        axis_rad=float(np.arccos(min(1.0, cosine))),
        length=long_u / max(long_v, 1e-12) - 1.0,
        ends_m=(float(ends[0]), float(ends[1])),
        sigma_m=found.sigma_m,
        sigma_rad=found.sigma_rad,
    )


def assign(found: tuple[Found, ...], parts: tuple[TruePart, ...]) -> dict[int, tuple[int, Error]]:
    """Which found part is which true target: one to one, best total. Keys are indices into ``found``."""
    targets = [j for j, part in enumerate(parts) if part.target]
    if not found or not targets:
        return {}
    compared = [[error(one, parts[j]) for j in targets] for one in found]
    cost = np.array(
        [
            [e.cost if e.within(parts[j].tolerance) else 1e6 for e, j in zip(row, targets, strict=True)]
            for row in compared
        ]
    )
    rows, columns = linear_sum_assignment(cost)
    return {
        int(i): (targets[k], compared[i][k]) for i, k in zip(rows, columns, strict=True) if cost[i, k] < 1e6
    }


def score(answer: Answer, truth: Truth) -> LookScore:
    """Score one answer."""
    parts = truth.parts
    matched = assign(answer.found, parts)
    which = {i: j for i, (j, _) in matched.items()}
    hit = set(which.values())
    asked = {j for j, part in enumerate(parts) if part.asked}
    pickable = {j for j in asked if parts[j].pickable}
    offered = [i for i, one in enumerate(answer.found) if one.offered]
    picks = (which.get(0), which.get(offered[0]) if offered else None)
    if answer.told is not None:
        picks = (assign((answer.told,), parts).get(0, (None,))[0],) * 2
    first = free = None
    if pickable:
        first = picks[0] is not None and parts[picks[0]].pickable
    if any(parts[j].free for j in asked):
        free = picks[1] is not None and parts[picks[1]].free
    place = {j: i for i, j in which.items()}
    both = [c for c in truth.crossings if c.above in place and c.below in place]
    ranks = [c for c in both if not parts[c.below].pickable and 1 / 3 < c.at < 2 / 3]
    stated = set(answer.over or ())
    pairs = {(place[c.above], place[c.below]) for c in both}
    inverted = {(i, j) for i, j in pairs if (j, i) in stated and (i, j) not in stated}
    pieces = answer.segments if len(answer.segments) else np.array([f.ends for f in answer.found])
    right_segments, segments = segments_score(pieces, [p.edges for p in parts if p.alike])
    return LookScore(
        targets=sum(part.target for part in parts),
        found=len(answer.found),
        right=len(matched),
        asked=len(asked),
        asked_hit=len(asked & hit),
        pickable=len(pickable),
        pickable_hit=len(pickable & hit),
        first=first,
        free=free,
        ranked=len(ranks),
        misranked=sum(place[c.above] > place[c.below] for c in ranks),
        told=0 if answer.over is None else len(pairs),
        truly=len(pairs & stated),
        inverted=len(inverted),
        segments=segments,
        segments_right=right_segments,
        negative=truth.negative,
        errors=tuple(e for _, e in matched.values()),
    )


SEGMENT_LATERAL_M = 0.003
SEGMENT_DEPTH_M = 0.008
SEGMENT_SIGHT_M = 0.004
"""A segment is right within the first two; it belongs to a part when its picture is within the third."""


def segments_score(segments: Floats, shapes: list[Floats]) -> tuple[int, int]:
    """The paper's score: of all segments whose picture lies along a part, those truly on it.

    Parameters
    ----------
    segments
        (S, 2, 3) m.
    shapes
        One (E, 2, 3) m per part: its edges.

    Returns
    -------
    tuple of int
        Right ones, and all that belong to a part.
    """
    right = total = 0
    along = np.linspace(0.0, 1.0, 41)[:, None]
    for ends in segments:
        seen = exact = False
        for edges in shapes:
            near, on = [], []
            for point in ends:
                at = np.concatenate([a + along * (b - a) for a, b in edges])
                off = at[:, :2] / at[:, 2:] - point[None, :2] / max(float(point[2]), 1e-9)
                near.append((np.linalg.norm(off, axis=1) * at[:, 2]).min() <= SEGMENT_SIGHT_M)
                on.append(any(_on(point, a, b) for a, b in edges))
            seen = seen or all(near)
            exact = exact or all(on)
        total += seen or exact
        right += exact
    return right, total


def _on(point: Floats, start: Floats, end: Floats) -> bool:
    way = end - start
    share = np.clip((point - start) @ way / max(float(way @ way), 1e-15), 0.0, 1.0)
    off = point - start - share * way
    return bool(np.hypot(off[0], off[1]) <= SEGMENT_LATERAL_M and abs(off[2]) <= SEGMENT_DEPTH_M)


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """Many looks as one line. Shares are 0..1 and NaN where there was nothing to count."""

    looks: int
    recall: float
    pickable: float
    precision: float
    first: float
    free: float
    ranked: float
    told: float
    middle_mm: tuple[float, float]
    end_mm: tuple[float, float]
    axis_deg: tuple[float, float]
    depth_mm: tuple[float, float]
    inside_m: float
    inside_rad: float
    segments: float
    false_picks: int
    negatives: int
    free_looks: int = field(default=0)


def summary(scores: Iterable[LookScore]) -> Summary:
    """Add looks up: counts over all of them; medians and 95th percentiles of the right parts' errors."""
    every = tuple(scores)
    some = [s for s in every if not s.negative]
    errors = list(chain.from_iterable(s.errors for s in some))
    firsts = [s.first for s in some if s.first is not None]
    frees = [s.free for s in some if s.free is not None]
    ranked = sum(s.ranked for s in some)
    negative = [s for s in every if s.negative]
    return Summary(
        looks=len(every),
        recall=share(sum(s.asked_hit for s in some), sum(s.asked for s in some)),
        pickable=share(sum(s.pickable_hit for s in some), sum(s.pickable for s in some)),
        precision=share(sum(s.right for s in some), sum(s.found for s in some)),
        first=share(sum(firsts), len(firsts)),
        free=share(sum(frees), len(frees)),
        ranked=share(ranked - sum(s.misranked for s in some), ranked),
        told=share(sum(s.truly for s in some), sum(s.told for s in some)),
        middle_mm=_spread([1000.0 * e.middle_m for e in errors]),
        end_mm=_spread([1000.0 * one for e in errors for one in e.ends_m]),
        axis_deg=_spread([float(np.degrees(e.axis_rad)) for e in errors]),
        depth_mm=_spread([1000.0 * e.depth_m for e in errors]),
        inside_m=_inside([(e.middle_m, e.sigma_m) for e in errors]),
        inside_rad=_inside([(e.axis_rad, e.sigma_rad) for e in errors]),
        segments=share(sum(s.segments_right for s in some), sum(s.segments for s in some)),
        false_picks=sum(s.found for s in negative),
        negatives=len(negative),
        free_looks=len(frees),
    )


def share(part: float, whole: float) -> float:
    """``part / whole``, NaN of nothing."""
    return part / whole if whole else float("nan")


def _spread(values: list[float]) -> tuple[float, float]:
    if not values:
        return float("nan"), float("nan")
    return float(np.percentile(values, 50)), float(np.percentile(values, 95))


def _inside(pairs: list[tuple[float, float]]) -> float:
    """Share of errors within `SIGMAS` of their stated sigma, of those that have one."""
    stated = [(value, sigma) for value, sigma in pairs if np.isfinite(sigma)]
    return share(sum(value <= SIGMAS * sigma for value, sigma in stated), len(stated))


# ---------------------------------------------------------------------- from the detector's own records


def answer_of(scene: Scene, told: Candidate | None = None) -> Answer:
    """The detector's answer: what it offers, then what it recognised and would not pick now.

    ``told``: the first pick, if it was told before the rest.
    """
    recognised = scene.recognised
    place = {id(candidate): i for i, candidate in enumerate(recognised)}
    found = [place.get(id(candidate)) for candidate in scene.candidates]
    over = [(found[crossing.above], found[crossing.below]) for crossing in scene.crossings]
    return Answer(
        found=tuple(found_of(candidate) for candidate in recognised),
        segments=np.stack([scene.segments.start, scene.segments.end], axis=1),
        over=tuple((i, j) for i, j in over if i is not None and j is not None) if over else None,
        told=None if told is None else found_of(told),
    )


def found_of(candidate: Candidate) -> Found:
    """One candidate as the score sees it."""
    return Found(
        ends=np.stack([candidate.start, candidate.end]),
        sigma_m=candidate.sigma_m,
        sigma_rad=candidate.sigma_rad,
        offered=candidate.offered,
    )
