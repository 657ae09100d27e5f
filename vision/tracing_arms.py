"""Arms of a crossing: where edges of a skeleton graph may be believed, and what going from arm to arm costs.

At a fork the other strand spoils the path, at a free end the tip does. Beyond that a curve is fitted, which
tells where the arm enters the crossing and in which direction. How arms are paired: `tracing_crossings`.

Lengths are in radii unless they say px: distances from the skeleton to the nearest background.
"""

from __future__ import annotations

import numpy as np

from vision.jit import compiled, lean
from vision.net import radius_px
from vision.types import Floats, Ints, Mask

TRIM_RADII = 1.2
"""The skeleton of an arm is bent by the crossing this far from a fork, in radii at the fork,"""
FORK_RADII = 1.5
"""which are this many of the arm at least: a speck of background beside a fork makes it look narrow."""
FIT_RADII = 6.0
"""The piece of an arm that its direction is fitted to."""


@compiled
def edge_radii(mask: Mask, pixels: Floats, starts: Ints) -> tuple[Floats, Floats]:
    """(M,) median and mean radius of each edge, px, from every fourth pixel."""
    count = len(starts) - 1
    median = np.zeros(count)
    mean = np.zeros(count)
    for e in range(count):
        size = starts[e + 1] - starts[e]
        step = 4 if size > 12 else 1
        found = np.empty((size + step - 1) // step)
        for k in range(len(found)):
            p = starts[e] + k * step
            found[k] = radius_px(mask, pixels[p, 0], pixels[p, 1])
        median[e] = np.median(found)
        mean[e] = found.mean()
    return median, mean


@compiled
def trims(edges: Ints, degree: Ints, lengths_px: Floats, node_radius: Floats, median: Floats) -> Floats:
    """(M, 2) px of each edge's path that its two ends spoil, at most a third of it each.

    At a fork the other strand does, at a free end the skeleton turns to a corner of the tip.
    """
    spoilt = np.zeros((len(edges), 2))
    for e in range(len(edges)):
        for side in range(2):
            n = edges[e, side]
            px = 0.0
            if degree[n] >= 3:
                px = TRIM_RADII * max(node_radius[n], FORK_RADII * median[e])
            elif degree[n] == 1:
                px = median[e]
            spoilt[e, side] = min(px, lengths_px[e] / 3.0)
    return spoilt


@compiled
def arm(pixels: Floats, start: int, stop: int, side: int, skip_px: float, far_px: float) -> Floats:
    """Where an arm enters a crossing: (x, y, dx, dy) with the direction inwards.

    A parabola in the arc length is fitted between `skip_px` and `far_px` from the end of the path, a
    straight line where that is short.
    """
    rows = np.zeros(5)  # sums of t^0 .. t^4
    right = np.zeros((3, 2))
    walked = 0.0
    count = 0
    reached = skip_px
    for k in range(stop - start):
        p = start + k if side == 0 else stop - 1 - k
        if k > 0:
            before = p - 1 if side == 0 else p + 1
            walked += np.hypot(pixels[p, 0] - pixels[before, 0], pixels[p, 1] - pixels[before, 1])
        if walked < skip_px:
            continue
        if walked > far_px and count >= 3:
            break
        t = walked - skip_px
        power = 1.0
        for q in range(5):
            rows[q] += power
            if q < 3:
                right[q, 0] += power * pixels[p, 0]
                right[q, 1] += power * pixels[p, 1]
            power *= t
        count += 1
        reached = walked
    found = np.zeros(4)
    if count >= 10 and reached - skip_px > 12.0:
        matrix = np.empty((3, 3))
        for i in range(3):
            for j in range(3):
                matrix[i, j] = rows[i + j]
        solved = np.linalg.solve(matrix, right)
        found[:2] = solved[0]
        found[2:] = -solved[1]
    elif count >= 2 and rows[0] * rows[2] - rows[1] ** 2 > 1e-9:
        below = rows[0] * rows[2] - rows[1] ** 2
        for c in range(2):
            slope = (rows[0] * right[1, c] - rows[1] * right[0, c]) / below
            found[c] = (right[0, c] - slope * rows[1]) / rows[0]
            found[2 + c] = -slope
    else:
        near = start if side == 0 else stop - 1
        away = stop - 1 if side == 0 else start
        found[:2] = pixels[near]
        found[2:] = pixels[near] - pixels[away]
    size = np.hypot(found[2], found[3])
    if size > 0:
        found[2:] /= size
    return found


@lean
def turn(ax: float, ay: float, bx: float, by: float) -> float:
    """Signed angle from one direction to another, rad."""
    return float(np.arctan2(ax * by - ay * bx, ax * bx + ay * by))


@lean
def bending(one: Floats, other: Floats) -> float:
    """What it costs to go into a crossing by one arm and out by another, rad squared.

    Bending energy of the cubic between the two ends times their distance: 4 (a^2 + a b + b^2) with the
    slopes a, b of its ends against its chord. An arc that turns by t costs t^2, an S three times as much.
    """
    cx = other[0] - one[0]
    cy = other[1] - one[1]
    if np.hypot(cx, cy) < 1e-6:
        return turn(one[2], one[3], -other[2], -other[3]) ** 2
    a = turn(cx, cy, one[2], one[3])
    b = turn(cx, cy, -other[2], -other[3])
    return 4.0 * (a * a + a * b + b * b)


@lean
def cubic(one: Floats, other: Floats, t: float) -> tuple[float, float]:
    """Place at 0 <= t <= 1 on the curve that goes into a crossing by one arm and out by another."""
    chord = np.hypot(other[0] - one[0], other[1] - one[1])
    h = t * t * (3.0 - 2.0 * t)
    m = t * (1.0 - t) * (1.0 - t) * chord
    n = t * t * (1.0 - t) * chord
    return (
        (1.0 - h) * one[0] + h * other[0] + m * one[2] + n * other[2],
        (1.0 - h) * one[1] + h * other[1] + m * one[3] + n * other[3],
    )


@compiled
def arms_of(pixels: Floats, starts: Ints, lengths_px: Floats, spoilt: Floats, median: Floats) -> Floats:
    """(M, 2, 4) `arm` of both ends of every edge."""
    found = np.zeros((len(starts) - 1, 2, 4))
    for e in range(len(found)):
        for side in range(2):
            skip = spoilt[e, side]
            far = min(skip + FIT_RADII * median[e], lengths_px[e] - spoilt[e, 1 - side])
            found[e, side] = arm(pixels, starts[e], starts[e + 1], side, skip, max(far, skip + 2.0))
    return found
