"""The default method from two grey pictures to candidates: its stages in order.

Adaptive foreground, Guo-Hall thinning, the graph without its short branches, straight pieces measured
on both flanks and joined through crossings into whole parts, matched as wholes on calibrated epipolar
geometry, completed with the known length, and offered or refused.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from vision import binarize, graph, match_paper, reconstruct, retrieve, thin
from vision.foreground import stands_out
from vision.lines import straight_pieces
from vision.look import Look
from vision.match import match
from vision.offer import candidates
from vision.published import LONGEST_TOPOLOGY_DETOUR, Observer, depth_gate_m, nodes_of_part, require_pictures
from vision.reconstruct_lines import Level, level_of_depths, level_of_table
from vision.shapes import locate_shapes
from vision.stereo import Rectification, Side, rectification, rectify_points
from vision.strands import Strands, find_strands
from vision.types import (
    CameraModel,
    Candidate,
    Graph,
    Grey,
    Matches,
    PartModel,
    Plane,
    Scene,
    Segments3D,
    StereoModel,
    Transform,
    Tuning,
    View,
    read_only,
)

CORNER_WIDTHS = 0.25
TRIM_WIDTHS = 0.6
PIECE_WIDTHS = 1.0
"""Chord deviation of a corner, what is cut off at junctions, and the shortest piece, in part widths."""
GROW_LENGTHS = 0.6
LONGEST_LENGTHS = 1.1
"""How far a part is followed beyond its pieces, and up to which length, in part lengths: a tenth more
than at the table because parts may lie nearer."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Scale:
    """How large the part is in the picture."""

    width_px: float
    length_px: float


def locate_default(
    left_grey: Grey,
    right_grey: Grey,
    stereo_model: StereoModel,
    part: PartModel,
    tuning: Tuning,
    table: Plane | None = None,
    observe: Observer | None = None,
) -> Scene:
    """Find parts in a calibrated stereo pair with the project's own method.

    Straight parts go through whole-strand matching. Parts with a topology go, for now, through the
    published matching and retrieval, on graphs of this method's own foreground and thinning with
    points that are rectified one by one.

    Parameters
    ----------
    left_grey, right_grey : (H, W) uint8
        Raw pictures of the two calibrated cameras.
    stereo_model, part, tuning, table
        See their records. Without ``tuning.depth_m`` a table is needed. ``tuning.band`` replaces the
        adaptive foreground.
    observe
        Called with ``binarize``, ``thin``, ``graph``, ``strands`` (pairs left, right), ``match``,
        ``reconstruct`` and ``retrieve``.

    Returns
    -------
    Scene
        Views are in raw pixels; candidates and segments in the raw left camera frame.

    Raises
    ------
    ValueError
        Pictures of a wrong type or size, or neither a depth range nor a table.
    """
    require_pictures(left_grey, right_grey, stereo_model)
    tell = observe or _nobody
    rect = rectification(stereo_model)
    depth_m = depth_gate_m(stereo_model, tuning, table)
    scale = _scale(part, rect, depth_m, table, tuning)
    greys = (left_grey, right_grey)
    found = [stands_out(grey, scale.width_px) for grey in greys]
    masks = [
        one.mask if tuning.band is None else binarize.in_band(grey, tuning.band)
        for grey, one in zip(greys, found, strict=True)
    ]
    tell("binarize", tuple(masks))
    skeletons = [thin.guo_hall(mask) for mask in masks]
    tell("thin", tuple(skeletons))
    graphs = [graph.prune(graph.trace(skeleton), tuning.spur_px) for skeleton in skeletons]
    tell("graph", tuple(graphs))
    views = [
        View(
            grey=grey,
            mask=mask,
            skeleton=skeleton,
            graph=traced,
            band=tuning.band or (min(255, round(one.floor_grey)), 255),
        )
        for grey, mask, skeleton, traced, one in zip(greys, masks, skeletons, graphs, found, strict=True)
    ]
    if part.topology is not None:
        return locate_shapes(left_grey, right_grey, stereo_model, part, tuning, table, observe)
    sides: tuple[Side, Side] = ("left", "right")
    looks = [
        Look(
            grey=np.ascontiguousarray(grey, np.float32),
            mask=mask,
            rect=rect,
            side=side,
            width_px=scale.width_px,
            contrast_grey=one.contrast_grey,
        )
        for grey, mask, side, one in zip(greys, masks, sides, found, strict=True)
    ]
    strands = [_strands(look, traced, scale) for look, traced in zip(looks, graphs, strict=True)]
    tell("strands", tuple(strands))
    pair = (looks[0], looks[1])
    matches, placed = match(strands[0], strands[1], pair, _level(rect, depth_m, table, tuning), part)
    tell("match", matches)
    segments = Segments3D(
        start=read_only(placed.ends_m[:, 0].copy()),
        end=read_only(placed.ends_m[:, 1].copy()),
        edge=read_only(placed.solved.left.copy()),
        residual_px=read_only(placed.solved.residual_px.copy()),
    )
    tell("reconstruct", segments)
    offered = candidates(placed, strands[0], strands[1], pair, part, tuning, table)
    tell("retrieve", offered)
    return _scene(offered, segments, views, matches)


def warm_up() -> None:
    """Compile everything that is compiled, on a small picture pair of its own.

    To be called before the cell says it is ready: the first call on a machine takes seconds, later
    starts load the compiled code from disk.
    """
    camera = CameraModel(
        matrix=read_only(np.array([[300.0, 0.0, 80.0], [0.0, 300.0, 60.0], [0.0, 0.0, 1.0]])),
        distortion=read_only(np.zeros(5)),
        width_px=160,
        height_px=120,
    )
    right_from_left = Transform(
        rotation=read_only(np.eye(3)), translation=read_only(np.array([-0.05, 0.0, 0.0]))
    )
    stereo_model = StereoModel(left=camera, right=camera, right_from_left=right_from_left)
    part = PartModel(code=0, name="warm-up", length_m=0.04, length_tolerance_m=0.004, diameter_m=0.005)
    left, right = np.full((2, 120, 160), 20, np.uint8)
    left[57:62, 70:100] = right[57:62, 32:62] = 220
    left[40:80, 83:88] = right[40:80, 45:50] = 220
    thin.zhang_suen(left > 100)
    tuning = Tuning(depth_m=(0.3, 0.5))
    locate_default(left, right, stereo_model, part, tuning)


def _strands(look: Look, traced: Graph, scale: _Scale) -> Strands:
    width = scale.width_px
    pieces = straight_pieces(
        traced,
        corner_px=max(1.2, CORNER_WIDTHS * width),
        trim_px=TRIM_WIDTHS * width + 1.0,
        least_px=max(3.0, PIECE_WIDTHS * width),
    )
    return find_strands(look, pieces, GROW_LENGTHS * scale.length_px, LONGEST_LENGTHS * scale.length_px)


def _scale(
    part: PartModel,
    rect: Rectification,
    depth_m: tuple[float, float],
    table: Plane | None,
    tuning: Tuning,
) -> _Scale:
    """Size in the picture at the table (parts lie low), without one in the middle of the depth range."""
    if tuning.depth_m is None and table is not None:
        # height 0 along the line of sight through the rectified centre
        depth = -table.offset_m / float(rect.rect_from_left[2] @ table.normal)
    else:
        depth = 0.5 * (depth_m[0] + depth_m[1])
    px_per_m = rect.focal_px / depth
    return _Scale(width_px=max(2.0, part.diameter_m * px_per_m), length_px=part.length_m * px_per_m)


def _level(rect: Rectification, depth_m: tuple[float, float], table: Plane | None, tuning: Tuning) -> Level:
    if tuning.depth_m is None and table is not None:
        return level_of_table(rect, table, tuning.height_m)
    return level_of_depths(rect, depth_m)


def _by_topology(
    views: list[View],
    part: PartModel,
    tuning: Tuning,
    table: Plane | None,
    rect: Rectification,
    depth_m: tuple[float, float],
    tell: Observer,
) -> Scene:
    length_px = part.length_m * rect.focal_px / depth_m[0]
    graphs = [
        _rectified(nodes_of_part(views[0].graph, part, length_px, tuning.spur_px), rect, "left"),
        _rectified(nodes_of_part(views[1].graph, part, length_px, tuning.spur_px), rect, "right"),
    ]
    gates = match_paper.Gates(
        depth_m=depth_m,
        position_px=(-tuning.epipolar_px, tuning.epipolar_px),
        angle_rad=tuning.angle_rad,
    )
    matches = match_paper.match(graphs[0], graphs[1], rect, gates)
    tell("match", matches)
    in_space = reconstruct.space_graph(graphs[0], graphs[1], matches, rect)
    segments = reconstruct.edge_segments(in_space)
    tell("reconstruct", segments)
    offered = retrieve.retrieve_topology(in_space, part, tuning, table, LONGEST_TOPOLOGY_DETOUR)
    tell("retrieve", offered)
    return _scene(offered, segments, views, matches)


def _rectified(traced: Graph, rect: Rectification, side: Side) -> Graph:
    """The graph with all its points in rectified pixels."""
    counts = np.cumsum([0, *(len(path) for path in traced.paths)])
    moved = rectify_points(np.concatenate([*traced.paths, np.zeros((0, 2))]), rect, side)
    paths = [moved[a:b] for a, b in pairwise(counts.tolist())]
    lengths = [float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()) for path in paths]
    return Graph(
        points=read_only(rectify_points(traced.points, rect, side)),
        degree=traced.degree,
        component=traced.component,
        edges=traced.edges,
        lengths_px=read_only(np.array(lengths, np.float64)),
        paths=tuple(read_only(path.copy()) for path in paths),
    )


def _scene(
    offered: tuple[Candidate, ...], segments: Segments3D, views: list[View], matches: Matches
) -> Scene:
    return Scene(
        method="default",
        candidates=offered,
        segments=segments,
        left=views[0],
        right=views[1],
        matches=matches,
    )


def _nobody(_stage: str, _product: object) -> None:
    return None
