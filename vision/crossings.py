"""Which part lies on which where they cross in the picture, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vision.claims import State
from vision.explain import Frame
from vision.types import Floats

CLOSE_SHARE = 0.05
"""Crossings just beyond an end count: the end itself lies there."""
FLANK_WEIGHT = 3.0
"""How much the share of flanks that go on through a crossing weighs beside depth, in standard deviations."""
LEAST_SIGMA_D = 0.15
"""Disparity of a crossing is never known better than this share of one diameter's."""
MIDDLE = (1.0 / 3.0, 2.0 / 3.0)


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
    above, sure = np.zeros((count, count)), np.zeros((count, count))
    place, gap = np.full((count, count), np.nan), np.zeros((count, count))
    shares, crosses = _meetings(parts)
    for i in range(count):
        for k in np.flatnonzero(crosses[i, i + 1 :]) + i + 1:
            s, t = float(shares[i, k]), float(shares[k, i])
            nearer = (1 - s) * parts[i, 3] + s * parts[i, 6] - (1 - t) * parts[k, 3] - t * parts[k, 6]
            variance = _variance(covariance[i], s) + _variance(covariance[k], t)
            sigma = float(np.sqrt(variance + (LEAST_SIGMA_D * frame.diameter_d) ** 2))
            flanks = 0.0
            if abs(nearer) < FLANK_WEIGHT * sigma:
                flanks = _through(state, rows[i], s, parts[i], parts[k])
                flanks -= _through(state, rows[k], t, parts[k], parts[i])
            z = nearer / sigma + FLANK_WEIGHT * flanks
            place[i, k], place[k, i] = s, t
            gap[i, k], gap[k, i] = nearer, -nearer
            upper, lower = (i, k) if z > 0 else (k, i)
            above[upper, lower] = min(1.0, max(0.1, abs(nearer) / frame.diameter_d))
            sure[upper, lower] = abs(z)
    return Crossed(above=above, sure=sure, place=place, gap=gap)


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
    left = [n for n, good in enumerate(offered) if good]
    weighing = list(range(len(offered)))
    weight = found.above * np.minimum(found.sure, 2.0) / 2.0
    order = []
    while left:
        on = [(round(float(weight[weighing, n].sum()), 3), -float(worth[n]), n) for n in left]
        best = min(on)[2]
        order.append(best)
        left.remove(best)
        weighing.remove(best)
    return order


def _meetings(parts: Floats) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """(C, C) where on the left image of part i it crosses that of k, share of its length; whether it does."""
    start, way = parts[:, 1:3], parts[:, 4:6] - parts[:, 1:3]
    cross = way[:, None, 0] * way[None, :, 1] - way[:, None, 1] * way[None, :, 0]
    away = start[None] - start[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (away[..., 0] * way[None, :, 1] - away[..., 1] * way[None, :, 0]) / cross
    inside = (np.abs(cross) > 1e-6) & (share >= -CLOSE_SHARE) & (share <= 1 + CLOSE_SHARE)
    return np.asarray(share, np.float64), inside & inside.T


def _variance(covariance: Floats, share: float) -> float:
    """Of the disparity at a place of the axis, px squared."""
    a, b = 1 - share, share
    return float(a * a * covariance[2, 2] + 2 * a * b * covariance[2, 5] + b * b * covariance[5, 5])


def _through(state: State, row: int, share: float, own: Floats, other: Floats) -> float:
    """Share of a part's flanks that are seen where the other crosses it, mean of both pictures."""
    a, b = own[4:6] - own[1:3], other[4:6] - other[1:3]
    sine = abs(float(a[0] * b[1] - a[1] * b[0])) / float(np.hypot(*a) * np.hypot(*b))
    reach = 0.5 * float(np.mean(state.width[row])) / max(sine, 0.15) / float(np.hypot(*a))
    seen = []
    for view in range(2):
        steps = int(state.samples[row, view])
        first = max(0, int((share - reach) * steps))
        last = min(steps, int(np.ceil((share + reach) * steps)))
        if last > first:
            seen.append(float((state.value[row, view, first:last] > 0.3).mean()))
    return float(np.mean(seen)) if seen else 0.0
