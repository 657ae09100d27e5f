"""What every hypothesis gains beside those that are chosen, and what choosing one takes from the others.

A chosen part claims the edges of its flanks and ends; what is left is what others can be made of. A part
gains by flanks and ends that nobody else claims and loses by places without them, less where another chosen
part lies over it, more where the picture shows background. Parts do not pass through each other.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from vision.edges import Edges, Ids, Reals
from vision.ends import LANES
from vision.flank import Counts
from vision.jit import inlined, lean
from vision.neighbours import neighbours
from vision.traits import BEYOND, Traits, claimed_edges
from vision.types import Bools, Floats, Ints

UNSEEN, HIDDEN, BACKGROUND, OUTSIDE = 0.35, 0.08, 1.5, 0.35
"""What a px of axis costs without flanks: in the open, under another part, on background, off the picture."""
ONE_FLANK, BOTH_FLANKS, SEEN_COST = 0.45, 0.6, 0.1
TIP_WIDTHS, NO_TIP_WIDTHS, BEYOND_WEIGHT = 1.3, 0.65, 0.5
"""An end that is seen; one that is neither seen nor covered; flanks that go on beyond it, each px."""
THROUGH = 0.6
"""Axes nearer than this share of the diameter pass through each other."""
THROUGH_LENGTHS = 0.25
PARALLEL = 0.97
BELOW_SHARE, ABOVE_SHARE, CROSSING, ALONG = 0.35, 0.5, 0.95, 0.985
"""A part may cover another unless it lies this share of a diameter below it; it surely does, at a crossing
and not along it (cosine), from the second share above it."""
MOST_COVERS = 64
NEVER = -1e9


class State(NamedTuple):
    """Everything the compiled choice works on; N hypotheses, two views."""

    samples: npt.NDArray[np.int32]
    ends: Floats
    width: Floats
    value: Reals
    edge: Ids
    ground: npt.NDArray[np.uint8]
    tip_value: Reals
    tip_edge: Ids
    beyond_value: Reals
    beyond_edge: Ids
    table_l: Reals
    at_l: Ids
    table_r: Reals
    at_r: Ids
    taken_l: Counts
    taken_r: Counts
    disparity: Floats
    space: Floats
    prior: Floats
    soft: Floats
    hard: Ints
    covers: npt.NDArray[np.int32]
    covered: Ints
    claims: npt.NDArray[np.int64]
    claim_count: Ints
    gain: Floats
    near_at: Ints
    near: Ints
    pair: Reals
    spans: npt.NDArray[np.int16]
    rival: Bools
    related: Bools
    hidden: npt.NDArray[np.uint8]
    size_px: float
    width_px: float
    diameter: float
    step_d: float


def state(
    hypotheses: Floats,
    seen: Traits,
    left: Edges,
    right: Edges,
    space: Floats,
    prior: Floats,
    length_px: float,
    width_px: float,
    diameter_m: float,
    diameter_d: float,
    related: bool = True,
) -> State:
    """A fresh state with nothing chosen.

    Parameters
    ----------
    space : (N, 2, 3)
        Ends in m, any orthonormal frame.
    prior : (N,)
        What each part gains or loses for itself.
    diameter_d
        Disparity that one diameter of height makes, px.
    related
        Without it nothing can be taken, only looked at.
    """
    n = len(hypotheses)
    longest = int(3 * seen.value.shape[2] * 1.5 * 2) + 64
    near_at, near = np.zeros(n + 1, np.int64), np.zeros(0, np.int64)
    if related:
        near_at, near = neighbours(seen.ends, width_px + 2.0)
    return State(
        samples=seen.count, ends=seen.ends, width=seen.width, value=seen.value, edge=seen.edge,
        ground=seen.ground, tip_value=seen.tip_value, tip_edge=seen.tip_edge,
        beyond_value=seen.beyond_value, beyond_edge=seen.beyond_edge,
        table_l=left.table, at_l=left.at, table_r=right.table, at_r=right.at,
        taken_l=np.zeros(len(left.table) + 1, np.uint16), taken_r=np.zeros(len(right.table) + 1, np.uint16),
        disparity=np.ascontiguousarray(hypotheses[:, [3, 6]]), space=np.ascontiguousarray(space), prior=prior,
        soft=np.zeros(n), hard=np.zeros(n, np.int64),
        covers=np.empty((n, 2, MOST_COVERS, 4), np.int32), covered=np.zeros((n, 2), np.int64),
        claims=np.empty((n, 2, longest), np.int64), claim_count=np.full((n, 2), -1, np.int64),
        gain=np.zeros(n), near_at=near_at, near=near,
        pair=np.empty((len(near), 4), np.float32), spans=np.empty((len(near), 2, 2), np.int16),
        rival=np.zeros(len(near), np.bool_), related=np.zeros(n, np.bool_),
        hidden=np.zeros(seen.value.shape[2], np.uint8),
        size_px=length_px, width_px=width_px, diameter=diameter_m, step_d=diameter_d,
    )  # fmt: skip


@inlined
def gain_of(h: int, s: State) -> float:
    """What a hypothesis adds to what is chosen, in px of evidence."""
    if s.hard[h] > 0:
        return NEVER
    total = s.prior[h] - s.soft[h]
    hidden = s.hidden
    for view in range(2):
        taken = s.taken_l if view == 0 else s.taken_r
        steps = s.samples[h, view]
        hidden[:steps] = 0
        for c in range(s.covered[h, view]):
            level = 1 + s.covers[h, view, c, 3]
            for q in range(s.covers[h, view, c, 1], s.covers[h, view, c, 2]):
                hidden[q] = max(hidden[q], level)
        part = 0.0
        for q in range(steps):
            kind = s.ground[h, view, q]
            if kind == 0:
                part -= BACKGROUND
                continue
            if kind == 2:
                part -= OUTSIDE
                continue
            low, high = 0.0, 0.0
            e = s.edge[h, view, q, 0]
            if e >= 0 and taken[e] == 0:
                low = s.value[h, view, q, 0]
            e = s.edge[h, view, q, 1]
            if e >= 0 and taken[e] == 0:
                high = s.value[h, view, q, 1]
            if hidden[q] == 2:
                # what is seen through another part is not this one
                part -= HIDDEN
            elif low == 0.0 and high == 0.0:
                part -= HIDDEN if hidden[q] > 0 else UNSEEN
            else:
                part += ONE_FLANK * (low + high) + BOTH_FLANKS * min(low, high) - SEEN_COST
        dx = s.ends[h, view, 2] - s.ends[h, view, 0]
        dy = s.ends[h, view, 3] - s.ends[h, view, 1]
        total += part * np.hypot(dx, dy) / max(steps, 1)
        for end in range(2):
            tip = 0.0
            for lane in range(LANES):
                e = s.tip_edge[h, view, end, lane]
                if e >= 0 and taken[e] == 0:
                    tip += s.tip_value[h, view, end, lane]
            tip /= LANES
            total += TIP_WIDTHS * s.width_px * tip
            if hidden[0 if end == 0 else max(steps - 1, 0)] == 0:
                total -= NO_TIP_WIDTHS * s.width_px * max(0.0, 1 - 1.6 * tip)
            more = 0.0
            for q in range(BEYOND):
                a, b = s.beyond_edge[h, view, end, q, 0], s.beyond_edge[h, view, end, q, 1]
                if a >= 0 and b >= 0 and taken[a] == 0 and taken[b] == 0:
                    more += min(s.beyond_value[h, view, end, q, 0], s.beyond_value[h, view, end, q, 1])
            total -= BEYOND_WEIGHT * more
    return float(total)


@inlined
def _overlap(s: State, h: int, k: int, view: int) -> tuple[int, int, float]:
    """Samples of h under the outline of k, first and behind the last; k's disparity less h's there, px."""
    xa, ya = s.ends[k, view, 0], s.ends[k, view, 1]
    dx, dy = s.ends[k, view, 2] - xa, s.ends[k, view, 3] - ya
    size_k = np.hypot(dx, dy)
    ux, uy = dx / size_k, dy / size_k
    px, py = s.ends[h, view, 0], s.ends[h, view, 1]
    qx, qy = s.ends[h, view, 2] - px, s.ends[h, view, 3] - py
    half = 0.25 * (s.width[k, 0] + s.width[k, 1]) + 0.7
    # along k: t = t0 + share t1; across: c = c0 + share c1
    t0, t1 = (px - xa) * ux + (py - ya) * uy, qx * ux + qy * uy
    c0, c1 = -(px - xa) * uy + (py - ya) * ux, -qx * uy + qy * ux
    low, high = 0.0, 1.0
    if abs(c1) < 1e-9:
        if abs(c0) > half:
            return 0, 0, 0.0
    else:
        a, b = (-half - c0) / c1, (half - c0) / c1
        low, high = max(low, min(a, b)), min(high, max(a, b))
    if abs(t1) < 1e-9:
        if t0 < -1 or t0 > size_k + 1:
            return 0, 0, 0.0
    else:
        a, b = (-1 - t0) / t1, (size_k + 1 - t0) / t1
        low, high = max(low, min(a, b)), min(high, max(a, b))
    if high <= low:
        return 0, 0, 0.0
    middle = 0.5 * (low + high)
    there = min(max((t0 + middle * t1) / size_k, 0.0), 1.0)
    own = s.disparity[h, 0] + middle * (s.disparity[h, 1] - s.disparity[h, 0])
    other = s.disparity[k, 0] + there * (s.disparity[k, 1] - s.disparity[k, 0])
    steps = s.samples[h, view]
    return int(low * steps), min(int(np.ceil(high * steps)), steps), other - own


@inlined
def _apart(s: State, h: int, k: int) -> tuple[float, float]:
    """Distance of two axes in space, m, and the cosine between them (Lumelsky 1985, clamped)."""
    uu = uv = vv = uw = vw = 0.0
    for n in range(3):
        u, v = s.space[h, 1, n] - s.space[h, 0, n], s.space[k, 1, n] - s.space[k, 0, n]
        w = s.space[h, 0, n] - s.space[k, 0, n]
        uu, uv, vv = uu + u * u, uv + u * v, vv + v * v
        uw, vw = uw + u * w, vw + v * w
    det = uu * vv - uv * uv
    p = 0.5 if det < 1e-9 * uu * vv else min(max((uv * vw - vv * uw) / det, 0.0), 1.0)
    q = min(max((uv * p + vw) / vv, 0.0), 1.0)
    p = min(max((uv * q - uw) / uu, 0.0), 1.0)
    total = 0.0
    for n in range(3):
        first = s.space[h, 0, n] + p * (s.space[h, 1, n] - s.space[h, 0, n])
        second = s.space[k, 0, n] + q * (s.space[k, 1, n] - s.space[k, 0, n])
        total += (first - second) ** 2
    return float(np.sqrt(total)), float(abs(uv) / np.sqrt(uu * vv))


@lean
def relate(s: State, k: int) -> None:
    """What a hypothesis is to each of its neighbours, once it is needed: distance and cosine of the axes, how
    far the neighbour lies below it in either view, which of the neighbour's samples it covers, and whether
    both cannot be."""
    if s.related[k]:
        return
    s.related[k] = True
    for at in range(s.near_at[k], s.near_at[k + 1]):
        h = s.near[at]
        apart, cosine = _apart(s, h, k)
        s.pair[at, 0], s.pair[at, 1] = apart, cosine
        for view in range(2):
            first, last, above = _overlap(s, h, k, view)
            s.spans[at, view, 0], s.spans[at, view, 1] = first, last
            s.pair[at, 2 + view] = above
        rival = apart < THROUGH * s.diameter and cosine > PARALLEL
        if not rival:
            dx, dy = s.ends[h, 0, 2] - s.ends[h, 0, 0], s.ends[h, 0, 3] - s.ends[h, 0, 1]
            ex, ey = s.ends[k, 0, 2] - s.ends[k, 0, 0], s.ends[k, 0, 3] - s.ends[k, 0, 1]
            size, other = np.hypot(dx, dy), np.hypot(ex, ey)
            if abs(dx * ex + dy * ey) > 0.98 * size * other:
                mx = 0.5 * (s.ends[k, 0, 0] + s.ends[k, 0, 2] - s.ends[h, 0, 0] - s.ends[h, 0, 2])
                my = 0.5 * (s.ends[k, 0, 1] + s.ends[k, 0, 3] - s.ends[h, 0, 1] - s.ends[h, 0, 3])
                along, across = abs(mx * dx + my * dy) / size, abs(-mx * dy + my * dx) / size
                rival = along < 0.35 * s.size_px and across < 1.3 * s.width_px
        s.rival[at] = rival


@lean
def take(s: State, k: int, alive: Bools) -> None:
    """Choose k: claims, covers and conflicts of all others follow, and the gains of those it touches."""
    relate(s, k)
    _claim(s, k, True)
    for at in range(s.near_at[k], s.near_at[k + 1]):
        _press(s, k, at)
        h = s.near[at]
        if alive[h]:
            s.gain[h] = gain_of(h, s)


@lean
def give_back(s: State, k: int) -> None:
    """Undo `take`, but for the gains."""
    _claim(s, k, False)
    for at in range(s.near_at[k], s.near_at[k + 1]):
        _release(s, k, at)


@lean
def lay(s: State, k: int, among: Bools) -> None:
    """As `take`, for what concerns those ``among`` which a sum is made; gains are left."""
    relate(s, k)
    _claim(s, k, True)
    for at in range(s.near_at[k], s.near_at[k + 1]):
        if among[s.near[at]]:
            _press(s, k, at)


@lean
def lift(s: State, k: int, among: Bools) -> None:
    """Undo `lay`, or what it concerns of `take`."""
    _claim(s, k, False)
    for at in range(s.near_at[k], s.near_at[k + 1]):
        if among[s.near[at]]:
            _release(s, k, at)


@inlined
def _press(s: State, k: int, at_near: int) -> None:
    """What a chosen k does to one of its neighbours."""
    h = s.near[at_near]
    apart, cosine = s.pair[at_near, 0], s.pair[at_near, 1]
    if apart < THROUGH * s.diameter:
        if cosine > PARALLEL:
            s.hard[h] += 1
        else:
            s.soft[h] += THROUGH_LENGTHS * s.size_px * (1 - apart / (THROUGH * s.diameter))
    if cosine > ALONG:
        # a part right below another of its own direction explains nothing
        return
    for view in range(2):
        first, last = s.spans[at_near, view, 0], s.spans[at_near, view, 1]
        above = s.pair[at_near, 2 + view]
        at = s.covered[h, view]
        if last > first and above > -BELOW_SHARE * s.step_d and at < MOST_COVERS:
            s.covers[h, view, at, 0] = k
            s.covers[h, view, at, 1] = first
            s.covers[h, view, at, 2] = last
            s.covers[h, view, at, 3] = 1 if above > ABOVE_SHARE * s.step_d and cosine < CROSSING else 0
            s.covered[h, view] += 1


@inlined
def _release(s: State, k: int, at_near: int) -> None:
    """Undo `_press`."""
    h = s.near[at_near]
    apart, cosine = s.pair[at_near, 0], s.pair[at_near, 1]
    if apart < THROUGH * s.diameter:
        if cosine > PARALLEL:
            s.hard[h] -= 1
        else:
            s.soft[h] -= THROUGH_LENGTHS * s.size_px * (1 - apart / (THROUGH * s.diameter))
    for view in range(2):
        if s.spans[at_near, view, 1] <= s.spans[at_near, view, 0]:
            continue
        kept = 0
        for c in range(s.covered[h, view]):
            if s.covers[h, view, c, 0] != k:
                for n in range(4):
                    s.covers[h, view, kept, n] = s.covers[h, view, c, n]
                kept += 1
        s.covered[h, view] = kept


@lean
def _claim(s: State, k: int, add: bool) -> None:
    for view in range(2):
        if s.claim_count[k, view] < 0:
            table = s.table_l if view == 0 else s.table_r
            at = s.at_l if view == 0 else s.at_r
            s.claim_count[k, view] = claimed_edges(
                table, at, s.ends[k, view], s.width[k, 0], s.width[k, 1], s.claims[k, view]
            )
        taken = s.taken_l if view == 0 else s.taken_r
        for c in range(s.claim_count[k, view]):
            e = s.claims[k, view, c]
            taken[e] = taken[e] + np.uint16(1) if add else taken[e] - np.uint16(1)
