"""Matched nodes to points in space: the left graph with coordinates in metres (section 3.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from vision.stereo import Rectification, triangulate
from vision.types import Floats, Graph, Ints, Matches, Segments3D, read_only

STEP_PX = 8
"""Paths are measured in steps of so many points: pixel by pixel a staircase is up to 1.4 times too long."""
JOG_PX = 3.0
"""A straight part's way swerves by about this much where it is crossed, as the crossing's skeleton does."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SpaceGraph:
    """A graph in space: the nodes that both pictures show.

    ``points`` (N, 3) m, raw left camera frame; ``node`` (N,) node number in the left picture's graph;
    ``degree`` (N,) and ``component`` (N,) as there, ``right_component`` (N,) as in the right picture;
    ``edges`` (M, 2) rows of ``points``; ``left_edge`` (M,) edge number in the left picture's graph;
    ``residual_px`` (N,) row difference of the two views. ``detour`` (N, N): by what share the shortest way
    along edges is longer than the straight line, beyond `JOG_PX`, in the picture where it is more; infinite
    where no way is.
    """

    points: Floats
    node: Ints
    degree: Ints
    component: Ints
    right_component: Ints
    edges: Ints
    left_edge: Ints
    residual_px: Floats
    detour: Floats


def space_graph(left: Graph, right: Graph, matches: Matches, rect: Rectification) -> SpaceGraph:
    """The left graph in space, as far as its nodes are matched.

    Graph points are rectified pixels. Nodes that would lie behind the cameras are left out.
    """
    left_px, right_px = left.points[matches.left], right.points[matches.right]
    points = triangulate(left_px, right_px, rect)
    seen = np.isfinite(points).all(axis=1)
    node = matches.left[seen]
    row = np.full(len(left.points), -1, np.int64)
    row[node] = np.arange(len(node))
    ends = row[left.edges].reshape(-1, 2)
    both = np.flatnonzero((ends >= 0).all(axis=1))
    return SpaceGraph(
        points=read_only(points[seen]),
        node=read_only(node),
        degree=read_only(left.degree[node]),
        component=read_only(left.component[node]),
        right_component=read_only(right.component[matches.right[seen]]),
        edges=read_only(ends[both]),
        left_edge=read_only(both.astype(np.int64)),
        residual_px=read_only(np.abs(left_px[:, 1] - right_px[:, 1])[seen]),
        detour=read_only(np.maximum(_detour(left, node), _detour(right, matches.right[seen]))),
    )


def edge_segments(graph: SpaceGraph) -> Segments3D:
    """Every edge with both ends in space, as a straight piece; loops are left out."""
    proper = graph.edges[:, 0] != graph.edges[:, 1]
    ends = graph.edges[proper]
    return Segments3D(
        start=read_only(graph.points[ends[:, 0]]),
        end=read_only(graph.points[ends[:, 1]]),
        edge=read_only(graph.left_edge[proper]),
        residual_px=read_only(graph.residual_px[ends].max(axis=1, initial=0.0)),
    )


def couples(graph: SpaceGraph, longest_detour: float) -> tuple[Segments3D, Ints]:
    """Every couple of linked nodes that belong to one object in both pictures (section 3.3).

    Linked means: a way along edges joins them. The couple need not be an edge, because a part that others
    cross is cut into several. With an infinite ``longest_detour`` every two nodes of an object are a couple;
    with a small one only those whose way is about straight, in both pictures.

    Returns
    -------
    Segments3D
        One piece a couple; ``edge`` is -1 where no edge joins its nodes directly.
    (S, 2) int
        Rows of ``graph.points`` of the couple's two nodes.
    """
    count = len(graph.points)
    first, second = np.triu_indices(count, k=1)
    linked = graph.detour[first, second] <= longest_detour
    linked &= graph.component[first] == graph.component[second]
    linked &= graph.right_component[first] == graph.right_component[second]
    rows = np.column_stack([first[linked], second[linked]]).astype(np.int64)
    direct = np.full((count, count), -1, np.int64)
    for (a, b), edge in zip(graph.edges.tolist(), graph.left_edge.tolist(), strict=True):
        direct[a, b] = direct[b, a] = edge
    segments = Segments3D(
        start=read_only(graph.points[rows[:, 0]]),
        end=read_only(graph.points[rows[:, 1]]),
        edge=read_only(direct[rows[:, 0], rows[:, 1]]),
        residual_px=read_only(graph.residual_px[rows].max(axis=1, initial=0.0)),
    )
    return segments, rows


def _detour(graph: Graph, nodes: Ints) -> Floats:
    """(K, K) share by which ways between nodes are longer than straight lines, in one picture."""
    count = len(graph.points)
    if len(nodes) == 0:
        return np.zeros((0, 0))
    shortest: dict[tuple[int, int], float] = {}
    for (a, b), path in zip(graph.edges.tolist(), graph.paths, strict=True):
        pair = (min(a, b), max(a, b))
        shortest[pair] = min(shortest.get(pair, np.inf), _way_px(path))
    links = np.array(list(shortest), np.int64).reshape(-1, 2)
    table = csr_array((np.array(list(shortest.values())), (links[:, 0], links[:, 1])), shape=(count, count))
    way = dijkstra(table, directed=False, indices=nodes)[:, nodes]
    points = graph.points[nodes]
    straight = np.linalg.norm(points[:, None] - points[None, :], axis=2)
    apart = straight > 0
    share = np.where(np.isfinite(way), 0.0, np.inf)
    share[apart] = (way[apart] - JOG_PX) / straight[apart] - 1.0
    return np.asarray(share, np.float64)


def _way_px(path: Floats) -> float:
    """Length of a path (K, 2) measured in steps of `STEP_PX` points, never zero."""
    stops = path[np.append(np.arange(0, len(path) - 1, STEP_PX), len(path) - 1)]
    return max(float(np.linalg.norm(np.diff(stops, axis=0), axis=1).sum()), 1e-6)
