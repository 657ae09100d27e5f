"""Crossings of a skeleton graph: which arms meet there, and which two of them are one strand.

Where strands cross, their skeletons share a piece: a point at a right angle, a bridge between two forks
at a shallow one. Forks joined by bridges are one crossing. What goes on within it is not read from the
skeleton but from its arms away from it: their ends are paired so that the curves through the crossing
bend least in all, over all arms at once. An arm may stay alone, for a fixed price. Whether a longer edge
is a bridge is asked in the same currency: it is when its two ends as one crossing cost less than as two.

All lengths are in radii: distances from the skeleton to the nearest background.
"""

from __future__ import annotations

import numpy as np

from vision.jit import compiled, lean
from vision.tracing_arms import bending, cubic
from vision.types import Bools, Floats, Ints, Mask

SHORT_RADII = 3.0
"""An edge between two forks up to this long is a bridge."""
LONG_RADII = 25.0
"""A longer one may be, up to this: strands that cross at 9 degrees share 2 / sin(4.5 deg) radii,"""
SHARED_WIDTH = 1.1
"""and are this much wider there on the average than one alone, unless the edge is shorter than"""
NARROW_RADII = 8.0
"""this. An edge that leads back into the same crossing is a hole in it up to the same length."""
SINGLE_COST = 0.8
"""Price of an arm that stays alone, rad squared: a couple may turn by sqrt(2 * 0.8) rad = 72 degrees."""
OFF_MASK = 0.15
"""A curve through a crossing may lie on background for this share of it; no pair beyond."""
MOST_ARMS = 14
"""Crossings with more arms are paired best first, not best in all."""


@lean
def _leaves(mask: Mask, one: Floats, other: Floats) -> bool:
    """True when the curve from arm to arm lies on background for too much of its way."""
    steps = int(np.hypot(other[0] - one[0], other[1] - one[1])) + 1
    off = 0
    for k in range(1, steps):
        u, v = cubic(one, other, k / steps)
        x = int(np.floor(u + 0.5))
        y = int(np.floor(v + 0.5))
        if not (0 <= x < mask.shape[1] and 0 <= y < mask.shape[0] and mask[y, x]):
            off += 1
    return off > OFF_MASK * steps


@compiled
def pairing(cost: Floats, single: float) -> tuple[Ints, float]:
    """(A,) the partner of each arm, -1 for one that stays alone, so that the sum is least; the sum."""
    count = len(cost)
    partner = np.full(count, -1, np.int64)
    if count > MOST_ARMS:
        free = np.ones(count, np.bool_)
        total = count * single
        while True:
            best = 2.0 * single
            x = y = -1
            for i in range(count):
                for j in range(i + 1, count):
                    if free[i] and free[j] and cost[i, j] < best:
                        best = cost[i, j]
                        x = i
                        y = j
            if x < 0:
                return partner, total
            total += best - 2.0 * single
            partner[x] = y
            partner[y] = x
            free[x] = free[y] = False
    sets = 1 << count
    least = np.zeros(sets)
    choice = np.full(sets, -1, np.int64)
    for chosen in range(1, sets):
        i = 0
        while not (chosen >> i) & 1:
            i += 1
        rest = chosen ^ (1 << i)
        least[chosen] = single + least[rest]
        for j in range(i + 1, count):
            if (chosen >> j) & 1:
                price = cost[i, j] + least[rest ^ (1 << j)]
                if price < least[chosen]:
                    least[chosen] = price
                    choice[chosen] = j
    chosen = sets - 1
    while chosen:
        i = 0
        while not (chosen >> i) & 1:
            i += 1
        j = choice[chosen]
        chosen ^= 1 << i
        if j >= 0:
            partner[i] = j
            partner[j] = i
            chosen ^= 1 << j
    return partner, least[sets - 1]


@compiled
def _couple(
    mask: Mask, nodes: Ints, first: Ints, at: Ints, inside: Bools, arms: Floats, goes_on: Ints
) -> float:
    """Pairs the arms of one crossing, given by its nodes, in `goes_on`; returns what it costs."""
    room = 0
    for n in nodes:
        room += first[n + 1] - first[n]
    of = np.empty(room, np.int64)
    size = 0
    for n in nodes:
        for k in range(first[n], first[n + 1]):
            if not inside[at[k] // 2]:
                of[size] = at[k]
                size += 1
    cost = np.zeros((size, size))
    for i in range(size):
        for j in range(i):
            one = arms[of[i] // 2, of[i] % 2]
            other = arms[of[j] // 2, of[j] % 2]
            cost[i, j] = bending(one, other)
            if cost[i, j] < 2.0 * SINGLE_COST and _leaves(mask, one, other):
                cost[i, j] = 2.0 * SINGLE_COST
            cost[j, i] = cost[i, j]
    chosen, total = pairing(cost, SINGLE_COST)
    for i in range(size):
        goes_on[of[i] // 2, of[i] % 2] = of[chosen[i]] if chosen[i] >= 0 else -1
    return total


@compiled
def crossings(
    mask: Mask, edges: Ints, degree: Ints, lengths_px: Floats, median: Floats, mean: Floats, arms: Floats
) -> tuple[Ints, Ints, Bools]:
    """Which forks are one crossing, and how its arms go on.

    Returns
    -------
    crossing : (N,) int
        Of each node, as the number of its first node.
    goes_on : (M, 2) int
        For both ends of each edge the end (2 edge + side) it goes on to, -1 for none.
    within : (M,) bool
        True for edges within a crossing.
    """
    nodes = len(degree)
    count = len(edges)
    first = np.zeros(nodes + 1, np.int64)
    for n in range(nodes):
        first[n + 1] = first[n] + degree[n]
    at = np.empty(first[nodes], np.int64)
    filled = first.copy()
    for e in range(count):
        for side in range(2):
            at[filled[edges[e, side]]] = 2 * e + side
            filled[edges[e, side]] += 1
    radius = _radius_at(edges, degree, median, first, at)
    # the nodes of a crossing as a ring: the next one of each
    crossing = np.arange(nodes)
    following = np.arange(nodes)
    within = np.zeros(count, np.bool_)
    goes_on = np.full((count, 2), -1, np.int64)
    for e in range(count):
        if radius[e] > 0 and edges[e, 0] != edges[e, 1] and lengths_px[e] < SHORT_RADII * radius[e]:
            _merge(crossing, following, edges[e, 0], edges[e, 1])
    _holes(edges, lengths_px, radius, crossing, within)
    price = np.zeros(nodes)
    for n in range(nodes):
        if crossing[n] == n and degree[n] >= 3:
            price[n] = _couple(mask, _ring(following, n), first, at, within, arms, goes_on)
    for e in np.argsort(lengths_px, kind="mergesort"):
        a = crossing[edges[e, 0]]
        b = crossing[edges[e, 1]]
        if a == b or radius[e] <= 0 or lengths_px[e] > LONG_RADII * radius[e]:
            continue
        if lengths_px[e] > NARROW_RADII * radius[e] and mean[e] < SHARED_WIDTH * radius[e]:
            continue
        both = np.concatenate((_ring(following, a), _ring(following, b)))
        tried = within.copy()
        tried[e] = True
        ways = goes_on.copy()
        total = _couple(mask, both, first, at, tried, arms, ways)
        if total < price[a] + price[b]:
            _merge(crossing, following, a, b)
            within[e] = True
            _holes(edges, lengths_px, radius, crossing, within)
            a = crossing[a]
            price[a] = _couple(mask, _ring(following, a), first, at, within, arms, goes_on)
    for e in range(count):
        if within[e]:
            goes_on[e] = -1
    return crossing, goes_on, within


@compiled
def _radius_at(edges: Ints, degree: Ints, median: Floats, first: Ints, at: Ints) -> Floats:
    """(M,) px, the widest other arm at the end of an edge where that is less; 0 where an end is no fork.

    The widest, because a thick strand between two thin ones that cross it is no bridge of theirs.
    """
    radius = np.zeros(len(edges))
    for e in range(len(edges)):
        a = edges[e, 0]
        b = edges[e, 1]
        if degree[a] < 3 or degree[b] < 3:
            continue
        least = np.inf
        for n in (a, b):
            widest = 0.0
            for k in range(first[n], first[n + 1]):
                if at[k] // 2 != e:
                    widest = max(widest, median[at[k] // 2])
            if widest > 0:
                least = min(least, widest)
        if least < np.inf:
            radius[e] = least
    return radius


@lean
def _merge(crossing: Ints, following: Ints, one: int, other: int) -> None:
    """Makes two crossings one."""
    a = min(crossing[one], crossing[other])
    b = max(crossing[one], crossing[other])
    if a == b:
        return
    n = b
    while True:
        crossing[n] = a
        n = following[n]
        if n == b:
            break
    following[a], following[b] = following[b], following[a]


@compiled
def _ring(following: Ints, first: int) -> Ints:
    """The nodes of a crossing."""
    size = 1
    n = following[first]
    while n != first:
        size += 1
        n = following[n]
    nodes = np.empty(size, np.int64)
    for k in range(size):
        nodes[k] = n
        n = following[n]
    return nodes


@lean
def _holes(edges: Ints, lengths_px: Floats, radius: Floats, crossing: Ints, within: Bools) -> None:
    """Marks short edges with both ends in one crossing."""
    for e in range(len(edges)):
        if radius[e] > 0 and crossing[edges[e, 0]] == crossing[edges[e, 1]]:
            within[e] = within[e] or lengths_px[e] < NARROW_RADII * radius[e]
