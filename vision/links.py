"""Pieces of skeleton measured on their flanks and grouped into parts that crossings have cut.

Two piece ends are linked when each lies on the other's continuation, to within what the line fits can
tell, and the picture shows foreground all along the gap. Links are made best first, one per end.
"""

from __future__ import annotations

import numpy as np

from vision.lines import Pieces, fit_line, flanks
from vision.look import Look, Run
from vision.stereo import rectify_points
from vision.types import Floats

LINK_CHI2 = 16.0
"""Two pieces may miss each other's continuation by four deviations in all."""
OFFSET_FLOOR_PX = 0.3
ANGLE_FLOOR_RAD = 0.007
"""Lines are never better than this: parts and lenses are not perfectly straight."""
SAME_WIDTHS, SAME_COSINE, SAME_SHARE = 0.4, 0.97, 0.5
"""Two runs tell of one part where they are this near and parallel; a run mostly told of is no other part."""
SAMPLES = 16
GAP_COVER = 0.97
SHADOW_WIDTHS = 1.0
"""Share of a gap that must be foreground, or how much of it may be missing at most, in part widths."""


def measure(look: Look, pieces: Pieces) -> list[Run]:
    """Sub-pixel lines of the pieces; pieces without two flanks at a plausible width are dropped."""
    if len(pieces.start) == 0:
        return []
    chord = pieces.end - pieces.start
    length = np.linalg.norm(chord, axis=1)
    counts = np.maximum(np.ceil(length).astype(np.int64), 3)
    owner = np.repeat(np.arange(len(counts)), counts)
    share = np.concatenate([np.linspace(0.0, 1.0, n) for n in counts])
    along = chord / length[:, None]
    at = pieces.start[owner] + share[:, None] * chord[owner]
    normal = np.stack([-along[owner, 1], along[owner, 0]], axis=1)
    half = 0.5 * look.width_px
    found = flanks(look.grey, at, normal, half, max(1.5, 0.45 * look.width_px))
    width = found.high_px - found.low_px
    good = np.minimum(found.low_slope, found.high_slope) > look.slope_floor
    good &= (width > 0.55 * look.width_px) & (width < 1.5 * look.width_px)
    centre = at + (0.5 * (found.low_px + found.high_px))[:, None] * normal
    rectified = rectify_points(centre, look.rect, look.side)
    runs = []
    for number in range(len(counts)):
        mine = (owner == number) & good
        if mine.sum() < max(3, 0.3 * counts[number]):
            continue
        points = rectified[mine]
        weights = np.ones(len(points))
        line = fit_line(points, weights)
        if line is None or line.scale_px > max(0.8, 0.2 * look.width_px):
            continue
        t = (points - line.origin) @ line.direction
        runs.append(
            Run(
                line=line,
                low=float(t.min()),
                high=float(t.max()),
                width_px=float(np.median(width[mine])),
                points=points,
                weights=weights,
            )
        )
    return runs


def lie_in(runs: list[Run], others: list[Run], width_px: float) -> list[bool]:
    """Of each run, whether most of it is also told by others of about its line."""
    if not others:
        return [False] * len(runs)
    origin = np.array([other.line.origin for other in others])
    direction = np.array([other.line.direction for other in others])
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=1)
    low = np.array([other.low for other in others]) - 1.0
    high = np.array([other.high for other in others]) + 1.0
    told = []
    for run in runs:
        same = np.abs(direction @ run.line.direction) > SAME_COSINE
        relative = run.at(np.linspace(run.low, run.high, SAMPLES))[None] - origin[same, None]
        along = np.einsum("opk,ok->op", relative, direction[same])
        across = np.abs(np.einsum("opk,ok->op", relative, normal[same]))
        inside = (across < SAME_WIDTHS * width_px) & (along > low[same, None]) & (along < high[same, None])
        told.append(bool(inside.any(axis=0).mean() > SAME_SHARE))
    return told


def link(look: Look, runs: list[Run]) -> list[list[int]]:
    """Groups of runs that are one part, by links between their ends, best first."""
    count = len(runs)
    if count == 0:
        return []
    direction = np.array([run.line.direction for run in runs])
    outward = np.concatenate([-direction, direction])
    tip = np.concatenate([[run.at(np.array([t]))[0] for run, t in _both(runs, side)] for side in (0, 1)])
    length = np.tile(np.array([run.high - run.low for run in runs]), 2)
    offset = np.tile(np.array([run.line.sigma_px for run in runs]), 2)
    slope = np.tile(np.array([run.line.sigma_rad for run in runs]), 2)
    owner = np.tile(np.arange(count), 2)
    gap = tip[None, :, :] - tip[:, None, :]
    ahead = np.einsum("ijk,ik->ij", gap, outward)
    back = np.einsum("ijk,jk->ij", -gap, outward)
    cosine = outward @ outward.T
    angle = np.arccos(np.clip(-cosine, -1.0, 1.0))
    normal = np.stack([-outward[:, 1], outward[:, 0]], axis=1)
    # half way: what the extrapolations of both lines differ by
    miss = np.einsum("ijk,ik->ij", gap, normal) - 0.5 * ahead * np.sin(_turn(outward, -outward))
    lever = 0.5 * length + 0.5 * np.abs(ahead)
    spread = OFFSET_FLOOR_PX**2 + offset[:, None] ** 2 + offset[None, :] ** 2
    spread = spread + (lever * slope[:, None]) ** 2 + (lever * slope[None, :]) ** 2
    turn = ANGLE_FLOOR_RAD**2 + slope[:, None] ** 2 + slope[None, :] ** 2
    chi2 = miss**2 / spread + angle**2 / turn
    least = -1.5 * look.width_px
    possible = (owner[:, None] < owner[None, :]) & (ahead > least) & (back > least) & (angle < 0.25)
    possible &= chi2 < LINK_CHI2
    possible &= np.abs(miss) < 0.5 * look.width_px
    firsts, seconds = np.nonzero(possible)
    order = np.argsort(chi2[firsts, seconds] + 0.02 * np.maximum(ahead[firsts, seconds], 0.0))
    taken = np.zeros(2 * count, np.bool_)
    group = list(range(count))
    for a, b in zip(firsts[order].tolist(), seconds[order].tolist(), strict=True):
        if taken[a] or taken[b] or _find(group, owner[a]) == _find(group, owner[b]):
            continue
        if ahead[a, b] > 0 and not _covered(look, tip[a], tip[b]):
            continue
        taken[a] = taken[b] = True
        group[_find(group, owner[a])] = _find(group, owner[b])
    members: dict[int, list[int]] = {}
    for number in range(count):
        members.setdefault(_find(group, number), []).append(number)
    return list(members.values())


def _both(runs: list[Run], side: int) -> list[tuple[Run, float]]:
    return [(run, run.low if side == 0 else run.high) for run in runs]


def _turn(first: Floats, second: Floats) -> Floats:
    """(N, M) signed angle from first (N, 2) to second (M, 2)."""
    sine = first[:, None, 0] * second[None, :, 1] - first[:, None, 1] * second[None, :, 0]
    return np.asarray(np.arctan2(sine, first @ second.T), np.float64)


def _find(group: list[int], item: int) -> int:
    while group[item] != item:
        item = group[item]
    return item


def _covered(look: Look, start_px: Floats, end_px: Floats) -> bool:
    """Foreground all along a gap, on its axis and a quarter width to both sides."""
    gap = end_px - start_px
    length = float(np.hypot(*gap))
    if length < 1.0:
        return True
    normal = np.array([-gap[1], gap[0]]) / length
    along = start_px + np.linspace(0.0, 1.0, int(np.ceil(length)) + 1)[:, None] * gap
    lanes = np.stack([along + s * look.width_px * normal for s in (-0.25, 0.0, 0.25)])
    on = look.mask_at(lanes.reshape(-1, 2)).reshape(3, -1)
    # a shadow beside what lies over the part may break its foreground for less than a width
    missing_px = (~on).sum(axis=1) * length / on.shape[1]
    return bool(np.median(missing_px) <= max(SHADOW_WIDTHS * look.width_px, (1.0 - GAP_COVER) * length))


def join(runs: list[Run], group: list[int]) -> Run:
    if len(group) == 1:
        return runs[group[0]]
    longest = max((runs[n] for n in group), key=lambda run: run.high - run.low)
    points = np.concatenate([runs[n].points for n in group])
    points = points[np.argsort(points @ longest.line.direction)]
    weights = np.ones(len(points))
    line = fit_line(points, weights) or longest.line
    t = (points - line.origin) @ line.direction
    width = float(np.average([runs[n].width_px for n in group], weights=[len(runs[n].points) for n in group]))
    return Run(
        line=line, low=float(t.min()), high=float(t.max()), width_px=width, points=points, weights=weights
    )
