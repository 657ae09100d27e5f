"""Which part lies on which where one passes over the other, and how sure that is.

"Over" is meant straight down on the table, because that is how jaws come: two parts cross where their
footprints meet, also where one only brushes the other beside its axis. The picture of the left camera would
show it askew.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vision.canvas import LEAST_DISPARITY_PX
from vision.claims import State
from vision.edges import Reals
from vision.explain import Frame
from vision.jit import compiled, lean
from vision.types import Bools, Floats, Ints

BRUSH_DIAMETERS, END_DIAMETERS = 0.2, 0.3
"""How much wider and longer than measured a footprint is taken to be, on each side, because parts may touch;
half as much where a part is refused for it."""
BESIDE_DIAMETERS, BESIDE_APART = 0.4, (0.9, 1.1)
"""Parts whose axes do not cross lie beside each other unless one is this much higher; nearer to each other
than the first, in diameters, unless it is half as much higher as two round ones must be there; farther than
the second in any case."""
BESIDE_HIGHER = 0.6
"""Of parts beside one that are measured higher by up to this many diameters 11 % truly lie on it; of lower
ones and of those higher still 2 % (`bench.doubts`, 3,552 such pairs of 360 heaps)."""
FLANK_WEIGHT = 3.0
"""How much the share of flanks that go on through a crossing weighs beside depth, in standard deviations."""
LEAST_SIGMA_D = 0.15
"""Disparity of a crossing is never known better than this share of one diameter's."""
SEEN = 0.3
"""Least strength of a flank that is seen."""
STEEPNESS, BESIDE_WEIGHT, LEAST_DOUBT = 2.5, 0.15, 0.05
"""How fast a wrong order becomes unlikely with standard deviations: of crossings up to 0.5 29 % were wrong,
up to 1 8 %, up to 1.5 1.3 %, up to 2 0.4 %, beyond that none of 30,980 (`bench.doubts`, 360 heaps). What a
part that may lie on one beside it weighs on it. Less than the last is no doubt."""
MIDDLE = (1.0 / 3.0, 2.0 / 3.0)

Counts = npt.NDArray[np.int32]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Crossed:
    """Of C parts: ``above`` (C, C) how much i lies above k where they cross, in diameters, 0 where it does
    not; ``sure`` (C, C) in standard deviations; ``place`` (C, C) where on i, share of its length, NaN
    without a crossing; ``gap`` (C, C) m from axis to axis, i higher positive; ``middle`` (C, C) whether k
    meets the middle third of i; ``beside`` (C, C) whether i lies beside k and a little higher, so that it may
    lie on it after all."""

    above: Floats
    sure: Floats
    place: Floats
    gap: Floats
    middle: Bools
    beside: Bools


def crossed(parts: Floats, covariance: Floats, rows: list[int], state: State, frame: Frame) -> Crossed:
    """All crossings of parts (C, `COLUMNS`); ``rows`` are their places in the state."""
    count = len(parts)
    found = Crossed(
        above=np.zeros((count, count)),
        sure=np.zeros((count, count)),
        place=np.full((count, count), np.nan),
        gap=np.zeros((count, count)),
        middle=np.zeros((count, count), np.bool_),
        beside=np.zeros((count, count), np.bool_),
    )
    _cross(
        parts, covariance, laid(parts, frame), np.array(rows, np.int64), state.samples, state.width,
        state.value, frame.part.diameter_m, frame.on.focal_px * frame.on.baseline_m, found.above, found.sure,
        found.place, found.gap, found.middle, found.beside,
    )  # fmt: skip
    return found


def laid(parts: Floats, frame: Frame) -> Floats:
    """(C, 2, 3) m: where the ends of parts (C, `COLUMNS`) are on the table, and how high above it, up to a
    constant."""
    ends = parts[:, 1:7].reshape(-1, 2, 3)
    depth = frame.on.focal_px * frame.on.baseline_m / np.maximum(ends[..., 2], LEAST_DISPARITY_PX)
    points = np.empty_like(ends)
    points[..., :2] = (ends[..., :2] - frame.on.centre_px) * (depth / frame.on.focal_px)[..., None]
    points[..., 2] = depth
    a, b, c = frame.level
    up = np.array([a * frame.on.focal_px, b * frame.on.focal_px, np.array([a, b]) @ frame.on.centre_px + c])
    up *= -np.sign(up[2]) / np.linalg.norm(up)
    along = np.array([1.0, 0.0, 0.0]) - up[0] * up
    along /= np.linalg.norm(along)
    return np.ascontiguousarray(points @ np.stack([along, np.cross(up, along), up]).T)


def ranked(found: Crossed, worth: Floats, offered: list[bool], unsure: Floats) -> list[int]:
    """Parts in the order in which they can be taken: always the one with the fewest others on it, as far as
    can be expected, and of these the best.

    Parts that are not offered stay where they are and go on weighing on what is below them. ``unsure`` (C,)
    weighs on a part as long as it would be the first one.
    """
    wrong = 1.0 / (1.0 + np.exp(STEEPNESS * found.sure))
    weight = np.where(found.above > 0, 1.0 - wrong, 0.0)
    # who seems to lie above, but hardly, may lie below: not the one to take before all others
    doubt = np.where(found.above > 0, wrong, 0.0).T.copy()
    doubt[found.beside] = BESIDE_WEIGHT
    np.fill_diagonal(doubt, unsure)
    doubt[doubt < LEAST_DOUBT] = 0.0
    taken: list[int] = _ranked(weight, doubt, worth, np.array(offered, np.bool_)).tolist()
    return taken


@compiled
def _ranked(weight: Floats, doubt: Floats, worth: Floats, offered: Bools) -> Ints:
    """``doubt`` counts for the first place only."""
    count = len(offered)
    on = np.zeros(count)
    gone = np.zeros(count, np.bool_)
    order = np.empty(offered.sum(), np.int64)
    for place in range(len(order)):
        best = -1
        for n in range(count):
            if gone[n] or not offered[n]:
                continue
            total = 0.0
            for other in range(count):
                if not gone[other]:
                    total += weight[other, n]
                    if place == 0:
                        total += doubt[other, n]
            on[n] = np.round(total, 3)
            if best < 0 or on[n] < on[best] or (on[n] == on[best] and worth[n] > worth[best]):
                best = n
        order[place] = best
        gone[best] = True
    return order


@compiled
def _cross(
    parts: Floats, covariance: Floats, ends: Floats, rows: Ints, samples: Counts, width: Floats, value: Reals,
    diameter_m: float, focal_baseline: float, above: Floats, sure: Floats, place: Floats, gap: Floats,
    middle: Bools, beside: Bools,
) -> None:  # fmt: skip
    """Every pair whose footprints meet, into tables (C, C). ``ends`` as `laid` has them."""
    pad_m, longer_m = (0.5 + BRUSH_DIAMETERS) * diameter_m, END_DIAMETERS * diameter_m
    for i in range(len(parts)):
        for k in range(i + 1, len(parts)):
            if not meet(ends[i], ends[k], 0.0, 1.0, longer_m, pad_m):
                continue
            s, t = nearest(ends[i], ends[k])
            higher = (1 - s) * ends[i, 0, 2] + s * ends[i, 1, 2] - (1 - t) * ends[k, 0, 2] - t * ends[k, 1, 2]
            if (s in (0.0, 1.0) or t in (0.0, 1.0)) and abs(higher) < _least(
                ends[i], ends[k], s, t, diameter_m
            ):
                beside[i, k] = 0 <= higher < BESIDE_HIGHER * diameter_m
                beside[k, i] = 0 <= -higher < BESIDE_HIGHER * diameter_m
                continue
            disparity = 0.25 * (parts[i, 3] + parts[i, 6] + parts[k, 3] + parts[k, 6])
            per_px = focal_baseline / disparity**2
            variance = _variance(covariance[i], s) + _variance(covariance[k], t)
            sigma = np.sqrt(variance * per_px**2 + (LEAST_SIGMA_D * diameter_m) ** 2)
            flanks = 0.0
            if abs(higher) < FLANK_WEIGHT * sigma and not _at_an_end(ends[i], ends[k], s, t, diameter_m):
                flanks = _through(samples, width, value, rows[i], s, parts[i], parts[k])
                flanks -= _through(samples, width, value, rows[k], t, parts[k], parts[i])
            z = higher / sigma + FLANK_WEIGHT * flanks
            place[i, k], place[k, i] = s, t
            gap[i, k], gap[k, i] = higher, -higher
            less_m = 0.5 * (1.0 + BRUSH_DIAMETERS) * diameter_m
            middle[i, k] = meet(ends[i], ends[k], MIDDLE[0], MIDDLE[1], 0.5 * longer_m, less_m)
            middle[k, i] = meet(ends[k], ends[i], MIDDLE[0], MIDDLE[1], 0.5 * longer_m, less_m)
            upper, lower = (i, k) if z > 0 else (k, i)
            above[upper, lower] = min(1.0, max(0.1, abs(higher) / diameter_m))
            sure[upper, lower] = abs(z)


@lean
def _at_an_end(own: Floats, other: Floats, s: float, t: float, diameter_m: float) -> bool:
    """Whether two parts cross less than a diameter from an end of either: an end that lies on another part
    hides hardly anything of it, so flanks that go on tell nothing."""
    size = np.hypot(own[1, 0] - own[0, 0], own[1, 1] - own[0, 1])
    across = np.hypot(other[1, 0] - other[0, 0], other[1, 1] - other[0, 1])
    return bool(min(min(s, 1 - s) * size, min(t, 1 - t) * across) < diameter_m)


@lean
def _least(own: Floats, other: Floats, s: float, t: float, diameter_m: float) -> float:
    """How much higher one of two parts is at least, m, if it lies on the other with its side or its end."""
    x = (1 - s) * own[0, 0] + s * own[1, 0] - (1 - t) * other[0, 0] - t * other[1, 0]
    y = (1 - s) * own[0, 1] + s * own[1, 1] - (1 - t) * other[0, 1] - t * other[1, 1]
    apart = np.hypot(x, y) / diameter_m
    near, far = BESIDE_APART
    if apart > far:
        return np.inf
    if apart > near:
        return BESIDE_DIAMETERS * diameter_m
    return float(0.5 * np.sqrt(1.0 - apart * apart) * diameter_m)


@lean
def meet(own: Floats, other: Floats, low: float, high: float, longer_m: float, pad_m: float) -> bool:
    """Whether the footprint of a part meets that of another's stretch ``low`` to ``high``: no line between
    the two rectangles parts them (the separating axis theorem). Ends (2, 3) as `laid` has them."""
    ax, ay = own[1, 0] - own[0, 0], own[1, 1] - own[0, 1]
    bx, by = other[1, 0] - other[0, 0], other[1, 1] - other[0, 1]
    size_a, size_b = max(np.hypot(ax, ay), 1e-12), max(np.hypot(bx, by), 1e-12)
    at = 0.5 * (low + high)
    dx = other[0, 0] + 0.5 * bx - own[0, 0] - at * ax
    dy = other[0, 1] + 0.5 * by - own[0, 1] - at * ay
    half_a = 0.5 * (high - low) * size_a + (longer_m if high - low == 1.0 else 0.0)
    half_b = 0.5 * size_b + longer_m
    ax, ay, bx, by = ax / size_a, ay / size_a, bx / size_b, by / size_b
    cosine, sine = abs(ax * bx + ay * by), abs(ax * by - ay * bx)
    long_m, wide_m = pad_m * sine, pad_m * (1.0 + cosine)
    return bool(
        abs(ax * dx + ay * dy) < half_a + half_b * cosine + long_m
        and abs(ax * dy - ay * dx) < half_b * sine + wide_m
        and abs(bx * dx + by * dy) < half_b + half_a * cosine + long_m
        and abs(bx * dy - by * dx) < half_a * sine + wide_m
    )


@lean
def nearest(own: Floats, other: Floats) -> tuple[float, float]:
    """Shares of their lengths at which two footprints' axes cross or come nearest."""
    ux, uy = own[1, 0] - own[0, 0], own[1, 1] - own[0, 1]
    vx, vy = other[1, 0] - other[0, 0], other[1, 1] - other[0, 1]
    wx, wy = other[0, 0] - own[0, 0], other[0, 1] - own[0, 1]
    turn = ux * vy - uy * vx
    if abs(turn) > 1e-15:
        s, t = (wx * vy - wy * vx) / turn, (wx * uy - wy * ux) / turn
        if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
            return s, t
    best, here, there = 1e30, 0.0, 0.0
    for end in range(2):
        px, py = end * ux - wx, end * uy - wy
        t = min(1.0, max(0.0, (px * vx + py * vy) / max(vx * vx + vy * vy, 1e-15)))
        away = np.hypot(t * vx - px, t * vy - py)
        if away < best:
            best, here, there = away, float(end), t
        px, py = wx + end * vx, wy + end * vy
        s = min(1.0, max(0.0, (px * ux + py * uy) / max(ux * ux + uy * uy, 1e-15)))
        away = np.hypot(s * ux - px, s * uy - py)
        if away < best:
            best, here, there = away, s, float(end)
    return here, there


@lean
def _variance(covariance: Floats, share: float) -> float:
    """Of the disparity at a place of the axis, px squared."""
    a, b = 1 - share, share
    return float(a * a * covariance[2, 2] + 2 * a * b * covariance[2, 5] + b * b * covariance[5, 5])


@lean
def _through(
    samples: Counts, width: Floats, value: Reals, row: int, share: float, own: Floats, other: Floats
) -> float:
    """Share of a part's flanks that are seen where the other crosses it, mean of both pictures."""
    ax, ay, bx, by = own[4] - own[1], own[5] - own[2], other[4] - other[1], other[5] - other[2]
    size = np.hypot(ax, ay)
    sine = abs(ax * by - ay * bx) / (size * np.hypot(bx, by))
    reach = 0.25 * (width[row, 0] + width[row, 1]) / max(sine, 0.15) / size
    total, views = 0.0, 0
    for view in range(2):
        steps = samples[row, view]
        first = max(0, int((share - reach) * steps))
        last = min(steps, int(np.ceil((share + reach) * steps)))
        if last > first:
            seen = 0
            for q in range(first, last):
                for side in range(2):
                    if value[row, view, q, side] > SEEN:
                        seen += 1
            total += seen / (2 * (last - first))
            views += 1
    return total / views if views > 0 else 0.0
