"""Which part lies on which where they cross in the picture, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vision.claims import State
from vision.edges import Reals
from vision.explain import Frame
from vision.jit import compiled
from vision.types import Bools, Floats, Ints

CLOSE_SHARE = 0.05
"""Crossings just beyond an end count: the end itself lies there."""
FLANK_WEIGHT = 3.0
"""How much the share of flanks that go on through a crossing weighs beside depth, in standard deviations."""
LEAST_SIGMA_D = 0.15
"""Disparity of a crossing is never known better than this share of one diameter's."""
SEEN = 0.3
"""Least strength of a flank that is seen."""
DOUBT_WEIGHT, LEAST_DOUBT = 0.5, 0.05
"""What a crossing weighs on the part that seems to lie above, where nothing tells; less than this is none."""
MIDDLE = (1.0 / 3.0, 2.0 / 3.0)

Counts = npt.NDArray[np.int32]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Crossed:
    """Of C parts: ``above`` (C, C) how much i lies above k where they cross, in diameters, 0 where it does
    not; ``sure`` (C, C) in standard deviations; ``place`` (C, C) where on i, share of its length, NaN
    without a crossing; ``gap`` (C, C) in px of disparity, i nearer positive."""

    above: Floats
    sure: Floats
    place: Floats
    gap: Floats


def crossed(parts: Floats, covariance: Floats, rows: list[int], state: State, frame: Frame) -> Crossed:
    """All crossings of parts (C, `COLUMNS`); ``rows`` are their places in the state."""
    count = len(parts)
    found = Crossed(
        above=np.zeros((count, count)),
        sure=np.zeros((count, count)),
        place=np.full((count, count), np.nan),
        gap=np.zeros((count, count)),
    )
    _cross(
        parts, covariance, np.array(rows, np.int64), state.samples, state.width, state.value,
        frame.diameter_d, found.above, found.sure, found.place, found.gap,
    )  # fmt: skip
    return found


def some_crossed(found: Crossed, count: int) -> Crossed:
    """The crossings among the first ``count`` parts only."""
    return Crossed(
        above=found.above[:count, :count],
        sure=found.sure[:count, :count],
        place=found.place[:count, :count],
        gap=found.gap[:count, :count],
    )


def ranked(found: Crossed, worth: Floats, offered: list[bool]) -> list[int]:
    """Parts in the order in which they can be taken: always one with the least weight on it, then the best.

    Parts that are not offered stay where they are and go on weighing on what is below them.
    """
    weight = found.above * np.minimum(found.sure, 2.0) / 2.0
    # who seems to lie above, but hardly, may lie below: not the one to take before all others
    doubt = np.where(found.above > 0, DOUBT_WEIGHT * np.exp(-0.5 * found.sure**2), 0.0).T.copy()
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
    parts: Floats, covariance: Floats, rows: Ints, samples: Counts, width: Floats, value: Reals,
    diameter_d: float, above: Floats, sure: Floats, place: Floats, gap: Floats,
) -> None:  # fmt: skip
    """Every pair that crosses in the left picture, into tables (C, C)."""
    for i in range(len(parts)):
        for k in range(i + 1, len(parts)):
            s, t = _meeting(parts[i], parts[k]), _meeting(parts[k], parts[i])
            if not (-CLOSE_SHARE <= s <= 1 + CLOSE_SHARE and -CLOSE_SHARE <= t <= 1 + CLOSE_SHARE):
                continue
            nearer = (1 - s) * parts[i, 3] + s * parts[i, 6] - (1 - t) * parts[k, 3] - t * parts[k, 6]
            variance = _variance(covariance[i], s) + _variance(covariance[k], t)
            sigma = np.sqrt(variance + (LEAST_SIGMA_D * diameter_d) ** 2)
            flanks = 0.0
            if abs(nearer) < FLANK_WEIGHT * sigma:
                flanks = _through(samples, width, value, rows[i], s, parts[i], parts[k])
                flanks -= _through(samples, width, value, rows[k], t, parts[k], parts[i])
            z = nearer / sigma + FLANK_WEIGHT * flanks
            place[i, k], place[k, i] = s, t
            gap[i, k], gap[k, i] = nearer, -nearer
            upper, lower = (i, k) if z > 0 else (k, i)
            above[upper, lower] = min(1.0, max(0.1, abs(nearer) / diameter_d))
            sure[upper, lower] = abs(z)


@compiled
def _meeting(own: Floats, other: Floats) -> float:
    """Where on the left image of a part another's line crosses it, share of its length; NaN if along it."""
    ax, ay = own[4] - own[1], own[5] - own[2]
    bx, by = other[4] - other[1], other[5] - other[2]
    cross = ax * by - ay * bx
    if abs(cross) <= 1e-6:
        return np.nan
    return float(((other[1] - own[1]) * by - (other[2] - own[2]) * bx) / cross)


@compiled
def _variance(covariance: Floats, share: float) -> float:
    """Of the disparity at a place of the axis, px squared."""
    a, b = 1 - share, share
    return float(a * a * covariance[2, 2] + 2 * a * b * covariance[2, 5] + b * b * covariance[5, 5])


@compiled
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
