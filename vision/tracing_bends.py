"""Is it a straight part, or a piece of something that bends or goes on: the veto for cables.

A straight part of length L is straight wherever it is measured, and ends. A cable under the same place in
the picture does neither. What a curve does within a crossing says nothing, because there it is drawn, not
measured.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vision.jit import compiled, lean
from vision.tracing import Curves
from vision.tracing_curves import SLOPE_PX
from vision.types import Bools, Floats, Ints, read_only

OFF_WIDTHS = 0.6
"""A curve is under a segment where it is not farther from it than this,"""
OFF_RAD = 0.35
"""and does not lead away from it by more."""
CORNER_RAD = 0.7
"""A curve that turns by more within 2.5 radii is a corner, where two ends touch or a part is bent
sharply; a cable does not. What lies on either side of a corner is judged alone."""


CURVED_WIDTHS = 1.0
"""A strand that bulges by more is no straight part: of some 300 straight parts in rendered piles none bulged
by more than 0.53 widths, the two pieces of a cable by 4.4 and 10.8."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Continuation:
    """What the strand under a segment does beyond the segment's two ends.

    ``strand`` its number, -1 when there is none; ``covered`` share of the segment from its
    first to its last place that lies on it;
    ``beyond_px`` (2,) how much farther the strand goes on beyond the first and the second end;
    ``bend_rad`` (2,) the most its direction there differs from the segment's, as far out as the segment
    is long, without what lies within crossings.
    """

    strand: int
    covered: float
    beyond_px: Floats
    bend_rad: Floats


def continuation(curves: Curves, segment: Floats, width_px: float) -> Continuation:
    """How the strand under a segment goes on.

    Parameters
    ----------
    curves : Curves
    segment : (2, 2) float
        Its two ends, raw px.
    width_px : float
        Of the part.

    Returns
    -------
    Continuation
        Of the strand that covers most of it.
    """
    strand, covered, beyond, bend = _continuation(
        curves.points,
        curves.starts,
        curves.bridged,
        curves.closed,
        np.ascontiguousarray(segment, np.float64),
        OFF_WIDTHS * width_px,
    )
    return Continuation(strand=strand, covered=covered, beyond_px=read_only(beyond), bend_rad=read_only(bend))


def sagitta_px(curves: Curves, length_px: float) -> Floats:
    """How far each strand bulges over a straight part of its length.

    Parameters
    ----------
    curves : Curves
    length_px : float
        Of the part.

    Returns
    -------
    (S,) float
        px, greatest distance of a measured point from the chord of a stretch up to `length_px` long that
        lies between crossings and corners. A straight part gives less than half its width.
    """
    parted = _parted(curves.points, curves.starts, curves.bridged, curves.radius_px)
    return _sagitta(curves.points, curves.starts, parted, float(length_px))


def curved(curves: Curves, length_px: float, width_px: float) -> Bools:
    """(S,) True for strands that bulge over a part's length as no straight part of its width does."""
    return np.asarray(sagitta_px(curves, length_px) > CURVED_WIDTHS * width_px, np.bool_)


@compiled
def _continuation(
    points: Floats, starts: Ints, bridged: Bools, closed: Bools, segment: Floats, off_px: float
) -> tuple[int, float, Floats, Floats]:
    beyond = np.zeros(2)
    bend = np.zeros(2)
    du = segment[1, 0] - segment[0, 0]
    dv = segment[1, 1] - segment[0, 1]
    size = np.hypot(du, dv)
    best = -1
    most = 0
    low = high = -1
    under = 0.0
    if size < 1e-9:
        return best, 0.0, beyond, bend
    du /= size
    dv /= size
    for s in range(len(starts) - 1):
        count = 0
        first = last = -1
        first_along = np.inf
        last_along = -np.inf
        for k in range(starts[s], starts[s + 1]):
            pu = points[k, 0] - segment[0, 0]
            pv = points[k, 1] - segment[0, 1]
            along = pu * du + pv * dv
            if along < -0.5 or along > size + 0.5 or abs(pv * du - pu * dv) > off_px:
                continue
            if abs(_turn_at(points, starts[s], starts[s + 1], k, 1, du, dv, True)) > OFF_RAD:
                continue
            count += 1
            if along < first_along:
                first_along = along
                first = k
            if along > last_along:
                last_along = along
                last = k
        if count > most:
            most = count
            best = s
            low = first
            high = last
            under = min(1.0, (last_along - first_along + 1.0) / size)
    if best < 0:
        return best, 0.0, beyond, bend
    begin = starts[best]
    stop = starts[best + 1]
    forwards = 1 if high >= low else -1
    if high == low:
        a = max(low - SLOPE_PX, begin)
        b = min(low + SLOPE_PX, stop - 1)
        if (points[b, 0] - points[a, 0]) * du + (points[b, 1] - points[a, 1]) * dv < 0:
            forwards = -1
    for end in range(2):
        k = low if end == 0 else high
        other = high if end == 0 else low
        step = -forwards if end == 0 else forwards
        along = (points[k, 0] - segment[0, 0]) * du + (points[k, 1] - segment[0, 1]) * dv
        walked = -along if end == 0 else along - size
        sign = -1.0 if end == 0 else 1.0
        while True:
            following = k + step
            if following < begin or following >= stop:
                if not closed[best]:
                    break
                following = stop - 1 if step < 0 else begin
            if following == other:
                break
            walked += np.hypot(points[following, 0] - points[k, 0], points[following, 1] - points[k, 1])
            k = following
            if 0.0 < walked < size and not _near_bridge(bridged, begin, stop, k):
                turn = _turn_at(points, begin, stop, k, step, sign * du, sign * dv, False)
                bend[end] = max(bend[end], abs(turn))
        beyond[end] = max(walked, 0.0)
    return best, under, beyond, bend


@lean
def _near_bridge(bridged: Bools, begin: int, stop: int, k: int) -> bool:
    """True where a direction taken at a point reaches into a crossing, or over an end."""
    if k - SLOPE_PX < begin or k + SLOPE_PX >= stop:
        return True
    return bool(bridged[k - SLOPE_PX : k + SLOPE_PX + 1].any())


@lean
def _turn_at(
    points: Floats, begin: int, stop: int, k: int, step: int, du: float, dv: float, either: bool
) -> float:
    """Angle from a direction to that of the curve at a point, walked by `step`, or `either` way."""
    a = max(k - SLOPE_PX, begin)
    b = min(k + SLOPE_PX, stop - 1)
    cu = (points[b, 0] - points[a, 0]) * step
    cv = (points[b, 1] - points[a, 1]) * step
    along = cu * du + cv * dv
    across = cv * du - cu * dv
    return float(np.arctan2(across, abs(along) if either else along))


@compiled
def _parted(points: Floats, starts: Ints, bridged: Bools, radius: Floats) -> Bools:
    """(K,) True within crossings and at corners."""
    parted = bridged.copy()
    for s in range(len(starts) - 1):
        reach = max(2 * SLOPE_PX, int(np.rint(2.5 * radius[s])))  # the points are smoothed
        for k in range(starts[s] + reach, starts[s + 1] - reach):
            here = points[k]
            before = here - points[k - reach]
            after = points[k + reach] - here
            if (
                abs(np.arctan2(before[0] * after[1] - before[1] * after[0], np.dot(before, after)))
                > CORNER_RAD
            ):
                parted[k] = True
    return parted


@compiled
def _sagitta(points: Floats, starts: Ints, bridged: Bools, length_px: float) -> Floats:
    found = np.zeros(len(starts) - 1)
    for s in range(len(found)):
        k = starts[s]
        while k < starts[s + 1]:
            if bridged[k]:
                k += 1
                continue
            stop = k
            while stop < starts[s + 1] and not bridged[stop]:
                stop += 1
            # windows of the length, a quarter of it apart, and the last one
            a = k
            while a < stop - 2:
                b = a
                walked = 0.0
                while b + 1 < stop and walked < length_px:
                    walked += np.hypot(points[b + 1, 0] - points[b, 0], points[b + 1, 1] - points[b, 1])
                    b += 1
                cu = points[b, 0] - points[a, 0]
                cv = points[b, 1] - points[a, 1]
                chord = np.hypot(cu, cv)
                for m in range(a + 1, b):
                    pu = points[m, 0] - points[a, 0]
                    pv = points[m, 1] - points[a, 1]
                    off = abs(pv * cu - pu * cv) / chord if chord > 1e-6 else np.hypot(pu, pv)
                    found[s] = max(found[s], off)
                if b + 1 >= stop:
                    break
                a += max(1, int(0.25 * length_px))
            k = stop
    return found
