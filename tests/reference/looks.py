"""What the stages of the default method are given: drawn pictures, their edges, and parts as hypotheses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tests.reference.sticks import TABLE, Stick, pair, rig
from vision import claims
from vision.canvas import in_space, on_canvas
from vision.default import LINE_SLACK_PX, frame_of
from vision.edges import Edges, edges, signposts
from vision.explain import Explanation, Frame, explain
from vision.foreground import stands_out
from vision.proposals import lines
from vision.refine import COLUMNS, DA, DB, LENGTH, UNIT, XA, XB, YA, YB
from vision.strays import strays
from vision.traits import traits
from vision.types import PartModel, Tuning
from vision.windows import windows

Floats = npt.NDArray[np.float64]
Grey = npt.NDArray[np.uint8]

ROD = PartModel(code=7, name="rod", length_m=0.1, length_tolerance_m=0.004, diameter_m=0.004)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Seen:
    """Both pictures and their edges."""

    greys: tuple[Grey, Grey]
    left: Edges
    right: Edges


def frame(part: PartModel = ROD) -> Frame:
    """The frame of a look at the drawn table."""
    return frame_of(rig(), part, Tuning(), TABLE)


def seen(greys: tuple[Grey, Grey], of: Frame, row_shift_px: float = 0.0) -> Seen:
    """The edges of two pictures as `vision.default` finds them."""
    found = []
    for side, grey in enumerate(greys):
        out = stands_out(grey, of.width_px)
        near = out.ground | out.mask
        found.append(edges(grey, near, near, out.contrast_grey, of.on, side, side * row_shift_px))
    return Seen(greys=greys, left=found[0], right=found[1])


def drawn(sticks: list[Stick], of: Frame, seed: int = 0) -> Seen:
    """The edges of drawn sticks."""
    return seen(pair(sticks, seed=seed), of)


def ends_px(stick: Stick, of: Frame) -> Floats:
    """(6,) both true ends (x, y, d) on the canvas."""
    return on_canvas(np.stack([stick.start, stick.end]), of.on).reshape(6)


def hypotheses(sticks: list[Stick], of: Frame, *, free: bool = False) -> Floats:
    """(N, `COLUMNS`) the sticks as they are; of the product's length, or of an unknown one."""
    rows = np.zeros((len(sticks), COLUMNS))
    for row, stick in zip(rows, sticks, strict=True):
        row[1:7] = ends_px(stick, of)
        row[UNIT] = of.unit
        row[LENGTH] = 0.0 if free else float(np.linalg.norm(stick.end - stick.start))
    return rows


def state_of(rows: Floats, pictures: Seen, of: Frame) -> claims.State:
    """A fresh state of the choice over hypotheses, none of which gains or loses for itself."""
    return claims.state(
        rows,
        traits(rows, pictures.left, pictures.right, of.camera, 2.8 * of.length_px),
        pictures.left,
        pictures.right,
        in_space(rows[:, 1:7].reshape(-1, 2, 3), of.on),
        np.zeros(len(rows)),
        of.length_px,
        of.width_px,
        of.part.diameter_m,
        of.diameter_d,
    )


def pool_of(pictures: Seen, of: Frame) -> Floats:
    """Hypotheses as `vision.default` proposes them, but for what the skeleton graph adds."""
    none = np.zeros((0, 4))
    left, right = (lines(side, none, of.width_px, of.length_px) for side in (pictures.left, pictures.right))
    slack = np.array([0.0, 0.0, LINE_SLACK_PX])
    planes = np.stack([of.low - slack, of.high + slack])
    length_m = of.part.length_m
    return np.concatenate(
        [
            windows(left, right, of.on, planes, length_m, of.width_px, of.length_px, of.unit),
            strays(left, right, of.on, planes, length_m, of.length_px, of.unit),
        ]
    )


def explained(pictures: Seen, of: Frame) -> Explanation:
    """The set of parts that explains the pictures."""
    return explain(pool_of(pictures, of), pictures.left, pictures.right, of)


def outlined(
    row: Floats,
    of: Frame,
    beyond_px: Floats,
    moved_px: tuple[float, float] = (0.0, 0.0),
    row_shift_px: float = 0.0,
    scatter_px: float = 0.0,
    random: np.random.Generator | None = None,
) -> Seen:
    """Edges of one part (`COLUMNS`,) put down one by one: flanks and straight ends.

    ``beyond_px`` (2, 2) how far beyond its axis an end is seen, by view and end; ``moved_px`` how far all
    edges of a view are off along the normal; ``row_shift_px`` the rows of the right picture; ``scatter_px``
    of each flank.
    """
    views = []
    for view in range(2):
        start = np.array([row[XA] - view * row[DA], row[YA]])
        way = np.array([row[XB] - view * row[DB], row[YB]]) - start
        size = float(np.linalg.norm(way))
        along = way / size
        normal = np.array([-along[1], along[0]])
        aside = moved_px[view] * normal + view * np.array([0.0, row_shift_px])
        edges = []
        for step in range(int(size)):
            share = (step + 0.5) / int(size)
            half = 0.5 * row[UNIT] * (row[DA] + share * (row[DB] - row[DA]))
            for sign in (-1.0, 1.0):
                off = sign * half + (0.0 if random is None else random.normal(0, scatter_px))
                edges.append([*(start + share * way + off * normal + aside), *(-sign * normal), 1.0])
        for end, sign in ((0, -1.0), (1, 1.0)):
            width = row[UNIT] * row[DA + 3 * end]
            for lane in np.arange(-0.5 * width, 0.51 * width, 0.7):
                at = start + end * way + sign * beyond_px[view, end] * along + lane * normal + aside
                edges.append([*at, *(-sign * along), 1.0])
        table = np.array(edges, np.float32)
        named = np.full((of.on.height_px, of.on.width_px), -1, np.int32)
        for number, (x, y, *_) in enumerate(edges):
            named[int(y + 0.5), int(x + 0.5)] = number
        ground = np.ones(named.shape, np.uint8)
        views.append(Edges(table=table, at=named, posts=signposts(table, named), ground=ground))
    blank = np.zeros((4, 4), np.uint8)
    return Seen(greys=(blank, blank), left=views[0], right=views[1])


def worst_end_m(row: Floats, stick: Stick, of: Frame) -> float:
    """Distance of the worse of its ends from the stick's, m."""
    ends = in_space(row[1:7].reshape(2, 3), of.on)
    truth = np.stack([stick.start, stick.end])
    straight, turned = (np.linalg.norm(side - truth, axis=1).max() for side in (ends, ends[::-1]))
    return float(min(straight, turned))
