"""A part with a topology as what a camera sees of it: sampled edges, inside, and what must not go on.

The part's graph or its stated outline becomes a planar figure of bars, discs, holes and slots. Its edge is
sampled with outward normals, its inside on and beside the centre lines, and lines beyond each end of a bar,
where the same part shows nothing: evidence there says that the picture shows something longer.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, pairwise

import numpy as np

from vision.types import Bools, Floats, Ints, NodeKind, Outline, PartModel, Topology, read_only

BEND_WIDTHS = 1.6
"""Bent rods have round corners of a radius no product file states; this much of each flank is left out."""
TIP_WEIGHT = 0.3
"""End faces of rods are short, and often rounded or cut at a slant."""
_ROUNDED_WIDTHS = 0.2
"""Blur and chamfers round the corners of end faces."""
_WELD_WIDTHS = 0.35
_DEEP_WIDTHS = 0.001
_BEYOND_WIDTHS = (0.2, 2.5)
NEXT_WIDTHS = 0.9
_CLEAR_WIDTHS = 0.5
_STRAIGHT_COSINE = 0.996
_SYMMETRIC_WIDTHS = 0.15
_RIM_WIDTHS = 0.28
_FEWEST_ROUND = 12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ShapeModel:
    """A part, sampled in its own plane (x, y), metres.

    ``points``, ``normals`` (P, 2) of the edge, outwards; ``grows`` (P,) 1 for edges that shading moves, 0 for
    the end faces of rods; ``weights`` (P,) for fitting; ``arm`` (P,) the primitive each belongs to, counted
    bars, discs, holes, slots; ``tip`` (P,) the bar end whose face it lies on (2 x bar + 0 or 1), -1 for none;
    ``body`` (Q, 2) inside, ``body_arm`` (Q,); ``beyond``, ``beyond_normals`` (K, 2) flanks continued past bar
    ends, ``beyond_end`` (K,) which end, ``beyond_next`` (K,) whether close to it; ``lines`` (B, 5) maximal
    straight runs x0, y0, x1, y1, width; ``lift_m`` height of the edge over the nodes' plane; ``rest_m`` of
    that plane over what the part lies on; ``two_faced`` whether lying on its other face makes a
    difference; ``arms``, ``bars`` how many primitives and how many of them bars.
    """

    points: Floats
    normals: Floats
    grows: Floats
    weights: Floats
    arm: Ints
    tip: Ints
    body: Floats
    body_arm: Ints
    beyond: Floats
    beyond_normals: Floats
    beyond_end: Ints
    beyond_next: Bools
    lines: Floats
    lift_m: float
    rest_m: float
    width_m: float
    two_faced: bool
    arms: int
    bars: int


def width_of(part: PartModel) -> float:
    """How wide the arms of a part look from above, m."""
    return part.diameter_m if part.outline is None else float(part.outline.bar_width_m.min())


# A pure function of frozen records: remembering its answer is not shared state anybody can see.
@lru_cache(maxsize=16)
def shape_model(part: PartModel, spacing_m: float) -> ShapeModel:
    """The sampled shape of a part with a topology, one sample of edge every ``spacing_m``.

    Raises
    ------
    ValueError
        The part has no topology, or its topology has no edge.
    """
    topology = part.topology
    if topology is None or len(topology.edges) == 0:
        raise ValueError(f"{part.name} has no topology to look for")
    rods = part.outline is None
    figure = _rods(topology, part.diameter_m) if part.outline is None else part.outline
    ends = [_end_kinds(topology, figure.bars[k], figure.bar_width_m[k]) for k in range(len(figure.bars))]
    edge, normals, arm, tip = _edge(figure, ends, rods, spacing_m)
    body, body_arm = _body(figure, ends, rods, spacing_m)
    beyond, beyond_normals, beyond_end, beyond_next = _beyond(figure, ends, spacing_m)
    width = width_of(part)
    lines = _lines(figure)
    return ShapeModel(
        points=read_only(edge),
        normals=read_only(normals),
        grows=read_only(np.where(tip >= 0, 0.0 if rods else 1.0, 1.0)),
        weights=read_only(np.where(tip >= 0, TIP_WEIGHT if rods else 1.0, 1.0)),
        arm=read_only(arm),
        tip=read_only(tip),
        body=read_only(body),
        body_arm=read_only(body_arm),
        beyond=read_only(beyond),
        beyond_normals=read_only(beyond_normals),
        beyond_end=read_only(beyond_end),
        beyond_next=read_only(beyond_next),
        lines=read_only(lines),
        lift_m=0.0 if rods else 0.5 * part.diameter_m,
        rest_m=0.5 * part.diameter_m,
        width_m=width,
        two_faced=not _mirror_symmetric(edge, lines, _SYMMETRIC_WIDTHS * width),
        arms=len(figure.bars) + len(figure.discs) + len(figure.holes) + len(figure.slots),
        bars=len(figure.bars),
    )


def _rods(topology: Topology, diameter_m: float) -> Outline:
    """Round rods along the edges of a graph."""
    ends = topology.points[topology.edges][:, :, :2]
    return Outline(
        bars=read_only(ends.copy()),
        bar_width_m=read_only(np.full(len(ends), diameter_m)),
        discs=read_only(np.zeros((0, 3))),
        holes=read_only(np.zeros((0, 3))),
        slots=read_only(np.zeros((0, 5))),
    )


def _end_kinds(topology: Topology, bar: Floats, width_m: float) -> tuple[NodeKind, NodeKind]:
    """What lies at both ends of a bar: the kind of the nearest node, within a width; otherwise an end."""
    kinds = []
    for end in bar:
        off = np.linalg.norm(topology.points[:, :2] - end, axis=1)
        off[[kind is NodeKind.LOOP_CENTRE for kind in topology.kinds]] = np.inf
        near = int(np.argmin(off))
        kinds.append(topology.kinds[near] if off[near] < width_m else NodeKind.JUNCTION)
    return kinds[0], kinds[1]


def _along(start: float, stop: float, spacing: float) -> Floats:
    """Places between two, half a spacing inside at either end."""
    count = max(1, round((stop - start) / spacing))
    return start + (np.arange(count) + 0.5) * (stop - start) / count


def _edge(
    figure: Outline, ends: list[tuple[NodeKind, NodeKind]], rods: bool, spacing: float
) -> tuple[Floats, Floats, Ints, Ints]:
    found: list[tuple[Floats, Floats, int, int]] = []
    for k, (bar, width) in enumerate(zip(figure.bars, figure.bar_width_m.tolist(), strict=True)):
        way, length = _way(bar)
        aside = np.array([-way[1], way[0]])
        cut = [_cut(kind, width) if rods else 0.0 for kind in ends[k]]
        t = _along(cut[0], length - cut[1], spacing) if length > sum(cut) else np.zeros(0)
        for side in (-1.0, 1.0):
            at = bar[0] + t[:, None] * way + side * 0.5 * width * aside
            found.append((at, np.tile(side * aside, (len(t), 1)), k, -1))
        for last in (0, 1):
            if ends[k][last] is not NodeKind.END:
                continue
            reach = (0.5 - _ROUNDED_WIDTHS) * width
            across = _along(-reach, reach, min(spacing, 0.15 * width))
            out = way if last else -way
            found.append(
                (bar[last] + across[:, None] * aside, np.tile(out, (len(across), 1)), k, 2 * k + last)
            )
    arm = len(figure.bars)
    for rounds, sign in ((figure.discs, 1.0), (figure.holes, -1.0)):
        for u, v, radius in rounds.tolist():
            turn = _along(0.0, 2 * np.pi, min(spacing / radius, 2 * np.pi / _FEWEST_ROUND))
            out = np.stack([np.cos(turn), np.sin(turn)], axis=1)
            found.append((np.array([u, v]) + radius * out, sign * out, arm, -1))
            arm += 1
    for u, v, du, dv, width in figure.slots.tolist():
        way, aside, start = np.array([du, dv]), np.array([-dv, du]), np.array([u, v])
        t = _along(0.0, 4 * width, spacing)
        for side in (-1.0, 1.0):
            at = start + t[:, None] * way + side * 0.5 * width * aside
            found.append((at, np.tile(-side * aside, (len(t), 1)), arm, -1))
        turn = _along(0.5 * np.pi, 1.5 * np.pi, 2 * spacing / width)
        out = np.cos(turn)[:, None] * way + np.sin(turn)[:, None] * aside
        found.append((start + 0.5 * width * out, -out, arm, -1))
        arm += 1
    kept = []
    for at, out, number, tip in found:
        is_cut = number >= len(figure.bars) + len(figure.discs)
        keep = _open(figure, at, number, rods) if not is_cut else _cuts_edge(figure, at, number)
        kept.append((at[keep], out[keep], np.full(keep.sum(), number), np.full(keep.sum(), tip)))
    at, out, arms, tips = (np.concatenate(column) for column in zip(*kept, strict=True))
    return at, out, arms.astype(np.int64), tips.astype(np.int64)


def _cut(kind: NodeKind, width: float) -> float:
    """What is left out of a rod's flank next to a node."""
    if kind is NodeKind.CORNER:
        return BEND_WIDTHS * width
    return _ROUNDED_WIDTHS * width if kind is NodeKind.END else 0.0


def _way(bar: Floats) -> tuple[Floats, float]:
    length = float(np.linalg.norm(bar[1] - bar[0]))
    return (bar[1] - bar[0]) / length, length


def _depth_in_solid(figure: Outline, at: Floats, number: int) -> Floats:
    """How deep points lie in a bar or disc; negative outside."""
    if number < len(figure.bars):
        way, length = _way(figure.bars[number])
        off = at - figure.bars[number][0]
        t, s = off @ way, np.abs(off @ np.array([-way[1], way[0]]))
        return np.asarray(np.minimum(np.minimum(t, length - t), 0.5 * figure.bar_width_m[number] - s))
    u, v, radius = figure.discs[number - len(figure.bars)]
    return np.asarray(radius - np.hypot(at[:, 0] - u, at[:, 1] - v))


def _depth_in_cut(figure: Outline, at: Floats, number: int) -> Floats:
    """How deep points lie in a hole or slot; negative outside."""
    number -= len(figure.bars) + len(figure.discs)
    if number < len(figure.holes):
        u, v, radius = figure.holes[number]
        return np.asarray(radius - np.hypot(at[:, 0] - u, at[:, 1] - v))
    u, v, du, dv, width = figure.slots[number - len(figure.holes)]
    off = at - np.array([u, v])
    t, s = off @ np.array([du, dv]), off @ np.array([-dv, du])
    return np.asarray(0.5 * width - np.hypot(np.minimum(t, 0.0), s))


def _run(figure: Outline, number: int) -> tuple[Floats, float]:
    return figure.bars[number], float(figure.bar_width_m[number])


def _solids(figure: Outline) -> range:
    return range(len(figure.bars) + len(figure.discs))


def _cuts(figure: Outline) -> range:
    first = len(figure.bars) + len(figure.discs)
    return range(first, first + len(figure.holes) + len(figure.slots))


def _deep(figure: Outline) -> float:
    return _DEEP_WIDTHS * float(figure.bar_width_m.min())


def _open(figure: Outline, at: Floats, number: int, rods: bool) -> Bools:
    """Whether points on the edge of one solid are on the edge of the figure; welds of rods are left out."""
    keep = np.ones(len(at), np.bool_)
    for other in _solids(figure):
        if other == number:
            continue
        limit = _deep(figure)
        if rods and _joined(_run(figure, number), _run(figure, other)) is None:
            limit = -_WELD_WIDTHS * float(figure.bar_width_m[other])
        keep &= _depth_in_solid(figure, at, other) < limit
    for cut in _cuts(figure):
        keep &= _depth_in_cut(figure, at, cut) < 0
    return keep


def _cuts_edge(figure: Outline, at: Floats, number: int) -> Bools:
    """Whether points on the edge of one hole or slot are on the edge of the figure."""
    keep = inside(figure, at, ignore_cuts=True) > _deep(figure)
    for cut in _cuts(figure):
        if cut != number:
            keep &= _depth_in_cut(figure, at, cut) < 0
    return keep


def inside(figure: Outline, at: Floats, ignore_cuts: bool = False) -> Floats:
    """How deep points (N, 2) lie in the figure, as far as single primitives tell; negative outside."""
    depth = np.max([_depth_in_solid(figure, at, number) for number in _solids(figure)], axis=0)
    if not ignore_cuts:
        for cut in _cuts(figure):
            depth = np.minimum(depth, -_depth_in_cut(figure, at, cut))
    return np.asarray(depth)


def _body(
    figure: Outline, ends: list[tuple[NodeKind, NodeKind]], rods: bool, spacing: float
) -> tuple[Floats, Ints]:
    points, arms = [], []
    rim = _RIM_WIDTHS * float(figure.bar_width_m.min())
    for k, (bar, width) in enumerate(zip(figure.bars, figure.bar_width_m.tolist(), strict=True)):
        way, length = _way(bar)
        aside = np.array([-way[1], way[0]])
        cut = [_cut(kind, width) if rods else 0.0 for kind in ends[k]]
        low, high = cut[0] + 0.3 * width, length - cut[1] - 0.3 * width
        t = _along(low, high, spacing) if high > low else np.array([0.5 * length])
        for lane in (0.0,) if rods else (-0.2, 0.0, 0.2):
            at = bar[0] + t[:, None] * way + lane * width * aside
            at = at[inside(figure, at) > rim]
            points.append(at)
            arms.append(np.full(len(at), k))
    for k, (u, v, radius) in enumerate(figure.discs.tolist()):
        turn = _along(0.0, 2 * np.pi, min(spacing / radius, 2 * np.pi / _FEWEST_ROUND))
        out = np.stack([np.cos(turn), np.sin(turn)], axis=1)
        at = np.concatenate([np.array([u, v]) + share * radius * out for share in (0.5, 0.78)])
        at = at[inside(figure, at) > 0.5 * rim]
        points.append(at)
        arms.append(np.full(len(at), len(figure.bars) + k))
    return np.concatenate(points), np.concatenate(arms).astype(np.int64)


def _beyond(
    figure: Outline, ends: list[tuple[NodeKind, NodeKind]], spacing: float
) -> tuple[Floats, Floats, Ints, Bools]:
    """Flanks of each bar continued past both its ends, as far as they leave the figure."""
    points, normals, numbers, nexts = (
        [np.zeros((0, 2))],
        [np.zeros((0, 2))],
        [np.zeros(0, int)],
        [np.zeros(0)],
    )
    for k, (bar, width) in enumerate(zip(figure.bars, figure.bar_width_m.tolist(), strict=True)):
        way, _ = _way(bar)
        aside = np.array([-way[1], way[0]])
        low, high = (share * width for share in _BEYOND_WIDTHS)
        t = np.arange(low, 2 * high, min(spacing, 0.2 * width))
        for last in (0, 1):
            out = way if last else -way
            middle = bar[last] + t[:, None] * out
            clear = 0.0 if ends[k][last] is NodeKind.END else _CLEAR_WIDTHS * width
            free = np.flatnonzero(inside(figure, middle, ignore_cuts=True) < -clear)
            free = free[t[free] < t[free[0]] + high - low] if len(free) else free
            for side in (-1.0, 1.0):
                points.append(middle[free] + side * 0.5 * width * aside)
                normals.append(np.tile(side * aside, (len(free), 1)))
                numbers.append(np.full(len(free), 2 * k + last))
                nexts.append(t[free] < NEXT_WIDTHS * width)
    return (
        np.concatenate(points),
        np.concatenate(normals),
        np.concatenate(numbers).astype(np.int64),
        np.concatenate(nexts).astype(np.bool_),
    )


def _lines(figure: Outline) -> Floats:
    """(B, 5) straight runs: bars of one width that continue each other are one."""
    runs = [(bar, float(width)) for bar, width in zip(figure.bars, figure.bar_width_m, strict=True)]
    while True:
        for one, other in combinations(range(len(runs)), 2):
            joined = _joined(runs[one], runs[other])
            if joined is not None:
                runs = [run for k, run in enumerate(runs) if k not in (one, other)] + [joined]
                break
        else:
            return np.array([[*bar[0], *bar[1], width] for bar, width in runs])


def _joined(one: tuple[Floats, float], other: tuple[Floats, float]) -> tuple[Floats, float] | None:
    if abs(float(_way(one[0])[0] @ _way(other[0])[0])) < _STRAIGHT_COSINE:
        return None
    gaps = np.linalg.norm(one[0][:, None] - other[0][None], axis=2)
    a, b = np.unravel_index(int(np.argmin(gaps)), gaps.shape)
    if gaps[a, b] > 0.1 * one[1]:
        return None
    return np.stack([one[0][1 - a], other[0][1 - b]]), one[1]


def _mirror_symmetric(edge: Floats, lines: Floats, tolerance: float) -> bool:
    """Whether some reflection takes the sampled edge onto itself."""
    off = edge - edge.mean(axis=0)
    ways = [_way(line[:4].reshape(2, 2))[0] for line in lines]
    ways += [(a + b) / np.linalg.norm(a + b) for a, b in pairwise(ways) if np.linalg.norm(a + b) > 1e-6]
    for way in ways:
        for axis in (way, np.array([-way[1], way[0]])):
            mirrored = 2 * np.outer(off @ axis, axis) - off
            gaps = np.linalg.norm(off[:, None] - mirrored[None], axis=2).min(axis=0)
            if gaps.max() < tolerance + np.median(np.linalg.norm(np.diff(edge, axis=0), axis=1)):
                return True
    return False
