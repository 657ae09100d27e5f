"""The published method from two grey pictures to candidates: its stages in order.

Binarization with one band, Zhang-Suen thinning, the graph without its short branches, Algorithm 1 with
disambiguation, points in space, retrieval by length or topology.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vision import binarize, corners, graph, loops, match_paper, reconstruct, retrieve, stereo, thin
from vision.empty import near_changes
from vision.quality import require_grey
from vision.stereo import Rectification
from vision.types import (
    EmptyTray,
    Graph,
    Grey,
    Mask,
    NodeKind,
    PartModel,
    Plane,
    Scene,
    StereoModel,
    Tuning,
    View,
    read_only,
)

Observer = Callable[[str, object], None]
"""Gets every product with the name of its stage, as soon as it is made."""

LONGEST_TOPOLOGY_DETOUR = 0.15
"""The same between neighbours of a part with several segments, whose own edges may be curved (a jaw)."""
ARM_PX = 8.0
"""The least length to each side over which the bend at a corner is measured."""
LONGEST_RIM = 1.5

LONGEST_DETOUR = 0.05
"""Two nodes are linked as one straight part when the way between them is at most this share longer than the
line.

The paper only says "linked". Taking every two nodes of an object finds more sticks and many more false ones
(H20 scenes: recall 58 % at 3 % precision, against 38 % at 27 %); its table has as many candidates as objects,
which needs a narrow reading.
"""


def locate_published(
    left_grey: Grey,
    right_grey: Grey,
    stereo_model: StereoModel,
    part: PartModel,
    tuning: Tuning,
    table: Plane | None = None,
    observe: Observer | None = None,
) -> Scene:
    """Find parts by comparing the skeleton graphs of two pictures, as published.

    Parameters as for `vision.locate.locate`, and the same errors.

    Parameters
    ----------
    observe
        Called with ``rectify``, ``binarize``, ``thin``, ``graph`` (pairs left, right), ``match``,
        ``reconstruct`` and ``retrieve``.

    Returns
    -------
    Scene
        Views are in rectified pixels; candidates and segments in the raw left camera frame.
    """
    require_pictures(left_grey, right_grey, stereo_model)
    tell = observe or _nobody
    rect = stereo.rectification(stereo_model)
    gates = match_paper.Gates(
        depth_m=depth_gate_m(stereo_model, tuning, table),
        position_px=(-tuning.epipolar_px, tuning.epipolar_px),
        angle_rad=tuning.angle_rad,
    )
    greys = stereo.rectify_pictures(left_grey, right_grey, rect)
    tell("rectify", greys)
    # the band is proposed from the raw pictures, whose histogram has no black frame
    bands = [tuning.band or binarize.propose_band(raw) for raw in (left_grey, right_grey)]
    masks = [binarize.in_band(grey, band) for grey, band in zip(greys, bands, strict=True)]
    if tuning.empty is not None:
        masks = _put_there(masks, (left_grey, right_grey), tuning.empty, rect, tuning.spur_px)
    tell("binarize", tuple(masks))
    skeletons = [thin.zhang_suen(mask) for mask in masks]
    tell("thin", tuple(skeletons))
    length_px = part.length_m * rect.focal_px / gates.depth_m[0]
    graphs = [
        nodes_of_part(graph.prune(graph.trace(skeleton), tuning.spur_px), part, length_px, tuning.spur_px)
        for skeleton in skeletons
    ]
    tell("graph", tuple(graphs))
    views = [
        View(grey=grey, mask=mask, skeleton=skeleton, graph=traced, band=band)
        for grey, mask, skeleton, traced, band in zip(greys, masks, skeletons, graphs, bands, strict=True)
    ]
    matches = match_paper.match(graphs[0], graphs[1], rect, gates)
    tell("match", matches)
    in_space = reconstruct.space_graph(graphs[0], graphs[1], matches, rect)
    segments = reconstruct.edge_segments(in_space)
    tell("reconstruct", segments)
    if part.topology is None:
        couples, _ = reconstruct.couples(in_space, LONGEST_DETOUR)
        candidates = retrieve.retrieve_sticks(couples, part, tuning, table)
    else:
        candidates = retrieve.retrieve_topology(in_space, part, tuning, table, LONGEST_TOPOLOGY_DETOUR)
    tell("retrieve", candidates)
    return Scene(
        method="published",
        candidates=candidates,
        segments=segments,
        left=views[0],
        right=views[1],
        matches=matches,
    )


def _put_there(
    masks: list[Mask], raw: tuple[Grey, Grey], empty: EmptyTray, rect: Rectification, near_px: float
) -> list[Mask]:
    """Rectified masks without what belongs to the empty tray."""
    left, right = (
        np.where(near_changes(grey, reference, near_px), np.uint8(255), np.uint8(0))
        for grey, reference in zip(raw, (empty.left, empty.right), strict=True)
    )
    kept = stereo.rectify_pictures(left, right, rect)
    return [read_only(mask & (there > 127)) for mask, there in zip(masks, kept, strict=True)]


def require_pictures(left_grey: Grey, right_grey: Grey, stereo_model: StereoModel) -> None:
    """Raise ValueError unless both are grey 8-bit pictures of the sizes the cameras were calibrated for."""
    require_grey(left_grey, "left picture")
    require_grey(right_grey, "right picture")
    if left_grey.shape != right_grey.shape:
        raise ValueError(
            f"the pictures differ in size: {left_grey.shape} and {right_grey.shape} (rows, columns)"
        )
    for name, grey, camera in (
        ("left", left_grey, stereo_model.left),
        ("right", right_grey, stereo_model.right),
    ):
        if grey.shape != (camera.height_px, camera.width_px):
            raise ValueError(
                f"the {name} picture is {grey.shape} (rows, columns), "
                f"its camera is calibrated for {(camera.height_px, camera.width_px)}"
            )


def depth_gate_m(stereo_model: StereoModel, tuning: Tuning, table: Plane | None) -> tuple[float, float]:
    """The depth range to search: the given one, or that of the heights above the table.

    Raises
    ------
    ValueError
        Neither is there.
    """
    if tuning.depth_m is not None:
        return tuning.depth_m
    if table is None:
        raise ValueError("a depth range (tuning.depth_m) or a table plane is needed")
    return stereo.depth_range(stereo_model, table, tuning.height_m)


def nodes_of_part(traced: Graph, part: PartModel, length_px: float, spur_px: float) -> Graph:
    """The graph with the kinds of nodes the part has: corners and hole centres are added where it has some.

    ``length_px`` is how long the part looks; the rim of a hole is not longer than `LONGEST_RIM` times that.
    ``spur_px`` is the length below which a skeleton's shape means nothing, so bends are measured over it.
    """
    kinds = () if part.topology is None else part.topology.kinds
    if NodeKind.CORNER in kinds:
        traced = corners.with_corners(traced, max(ARM_PX, spur_px))
    if NodeKind.LOOP_CENTRE in kinds:
        traced = loops.with_loop_centres(traced, LONGEST_RIM * length_px)
    return traced


def _nobody(_stage: str, _product: object) -> None:
    return None
