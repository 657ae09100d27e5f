"""Holes as nodes: the centre of every small loop of a graph, for parts whose own graph has holes.

A skeleton runs around a hole. The ring's junctions say where the part meets the ring, not where the hole is,
and a ring at the very end of a part leaves no end point at all.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from vision.types import Bools, Floats, Graph, read_only


def with_loop_centres(graph: Graph, longest_px: float) -> Graph:
    """The graph with a node in the middle of each loop, joined to the loop's nodes by straight edges.

    A loop is a piece that no single edge would cut off, of at most ``longest_px`` along its edges; longer
    ones are heaps of parts and stay as they are. New nodes and edges come after the old ones, whose numbers
    stay.
    """
    ring = ~_bridges(graph)
    if not ring.any():
        return graph
    count = len(graph.points)
    piece = _pieces(count, graph, ring)
    points, component = [graph.points], [graph.component]
    edges, paths = [graph.edges], list(graph.paths)
    for number in np.unique(piece[graph.edges[ring, 0]]).tolist():
        of_ring = np.flatnonzero(ring & (piece[graph.edges[:, 0]] == number))
        if graph.lengths_px[of_ring].sum() > longest_px:
            continue
        centre = np.concatenate([graph.paths[edge] for edge in of_ring.tolist()]).mean(axis=0)
        nodes = np.unique(graph.edges[of_ring])
        new = count + len(points) - 1
        points.append(centre[None, :])
        component.append(graph.component[nodes[:1]])
        edges.append(np.column_stack([np.full(len(nodes), new, np.int64), nodes]))
        paths += [_straight(centre, graph.points[node]) for node in nodes.tolist()]
    pairs = np.concatenate(edges).astype(np.int64)
    places = np.concatenate(points)
    lengths = [float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()) for path in paths]
    return Graph(
        points=read_only(places),
        degree=read_only(np.bincount(pairs.reshape(-1), minlength=len(places)).astype(np.int64)),
        component=read_only(np.concatenate(component)),
        edges=read_only(pairs),
        lengths_px=read_only(np.array(lengths, np.float64)),
        paths=tuple(read_only(path) for path in paths),
    )


def _bridges(graph: Graph) -> Bools:
    """(M,): would the two ends of an edge be apart without it."""
    bridge = np.zeros(len(graph.edges), np.bool_)
    for edge, (a, b) in enumerate(graph.edges.tolist()):
        others = np.ones(len(graph.edges), np.bool_)
        others[edge] = False
        piece = _pieces(len(graph.points), graph, others)
        bridge[edge] = piece[a] != piece[b]
    return bridge


def _pieces(count: int, graph: Graph, used: Bools) -> Floats:
    """(N,) number of the connected piece of each node when only some edges count."""
    ends = graph.edges[used]
    table = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    return np.asarray(connected_components(table, directed=False)[1])


def _straight(start: Floats, end: Floats) -> Floats:
    steps = max(2, round(float(np.linalg.norm(end - start))) + 1)
    return np.linspace(start, end, steps)
