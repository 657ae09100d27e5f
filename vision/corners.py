"""Corners as nodes: where an edge of a graph bends sharply, for parts whose own graph has corners.

A skeleton passes a corner without a junction, so the traced graph of an L is one bent edge between two ends.
"""

from __future__ import annotations

import numpy as np

from vision.types import Floats, Graph, read_only

LEAST_BEND_RAD = 0.6
"""Bends of crossing sticks and of rounded skeleton ends stay below this; hexagon keys bend by 1.5."""
LEAST_SAG_PX = 3.0
"""How far a path must leave its chord at a corner; skeletons of straight parts wander by one or two."""


def with_corners(graph: Graph, arm_px: float) -> Graph:
    """The graph with its edges cut where they bend, each corner a new node of degree 2.

    Corners are found as in the Ramer-Douglas-Peucker simplification: the path's point farthest from the chord
    between its ends, when the directions to both sides over ``arm_px`` differ enough there; then both halves
    again. New nodes come after the old ones, whose numbers stay.
    """
    points = [graph.points]
    component = [graph.component]
    edges: list[tuple[int, int]] = []
    paths: list[Floats] = []
    count = len(graph.points)
    for (a, b), path in zip(graph.edges.tolist(), graph.paths, strict=True):
        cuts = [] if a == b else _corners(path, 0, len(path) - 1, arm_px)
        nodes = [a, *range(count, count + len(cuts)), b]
        stops = [0, *cuts, len(path) - 1]
        points.append(path[cuts].reshape(-1, 2))
        component.append(np.full(len(cuts), graph.component[a], np.int64))
        count += len(cuts)
        for k in range(len(nodes) - 1):
            edges.append((nodes[k], nodes[k + 1]))
            paths.append(path[stops[k] : stops[k + 1] + 1].copy())
    pairs = np.array(edges, np.int64).reshape(-1, 2)
    lengths = [float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()) for path in paths]
    return Graph(
        points=read_only(np.concatenate(points)),
        degree=read_only(np.bincount(pairs.reshape(-1), minlength=count).astype(np.int64)),
        component=read_only(np.concatenate(component)),
        edges=read_only(pairs),
        lengths_px=read_only(np.array(lengths, np.float64)),
        paths=tuple(read_only(path) for path in paths),
    )


def _corners(path: Floats, first: int, last: int, arm_px: float) -> list[int]:
    """Indices of corners strictly between two indices of a path (K, 2), in order."""
    piece = path[first : last + 1]
    chord = piece[-1] - piece[0]
    length = float(np.linalg.norm(chord))
    if len(piece) < 3 or length == 0.0:
        return []
    off = piece - piece[0]
    sag = np.abs(chord[0] * off[:, 1] - chord[1] * off[:, 0]) / length
    at = first + int(np.argmax(sag))
    if sag.max() < LEAST_SAG_PX:
        return []
    before, after = _corners(path, first, at, arm_px), _corners(path, at, last, arm_px)
    here = [at] if _bend_rad(path, at, arm_px) >= LEAST_BEND_RAD else []
    return [*before, *here, *after]


def _bend_rad(path: Floats, at: int, arm_px: float) -> float:
    """Change of direction at a point of a path, over arms of about ``arm_px`` on each side."""
    reach = max(1, round(arm_px))
    back = path[at] - path[max(0, at - reach)]
    ahead = path[min(len(path) - 1, at + reach)] - path[at]
    cross = back[0] * ahead[1] - back[1] * ahead[0]
    return float(abs(np.arctan2(cross, back @ ahead)))
