"""Chosen parts laid on the edges that are theirs alone: the last fit, and what it says of their doubt.

The observations are those of `vision.refine`. Here a part is close to its place already, so its edges are
looked up three times instead of at every step, and kept.
"""

from __future__ import annotations

import numpy as np

from vision.edges import Ids, Signposts
from vision.ends import LANES, add_end, cap_px, look_at_ends
from vision.explain import LENGTH_SIGMA_SHARE, UNSHADED_SIGMA_PX
from vision.flank import Counts, nearest_edge
from vision.jit import compiled, inlined, lean
from vision.refine import (
    DAMPING,
    FLANK_SIGMA_PX,
    LENGTH,
    LONGEST_STEP_PX,
    NARROWEST,
    ONE_FLANK_WEIGHT,
    ROW_SIGMA_PX,
    UNIT,
    WIDEST,
    add_flanks,
    add_flat,
    solve,
)
from vision.traits import SAMPLE_PX, claimed_edges
from vision.types import Bools, Floats, Ints

TILT_SHARE = 0.05
KEPT_PX, STILL_PX = 0.4, 0.7
"""An edge so near to its flank is not exchanged for a nearer one; a part that moved less has not come into
the reach of others, because the reach shrinks by more."""
REACH_PX = (2.4, 1.6, 1.6, 1.1, 0.8)
"""How far from its flanks a part's edges may be, step by step."""
GATHERED = (2, 4)
"""Before these steps, and before the first, edges are looked up."""
FIRST_TIP_PX, TIP_PX = 3.5, 2.5
MOST_MOVED_PX, LEAST_KEPT = 2.5, 0.6
"""A part that moves further, or keeps less of what tells its place, has jumped to something else."""
STRETCH_WIDTHS, LEAST_OF_STRETCH, CALM = 2.0, 0.4, 2.0
"""Flanks are judged by stretches so many widths long, where so much of them is seen."""
MOST_CLAIMS = 8192
"""Edges of one part in one picture."""
FREE_ROUNDS, FREE_REACH_PX = 3, 1.6


@compiled
def measure(
    parts: Floats, chosen: Ints, ends_seen: Bools, ends: Floats, width: Floats, edge: Ids,
    left: Signposts, at_l: Ids, taken_l: Counts, right: Signposts, at_r: Ids, taken_r: Counts,
    camera: Floats, level: Floats, unit: float, step_d: float, shift: Floats, loose: Floats,
    covariance: Floats, strain: Floats, free: Floats,
) -> None:  # fmt: skip
    """Measure parts (C, `COLUMNS`) in place, each on the edges that no other claims.

    Parameters
    ----------
    chosen, ends_seen : (C,)
        Their rows in ``ends``, ``width`` and ``edge``, see `Traits`; whether both pictures show both ends.
    taken_l, taken_r
        How many chosen parts claim an edge; changed and changed back.
    camera, level, unit, step_d
        See `refine`.
    shift : (C, 2, 2)
        Where the low and the high flank are seen from their outlines in either view, along the normal, px.
    loose : (C, 2)
        Deviation of what still shifts all flanks of a part in one view alike, px. Both are set back to
        nothing known where they take a part off its own edges.
    covariance : (C, 6, 6)
        Of x, y, d of both ends, px; filled.
    strain : (C,)
        How many times larger it is for flanks that are not straight or not one known width apart; filled.
    free : (C, `COLUMNS`)
        The same parts measured without the known length, where their ends are seen; filled.
    """
    mine_l, mine_r = np.empty(MOST_CLAIMS, np.int64), np.empty(MOST_CLAIMS, np.int64)
    longest = int(np.hypot(at_l.shape[0], at_l.shape[1]) / SAMPLE_PX) + 1
    spots, tips = np.empty((2, longest, 2, 2)), np.empty((2, 2, LANES, 2))
    far_rim, steps = np.zeros((2, 2), np.bool_), np.zeros(2, np.int64)
    none, unsure = np.zeros((2, 2)), np.full(2, UNSHADED_SIGMA_PX)
    matrix, at_spots = np.zeros((6, 6)), np.zeros(6)
    for place in range(len(parts)):
        k = chosen[place]
        many_l = claimed_edges(left.table, at_l, ends[k, 0], width[k, 0], width[k, 1], mine_l)
        many_r = claimed_edges(right.table, at_r, ends[k, 1], width[k, 0], width[k, 1], mine_r)
        for c in range(many_l):
            taken_l[mine_l[c]] -= np.uint16(1)
        for c in range(many_r):
            taken_r[mine_r[c]] -= np.uint16(1)
        plain, one = parts[place].copy(), parts[place].copy()
        _recall(plain, 0, edge[k, 0], left, taken_l, spots, tips, far_rim, steps, camera)
        _recall(plain, 1, edge[k, 1], right, taken_r, spots, tips, far_rim, steps, camera)
        for turn in range(2):
            _step(plain, REACH_PX[turn], spots, tips, far_rim, steps, camera, level, unit, step_d, none,
                  unsure, matrix)  # fmt: skip
        before = np.trace(matrix)
        covariance[place] = matrix
        at_spots[:] = one[1:7]
        for turn in range(len(REACH_PX)):
            if turn in GATHERED:
                far = np.abs(one[1:7] - at_spots).max() > STILL_PX
                _look_again(one, 0, far, REACH_PX[turn], left, taken_l, spots, tips, far_rim, steps, camera)
                _look_again(one, 1, far, REACH_PX[turn], right, taken_r, spots, tips, far_rim, steps, camera)
                at_spots[:] = one[1:7]
            _step(one, REACH_PX[turn], spots, tips, far_rim, steps, camera, level, unit, step_d, shift[place],
                  loose[place], matrix)  # fmt: skip
        moved = np.abs(one[1:7] - parts[place, 1:7]).max()
        if moved > MOST_MOVED_PX or np.trace(matrix) < LEAST_KEPT * before:
            # it lost its own edges on the way: the first measurement stands, without the shading
            one[:] = plain
            shift[place] = 0.0
            loose[place] = UNSHADED_SIGMA_PX
        else:
            covariance[place] = matrix
        for n in range(6):
            covariance[place, n, n] += 1e-6
        covariance[place] = np.linalg.inv(covariance[place])
        strain[place] = max(1.0, _strain(one, REACH_PX[3], spots, steps, unit, shift[place]))
        if ends_seen[place]:
            free[place] = one
            free[place, LENGTH] = 0.0
            for _ in range(FREE_ROUNDS):
                _step(free[place], FREE_REACH_PX, spots, tips, far_rim, steps, camera, level, unit, step_d,
                      shift[place], loose[place], matrix)  # fmt: skip
        parts[place] = one
        for c in range(many_l):
            taken_l[mine_l[c]] += np.uint16(1)
        for c in range(many_r):
            taken_r[mine_r[c]] += np.uint16(1)


@lean
def _strain(part: Floats, reach: float, spots: Floats, steps: Ints, unit: float, shift: Floats) -> float:
    """How many times the variance they should have flanks are off straight lines one known width apart.

    Flanks are read stretch by stretch, because what spoils one edge (a neighbour's shadow, the shoulder of a
    seam) spoils those beside it: the mean of a stretch should be known far better than a single edge. Birge's
    ratio, with `CALM` stretches that are as they should be beside those that are seen.
    """
    chi, count = CALM, CALM
    scale = SAMPLE_PX / (FLANK_SIGMA_PX * FLANK_SIGMA_PX)
    for view in range(2):
        _, _, ux, uy, _ = _axis(part, view)
        nx, ny = -uy, ux
        many = max(2, int(STRETCH_WIDTHS * part[UNIT] * 0.5 * (part[3] + part[6]) / SAMPLE_PX))
        stretches = 0
        missed = weight = spread = both = 0.0
        for q in range(steps[view]):
            x, y, half = _station(part, view, (q + 0.5) / steps[view])
            off_low = (spots[view, q, 0, 0] - x) * nx + (spots[view, q, 0, 1] - y) * ny + half
            off_high = (x - spots[view, q, 1, 0]) * nx + (y - spots[view, q, 1, 1]) * ny + half
            low, high = abs(off_low) <= reach, abs(off_high) <= reach
            off_low -= shift[view, 0]
            off_high += shift[view, 1]
            if low and high:
                missed += 0.5 * (off_low - off_high)
                weight += 1.0
                spread += half - 0.5 * (off_low + off_high) - half * unit / part[UNIT]
                both += 1.0
            elif high:
                missed -= ONE_FLANK_WEIGHT * off_high
                weight += ONE_FLANK_WEIGHT
            elif low:
                missed += ONE_FLANK_WEIGHT * off_low
                weight += ONE_FLANK_WEIGHT
            if q % many == many - 1 or q == steps[view] - 1:
                if weight > LEAST_OF_STRETCH * many:
                    chi += scale * missed * missed / weight
                    stretches += 1
                if both > LEAST_OF_STRETCH * many:
                    chi += scale * spread * spread / both
                    count += 1.0
                missed = weight = spread = both = 0.0
        # two numbers of the line were fitted to them
        count += max(0, stretches - 2)
    return chi / count


@lean
def _recall(
    part: Floats, view: int, edge: Ids, posts: Signposts, taken: Counts,
    spots: Floats, tips: Floats, far_rim: Bools, steps: Ints, camera: Floats,
) -> None:  # fmt: skip
    """The nearest free edge of either flank at stations along a part in one view, NaN where there is none:
    the one that was found when the part was looked at, ``edge`` (S, 2), or else the nearest of those left."""
    _, _, ux, uy, size = _axis(part, view)
    count = min(int(size / SAMPLE_PX), spots.shape[1])
    steps[view] = count
    for q in range(count):
        spots[view, q] = np.nan
        x, y, half = _station(part, view, (q + 0.5) / count)
        # within a width of the ends the edge turns round the corner
        along = (q + 0.5) / count * size
        if along < half or size - along < half:
            continue
        for side in range(2):
            e = edge[q, side]
            # a gap that was closed with the edge beside it tells nothing of its own
            if e < 0 or taken[e] > 0 or (q > 0 and e == edge[q - 1, side]):
                sign = -1.0 if side == 0 else 1.0
                e, _ = nearest_edge(
                    posts, taken, x - sign * uy * half, y + sign * ux * half, sign * uy, -sign * ux,
                    REACH_PX[0],
                )  # fmt: skip
            if e >= 0:
                spots[view, q, side, 0], spots[view, q, side, 1] = posts.table[e, 0], posts.table[e, 1]
    look_at_ends(part[1:7], part[UNIT], view, False, FIRST_TIP_PX, posts, taken, camera, tips, far_rim)


@lean
def _look_again(
    part: Floats, view: int, far: bool, reach: float, posts: Signposts, taken: Counts,
    spots: Floats, tips: Floats, far_rim: Bools, steps: Ints, camera: Floats,
) -> None:  # fmt: skip
    """The same after a part has moved. An edge near the flank stays its own; where there was none within a
    larger reach there is none now, unless the part has moved ``far``."""
    _, _, ux, uy, size = _axis(part, view)
    for q in range(steps[view]):
        along = (q + 0.5) / steps[view] * size
        x, y, half = _station(part, view, (q + 0.5) / steps[view])
        if along < half or size - along < half:
            spots[view, q] = np.nan
            continue
        for side in range(2):
            sign = -1.0 if side == 0 else 1.0
            fx, fy = x - sign * uy * half, y + sign * ux * half
            off = (spots[view, q, side, 1] - fy) * ux - (spots[view, q, side, 0] - fx) * uy
            if abs(off) < KEPT_PX or (np.isnan(off) and not far):
                continue
            e, _ = nearest_edge(posts, taken, fx, fy, sign * uy, -sign * ux, reach)
            spots[view, q, side] = np.nan
            if e >= 0:
                spots[view, q, side, 0], spots[view, q, side, 1] = posts.table[e, 0], posts.table[e, 1]
    look_at_ends(part[1:7], part[UNIT], view, True, TIP_PX, posts, taken, camera, tips, far_rim)


@inlined
def _axis(part: Floats, view: int) -> tuple[float, float, float, float, float]:
    """Start, unit direction and length of a part in one view, px."""
    xa, ya = part[1] - view * part[3], part[2]
    dx, dy = part[4] - view * part[6] - xa, part[5] - ya
    size = np.hypot(dx, dy)
    return xa, ya, dx / size, dy / size, size


@inlined
def _station(part: Floats, view: int, share: float) -> tuple[float, float, float]:
    """Place on the axis of a part in one view and half its width there, px."""
    x = part[1] + share * (part[4] - part[1])
    y = part[2] + share * (part[5] - part[2])
    d = part[3] + share * (part[6] - part[3])
    return x - view * d, y, 0.5 * part[UNIT] * d


@compiled
def _step(
    part: Floats, reach: float, spots: Floats, tips: Floats, far_rim: Bools, steps: Ints, camera: Floats,
    level: Floats, unit: float, step_d: float, shift: Floats, loose: Floats, matrix: Floats,
) -> None:  # fmt: skip
    """One step of Gauss-Newton with Tukey's weights, in place; ``matrix`` (6, 6) its normal matrix."""
    p = part[1:7]
    wide = part[UNIT]
    right = np.zeros(6)
    matrix[:] = 0.0
    spread, spread_of = 0.0, 0
    for view in range(2):
        xa, ya, xb, yb = p[0] - view * p[2], p[1], p[3] - view * p[5], p[4]
        size = np.hypot(xb - xa, yb - ya)
        if size < 5:
            continue
        ux, uy = (xb - xa) / size, (yb - ya) / size
        nx, ny = -uy, ux
        aa = ab = bb = ra = rb = 0.0
        whole = whole_a = whole_b = missed = 0.0
        for q in range(steps[view]):
            share = (q + 0.5) / steps[view]
            x, y = xa + share * (xb - xa), ya + share * (yb - ya)
            width = wide * (p[2] + share * (p[5] - p[2]))
            off_low = (spots[view, q, 0, 0] - x) * nx + (spots[view, q, 0, 1] - y) * ny + 0.5 * width
            off_high = (x - spots[view, q, 1, 0]) * nx + (y - spots[view, q, 1, 1]) * ny + 0.5 * width
            # comparisons with what is not seen are false
            low, high = abs(off_low) <= reach, abs(off_high) <= reach
            if not low and not high:
                continue
            off_low -= shift[view, 0]
            off_high += shift[view, 1]
            if low and high:
                miss, weight = 0.5 * (off_low - off_high), 1.0
                spread += (width - off_high - off_low) / width
                spread_of += 1
            elif high:
                miss, weight = -off_high, ONE_FLANK_WEIGHT
            else:
                miss, weight = off_low, ONE_FLANK_WEIGHT
            weight *= (1 - (miss / (reach + 0.3)) ** 2) ** 2
            one = 1 - share
            aa += weight * one * one
            ab += weight * one * share
            bb += weight * share * share
            ra += weight * one * miss
            rb += weight * share * miss
            whole += weight
            whole_a += weight * one
            whole_b += weight * share
            missed += weight * miss
        scale = SAMPLE_PX / (FLANK_SIGMA_PX * FLANK_SIGMA_PX)
        add_flanks(
            view, nx, ny, scale, loose[view] ** 2 + view * (ny * ROW_SIGMA_PX) ** 2, (aa, ab, bb), (ra, rb),
            (whole, whole_a, whole_b, missed), matrix, right,
        )  # fmt: skip
        for end in range(2):
            _end(p, wide, view, end, ux, uy, tips, far_rim[view, end],
                 FIRST_TIP_PX if reach > TIP_PX else TIP_PX, camera, matrix, right)  # fmt: skip
    _beliefs(p, part[LENGTH], camera, level, step_d, matrix, right)
    _move(p, matrix, right)
    if spread_of * SAMPLE_PX > 20:
        part[UNIT] = min(max(wide * (0.5 + 0.5 * spread / spread_of), NARROWEST * unit), WIDEST * unit)


@lean
def _end(
    p: Floats, wide: float, view: int, end: int, ux: float, uy: float, tips: Floats, far: bool, reach: float,
    camera: Floats, matrix: Floats, right: Floats,
) -> None:  # fmt: skip
    """Adds where one end is seen along the axis in one view."""
    ox, oy = (-ux, -uy) if end == 0 else (ux, uy)
    x, y = p[3 * end] - view * p[3 * end + 2], p[3 * end + 1]
    cap, doubt = cap_px(p, end, view, wide * p[3 * end + 2], camera, far)
    total, lanes = 0.0, 0
    for lane in range(LANES):
        off = (tips[view, end, lane, 0] - x) * ox + (tips[view, end, lane, 1] - y) * oy - cap
        if abs(off) <= reach:
            total += off
            lanes += 1
    add_end(view, end, ox, oy, total / max(lanes, 1), lanes, doubt, matrix, right)


@lean
def _beliefs(
    p: Floats, length: float, camera: Floats, level: Floats, step_d: float, matrix: Floats, right: Floats
) -> None:
    """Adds the known length (0: unknown), and that most parts lie flat."""
    focal, baseline, cx, cy = camera[0], camera[1], camera[2], camera[3]
    za, zb = focal * baseline / p[2], focal * baseline / p[5]
    xa, ya = (p[0] - cx) * za / focal, (p[1] - cy) * za / focal
    xb, yb = (p[3] - cx) * zb / focal, (p[4] - cy) * zb / focal
    wx, wy, wz = xa - xb, ya - yb, za - zb
    now = np.sqrt(wx * wx + wy * wy + wz * wz)
    if length > 0:
        row = (
            wx * za / (focal * now), wy * za / (focal * now), -(wx * xa + wy * ya + wz * za) / (p[2] * now),
            -wx * zb / (focal * now), -wy * zb / (focal * now), (wx * xb + wy * yb + wz * zb) / (p[5] * now),
        )  # fmt: skip
        weight = 1 / (LENGTH_SIGMA_SHARE * length) ** 2
        for a in range(6):
            right[a] += weight * row[a] * (length - now)
            for b in range(6):
                matrix[a, b] += weight * row[a] * row[b]
    add_flat(p, level, TILT_SHARE * now * step_d, matrix, right)


@compiled
def _move(p: Floats, matrix: Floats, right: Floats) -> None:
    """One damped step; ``right`` becomes it."""
    damped = matrix.copy()
    for a in range(6):
        damped[a, a] += DAMPING
    solve(damped, right)
    for a in range(6):
        p[a] += min(max(right[a], -LONGEST_STEP_PX), LONGEST_STEP_PX)
