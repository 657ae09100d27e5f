"""Parts with a topology, from two grey pictures to candidates: T, Y and L rods, keys, brackets, spanners.

The part is a known flat shape. Ribbons of the left picture propose where it may lie (`shape_search`), both
pictures together settle its pose in space (`shape_fit`), and the set of parts is chosen that explains every
edge once and has nothing in the pictures against it (`shape_choice`).
"""

from __future__ import annotations

import cv2
import numpy as np

from vision import graph, thin
from vision.empty import put_there, side_of
from vision.foreground import Foreground, stands_out
from vision.published import Observer, require_pictures
from vision.ribbons import Ribbons, ribbons
from vision.shape_choice import choose
from vision.shape_fit import fit
from vision.shape_model import shape_model, width_of
from vision.shape_pose import both_slopes
from vision.shape_search import search
from vision.stereo import rectification
from vision.types import (
    CameraModel,
    Candidate,
    Floats,
    Grey,
    Mask,
    Matches,
    NodeKind,
    PartModel,
    Plane,
    Scene,
    Segments3D,
    StereoModel,
    Topology,
    Transform,
    Tuning,
    View,
    read_only,
)

COARSE_PX, FINE_PX = 5.0, 1.5
"""Spacing of edge samples for the search and for the fit."""
STEP_PX = 1.5
LEAST_RIBBON_WIDTHS = 1.2
LEAST_SLOPE, LEAST_SLOPE_SHARE = 3.0, 0.06
"""Grey per px, and as a share of the contrast of parts: what counts as an edge."""
RIBBON_WIDTH_PX = 7.0
MASK_WIDTH_PX = 2.6
"""The foreground is only a veto here; it is made on a picture shrunk until parts are about this wide."""


WARM_UP_PART = PartModel(
    code=0,
    name="warm-up",
    length_m=0.089,
    length_tolerance_m=0.008,
    diameter_m=0.008,
    topology=Topology(
        points=read_only(np.array([[0.089, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.057, 0.0]])),
        kinds=(NodeKind.END, NodeKind.CORNER, NodeKind.END),
        edges=read_only(np.array([[0, 1], [1, 2]])),
        axis=(0, 1),
    ),
)


def locate_shapes(
    left_grey: Grey,
    right_grey: Grey,
    stereo_model: StereoModel,
    part: PartModel,
    tuning: Tuning,
    table: Plane | None = None,
    observe: Observer | None = None,
) -> Scene:
    """Find parts with a topology in a calibrated stereo pair.

    Parameters as for `vision.locate.locate`, and the same errors; also for a part without a topology.

    Parameters
    ----------
    table
        Without one it is assumed parallel to the left picture at the far end of
        ``tuning.depth_m``.
    observe
        Called with ``binarize``, ``thin``, ``graph`` (pairs left, right), ``strands`` (poses at table
        height), ``match`` (poses in space) and ``retrieve``.

    Returns
    -------
    Scene
        Views are in raw pixels; candidates and segments in the raw left camera frame. Shapes are matched
        as wholes, so ``matches`` has no rows.
    """
    require_pictures(left_grey, right_grey, stereo_model)
    if part.topology is None:
        raise ValueError(f"{part.name} has no topology to look for")
    tell = observe or _nobody
    plane, height_m = _lies_on(table, tuning)
    distance_m = -plane.offset_m / float(plane.normal[2])
    metre_px = float(stereo_model.left.matrix[0, 0]) / distance_m
    greys = (left_grey, right_grey)
    width_px = width_of(part) * metre_px
    left_found, right_found = (
        put_there(_foreground(grey, width_px), grey, side_of(tuning.empty, side), width_px)
        for side, grey in enumerate(greys)
    )
    masks = (left_found.mask, right_found.mask)
    tell("binarize", masks)
    views = _views(greys, masks, (left_found, right_found), tuning.spur_px)
    tell("thin", tuple(view.skeleton for view in views))
    tell("graph", tuple(view.graph for view in views))
    floors = (_slope_floor(left_found), _slope_floor(right_found))
    round_px = part.diameter_m * metre_px if part.outline is None else 0.0
    slopes = both_slopes(greys, stereo_model, floors, round_px)
    pieces = _ribbons(left_grey, masks[0], width_of(part) * metre_px, floors[0])
    shapes = (
        shape_model(part, round(COARSE_PX / metre_px, 5)),
        shape_model(part, round(FINE_PX / metre_px, 5)),
    )
    near = (_grown(masks[0]), _grown(masks[1]))
    rough = search(
        shapes[0],
        _rays(pieces, stereo_model.left),
        slopes[0],
        near[0],
        plane.normal,
        plane.offset_m - shapes[0].rest_m,
        STEP_PX,
    )
    tell("strands", rough)
    fits = fit(rough, shapes, slopes, near, stereo_model, plane, height_m)
    tell("match", fits)
    found = choose(fits, shapes[1], part, part.topology, tuning, plane, rectification(stereo_model))
    tell("retrieve", found)
    return Scene(
        method="default",
        candidates=found,
        segments=_segments(found, part.topology),
        left=views[0],
        right=views[1],
        matches=_no_matches(),
    )


def warm_up() -> None:
    """Compile everything that is compiled for shapes, on a small picture pair of its own.

    To be called before the cell says it is ready: the first call on a machine takes seconds.
    """
    camera = CameraModel(
        matrix=read_only(np.array([[300.0, 0.0, 80.0], [0.0, 300.0, 60.0], [0.0, 0.0, 1.0]])),
        distortion=read_only(np.zeros(5)),
        width_px=160,
        height_px=120,
    )
    motion = Transform(rotation=read_only(np.eye(3)), translation=read_only(np.array([-0.05, 0.0, 0.0])))
    pair = StereoModel(left=camera, right=camera, right_from_left=motion)
    left, right = np.full((2, 120, 160), 20, np.uint8)
    for grey, first in ((left, 60), (right, 22)):
        grey[30:36, first : first + 70] = 220
        grey[30:76, first : first + 6] = 220
        grey[108:114, first : first + 70] = 220
        grey[68:114, first + 64 : first + 70] = 220
    locate_shapes(left, right, pair, WARM_UP_PART, Tuning(depth_m=(0.3, 0.4)))


def _lies_on(table: Plane | None, tuning: Tuning) -> tuple[Plane, tuple[float, float]]:
    """The plane parts lie on or above, and the range of heights above it."""
    if table is not None:
        return table, tuning.height_m
    if tuning.depth_m is None:
        raise ValueError("without a table a depth range is needed")
    near, far = tuning.depth_m
    return Plane(normal=read_only(np.array([0.0, 0.0, -1.0])), offset_m=far), (0.0, far - near)


def _foreground(grey: Grey, width_px: float) -> Foreground:
    """The foreground, by way of a smaller picture where parts are wide."""
    shrink = max(1, int(width_px / MASK_WIDTH_PX))
    if shrink == 1:
        return stands_out(grey, width_px)
    rows, columns = grey.shape
    small = cv2.resize(grey, (columns // shrink, rows // shrink), interpolation=cv2.INTER_AREA)
    found = stands_out(np.asarray(small, np.uint8), width_px / shrink)
    mask, ground = (
        np.asarray(cv2.resize(of.view(np.uint8), (columns, rows), interpolation=cv2.INTER_NEAREST) > 0)
        for of in (found.mask, found.ground)
    )
    return Foreground(
        mask=read_only(mask),
        ground=read_only(ground),
        contrast_grey=found.contrast_grey,
        floor_grey=found.floor_grey,
        noise_grey=found.noise_grey,
    )


def _ribbons(grey: Grey, mask: Mask, width_px: float, floor: float) -> Ribbons:
    """Ribbons of a picture in its own pixels, found on a smaller one where parts are wide: there the middle
    between two edges depends less on how each pixel of them points."""
    shrink = max(1, int(width_px / RIBBON_WIDTH_PX))
    if shrink > 1:
        size = (grey.shape[1] // shrink, grey.shape[0] // shrink)
        grey = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)
        mask = np.asarray(cv2.resize(mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0)
    width_px /= shrink
    found = ribbons(
        np.ascontiguousarray(grey, np.float32), mask, width_px, floor, LEAST_RIBBON_WIDTHS * width_px
    )
    back = 0.5 * (shrink - 1)
    return Ribbons(
        start=read_only(found.start * shrink + back),
        end=read_only(found.end * shrink + back),
    )


def _slope_floor(found: Foreground) -> float:
    return max(LEAST_SLOPE, LEAST_SLOPE_SHARE * found.contrast_grey)


def _grown(mask: Mask) -> Mask:
    """The mask and its next pixels: blur leaves the rim of a part half as bright."""
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)


def _rays(pieces: Ribbons, camera: CameraModel) -> Ribbons:
    """Pieces at focal length one, without distortion."""
    if len(pieces.start) == 0:
        return pieces
    ends = np.concatenate([pieces.start, pieces.end]).reshape(-1, 1, 2)
    ideal = cv2.undistortPoints(ends, camera.matrix, camera.distortion).reshape(2, -1, 2)
    return Ribbons(
        start=read_only(np.array(ideal[0], np.float64)),
        end=read_only(np.array(ideal[1], np.float64)),
    )


def _views(
    greys: tuple[Grey, Grey], masks: tuple[Mask, Mask], found: tuple[Foreground, Foreground], spur_px: float
) -> tuple[View, View]:
    views = []
    for grey, mask, one in zip(greys, masks, found, strict=True):
        skeleton = thin.guo_hall(mask)
        views.append(
            View(
                grey=grey,
                mask=mask,
                skeleton=skeleton,
                graph=graph.prune(graph.trace(skeleton), spur_px),
                band=(min(255, round(one.floor_grey)), 255),
            )
        )
    return views[0], views[1]


def _segments(found: tuple[Candidate, ...], topology: Topology) -> Segments3D:
    """The straight pieces of every part found."""
    parts = [candidate.nodes[topology.edges] for candidate in found if candidate.recognised]
    ends = np.concatenate([*parts, np.zeros((0, 2, 3))])
    residual = [np.full(len(topology.edges), c.residual_px) for c in found if c.recognised]
    return Segments3D(
        start=read_only(ends[:, 0].copy()),
        end=read_only(ends[:, 1].copy()),
        edge=read_only(np.full(len(ends), -1, np.int64)),
        residual_px=read_only(np.concatenate([*residual, np.zeros(0)])),
    )


def _no_matches() -> Matches:
    none: Floats = np.zeros(0)
    rows = read_only(np.zeros(0, np.int64))
    return Matches(left=rows, right=rows, cost_px=read_only(none), unmatched=0, ambiguous=0)


def _nobody(_stage: str, _product: object) -> None:
    return None
