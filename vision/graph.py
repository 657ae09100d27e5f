"""Skeleton to graph: end points, junctions merged to one node, edges with their pixel paths.

Two skeleton pixels are linked when they touch by a side, or by a corner that no side link goes
around. With these links a staircase is a plain chain, and what is left over as a closed curve is a
real loop of the picture, except in full 2x2 blocks. Pixels with three or more links, and full
blocks, are junction pixels; linked ones become one node at their centroid. Contracting a set of
linked pixels changes nodes minus edges by its number of closed curves, so a hole inside such a set
stays in the graph as a loop: nodes minus edges is always pieces minus holes of the skeleton.
"""

from __future__ import annotations

import heapq

import numpy as np

from vision.jit import compiled
from vision.types import Bools, Floats, Graph, Ints, Skeleton, read_only

# Link k of a pixel goes to (row, column) offset: east, south-east, south, south-west, and back.
_DY = (0, 1, 1, 1, 0, -1, -1, -1)
_DX = (1, 1, 0, -1, -1, -1, 0, 1)


def trace(skeleton: Skeleton) -> Graph:
    """The graph of a skeleton.

    Every skeleton pixel lies on exactly one path, or is a junction pixel within its node.
    ``len(points) - len(edges)`` is the Euler number (8-connected pieces minus holes) of the
    skeleton. The picture's border is as good as any other place.

    Parameters
    ----------
    skeleton : (H, W) bool
        One pixel wide where possible; thick spots are taken as junctions.

    Returns
    -------
    Graph
        Coordinates in px, (u, v), pixel centres at whole numbers.

    Examples
    --------
    >>> t = trace(np.array([[1, 1, 1], [0, 1, 0], [0, 1, 0]], bool))
    >>> sorted(t.degree.tolist())
    [1, 1, 1, 3]
    """
    if skeleton.ndim != 2:
        raise ValueError(f"a skeleton has two dimensions, not {skeleton.ndim}")
    rows, columns = skeleton.shape
    framed = np.zeros((rows + 2, columns + 2), np.bool_)
    framed[1:-1, 1:-1] = skeleton
    flat = framed.reshape(-1)
    pixels = np.flatnonzero(flat)
    if len(pixels) == 0:
        return _graph(np.zeros((0, 2)), np.zeros((0, 2), np.int64), ())
    points, edges, starts, chain = _trace(flat, pixels, columns + 2)
    at = np.stack([chain % (columns + 2) - 1, chain // (columns + 2) - 1], axis=1).astype(np.float64)
    inner = np.split(at, starts[1:-1]) if len(edges) else []
    paths = [
        np.concatenate([points[a : a + 1], way, points[b : b + 1]])
        for (a, b), way in zip(edges.tolist(), inner, strict=True)
    ]
    return _without_bends(points, edges, paths)


def prune(graph: Graph, spur_px: float) -> Graph:
    """The graph without short free ends: useless nodes removed by the size of their segment.

    Repeatedly the shortest edge with a free end is removed while it is shorter than `spur_px`. A
    node that is left with two edges is dissolved, so that the path through it becomes one edge (and
    may be long enough to stay). Pieces that are altogether shorter, single pixels among them,
    disappear.

    Parameters
    ----------
    graph : Graph
        Not changed.
    spur_px : float
        Shortest free edge that stays, along its path.

    Returns
    -------
    Graph
        A new graph, nodes numbered anew in their old order.
    """
    net = _Net(graph.points, graph.edges, graph.paths)
    queue = [(net.length_px[e], e) for e in range(len(net.ends)) if net.is_free(e)]
    heapq.heapify(queue)
    while queue:
        length_px, edge = heapq.heappop(queue)
        if length_px >= spur_px:
            break
        if not net.is_free(edge):
            continue
        for node in net.remove(edge):
            joined = net.dissolve(node)
            if joined is not None and net.is_free(joined):
                heapq.heappush(queue, (net.length_px[joined], joined))
    if spur_px > 0:
        net.drop_bare_nodes()
    return net.graph()


def _without_bends(points: Floats, edges: Ints, paths: list[Floats]) -> Graph:
    """The graph after nodes that only two edges meet are dissolved (a thick spot of a line)."""
    net = _Net(points, edges, tuple(paths))
    for node in range(len(points)):
        net.dissolve(node)
    return net.graph()


def _graph(points: Floats, edges: Ints, paths: tuple[Floats, ...]) -> Graph:
    count = len(points)
    degree = np.bincount(edges.reshape(-1), minlength=count).astype(np.int64)
    steps = [np.diff(path, axis=0) for path in paths]
    lengths_px = np.array([float(np.hypot(s[:, 0], s[:, 1]).sum()) for s in steps], np.float64)
    return Graph(
        points=read_only(points),
        degree=read_only(degree),
        component=read_only(_components(count, edges)),
        edges=read_only(edges),
        lengths_px=read_only(lengths_px),
        paths=tuple(read_only(path) for path in paths),
    )


class _Net:
    """A graph while it is being changed: edges by number, removed ones marked, nodes keep theirs."""

    def __init__(self, points: Floats, edges: Ints, paths: tuple[Floats, ...]) -> None:
        self.points = points
        self.ends: list[tuple[int, int]] = [(int(a), int(b)) for a, b in edges]
        self.paths: list[Floats] = list(paths)
        self.length_px: list[float] = [_length_px(path) for path in paths]
        self.alive = [True] * len(self.ends)
        self.used = [True] * len(points)
        self.at: list[list[int]] = [[] for _ in range(len(points))]
        for number, (a, b) in enumerate(self.ends):
            self.at[a].append(number)
            self.at[b].append(number)

    def is_free(self, edge: int) -> bool:
        """True when the edge is there and ends in an end point at least once."""
        a, b = self.ends[edge]
        return self.alive[edge] and (len(self.at[a]) == 1 or len(self.at[b]) == 1)

    def remove(self, edge: int) -> list[int]:
        """Takes an edge out together with its end points; the nodes that stay are returned."""
        self.alive[edge] = False
        stay = []
        for node in self.ends[edge]:
            self.at[node].remove(edge)
            if self.at[node]:
                stay.append(node)
            else:
                self.used[node] = False
        return stay

    def dissolve(self, node: int) -> int | None:
        """Joins the two edges of a node of degree 2 into one; None when there is nothing to join."""
        if len(self.at[node]) != 2 or self.at[node][0] == self.at[node][1]:
            return None
        first, second = self.at[node]
        before = self.paths[first] if self.ends[first][1] == node else self.paths[first][::-1]
        after = self.paths[second] if self.ends[second][0] == node else self.paths[second][::-1]
        start = self.ends[first][0] if self.ends[first][1] == node else self.ends[first][1]
        end = self.ends[second][1] if self.ends[second][0] == node else self.ends[second][0]
        joined = len(self.ends)
        self.ends.append((start, end))
        self.paths.append(np.concatenate([before, after[1:]]))
        self.length_px.append(self.length_px[first] + self.length_px[second])
        self.alive.append(True)
        self.alive[first] = self.alive[second] = False
        self.used[node] = False
        self.at[node] = []
        self.at[start].remove(first)
        self.at[start].append(joined)
        self.at[end].remove(second)
        self.at[end].append(joined)
        return joined

    def drop_bare_nodes(self) -> None:
        """Nodes without an edge go."""
        self.used = [bool(edges) for edges in self.at]

    def graph(self) -> Graph:
        """What is left, as a record."""
        number = np.cumsum(self.used) - 1
        kept = [edge for edge, alive in enumerate(self.alive) if alive]
        edges = np.array([[number[n] for n in self.ends[edge]] for edge in kept], np.int64).reshape(-1, 2)
        points = self.points[np.array(self.used, np.bool_)].reshape(-1, 2)
        return _graph(points, edges, tuple(self.paths[edge].copy() for edge in kept))


def _length_px(path: Floats) -> float:
    steps = np.diff(path, axis=0)
    return float(np.hypot(steps[:, 0], steps[:, 1]).sum())


def _components(count: int, edges: Ints) -> Ints:
    """Number of the connected piece of each node, counted from 0 in the order of first nodes."""
    parent = list(range(count))

    def root(node: int) -> int:
        while parent[node] != node:
            parent[node] = parent[parent[node]]
            node = parent[node]
        return node

    for a, b in edges.tolist():
        ra, rb = root(a), root(b)
        parent[max(ra, rb)] = min(ra, rb)
    roots = np.array([root(node) for node in range(count)], np.int64)
    return np.unique(roots, return_inverse=True)[1].astype(np.int64)


@compiled
def _links(flat: Bools, pixel: int, width: int) -> int:
    """The links of a pixel as bits 0..7."""
    bits = 0
    for k in range(0, 8, 2):
        if flat[pixel + _DY[k] * width + _DX[k]]:
            bits |= 1 << k
    for k in range(1, 8, 2):
        around = (1 << (k - 1)) | (1 << ((k + 1) % 8))
        if flat[pixel + _DY[k] * width + _DX[k]] and not bits & around:
            bits |= 1 << k
    return bits


@compiled
def _root(parent: Ints, item: int) -> int:
    while parent[item] != item:
        parent[item] = parent[parent[item]]
        item = parent[item]
    return item


@compiled
def _trace(flat: Bools, pixels: Ints, width: int) -> tuple[Floats, Ints, Ints, Ints]:
    """Nodes and chains of a framed skeleton.

    Returns points (N, 2) px, edges (M, 2), starts (M + 1,) of each edge's run in the last array,
    and the chain pixels (flat indices) between the two nodes of each edge.
    """
    count = len(pixels)
    index = np.full(len(flat), -1, np.int64)
    links = np.zeros(count, np.int64)
    degree = np.zeros(count, np.int64)
    junction = np.zeros(count, np.bool_)
    in_block = np.zeros(count, np.bool_)
    offset = np.zeros(8, np.int64)
    for k in range(8):
        offset[k] = _DY[k] * width + _DX[k]
    for i in range(count):
        index[pixels[i]] = i
        links[i] = _links(flat, pixels[i], width)
        for k in range(8):
            degree[i] += (links[i] >> k) & 1
        junction[i] = degree[i] >= 3
    blocks = np.zeros(count, np.int64)
    for i in range(count):
        p = pixels[i]
        if flat[p + 1] and flat[p + width] and flat[p + width + 1]:
            blocks[i] = 1
            for q in (p, p + 1, p + width, p + width + 1):
                junction[index[q]] = True
                in_block[index[q]] = True

    # One node for linked junction pixels; links that close a curve are remembered.
    parent = np.arange(count)
    spare_a = np.zeros(4 * count, np.int64)
    spare_b = np.zeros(4 * count, np.int64)
    spare = 0
    for blocks_first in (True, False):
        for i in range(count):
            if not junction[i]:
                continue
            for k in range(4):
                if not (links[i] >> k) & 1:
                    continue
                j = index[pixels[i] + offset[k]]
                if not junction[j] or (in_block[i] and in_block[j]) != blocks_first:
                    continue
                a = _root(parent, i)
                b = _root(parent, j)
                if a == b:
                    spare_a[spare] = i
                    spare_b[spare] = j
                    spare += 1
                else:
                    parent[max(a, b)] = min(a, b)
    holes = np.zeros(count, np.int64)
    for s in range(spare):
        holes[_root(parent, spare_a[s])] += 1
    for i in range(count):
        holes[_root(parent, i)] -= blocks[i]

    # Numbers and places of the nodes: junctions, end points, single pixels.
    node = np.full(count, -1, np.int64)
    sums = np.zeros((count, 3))
    nodes = 0
    for i in range(count):
        if junction[i] or degree[i] < 2:
            r = _root(parent, i)
            if node[r] < 0:
                node[r] = nodes
                nodes += 1
            n = node[r]
            node[i] = n
            sums[n, 0] += pixels[i] % width - 1
            sums[n, 1] += pixels[i] // width - 1
            sums[n, 2] += 1

    chain = np.zeros(count + 2 * spare, np.int64)
    used = 0
    edges = np.zeros((4 * count + spare, 2), np.int64)
    starts = np.zeros(4 * count + spare + 1, np.int64)
    made = 0
    seen = np.zeros(count, np.bool_)
    for i in range(count):
        if node[i] < 0:
            continue
        for k in range(8):
            if not (links[i] >> k) & 1:
                continue
            j = index[pixels[i] + offset[k]]
            if node[j] >= 0:
                if j > i and node[i] != node[j]:
                    edges[made, 0] = node[i]
                    edges[made, 1] = node[j]
                    made += 1
                    starts[made] = used
                continue
            if seen[j]:
                continue
            before = i
            here = j
            while node[here] < 0:
                seen[here] = True
                chain[used] = pixels[here]
                used += 1
                following = -1
                for m in range(8):
                    if (links[here] >> m) & 1:
                        other = index[pixels[here] + offset[m]]
                        if other != before:
                            following = other
                before = here
                here = following
            edges[made, 0] = node[i]
            edges[made, 1] = node[here]
            made += 1
            starts[made] = used
    # A hole within one junction: the link that closes it becomes a loop.
    for back in range(spare):
        s = spare - 1 - back
        r = _root(parent, spare_a[s])
        if holes[r] > 0:
            holes[r] -= 1
            chain[used] = pixels[spare_a[s]]
            chain[used + 1] = pixels[spare_b[s]]
            used += 2
            edges[made, 0] = node[spare_a[s]]
            edges[made, 1] = node[spare_a[s]]
            made += 1
            starts[made] = used
    # Closed curves without a node get one.
    for i in range(count):
        if node[i] >= 0 or seen[i]:
            continue
        node[i] = nodes
        sums[nodes, 0] = pixels[i] % width - 1
        sums[nodes, 1] = pixels[i] // width - 1
        sums[nodes, 2] = 1
        nodes += 1
        before = i
        here = i
        for k in range(8):
            if (links[i] >> k) & 1:
                here = index[pixels[i] + offset[k]]
        while here != i:
            seen[here] = True
            chain[used] = pixels[here]
            used += 1
            following = -1
            for m in range(8):
                if (links[here] >> m) & 1:
                    other = index[pixels[here] + offset[m]]
                    if other != before:
                        following = other
            before = here
            here = following
        edges[made, 0] = node[i]
        edges[made, 1] = node[i]
        made += 1
        starts[made] = used
    points = sums[:nodes, :2] / sums[:nodes, 2:3]
    return points, edges[:made].copy(), starts[: made + 1].copy(), chain[:used].copy()
