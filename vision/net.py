"""A graph while it is being changed: edges go, nodes that only two edges meet are dissolved.

Everything is in columns and compiled. An edge that was joined from two others remembers both and which
way round they lie; its path is put together only at the end, by walking down to the edges it began from.
"""

from __future__ import annotations

import heapq
from typing import TypeAlias

import numpy as np

from vision.jit import compiled, lean
from vision.types import Bools, Floats, Ints, Mask

Columns: TypeAlias = tuple[Floats, Ints, Floats, Ints, Floats, Ints, Ints]
"""points (N, 2), edges (M, 2), pixels (K, 2), starts (M + 1,), lengths_px (M,), degree, component (N,)."""


@compiled
def simplify(
    points: Floats, edges: Ints, pixels: Floats, starts: Ints, spurs: bool, limits: Floats
) -> Columns:
    """The graph without bends, or without spurs and the bends they leave.

    Parameters
    ----------
    points, edges, pixels, starts
        The graph's columns; not changed.
    spurs : bool
        False: every node that two edges meet is dissolved. True: repeatedly the shortest edge with a
        free end goes, while it is shorter than the limit of the node it hangs on; then nodes left with
        two edges are dissolved, and nodes without an edge go.
    limits : (N + 1,) float
        px, for each node the length below which an edge that hangs on it is a spur; the last one is
        for edges that hang on nothing. Not read without `spurs`.
    """
    nodes = len(points)
    made = len(edges)
    most = made + nodes  # each joint uses up a node
    ends = np.empty((most, 2), np.int64)
    ends[:made] = edges
    parts = np.full((most, 2), -1, np.int64)
    turned = np.zeros((most, 2), np.bool_)
    length = np.zeros(most)
    alive = np.zeros(most, np.bool_)
    degree = np.zeros(nodes, np.int64)
    for e in range(made):
        alive[e] = True
        length[e] = _length(pixels, starts[e], starts[e + 1])
        degree[edges[e, 0]] += 1
        degree[edges[e, 1]] += 1
    slots = np.zeros(nodes + 1, np.int64)
    for n in range(nodes):
        slots[n + 1] = slots[n] + degree[n]
    at = np.empty(2 * made, np.int64)
    filled = slots.copy()
    for e in range(made):
        for side in range(2):
            n = edges[e, side]
            at[filled[n]] = e
            filled[n] += 1
    used = np.ones(nodes, np.bool_)
    if spurs:
        queue = [(0.0, 0) for _ in range(0)]
        for e in range(made):
            if degree[edges[e, 0]] == 1 or degree[edges[e, 1]] == 1:
                heapq.heappush(queue, (length[e], e))
        while len(queue) > 0:
            size, e = heapq.heappop(queue)
            if not alive[e]:
                continue
            a = ends[e, 0]
            b = ends[e, 1]
            hangs_on = nodes
            if degree[a] > 1:
                hangs_on = a
            elif degree[b] > 1:
                hangs_on = b
            if size >= limits[hangs_on]:
                continue
            alive[e] = False
            for n in (a, b):
                _take_out(at, slots, degree, n, e)
            if hangs_on < nodes and degree[hangs_on] == 2:
                joined = _dissolve(
                    hangs_on, made, ends, parts, turned, length, alive, at, slots, degree, used
                )
                if joined >= 0:
                    made = joined + 1
                    if degree[ends[joined, 0]] == 1 or degree[ends[joined, 1]] == 1:
                        heapq.heappush(queue, (length[joined], joined))
        for n in range(nodes):
            used[n] = degree[n] > 0
    else:
        for n in range(nodes):
            if degree[n] == 2:
                joined = _dissolve(n, made, ends, parts, turned, length, alive, at, slots, degree, used)
                if joined >= 0:
                    made = joined + 1
    return _collect(points, pixels, starts, made, ends, parts, turned, alive, used, degree)


@lean
def _length(pixels: Floats, start: int, stop: int) -> float:
    total = 0.0
    for k in range(start + 1, stop):
        total += np.hypot(pixels[k, 0] - pixels[k - 1, 0], pixels[k, 1] - pixels[k - 1, 1])
    return total


@lean
def _take_out(at: Ints, slots: Ints, degree: Ints, node: int, edge: int) -> None:
    """One end of an edge leaves a node's list, whose order stays."""
    stop = slots[node] + degree[node]
    k = slots[node]
    while at[k] != edge:
        k += 1
    for later in range(k + 1, stop):
        at[later - 1] = at[later]
    degree[node] -= 1


@lean
def _dissolve(
    node: int,
    joined: int,
    ends: Ints,
    parts: Ints,
    turned: Bools,
    length: Floats,
    alive: Bools,
    at: Ints,
    slots: Ints,
    degree: Ints,
    used: Bools,
) -> int:
    """Joins the two edges of a node into edge number `joined`; -1 when it is one edge that comes back."""
    first = at[slots[node]]
    second = at[slots[node] + 1]
    if first == second:
        return -1
    turned[joined, 0] = ends[first, 1] != node
    turned[joined, 1] = ends[second, 0] != node
    ends[joined, 0] = ends[first, 1] if turned[joined, 0] else ends[first, 0]
    ends[joined, 1] = ends[second, 0] if turned[joined, 1] else ends[second, 1]
    parts[joined, 0] = first
    parts[joined, 1] = second
    length[joined] = length[first] + length[second]
    alive[joined] = True
    alive[first] = False
    alive[second] = False
    used[node] = False
    degree[node] = 0
    for side, old in ((0, first), (1, second)):
        n = ends[joined, side]
        _take_out(at, slots, degree, n, old)
        at[slots[n] + degree[n]] = joined
        degree[n] += 1
    return joined


@compiled
def _collect(
    points: Floats,
    pixels: Floats,
    starts: Ints,
    made: int,
    ends: Ints,
    parts: Ints,
    turned: Bools,
    alive: Bools,
    used: Bools,
    degree: Ints,
) -> Columns:
    """What is left, numbered anew in the old order."""
    number = np.cumsum(used) - 1
    nodes = number[-1] + 1 if len(used) else 0
    edges = 0
    for e in range(made):
        if alive[e]:
            edges += 1
    new_edges = np.empty((edges, 2), np.int64)
    new_starts = np.zeros(edges + 1, np.int64)
    lengths = np.empty(edges)
    new_pixels = np.empty((len(pixels), 2))
    stack = np.empty((len(ends) + 1, 2), np.int64)
    filled = 0
    at = 0
    for e in range(made):
        if not alive[e]:
            continue
        new_edges[at, 0] = number[ends[e, 0]]
        new_edges[at, 1] = number[ends[e, 1]]
        stack[0, 0] = e
        stack[0, 1] = 0
        waiting = 1
        begin = filled
        while waiting > 0:
            waiting -= 1
            here = stack[waiting, 0]
            backwards = stack[waiting, 1]
            if parts[here, 0] < 0:
                size = starts[here + 1] - starts[here]
                # the node between two parts is there once
                for k in range(1 if filled > begin else 0, size):
                    p = starts[here + 1] - 1 - k if backwards else starts[here] + k
                    new_pixels[filled, 0] = pixels[p, 0]
                    new_pixels[filled, 1] = pixels[p, 1]
                    filled += 1
                continue
            for side in (0, 1):
                last = (1 - side) if not backwards else side
                stack[waiting, 0] = parts[here, last]
                stack[waiting, 1] = int(turned[here, last]) ^ backwards
                waiting += 1
        at += 1
        new_starts[at] = filled
        lengths[at - 1] = _length(new_pixels, begin, filled)
    new_points = np.empty((nodes, 2))
    new_degree = np.empty(nodes, np.int64)
    for n in range(len(used)):
        if used[n]:
            new_points[number[n]] = points[n]
            new_degree[number[n]] = degree[n]
    component = _components(nodes, new_edges)
    return new_points, new_edges, new_pixels[:filled].copy(), new_starts, lengths, new_degree, component


@lean
def root(parent: Ints, item: int) -> int:
    """The first item of the set `item` is in; ways there become shorter."""
    while parent[item] != item:
        parent[item] = parent[parent[item]]
        item = parent[item]
    return item


@compiled
def _components(count: int, edges: Ints) -> Ints:
    """Number of the connected piece of each node, counted from 0 in the order of first nodes."""
    parent = np.arange(count)
    for e in range(len(edges)):
        a = root(parent, edges[e, 0])
        b = root(parent, edges[e, 1])
        parent[max(a, b)] = min(a, b)
    number = np.empty(count, np.int64)
    pieces = 0
    for n in range(count):
        r = root(parent, n)
        if r == n:
            number[n] = pieces
            pieces += 1
        else:
            number[n] = number[r]
    return number


@lean
def radius_px(mask: Mask, u: float, v: float) -> float:
    """Distance from a place to the nearest background pixel, 0 on background.

    What lies outside the picture is not background: a part that leaves the picture is not narrow there.
    A picture without background gives its larger side.
    """
    rows, columns = mask.shape
    x = min(max(int(np.rint(u)), 0), columns - 1)
    y = min(max(int(np.rint(v)), 0), rows - 1)
    if not mask[y, x]:
        return 0.0
    most = max(rows, columns)
    best = float(most * most)
    for ring in range(1, most):
        if ring * ring >= best:
            break
        for k in range(-ring, ring + 1):
            square = float(ring * ring + k * k)
            if square >= best:
                continue
            for side in range(4):
                if side == 0:
                    dx, dy = k, -ring
                elif side == 1:
                    dx, dy = k, ring
                elif side == 2:
                    dx, dy = -ring, k
                else:
                    dx, dy = ring, k
                if 0 <= x + dx < columns and 0 <= y + dy < rows and not mask[y + dy, x + dx]:
                    best = square
    return float(np.sqrt(best))


@compiled
def radii_px(mask: Mask, places: Floats) -> Floats:
    """`radius_px` at each of (N, 2) places."""
    found = np.empty(len(places))
    for n in range(len(places)):
        found[n] = radius_px(mask, places[n, 0], places[n, 1])
    return found
