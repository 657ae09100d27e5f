"""Edges that were paired at crossings, put together to curves with points to a fraction of a pixel.

Away from crossings the points lie midway between the two outlines, smoothed along the curve; through a
crossing a cubic joins the two arms; a free tip lies where the outline is met straight ahead.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vision.jit import compiled, lean
from vision.tracing_arms import cubic
from vision.types import Bools, Floats, Ints, Mask

SMOOTH_PX = 4
"""Half of the window of the running mean, which is taken twice."""
STEP_PX = 0.25
"""How closely an outline is looked for; a power of one half."""
SLOPE_PX = 4
"""A direction is taken over this many points to either side."""


@compiled
def smooth(points: Floats, half: int) -> Floats:
    """Running mean twice over; towards the ends the window shrinks and stays centred."""
    count = len(points)
    for _ in range(2):
        sums = np.zeros((count + 1, 2))
        for k in range(count):
            sums[k + 1] = sums[k] + points[k]
        result = np.empty((count, 2))
        for k in range(count):
            reach = min(half, min(k, count - 1 - k))
            result[k] = (sums[k + reach + 1] - sums[k - reach]) / (2 * reach + 1)
        points = result
    return points


@lean
def is_set(mask: Mask, u: float, v: float) -> bool:
    """True on foreground; outside the picture is none."""
    x = int(np.floor(u + 0.5))
    y = int(np.floor(v + 0.5))
    return bool(0 <= x < mask.shape[1] and 0 <= y < mask.shape[0] and mask[y, x])


@lean
def outline_px(mask: Mask, u: float, v: float, du: float, dv: float, near: float, most: float) -> float:
    """Distance to the outline in a direction; -1 when it is farther than `most`.

    Looked for from `near` on, when that place is foreground, in whole pixels and then in between.
    """
    far = near if is_set(mask, u + near * du, v + near * dv) else 0.0
    if not is_set(mask, u + far * du, v + far * dv):
        return 0.0
    while is_set(mask, u + (far + 1.0) * du, v + (far + 1.0) * dv):
        far += 1.0
        if far > most:
            return -1.0
    step = 0.5
    while step >= STEP_PX:
        if is_set(mask, u + (far + step) * du, v + (far + step) * dv):
            far += step
        step *= 0.5
    return far + step


@compiled
def centred(mask: Mask, points: Floats, radius: float) -> Floats:
    """The points moved to midway between both outlines, where the width there is that of the strand."""
    count = len(points)
    result = points.copy()
    for k in range(count):
        a = max(k - SLOPE_PX, 0)
        b = min(k + SLOPE_PX, count - 1)
        du = points[b, 0] - points[a, 0]
        dv = points[b, 1] - points[a, 1]
        size = np.hypot(du, dv)
        if size < 1e-9:
            continue
        nu = -dv / size
        nv = du / size
        plus = outline_px(mask, points[k, 0], points[k, 1], nu, nv, 0.5 * radius, 2.0 * radius + 1.0)
        minus = outline_px(mask, points[k, 0], points[k, 1], -nu, -nv, 0.5 * radius, 2.0 * radius + 1.0)
        if plus >= 0 and minus >= 0 and abs(plus - minus) < radius + 1.0:
            result[k, 0] += 0.5 * (plus - minus) * nu
            result[k, 1] += 0.5 * (plus - minus) * nv
    return result


@compiled
def bodies(
    mask: Mask, pixels: Floats, starts: Ints, within: Bools, spoilt: Floats, median: Floats
) -> tuple[Floats, Ints]:
    """Points of every edge away from its ends: (K, 2) px one after the other from starts (M + 1,)."""
    count = len(starts) - 1
    found = np.empty((len(pixels), 2))
    begin = np.zeros(count + 1, np.int64)
    filled = 0
    for e in range(count):
        if not within[e]:
            low = starts[e]
            high = starts[e + 1] - 1
            walked = 0.0
            while low < high:
                walked += np.hypot(pixels[low + 1, 0] - pixels[low, 0], pixels[low + 1, 1] - pixels[low, 1])
                if walked > spoilt[e, 0]:
                    break
                low += 1
            walked = 0.0
            while high > low:
                walked += np.hypot(
                    pixels[high, 0] - pixels[high - 1, 0], pixels[high, 1] - pixels[high - 1, 1]
                )
                if walked > spoilt[e, 1]:
                    break
                high -= 1
            points = smooth(pixels[low : high + 1].copy(), SMOOTH_PX)
            points = smooth(centred(mask, points, median[e]), SMOOTH_PX)
            for k in range(len(points)):
                found[filled + k] = points[k]
            filled += len(points)
        begin[e + 1] = filled
    return found[:filled], begin


@compiled
def assemble(
    mask: Mask,
    edges: Ints,
    degree: Ints,
    within: Bools,
    median: Floats,
    goes_on: Ints,
    points: Floats,
    begin: Ints,
) -> tuple[Floats, Bools, Ints, Bools, Floats]:
    """Curves from edge to edge.

    Returns points (K, 2) px, bridged (K,) True within crossings, starts (S + 1,), closed (S,) and
    radius (S,) px.
    """
    count = len(edges)
    room = 2 * len(points) + 64 * (count + 1)
    curve = np.empty((room, 2))
    bridged = np.zeros(room, np.bool_)
    starts = np.zeros(count + 1, np.int64)
    closed = np.zeros(count, np.bool_)
    radius = np.zeros(count)
    seen = within.copy()
    filled = 0
    made = 0
    for rings in (False, True):
        for first in range(2 * count):
            e = first // 2
            side = first % 2
            if seen[e] or (not rings and goes_on[e, side] >= 0):
                continue
            begins = filled
            if degree[edges[e, side]] == 1:
                filled = _tip(mask, points, begin[e], begin[e + 1], side, median[e], curve, filled)
            weight = 0
            end = first
            while True:
                e = end // 2
                side = end % 2
                seen[e] = True
                size = begin[e + 1] - begin[e]
                for k in range(size):
                    curve[filled] = points[begin[e] + k] if side == 0 else points[begin[e + 1] - 1 - k]
                    filled += 1
                radius[made] += size * median[e]
                weight += size
                end = goes_on[e, 1 - side]
                if end < 0:
                    if degree[edges[e, 1 - side]] == 1:
                        filled = _tip(
                            mask, points, begin[e], begin[e + 1], 1 - side, median[e], curve, filled
                        )
                    break
                filled = _bridge(points, begin, 2 * e + 1 - side, end, curve, bridged, filled)
                if seen[end // 2]:
                    break
            last = edges[e, 1 - side]
            closed[made] = rings or (edges[e, 0] == edges[e, 1] and degree[last] == 2)
            radius[made] /= max(weight, 1)
            if filled > begins:
                made += 1
                starts[made] = filled
    return (
        curve[:filled].copy(),
        bridged[:filled].copy(),
        starts[: made + 1].copy(),
        closed[:made].copy(),
        radius[:made].copy(),
    )


@compiled
def _outwards(points: Floats, begin: int, stop: int, side: int) -> Floats:
    """(4,) last point of a piece at one of its ends, and the unit direction out of it."""
    last = begin if side == 0 else stop - 1
    back = min(begin + 2 * SLOPE_PX, stop - 1) if side == 0 else max(stop - 1 - 2 * SLOPE_PX, begin)
    found = np.empty(4)
    found[:2] = points[last]
    found[2:] = points[last] - points[back]
    found[2:] /= max(np.hypot(found[2], found[3]), 1e-9)
    return found


@compiled
def _tip(
    mask: Mask, points: Floats, begin: int, stop: int, side: int, radius: float, curve: Floats, filled: int
) -> int:
    """The free end, where the outline is met straight ahead; returns the new length of the curve."""
    if stop - begin < 2:
        return filled
    u, v, du, dv = _outwards(points, begin, stop, side)
    far = outline_px(mask, u, v, du, dv, 0.0, 4.0 * radius + 2.0)
    if far > 0:
        curve[filled, 0] = u + far * du
        curve[filled, 1] = v + far * dv
        filled += 1
    return filled


@compiled
def _bridge(
    points: Floats, begin: Ints, end: int, onwards: int, curve: Floats, bridged: Bools, filled: int
) -> int:
    """Inner points of the cubic between two edge ends, about a pixel apart, at most 60."""
    a = end // 2
    b = onwards // 2
    if begin[a + 1] == begin[a] or begin[b + 1] == begin[b]:
        return filled
    one = _outwards(points, begin[a], begin[a + 1], end % 2)
    other = _outwards(points, begin[b], begin[b + 1], onwards % 2)
    steps = min(int(np.hypot(other[0] - one[0], other[1] - one[1])), 60)
    for k in range(1, steps):
        curve[filled, 0], curve[filled, 1] = cubic(one, other, k / steps)
        bridged[filled] = True
        filled += 1
    return filled


@compiled
def spread(mask: Mask, points: Floats, owner: Ints, most_px: Floats) -> npt.NDArray[np.int32]:
    """(H, W) the owner of the nearest point for each pixel of a mask, -1 for none near enough.

    Nearest is passed on from pixel to pixel, so that it does not jump over background. `most_px` (S,)
    is how near it must be, for each owner.
    """
    rows, columns = mask.shape
    nearest = np.full((rows, columns), -1, np.int32)
    queue = np.empty(len(points), np.int64)
    waiting = 0
    for k in range(len(points)):
        x = int(np.floor(points[k, 0] + 0.5))
        y = int(np.floor(points[k, 1] + 0.5))
        if not (0 <= x < columns and 0 <= y < rows and mask[y, x]):
            continue
        known = nearest[y, x]
        if known < 0:
            queue[waiting] = y * columns + x
            waiting += 1
        if known < 0 or _square(points, k, x, y) < _square(points, known, x, y):
            nearest[y, x] = k
    while waiting > 0:
        later = np.empty(8 * waiting, np.int64)
        found = 0
        for q in range(waiting):
            y = queue[q] // columns
            x = queue[q] % columns
            k = nearest[y, x]
            limit = most_px[owner[k]] ** 2
            for ny in range(max(y - 1, 0), min(y + 2, rows)):
                for nx in range(max(x - 1, 0), min(x + 2, columns)):
                    known = nearest[ny, nx]
                    if not mask[ny, nx] or known == k:
                        continue
                    square = _square(points, k, nx, ny)
                    if square <= limit and (known < 0 or square < _square(points, known, nx, ny)):
                        nearest[ny, nx] = k
                        later[found] = ny * columns + nx
                        found += 1
        queue = later
        waiting = found
    for y in range(rows):
        for x in range(columns):
            if nearest[y, x] >= 0:
                nearest[y, x] = owner[nearest[y, x]]
    return nearest


@lean
def _square(points: Floats, k: int, x: int, y: int) -> float:
    return float((points[k, 0] - x) ** 2 + (points[k, 1] - y) ** 2)
