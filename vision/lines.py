"""Sub-pixel centre lines of thin parts from the two flanks of their grey profile.

A skeleton is good for topology and bad for measuring: it moves in steps of whole pixels and bends at
crossings. Here it only says where to look. Across each sample of a piece the grey profile is searched
for its steepest rise and its steepest fall near the expected half width; the centroids of the slope there
are the two flanks and their mean lies on the centre line. A robust line goes through these points.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from vision.jit import compiled
from vision.types import Bools, Floats, Graph, Ints, read_only

Picture: TypeAlias = npt.NDArray[np.float32]

INNER_LANES = (-0.6, -0.3, 0.0, 0.3, 0.6)
_STEP_PX = 0.5
_TUKEY = 4.685
_L1_TURNS, _TUKEY_TURNS = 8, 8
_LEAST_SCALE_PX = 0.08


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pieces:
    """Straight runs of skeleton: ``start``, ``end`` (K, 2) px raw; ``edge`` (K,) of the graph."""

    start: Floats
    end: Floats
    edge: Ints


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Flanks:
    """Both flanks at N samples: ``low_px``, ``high_px`` (N,) offsets along the normal, low < high,
    ``low_slope``, ``high_slope`` (N,) steepness in grey per px, never negative."""

    low_px: Floats
    high_px: Floats
    low_slope: Floats
    high_slope: Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Line:
    """A fitted line: ``origin`` (2,) px, unit ``direction`` (2,), ``sigma_px`` of the offset at the
    origin, ``sigma_rad`` of the direction, ``scale_px`` robust spread of the points."""

    origin: Floats
    direction: Floats
    sigma_px: float
    sigma_rad: float
    scale_px: float

    @property
    def normal(self) -> Floats:
        """(2,) unit, a quarter turn from the direction."""
        return np.array([-self.direction[1], self.direction[0]])


def straight_pieces(graph: Graph, corner_px: float, trim_px: float, least_px: float) -> Pieces:
    """Edges cut at their corners, ends at junctions trimmed.

    Parameters
    ----------
    graph : Graph
    corner_px : float
        A path that leaves its chord by more is cut where it is farthest off (Douglas and Peucker).
    trim_px : float
        Cut off at ends that are no free tips: skeletons bend into junctions.
    least_px : float
        Shorter pieces are left out.
    """
    starts, ends, edges = [], [], []
    free = graph.degree == 1
    for number, path in enumerate(graph.paths):
        corners = np.flatnonzero(_corners(path, corner_px))
        for first, last in pairwise(corners.tolist()):
            a, b = path[first], path[last]
            length_px = float(np.hypot(*(b - a)))
            trim_a = 0.0 if first == 0 and free[graph.edges[number, 0]] else trim_px
            trim_b = 0.0 if last == len(path) - 1 and free[graph.edges[number, 1]] else trim_px
            if length_px - trim_a - trim_b < least_px:
                continue
            along = (b - a) / length_px
            starts.append(a + trim_a * along)
            ends.append(b - trim_b * along)
            edges.append(number)
    return Pieces(
        start=read_only(np.array(starts, np.float64).reshape(-1, 2)),
        end=read_only(np.array(ends, np.float64).reshape(-1, 2)),
        edge=read_only(np.array(edges, np.int64)),
    )


def flanks(grey: Picture, at_px: Floats, normal: Floats, half_px: float, window_px: float) -> Flanks:
    """The steepest rise before and the steepest fall after each sample.

    Parameters
    ----------
    grey : (H, W) float32
    at_px, normal : (N, 2)
        Samples and unit normals, raw pixels.
    half_px, window_px : float
        Flanks are searched ``half_px`` from the sample, ``window_px`` to both sides.
    """
    found = _flanks(
        grey, np.ascontiguousarray(at_px), np.ascontiguousarray(normal), float(half_px), float(window_px)
    )
    return Flanks(
        low_px=read_only(found[:, 0].copy()),
        high_px=read_only(found[:, 2].copy()),
        low_slope=read_only(found[:, 1].copy()),
        high_slope=read_only(found[:, 3].copy()),
    )


def fit_line(points_px: Floats, weights: Floats) -> Line | None:
    """Total least squares with Tukey's weights, in the direction of the points' order.

    Returns None for fewer than three points or points on one spot.
    """
    if len(points_px) < 3:
        return None
    found = _fit(np.ascontiguousarray(points_px), np.ascontiguousarray(weights))
    if not found[0]:
        return None
    _, ou, ov, du, dv, sigma_px, sigma_rad, scale_px = found
    if float((points_px[-1] - points_px[0]) @ (du, dv)) < 0:
        du, dv = -du, -dv
    return Line(
        origin=read_only(np.array([ou, ov])),
        direction=read_only(np.array([du, dv])),
        sigma_px=sigma_px,
        sigma_rad=sigma_rad,
        scale_px=scale_px,
    )


def end_fall(
    grey: Picture,
    at_px: Floats,
    along: Floats,
    half_px: float,
    window_px: float,
    lanes: tuple[float, ...] = INNER_LANES,
) -> Floats:
    """Where a part ends: the steepest fall of several lanes along its axis.

    Parameters
    ----------
    grey : (H, W) float32
    at_px, along : (2,)
        About where it ends and the unit direction outwards, raw pixels.
    half_px : float
        Half the part's width.
    window_px : float
        Searched before and after `at_px`.
    lanes
        Their places across the part, in half widths.

    Returns
    -------
    (lanes, 2)
        Of each lane: place of the steepest fall along the axis in px from `at_px`; its steepness.
    """
    normal = np.array([-along[1], along[0]])
    starts = np.stack([at_px + share * half_px * normal for share in lanes])
    return _falls(grey, starts, np.tile(along, (len(lanes), 1)), float(window_px))


@compiled
def _corners(path: Floats, corner_px: float) -> Bools:
    """Marks of the points that Douglas and Peucker keep; a closed path is cut at its far point."""
    count = len(path)
    keep = np.zeros(count, np.bool_)
    keep[0] = True
    keep[count - 1] = True
    stack = [(0, count - 1)]
    while len(stack) > 0:
        first, last = stack.pop()
        if last - first < 2:
            continue
        du = path[last, 0] - path[first, 0]
        dv = path[last, 1] - path[first, 1]
        chord = np.hypot(du, dv)
        worst = -1.0
        where = first
        for k in range(first + 1, last):
            pu = path[k, 0] - path[first, 0]
            pv = path[k, 1] - path[first, 1]
            off = abs(du * pv - dv * pu) / chord if chord > 1e-9 else np.hypot(pu, pv)
            if off > worst:
                worst = off
                where = k
        if worst > corner_px:
            keep[where] = True
            stack.append((first, where))
            stack.append((where, last))
    return keep


@compiled
def sample(grey: Picture, u: float, v: float) -> float:
    """Bilinear grey value; outside the picture its border value."""
    rows, columns = grey.shape
    u = min(max(u, 0.0), columns - 1.001)
    v = min(max(v, 0.0), rows - 1.001)
    iu = int(u)
    iv = int(v)
    fu = u - iu
    fv = v - iv
    top = (1.0 - fu) * grey[iv, iu] + fu * grey[iv, iu + 1]
    low = (1.0 - fu) * grey[iv + 1, iu] + fu * grey[iv + 1, iu + 1]
    value: float = (1.0 - fv) * top + fv * low
    return value


@compiled
def _steepest(
    grey: Picture, u: float, v: float, du: float, dv: float, low: float, high: float, sign: float
) -> tuple[float, float]:
    """Place and steepness (grey per px, times sign) of the steepest slope between two offsets."""
    count = max(3, int(np.ceil((high - low) / _STEP_PX)) + 1)
    slopes = np.empty(count + 2)
    for k in range(count + 2):
        slopes[k] = _slope(grey, u, v, du, dv, low + (k - 1) * _STEP_PX, sign)
    best = 1
    for k in range(1, count + 1):
        if slopes[k] > slopes[best]:
            best = k
    place = low + (best - 1) * _STEP_PX
    if slopes[best] <= 0.0:
        return place, 0.0
    # a parabola through the peak is drawn to whole pixels; the centroid of the slope is not
    for _ in range(2):
        total = max(_slope(grey, u, v, du, dv, place, sign), 1e-6)
        moment = 0.0
        for side in (-1.0, 1.0):
            for k in range(1, 4):
                s = side * k * _STEP_PX
                slope = _slope(grey, u, v, du, dv, place + s, sign)
                if slope <= 0.0:
                    break
                total += slope
                moment += slope * s
        place += moment / total
    return min(max(place, low), high), slopes[best]


@compiled
def _slope(grey: Picture, u: float, v: float, du: float, dv: float, s: float, sign: float) -> float:
    """Grey per px at an offset along a direction, times sign."""
    after = sample(grey, u + (s + _STEP_PX) * du, v + (s + _STEP_PX) * dv)
    before = sample(grey, u + (s - _STEP_PX) * du, v + (s - _STEP_PX) * dv)
    return sign * (after - before) / (2.0 * _STEP_PX)


@compiled
def _flanks(grey: Picture, at: Floats, normal: Floats, half: float, window: float) -> Floats:
    found = np.empty((len(at), 4))
    for k in range(len(at)):
        low, rise = _steepest(
            grey, at[k, 0], at[k, 1], normal[k, 0], normal[k, 1],
            -half - window, min(-half + window, -0.5), 1.0,
        )  # fmt: skip
        high, fall = _steepest(
            grey, at[k, 0], at[k, 1], normal[k, 0], normal[k, 1],
            max(half - window, 0.5), half + window, -1.0,
        )  # fmt: skip
        found[k, 0] = low
        found[k, 1] = rise
        found[k, 2] = high
        found[k, 3] = fall
    return found


@compiled
def _falls(grey: Picture, at: Floats, along: Floats, window: float) -> Floats:
    found = np.empty((len(at), 2))
    for k in range(len(at)):
        place, fall = _steepest(grey, at[k, 0], at[k, 1], along[k, 0], along[k, 1], -window, window, -1.0)
        found[k, 0] = place
        found[k, 1] = fall
    return found


@compiled
def _fit(points: Floats, weights: Floats) -> tuple[bool, float, float, float, float, float, float, float]:
    """(good, origin u, v, direction u, v, sigma offset, sigma angle, scale) by reweighting.

    First towards the least sum of distances, which finds the majority, then with Tukey's weights.
    """
    count = len(points)
    robust = np.ones(count)
    ou = ov = du = dv = 0.0
    scale = 1.0
    total = spread = 0.0
    for turn in range(_L1_TURNS + _TUKEY_TURNS):
        total = 0.0
        ou = 0.0
        ov = 0.0
        for k in range(count):
            w = weights[k] * robust[k]
            total += w
            ou += w * points[k, 0]
            ov += w * points[k, 1]
        if total < 1e-9:
            return False, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0
        ou /= total
        ov /= total
        suu = suv = svv = 0.0
        for k in range(count):
            w = weights[k] * robust[k]
            pu = points[k, 0] - ou
            pv = points[k, 1] - ov
            suu += w * pu * pu
            suv += w * pu * pv
            svv += w * pv * pv
        angle = 0.5 * np.arctan2(2.0 * suv, suu - svv)
        du = np.cos(angle)
        dv = np.sin(angle)
        spread = suu * du * du + 2.0 * suv * du * dv + svv * dv * dv
        off = np.empty(count)
        for k in range(count):
            off[k] = abs((points[k, 1] - ov) * du - (points[k, 0] - ou) * dv)
        scale = max(1.4826 * np.median(off), _LEAST_SCALE_PX)
        for k in range(count):
            r = off[k] / (_TUKEY * scale)
            if turn < _L1_TURNS:
                robust[k] = _LEAST_SCALE_PX / max(off[k], _LEAST_SCALE_PX)
            else:
                robust[k] = (1.0 - r * r) ** 2 if r < 1.0 else 0.0
    if spread < 1e-6:
        return False, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0
    return True, ou, ov, du, dv, scale / np.sqrt(total), scale / np.sqrt(spread), scale
