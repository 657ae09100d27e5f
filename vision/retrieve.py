"""What fits the product, offered or refused with a reason and a number (section 3.3).

Straight parts are couples of points at the right distance. Parts with several segments are sets of nodes
whose numbers of neighbours, distances and angles are those of the model. Both work on points in space,
wherever these come from.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from vision import transforms
from vision.reconstruct import SpaceGraph
from vision.types import (
    Bools,
    Candidate,
    Floats,
    Ints,
    NodeKind,
    PartModel,
    Plane,
    Refusal,
    Refused,
    Segments3D,
    Topology,
    Tuning,
    read_only,
)

NEAR_MISS = 2.0
"""A couple whose length is out by less than this many tolerances is reported as refused."""
MAX_NEAR_MISSES = 20
MAX_FITTING = 2000
"""Nodes of a crowded picture fit a model in many ways; beyond this the search ends, best hubs first."""
OTHER_NEIGHBOURS_COST = 0.1
"""Score lost for each node with more neighbours than the model has there (another part touches it)."""


def retrieve_sticks(
    segments: Segments3D, part: PartModel, tuning: Tuning, table: Plane | None = None
) -> tuple[Candidate, ...]:
    """Straight parts among pieces in space, best first, the refused ones last.

    The length is the distance of the two ends in 3-D; with ``tuning.length_2d`` the distance parallel to the
    table (without a table: to the picture plane), so that a steep part comes out too short and is not
    offered. Pieces that miss the length by less than `NEAR_MISS` tolerances are kept as refused, the
    `MAX_NEAR_MISSES` nearest of them; all others are nobody's concern and are left out.

    To the measured length comes what thinning took from both ends (``part.thinning_end_m``).

    The score is 1 for a perfect fit, and falls with the squares of the length error and of the disagreement
    of the views, each losing a half at its gate.
    """
    ways = segments.end - segments.start
    lengths = np.linalg.norm(ways, axis=1)
    measured = np.linalg.norm(_flattened(ways, _up(table)), axis=1) if tuning.length_2d else lengths
    measured = measured + 2.0 * part.thinning_end_m
    error = np.abs(measured - part.length_m)
    usable = np.flatnonzero((error <= NEAR_MISS * part.length_tolerance_m) & (lengths > 0))
    found = []
    for index in usable.tolist():
        reasons = []
        if error[index] > part.length_tolerance_m:
            limit = part.length_m + float(
                np.copysign(part.length_tolerance_m, measured[index] - part.length_m)
            )
            reasons.append(
                Refused(reason=Refusal.LENGTH, value=float(measured[index]), limit=limit, unit="m")
            )
        ends = np.stack([segments.start[index], segments.end[index]])
        residual_px = float(segments.residual_px[index])
        score = fit_score(float(error[index]) / part.length_tolerance_m, residual_px / tuning.epipolar_px)
        found.append(_candidate(part, ends, (0, 1), score, residual_px, reasons, tuning, table))
    return ranked(found)


def retrieve_topology(
    graph: SpaceGraph,
    part: PartModel,
    tuning: Tuning,
    table: Plane | None = None,
    longest_detour: float = math.inf,
) -> tuple[Candidate, ...]:
    """Parts with several segments in a graph in space, best first, the refused ones last.

    A set of nodes of one object fits when each has at least the neighbours the model has there (a junction
    at least three), the way between neighbours is straight but for ``longest_detour`` (see `SpaceGraph`), and
    all distances between them are the model's within ``part.length_tolerance_m``; the distances from a node
    to its neighbours and between those fix the angles, so angles are compared too.
    Model nodes without an edge (the centre of a hole) are placed by laying the model over the others.
    A junction or corner belongs to one part only: a second reading of it is refused as a duplicate.

    Raises
    ------
    ValueError
        The part has no topology, or one without edges.
    """
    topology = part.topology
    if topology is None or len(topology.edges) == 0:
        raise ValueError(f"{part.name}: a topology with edges is needed")
    anchors = _anchors(topology)
    neighbours = np.bincount(topology.edges.reshape(-1), minlength=len(topology.points))[anchors]
    allowed = _allowed(graph, topology, anchors, neighbours)
    points = _flattened(graph.points, _up(table)) if tuning.length_2d else graph.points
    same = (graph.component[:, None] == graph.component[None, :]) & (
        graph.right_component[:, None] == graph.right_component[None, :]
    )
    apart = np.where(same, np.linalg.norm(points[:, None] - points[None, :], axis=2), np.inf)
    along = np.where(graph.detour <= longest_detour, apart, np.inf)
    wanted = np.linalg.norm(topology.points[anchors][:, None] - topology.points[anchors][None, :], axis=2)
    linked = _linked(topology, anchors)
    readings: dict[frozenset[int], tuple[float, Candidate, tuple[int, ...]]] = {}
    for count, nodes in enumerate(_fitting(allowed, apart, along, wanted, linked, part.length_tolerance_m)):
        if count == MAX_FITTING:
            break
        camera_from_part = transforms.align(topology.points[anchors], graph.points[list(nodes)])
        laid = transforms.apply(camera_from_part, topology.points)
        off_m = float(np.sqrt(((laid[anchors] - graph.points[list(nodes)]) ** 2).sum(axis=1).mean()))
        placed = laid.copy()
        placed[anchors] = graph.points[list(nodes)]
        residual_px = float(graph.residual_px[list(nodes)].max())
        more = int(np.count_nonzero(graph.degree[list(nodes)] > neighbours))
        score = fit_score(off_m / part.length_tolerance_m, residual_px / tuning.epipolar_px)
        score = max(0.0, score - OTHER_NEIGHBOURS_COST * more)
        key = frozenset(nodes)
        if key not in readings or score > readings[key][0]:
            candidate = _candidate(part, placed, topology.axis, score, residual_px, [], tuning, table)
            hubs = tuple(n for n, count_at in zip(nodes, neighbours, strict=True) if count_at > 1)
            readings[key] = (score, candidate, hubs)
    taken: set[int] = set()
    found = []
    for _, candidate, hubs in sorted(readings.values(), key=lambda reading: -reading[0]):
        shared = taken.intersection(hubs)
        if shared:
            again = Refused(reason=Refusal.DUPLICATE, value=float(len(shared)), limit=0.0, unit="1")
            candidate = replace(candidate, refusals=(*candidate.refusals, again))
        elif candidate.offered:
            taken.update(hubs)
        found.append(candidate)
    return ranked(found)


def fit_score(size_share: float, residual_share: float) -> float:
    """0..1 from the size error and the disagreement of the views, each as a share of its gate."""
    return float(np.clip(1.0 - 0.5 * size_share**2 - 0.5 * residual_share**2, 0.0, 1.0))


def tilt_rad(axis: Floats, table: Plane | None) -> float:
    """Angle 0..pi/2 between a direction (3,) and the table, or the picture plane without a table."""
    rise = abs(float(axis @ _up(table))) / float(np.linalg.norm(axis))
    return float(np.arcsin(min(1.0, rise)))


def ranked(candidates: list[Candidate]) -> tuple[Candidate, ...]:
    """Offered ones by score, then refused ones by score; of the refused the best `MAX_NEAR_MISSES`."""
    offered = sorted((c for c in candidates if c.offered), key=lambda c: -c.score)
    refused = sorted((c for c in candidates if not c.offered), key=lambda c: -c.score)
    return (*offered, *refused[:MAX_NEAR_MISSES])


def _candidate(
    part: PartModel,
    nodes: Floats,
    axis_nodes: tuple[int, int],
    score: float,
    residual_px: float,
    reasons: list[Refused],
    tuning: Tuning,
    table: Plane | None,
) -> Candidate:
    start, end = nodes[axis_nodes[0]].copy(), nodes[axis_nodes[1]].copy()
    length = float(np.linalg.norm(end - start))
    axis = (end - start) / length
    refusals = list(reasons)
    tilt = tilt_rad(axis, table)
    if tilt > tuning.max_tilt_rad:
        refusals.append(Refused(reason=Refusal.TILT, value=tilt, limit=tuning.max_tilt_rad, unit="rad"))
    depth = nodes[:, 2]
    if tuning.depth_m is not None:
        near, far = tuning.depth_m
        if depth.min() < near:
            refusals.append(Refused(reason=Refusal.DEPTH, value=float(depth.min()), limit=near, unit="m"))
        if depth.max() > far:
            refusals.append(Refused(reason=Refusal.DEPTH, value=float(depth.max()), limit=far, unit="m"))
    if score < tuning.min_score:
        refusals.append(Refused(reason=Refusal.LOW_SCORE, value=score, limit=tuning.min_score, unit="1"))
    return Candidate(
        part_code=part.code,
        start=read_only(start),
        end=read_only(end),
        centre=read_only(0.5 * (start + end)),
        axis=read_only(axis),
        length_m=length,
        nodes=read_only(nodes.copy()),
        score=score,
        residual_px=residual_px,
        refusals=tuple(refusals),
    )


def _up(table: Plane | None) -> Floats:
    return np.array([0.0, 0.0, -1.0]) if table is None else np.asarray(table.normal, np.float64)


def _flattened(vectors: Floats, up: Floats) -> Floats:
    """Vectors (N, 3) without their part along ``up``."""
    return np.asarray(vectors - (vectors @ up)[:, None] * up, np.float64)


def _anchors(topology: Topology) -> Ints:
    """Model nodes with an edge, the one with most neighbours first, each next one beside an earlier one."""
    links: dict[int, set[int]] = {}
    for a, b in topology.edges.tolist():
        links.setdefault(a, set()).add(b)
        links.setdefault(b, set()).add(a)
    order: list[int] = []
    while len(order) < len(links):
        waiting = [n for n in links if n not in order]
        beside = [n for n in waiting if links[n].intersection(order)] or waiting
        order.append(max(beside, key=lambda n: (len(links[n]), -n)))
    return np.array(order, np.int64)


def _allowed(graph: SpaceGraph, topology: Topology, anchors: Ints, neighbours: Ints) -> Bools:
    """(K, N): may graph node n be model anchor k, by its number of neighbours."""
    at_least = neighbours.copy()
    for k, anchor in enumerate(anchors.tolist()):
        if topology.kinds[anchor] is NodeKind.JUNCTION:
            at_least[k] = max(3, at_least[k])
    return np.asarray(graph.degree[None, :] >= at_least[:, None], np.bool_)


def _linked(topology: Topology, anchors: Ints) -> Bools:
    """(K, K): does an edge of the model join the two anchors."""
    place = {anchor: k for k, anchor in enumerate(anchors.tolist())}
    linked = np.zeros((len(anchors), len(anchors)), np.bool_)
    for a, b in topology.edges.tolist():
        linked[place[a], place[b]] = linked[place[b], place[a]] = True
    return linked


def _fitting(
    allowed: Bools, apart: Floats, along: Floats, wanted: Floats, linked: Bools, tolerance_m: float
) -> Iterator[tuple[int, ...]]:
    """Every choice of one node per anchor with the wanted distances, depth first.

    ``apart`` (N, N) distances of nodes; ``along`` the same, infinite where the way is not straight, for
    anchors that the model links; ``wanted`` (K, K) distances of anchors.
    """
    anchors = len(wanted)

    def grow(chosen: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
        k = len(chosen)
        if k == anchors:
            yield chosen
            return
        fits = allowed[k].copy()
        for earlier, node in enumerate(chosen):
            distances = along[node] if linked[earlier, k] else apart[node]
            fits &= np.abs(distances - wanted[earlier, k]) <= tolerance_m
            fits[node] = False
        for node in np.flatnonzero(fits).tolist():
            yield from grow((*chosen, node))

    yield from grow(())
