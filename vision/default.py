"""The default method from two grey pictures to candidates: its stages in order.

Adaptive foreground, Guo-Hall thinning and the skeleton graph propose where parts may lie; directed edges of
both grey pictures say what is there; the set of parts of the known length that explains both pictures is
chosen, measured on its own edges, and offered or refused.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from vision import binarize, graph, thin
from vision.canvas import canvas, disparity_planes, in_space, points_through_grid
from vision.colour import Colour
from vision.crossings import crossed
from vision.edges import Edges, edges
from vision.empty import put_there, side_of
from vision.explain import Frame, explain
from vision.foreground import Foreground, stands_out
from vision.ghosts import below_ghosts
from vision.glance import at_first_sight
from vision.jit import steady
from vision.memory import keep_freed
from vision.offer import STRAINED, Offered, candidates, how_seen, unexplained
from vision.pieces import on_canvas_lines, straight_pieces
from vision.polish import Measured, polish
from vision.proposals import Lines, lines
from vision.published import Observer, depth_gate_m, require_pictures
from vision.rows import LEAST_ENDS, row_offset
from vision.shapes import locate_shapes
from vision.shapes import warm_up as warm_up_shapes
from vision.sizes import Size, lead, of_one_width, sizes_of, weighing_length_m
from vision.sizes import pool as propose
from vision.types import (
    CameraModel,
    Floats,
    Grey,
    Ints,
    Mask,
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

LINE_SLACK_PX = 3.0
CERTAIN_DIAMETERS, CERTAIN_ABOVE = 0.3, 1.5
"""What is told before the rest is known this well, and lies above what it crosses by this many standard
deviations."""
MOST_FIRST = 3
LOWEST_DIAMETERS = 1.2
"""Axes are looked for from this many diameters below where a lying part has its own."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Picture:
    """One picture on its way: what stands out, its graph, edges and lines."""

    grey: Grey
    found: Foreground
    view: View
    edges: Edges
    pieces: Floats
    lines: Lines


WARM_UP_STICKS = (
    (150.0, 60.0, 10.0, 75.0),
    (240.0, 150.0, 80.0, 75.0),
    (200.0, 190.0, 40.0, 76.0),
    (240.0, 140.0, 0.0, 77.0),
    (120.0, 160.0, 60.0, 75.0),
)
"""Middle in the left picture, direction and disparity; later ones lie on top."""


def locate_default(
    left_grey: Grey,
    right_grey: Grey,
    stereo_model: StereoModel,
    part: PartModel,
    tuning: Tuning,
    table: Plane | None = None,
    observe: Observer | None = None,
    colour_left: Colour | None = None,
    among: tuple[PartModel, ...] = (),
) -> Scene:
    """Find parts in a calibrated stereo pair with the project's own method.

    Straight parts of one width here, parts with a topology by `vision.shapes`.

    Parameters as for `vision.locate.locate`, and the same errors.

    Parameters
    ----------
    observe
        Called with ``binarize``, ``graph``, ``edges``, ``lines`` (pairs left, right), ``windows``,
        ``explain``, ``rows``, ``polish`` and ``retrieve``; and with ``first``, before the rest is
        explained, where a part is certain already: a `Scene` that is not complete.
    among
        Other products that may lie there, straight and as thick as ``part``: candidates say which product
        they are, and the first answer is of ``part`` only.

    Returns
    -------
    Scene
        Views are in raw pixels; candidates and segments in the raw left camera frame.
    """
    if among and not of_one_width(part, among):
        raise ValueError(f"not all of {', '.join(p.name for p in (part, *among))} are rods of one width")
    if part.topology is not None:
        return locate_shapes(left_grey, right_grey, stereo_model, part, tuning, table, observe)
    require_pictures(left_grey, right_grey, stereo_model)
    parts = (part, *among)
    for told in parts:
        if told.colour is not None and colour_left is None:
            raise ValueError(
                f"part {told.name} is told by its colour; a colour picture of the left camera is needed"
            )
    tell = observe or _nobody
    frame = frame_of(stereo_model, replace(part, length_m=weighing_length_m(parts)), tuning, table)
    sizes = sizes_of(parts, frame)
    greys = (steady(left_grey), steady(right_grey))
    pictures = _look(greys, frame, tuning, 0.0, tell)

    pool = _propose(pictures, frame, sizes, tell)
    first = _first(pool, pictures, greys, sizes, tuning, table, colour_left)
    if first is not None:
        tell("first", first)
    found = explain(pool, pictures[0].edges, pictures[1].edges, frame)
    tell("explain", found)
    offset = row_offset(found, pictures[0].edges, pictures[1].edges, frame)
    tell("rows", offset)
    if offset.significant:
        pictures = _look(greys, frame, tuning, -offset.px, tell)
        pool = _propose(pictures, frame, sizes, tell)
        found = explain(pool, pictures[0].edges, pictures[1].edges, frame)
        tell("explain", found)
    shift = -offset.px if offset.significant else 0.0
    measured = polish(found, pictures[0].edges, pictures[1].edges, greys, shift, frame)
    tell("polish", measured)
    over = crossed(measured.parts, measured.covariance, found.chosen, found.state, frame)
    off_px = offset.px if offset.significant else 0.0
    ahead = lead(found, sizes)
    haunted = below_ghosts(found, measured.parts, frame)
    offered = candidates(
        measured, found, over, frame, tuning, table, colour_left, off_px, sizes, ahead, haunted
    )
    tell("retrieve", offered.candidates)
    scene = _scene(offered, measured, pictures, frame, pool, off_px)
    if offset.ends < LEAST_ENDS:
        return scene
    return replace(scene, rows_seen_px=offset.px, rows_sigma_px=offset.sigma_px)


def frame_of(stereo_model: StereoModel, part: PartModel, tuning: Tuning, table: Plane | None) -> Frame:
    """What is the same for a whole look: geometry, heights, and how large the part looks at the table."""
    on = canvas(stereo_model)
    depth_m = depth_gate_m(stereo_model, tuning, table)
    gate = tuning.depth_m if tuning.depth_m is not None or table is None else None
    low, high = tuning.height_m
    resting = 0.5 * part.diameter_m
    heights = (
        (low, resting, high)
        if gate is not None
        else (max(low, resting - LOWEST_DIAMETERS * part.diameter_m), resting, high)
    )
    planes = disparity_planes(on, heights, table, gate if gate is not None else (None if table else depth_m))
    middle = on.centre_px
    disparity = float(planes[1, :2] @ middle + planes[1, 2])
    depth = on.focal_px * on.baseline_m / disparity
    return Frame(
        on=on,
        camera=np.array([on.focal_px, on.baseline_m, *on.centre_px]),
        level=planes[1],
        low=planes[0],
        high=planes[2],
        part=part,
        width_px=max(2.0, part.diameter_m * on.focal_px / depth),
        length_px=part.length_m * on.focal_px / depth,
        diameter_d=part.diameter_m * disparity / depth,
    )


def _look(
    greys: tuple[Grey, Grey], frame: Frame, tuning: Tuning, row_shift_px: float, tell: Observer
) -> tuple[_Picture, _Picture]:
    """Both pictures up to their lines; the right one with its rows shifted."""
    found = [
        put_there(stands_out(grey, frame.width_px), grey, side_of(tuning.empty, side), frame.width_px)
        for side, grey in enumerate(greys)
    ]
    masks: list[Mask] = [
        one.mask if tuning.band is None else binarize.in_band(grey, tuning.band)
        for grey, one in zip(greys, found, strict=True)
    ]
    tell("binarize", tuple(masks))
    views = [_view(grey, mask, one, tuning) for grey, mask, one in zip(greys, masks, found, strict=True)]
    tell("graph", tuple(view.graph for view in views))
    shifts = (0.0, row_shift_px)
    seen = [
        edges(grey, one.ground | mask, one.ground | mask, one.contrast_grey, frame.on, side, shift)
        for side, (grey, one, mask, shift) in enumerate(zip(greys, found, masks, shifts, strict=True))
    ]
    tell("edges", tuple(seen))
    pictures = []
    for side, (grey, one, view, of, shift) in enumerate(zip(greys, found, views, seen, shifts, strict=True)):
        pieces = straight_pieces(view.graph, frame.width_px)
        on_line = on_canvas_lines(pieces, frame.on, side, shift)
        pictures.append(
            _Picture(
                grey=grey,
                found=one,
                view=view,
                edges=of,
                pieces=pieces,
                lines=lines(of, on_line, frame.width_px, frame.length_px),
            )
        )
    tell("lines", tuple(picture.lines for picture in pictures))
    return pictures[0], pictures[1]


def _view(grey: Grey, mask: Mask, found: Foreground, tuning: Tuning) -> View:
    skeleton = thin.guo_hall(mask)
    return View(
        grey=grey,
        mask=mask,
        skeleton=skeleton,
        graph=graph.prune(graph.trace(skeleton), tuning.spur_px, mask),
        band=tuning.band or (min(255, round(found.floor_grey)), 255),
    )


def _propose(
    pictures: tuple[_Picture, _Picture], frame: Frame, sizes: tuple[Size, ...], tell: Observer
) -> Floats:
    # two lines tell the disparity at their ends to a few pixels only; the refined part is held to the heights
    slack = np.array([0.0, 0.0, LINE_SLACK_PX])
    planes = np.stack([frame.low - slack, frame.high + slack])
    pool = propose(pictures[0].lines, pictures[1].lines, planes, sizes)
    tell("windows", pool)
    return pool


def _first(
    pool: Floats,
    pictures: tuple[_Picture, _Picture],
    greys: tuple[Grey, Grey],
    sizes: tuple[Size, ...],
    tuning: Tuning,
    table: Plane | None,
    colour: Colour | None,
) -> Scene | None:
    """A scene with the parts of the first product that are certain already: seen whole in both pictures, ends
    and all, nothing over them, and rows that agree. None where there is no such part. Its segments are these
    parts, and the pieces of the graph that nobody has explained yet."""
    frame, part = sizes[0].frame, sizes[0].parts[0]
    wanted = part.code
    left, right = pictures[0].edges, pictures[1].edges
    found = at_first_sight(pool, left, right, frame)
    if found is None or row_offset(found, left, right, frame).significant:
        return None
    best = replace(found, chosen=found.chosen[:MOST_FIRST], margin=found.margin[:MOST_FIRST])
    measured = polish(best, left, right, greys, 0.0, frame)
    over = crossed(measured.parts, measured.covariance, best.chosen, best.state, frame)
    offered = candidates(measured, best, over, frame, tuning, table, colour, 0.0, sizes)
    loose = how_seen(best).flat | (measured.strain > STRAINED)
    kept = tuple(
        candidate
        for candidate, row in zip(offered.candidates, offered.rows, strict=True)
        if candidate.offered
        and candidate.part_code == wanted
        and candidate.sigma_m < CERTAIN_DIAMETERS * part.diameter_m
        and not loose[row]
        and not over.above[:, row].any()
        and not ((over.above[row] > 0) & (over.sure[row] < CERTAIN_ABOVE)).any()
    )
    if not kept:
        return None
    alone = Offered(candidates=kept, crossings=(), rows=[])
    return replace(_scene(alone, measured, pictures, frame, pool, 0.0), complete=False)


def _scene(
    offered: Offered,
    measured: Measured,
    pictures: tuple[_Picture, _Picture],
    frame: Frame,
    pool: Floats,
    row_offset_px: float,
) -> Scene:
    """Everything measured is a segment; so is what nobody explains, laid on the table: both are in the way
    of jaws."""
    ends = in_space(measured.parts[:, 1:7].reshape(-1, 2, 3), frame.on).reshape(-1, 2, 3)
    pieces = pictures[0].pieces
    moved = points_through_grid(frame.on.from_raw[0], pieces.reshape(-1, 2)).reshape(-1, 2, 2)
    lone = unexplained(moved, measured, frame.width_px)
    lying = np.empty((len(lone), 2, 3))
    lying[..., :2] = lone
    lying[..., 2] = lone @ frame.level[:2] + frame.level[2]
    segments = np.concatenate([ends, in_space(lying, frame.on)])
    none: Ints = np.zeros(0, np.int64)
    count = len(ends)
    return Scene(
        method="default",
        candidates=offered.candidates,
        segments=Segments3D(
            start=read_only(segments[:, 0].copy()),
            end=read_only(segments[:, 1].copy()),
            edge=read_only(np.full(len(segments), -1, np.int64)),
            residual_px=read_only(np.concatenate([measured.bow_px, np.full(len(lone), np.nan)])),
        ),
        left=pictures[0].view,
        right=pictures[1].view,
        matches=Matches(
            left=read_only(none.copy()),
            right=read_only(none.copy()),
            cost_px=read_only(np.zeros(0)),
            unmatched=len(lone),
            ambiguous=max(0, len(pool) - count),
        ),
        crossings=offered.crossings,
        row_offset_px=row_offset_px,
    )


def warm_up() -> None:
    """Compile everything that is compiled, on a small picture pair of its own; keep freed memory from now on.

    To be called before the cell says it is ready: the first call on a machine takes minutes, later
    starts load the compiled code from disk.
    """
    keep_freed()
    camera = CameraModel(
        matrix=read_only(np.array([[600.0, 0.0, 160.0], [0.0, 600.0, 120.0], [0.0, 0.0, 1.0]])),
        distortion=read_only(np.zeros(5)),
        width_px=320,
        height_px=240,
    )
    right_from_left = Transform(
        rotation=read_only(np.eye(3)), translation=read_only(np.array([-0.05, 0.0, 0.0]))
    )
    stereo_model = StereoModel(left=camera, right=camera, right_from_left=right_from_left)
    part = PartModel(code=0, name="warm-up", length_m=0.08, length_tolerance_m=0.008, diameter_m=0.005)
    left, right = _warm_up_picture(0), _warm_up_picture(1)
    thin.zhang_suen(left > 100)
    tuning = Tuning(depth_m=(0.3, 0.5))
    locate_default(left, right, stereo_model, part, tuning)
    # an empty table, and one camera that sees nothing, must not compile anything in the middle of an order
    empty = np.full_like(left, 20)
    locate_default(empty, empty, stereo_model, part, tuning)
    locate_default(left, empty, stereo_model, part, tuning)
    warm_up_shapes()


def _warm_up_picture(view: int) -> Grey:
    """Sticks of 120 by 7 px, some across others, 75 px of disparity and more; (240, 320)."""
    grey = np.full((240, 320), 20, np.uint8)
    for x, y, turn_deg, disparity in WARM_UP_STICKS:
        dx, dy = 60 * np.cos(np.radians(turn_deg)), 60 * np.sin(np.radians(turn_deg))
        for width, value in ((7, 120), (5, 170), (3, 220)):
            ends = [
                (round(16 * (x + s * dx - view * disparity)), round(16 * (y + s * dy))) for s in (-1.0, 1.0)
            ]
            cv2.line(grey, ends[0], ends[1], value, width, cv2.LINE_AA, 4)
    return grey


def _nobody(_stage: str, _product: object) -> None:
    return None
