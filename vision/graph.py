"""Skeleton to graph: end points, junctions merged to one node, edges with their pixel paths.

Two skeleton pixels are linked when they touch by a side, or by a corner that no side link goes
around. With these links a staircase is a plain chain, and what is left over as a closed curve is a
real loop of the picture, except in full 2x2 blocks. Pixels with three or more links, and full
blocks, are junction pixels; linked ones become one node at their centroid. Contracting a set of
linked pixels changes nodes minus edges by its number of closed curves, so a hole inside such a set
stays in the graph as a loop: nodes minus edges is always pieces minus holes of the skeleton.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vision.jit import compiled, lean
from vision.net import Columns, radii_px, root, simplify
from vision.types import Bools, Floats, Graph, Ints, Mask, Paths, Skeleton, read_only

SPUR_RADII = 1.5
"""A branch to a corner of the outline is 1.4 radii long at most."""

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
    width = -(-(columns + 2) // 8) * 8  # whole words of eight pixels, looked through a word at a time
    framed = np.zeros((rows + 2, width), np.bool_)
    framed[1:-1, 1 : columns + 1] = skeleton
    flat = framed.reshape(-1)
    pixels = _where(flat, flat.view(np.uint64))
    points, edges, path_pixels, starts = _trace(flat, pixels, width)
    return _graph(simplify(points, edges, path_pixels, starts, False, np.zeros(0)))


def prune(graph: Graph, spur_px: float, mask: Mask | None = None, spur_radii: float = SPUR_RADII) -> Graph:
    """The graph without short free ends: useless nodes removed by the size of their segment.

    Repeatedly the shortest edge with a free end is removed while it is a spur: shorter than `spur_px`
    or, where a mask is given, than the local width asks for. A node that is left with two edges is
    dissolved, so that the path through it becomes one edge (and may be long enough to stay). Pieces
    that are altogether shorter than `spur_px`, single pixels among them, disappear.

    A bump of the outline makes a branch that ends in the bump, so it is about as long as the
    foreground is wide from the junction to the outline, however wide that is. With a mask `spur_px`
    may therefore be small, and short stubs of thin parts stay.

    Parameters
    ----------
    graph : Graph
        Not changed.
    spur_px : float
        Shortest free edge that stays, along its path.
    mask : (H, W) bool
        What the graph is the skeleton of. None: one length for all.
    spur_radii : float
        Shortest free edge that stays, in distances from its junction to the nearest background.

    Returns
    -------
    Graph
        A new graph, nodes numbered anew in their old order.
    """
    if spur_px <= 0 and mask is None:
        return graph
    limits = np.full(len(graph.points) + 1, float(spur_px))
    if mask is not None:
        radii = radii_px(np.ascontiguousarray(mask), graph.points)
        limits[:-1] = np.maximum(limits[:-1], spur_radii * radii)
    flat = graph.flat_paths
    return _graph(simplify(graph.points, graph.edges, flat.pixels, flat.starts, True, limits))


def _graph(columns: Columns) -> Graph:
    points, edges, pixels, starts, lengths_px, degree, component = columns
    return Graph(
        points=read_only(points),
        degree=read_only(degree),
        component=read_only(component),
        edges=read_only(edges),
        lengths_px=read_only(lengths_px),
        paths=Paths(read_only(pixels), read_only(starts)),
    )


@compiled
def _where(flat: Bools, words: npt.NDArray[np.uint64]) -> Ints:
    """Flat indices of the pixels that are set; `words` is the same memory, eight pixels each."""
    count = 0
    for w in range(len(words)):
        if words[w] != 0:
            for k in range(8 * w, 8 * w + 8):
                count += flat[k]
    found = np.empty(count, np.int64)
    count = 0
    for w in range(len(words)):
        if words[w] != 0:
            for k in range(8 * w, 8 * w + 8):
                if flat[k]:
                    found[count] = k
                    count += 1
    return found


@lean
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
def _trace(flat: Bools, pixels: Ints, width: int) -> tuple[Floats, Ints, Floats, Ints]:
    """Nodes and edges of a framed skeleton.

    Returns points (N, 2) px, edges (M, 2), and the paths from node to node, (K, 2) px, one after the
    other from starts (M + 1,).
    """
    count = len(pixels)
    index = np.empty(len(flat), np.int32)  # read only where the skeleton is
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
                a = root(parent, i)
                b = root(parent, j)
                if a == b:
                    spare_a[spare] = i
                    spare_b[spare] = j
                    spare += 1
                else:
                    parent[max(a, b)] = min(a, b)
    holes = np.zeros(count, np.int64)
    for s in range(spare):
        holes[root(parent, spare_a[s])] += 1
    for i in range(count):
        holes[root(parent, i)] -= blocks[i]

    # Numbers and places of the nodes: junctions, end points, single pixels.
    node = np.full(count, -1, np.int64)
    sums = np.zeros((count, 3))
    nodes = 0
    for i in range(count):
        if junction[i] or degree[i] < 2:
            r = root(parent, i)
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
        r = root(parent, spare_a[s])
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
    paths = np.empty((used + 2 * made, 2))
    filled = 0
    ways = np.zeros(made + 1, np.int64)
    for e in range(made):
        paths[filled] = points[edges[e, 0]]
        filled += 1
        for k in range(starts[e], starts[e + 1]):
            paths[filled, 0] = chain[k] % width - 1
            paths[filled, 1] = chain[k] // width - 1
            filled += 1
        paths[filled] = points[edges[e, 1]]
        filled += 1
        ways[e + 1] = filled
    return points, edges[:made].copy(), paths, ways
