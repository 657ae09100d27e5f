"""Pieces of skeleton joined through crossings into whole straight parts, with their tips.

Two piece ends are linked when each lies on the other's continuation, to within what the line fits can
tell, and the picture shows foreground all along the gap. Links are made best first, one per end. The
line of the whole is then fitted again to both flanks wherever either is seen, followed outwards as
long as the picture supports it, and its two tips are located where five lanes fall to background.

Everything here is in rectified pixels; the picture is read through the rectification point by point.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from vision.lines import Line, Picture, Pieces, end_fall, fit_line, flanks
from vision.stereo import Rectification, Side, rectify_points, unrectify_points
from vision.types import Bools, Floats, Ints, Mask, read_only

LINK_CHI2 = 16.0
"""Two pieces may miss each other's continuation by four deviations in all."""
OFFSET_FLOOR_PX = 0.3
ANGLE_FLOOR_RAD = 0.007
"""Lines are never better than this: parts and lenses are not perfectly straight."""
GAP_COVER = 0.95
FREE_TIP_PX, HALF_TIP_PX, HIDDEN_TIP_PX = 0.4, 0.9, 30.0
"""Deviation along the axis of a tip that is seen whole, seen in part, or lies under something."""


class Tip(IntEnum):
    """How an end of a strand is seen."""

    FREE = 0
    HALF = 1
    HIDDEN = 2
    BORDER = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Look:
    """One picture and what is needed to read it.

    ``grey`` (H, W) float32 raw; ``mask`` (H, W) raw; ``width_px`` expected width of a part;
    ``contrast_grey`` what parts stand out by.
    """

    grey: Picture
    mask: Mask
    rect: Rectification
    side: Side
    width_px: float
    contrast_grey: float

    @property
    def slope_floor(self) -> float:
        """Least steepness of a flank, grey per px."""
        return max(3.0, 0.06 * self.contrast_grey)

    def raw_mask_at(self, raw_px: Floats) -> Bools:
        """(N,) the mask at the nearest pixel of raw points (N, 2); outside the picture False."""
        column = np.rint(raw_px[:, 0]).astype(np.int64)
        row = np.rint(raw_px[:, 1]).astype(np.int64)
        rows, columns = self.mask.shape
        inside = (column >= 0) & (row >= 0) & (column < columns) & (row < rows)
        found = self.mask[np.clip(row, 0, rows - 1), np.clip(column, 0, columns - 1)]
        return np.asarray(inside & found, np.bool_)

    def mask_at(self, points_px: Floats) -> Bools:
        """(N,) the mask at rectified points (N, 2)."""
        return self.raw_mask_at(unrectify_points(points_px, self.rect, self.side))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Strands:
    """Straight parts of one picture, in columns, rectified px.

    ``tips`` (S, 2, 2) both ends; ``kind`` (S, 2) of `Tip`; ``tip_sigma_px`` (S, 2) along the axis;
    ``reach_px`` (S, 2) how far beyond the tip the part could go on under others; ``direction`` (S, 2)
    unit from the first tip to the second; ``line_sigma_px`` (S, 2) across the axis at either tip;
    ``width_px`` (S,); ``seen`` (S,) share of the length at which both flanks are seen;
    ``middle_seen`` (S,) the same of the middle third.
    """

    tips: Floats
    kind: Ints
    tip_sigma_px: Floats
    reach_px: Floats
    direction: Floats
    line_sigma_px: Floats
    width_px: Floats
    seen: Floats
    middle_seen: Floats

    def __len__(self) -> int:
        return len(self.tips)

    @property
    def length_px(self) -> Floats:
        """(S,) distance of the tips."""
        return np.asarray(np.linalg.norm(self.tips[:, 1] - self.tips[:, 0], axis=1), np.float64)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Run:
    """A line with the interval of it that is known to be part, measured from its origin."""

    line: Line
    low: float
    high: float
    width_px: float
    points: Floats
    weights: Floats

    def at(self, along: Floats) -> Floats:
        return self.line.origin + along[:, None] * self.line.direction


def find_strands(look: Look, pieces: Pieces, grow_px: float) -> Strands:
    """Whole straight parts of one picture.

    Parameters
    ----------
    look : Look
    pieces : Pieces
        Raw pixels.
    grow_px : float
        How far a part is followed beyond its outermost piece.
    """
    runs = _measure(look, pieces)
    joined = [_join(runs, group) for group in _link(look, runs)]
    rows = []
    for run in joined:
        refined = _refine(look, run)
        if refined is not None:
            rows.append(_describe(look, refined, grow_px))
    return _without_doubles(_columns([row for row in rows if row is not None]), look.width_px)


def _measure(look: Look, pieces: Pieces) -> list[_Run]:
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
            _Run(
                line=line,
                low=float(t.min()),
                high=float(t.max()),
                width_px=float(np.median(width[mine])),
                points=points,
                weights=weights,
            )
        )
    return runs


def _link(look: Look, runs: list[_Run]) -> list[list[int]]:
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


def _both(runs: list[_Run], side: int) -> list[tuple[_Run, float]]:
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
    on = look.mask_at(lanes.reshape(-1, 2)).reshape(3, -1).mean(axis=1)
    return bool(on[1] >= GAP_COVER and on.min() >= 0.75)


def _join(runs: list[_Run], group: list[int]) -> _Run:
    if len(group) == 1:
        return runs[group[0]]
    longest = max((runs[n] for n in group), key=lambda run: run.high - run.low)
    points = np.concatenate([runs[n].points for n in group])
    points = points[np.argsort(points @ longest.line.direction)]
    weights = np.ones(len(points))
    line = fit_line(points, weights) or longest.line
    t = (points - line.origin) @ line.direction
    width = float(np.average([runs[n].width_px for n in group], weights=[len(runs[n].points) for n in group]))
    return _Run(
        line=line, low=float(t.min()), high=float(t.max()), width_px=width, points=points, weights=weights
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Evidence:
    """What the picture shows along a line: ``along`` (N,) px from its origin; ``low``, ``high`` (N,)
    offsets of the flanks in rectified px; ``has_low``, ``has_high``, ``on`` (N,) bool."""

    along: Floats
    low: Floats
    high: Floats
    has_low: Bools
    has_high: Bools
    on: Bools


def _evidence(look: Look, run: _Run, low: float, high: float, window_px: float) -> _Evidence:
    along = np.arange(low, high + 0.5, 1.0)
    at = run.at(along)
    both = unrectify_points(np.concatenate([at, at + run.line.normal]), look.rect, look.side)
    raw, aside = both[: len(at)], both[len(at) :] - both[: len(at)]
    scale = np.linalg.norm(aside, axis=1)
    half = 0.5 * run.width_px
    found = flanks(look.grey, raw, aside / scale[:, None], half, window_px)
    on = look.raw_mask_at(raw)
    floor = look.slope_floor
    # at either end of the window the slope still rises outwards: that flank is somebody else's
    edge = window_px - 0.25
    return _Evidence(
        along=along,
        low=found.low_px / scale,
        high=found.high_px / scale,
        has_low=(found.low_slope > floor) & (np.abs(found.low_px + half) < edge),
        has_high=(found.high_slope > floor) & (np.abs(found.high_px - half) < edge),
        on=on,
    )


def _refine(look: Look, run: _Run) -> _Run | None:
    """The line again, to both flanks where both are seen and to one, half a width off, where only one is."""
    for window in (max(1.5, 0.35 * look.width_px), max(1.0, 0.2 * look.width_px)):
        seen = _evidence(look, run, run.low, run.high, window)
        both = seen.has_low & seen.has_high & seen.on
        if both.sum() < 3:
            return None
        half = 0.5 * float(np.median((seen.high - seen.low)[both]))
        centre = 0.5 * (seen.low + seen.high)
        centre = np.where(both, centre, np.where(seen.has_low, seen.low + half, seen.high - half))
        used = seen.on & (seen.has_low | seen.has_high)
        points = (run.at(seen.along) + centre[:, None] * run.line.normal)[used]
        weights = np.where(both, 1.0, 0.25)[used]
        line = fit_line(points, weights)
        if line is None:
            return None
        t = (points - line.origin) @ line.direction
        run = _Run(
            line=line,
            low=float(t.min()),
            high=float(t.max()),
            width_px=2.0 * half,
            points=points,
            weights=weights,
        )
    return run


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Row:
    tips: Floats
    kind: tuple[Tip, Tip]
    reach_px: tuple[float, float]
    line_sigma_px: tuple[float, float]
    direction: Floats
    width_px: float
    seen: float
    middle_seen: float


def _describe(look: Look, run: _Run, grow_px: float) -> _Row | None:
    window = max(1.2, 0.25 * look.width_px)
    seen = _evidence(look, run, run.low - grow_px, run.high + grow_px, window)
    both = seen.has_low & seen.has_high & seen.on
    known = np.flatnonzero(both & (seen.along >= run.low - 0.5) & (seen.along <= run.high + 0.5))
    if len(known) < 3:
        return None
    reach = round(max(3.0, 6.0 * look.width_px))
    need = round(max(4.0, 0.8 * look.width_px))
    last = _grow(both, seen.on, int(known[-1]), 1, reach, need)
    first = _grow(both, seen.on, int(known[0]), -1, reach, need)
    tips, kinds, reaches = [], [], []
    for inner, sign in ((first, -1), (last, 1)):
        place, kind, beyond = _tip(look, run, seen, inner, sign)
        tips.append(place)
        kinds.append(kind)
        reaches.append(beyond)
    inside = both[first : last + 1]
    third = len(inside) // 3
    middle = inside[third : len(inside) - third]
    return _Row(
        tips=run.at(np.array(tips)),
        kind=(kinds[0], kinds[1]),
        reach_px=(reaches[0], reaches[1]),
        line_sigma_px=(_sigma_at(run.line, tips[0]), _sigma_at(run.line, tips[1])),
        direction=run.line.direction,
        width_px=run.width_px,
        seen=float(inside.mean()),
        middle_seen=float(middle.mean()) if len(middle) else 0.0,
    )


def _sigma_at(line: Line, along: float) -> float:
    return float(np.sqrt(0.1**2 + line.sigma_px**2 + (line.sigma_rad * along) ** 2))


def _grow(both: Bools, on: Bools, at: int, sign: int, reach: int, need: int) -> int:
    """Outermost sample still of this part: through foreground, to where both flanks are seen again."""
    size = len(both)
    best = at
    here = at + sign
    run = 0
    while 0 <= here < size and on[here] and abs(here - best) <= reach:
        if both[here]:
            run += 1
            if run >= need or abs(here - best) == run:
                best = here
                run = 0
        else:
            run = 0
        here += sign
    return best


def _tip(look: Look, run: _Run, seen: _Evidence, inner: int, sign: int) -> tuple[float, Tip, float]:
    """Place of an end along the line, how it is seen, and how far the part could go on beyond it."""
    width = run.width_px
    off = inner
    while 0 <= off < len(seen.on) and seen.on[off]:
        off += sign
    beyond = float(abs(off - inner))
    start = float(seen.along[inner])
    guess = start + sign * min(beyond, 0.5 * width)
    axis = sign * run.line.direction
    pair = unrectify_points(run.at(np.array([guess, guess + sign])), look.rect, look.side)
    rows, columns = look.mask.shape
    u, v = pair[0]
    if not (width < u < columns - 1 - width and width < v < rows - 1 - width):
        return start, Tip.BORDER, float("inf")
    step = float(np.hypot(*(pair[1] - pair[0])))
    along = (pair[1] - pair[0]) / step
    lanes = end_fall(look.grey, pair[0], along, 0.5 * width, max(2.0, 0.8 * width))
    strong = lanes[:, 1] > 2.0 * look.slope_floor
    if strong.sum() >= 2 and beyond <= 1.2 * width + 2.0:
        place = float(np.median(lanes[strong, 0])) / step
        close = strong & (np.abs(lanes[:, 0] / step - place) < max(1.0, 0.2 * width))
        past = run.at(np.array([guess + sign * (place + 0.6 * width)]))[0]
        normal = np.array([-axis[1], axis[0]])
        ahead = np.stack([past + s * width * normal for s in (-0.3, -0.15, 0.0, 0.15, 0.3)])
        clear = ~look.mask_at(ahead)
        if close.sum() >= 4 and clear.sum() >= 4:
            return guess + sign * float(lanes[close, 0].mean()) / step, Tip.FREE, 0.0
        if close.sum() >= 2 and clear.sum() >= 2:
            return guess + sign * float(lanes[close, 0].mean()) / step, Tip.HALF, 0.5 * width
    return start, Tip.HIDDEN, beyond + 0.5 * width


def _columns(rows: list[_Row]) -> Strands:
    kind = np.array([row.kind for row in rows], np.int64).reshape(-1, 2)
    sigma = np.array([FREE_TIP_PX, HALF_TIP_PX, HIDDEN_TIP_PX, HIDDEN_TIP_PX])[kind]
    return Strands(
        tips=read_only(np.array([row.tips for row in rows], np.float64).reshape(-1, 2, 2)),
        kind=read_only(kind),
        tip_sigma_px=read_only(sigma),
        reach_px=read_only(np.array([row.reach_px for row in rows], np.float64).reshape(-1, 2)),
        direction=read_only(np.array([row.direction for row in rows], np.float64).reshape(-1, 2)),
        line_sigma_px=read_only(np.array([row.line_sigma_px for row in rows], np.float64).reshape(-1, 2)),
        width_px=read_only(np.array([row.width_px for row in rows], np.float64)),
        seen=read_only(np.array([row.seen for row in rows], np.float64)),
        middle_seen=read_only(np.array([row.middle_seen for row in rows], np.float64)),
    )


def _without_doubles(strands: Strands, width_px: float) -> Strands:
    """Strands that lie along a longer one are its own fragments."""
    kept: list[int] = []
    length = strands.length_px
    for number in np.argsort(-length * (0.3 + strands.seen)).tolist():
        if length[number] < 1.5 * width_px:
            continue
        if not any(_lies_along(strands, number, other, width_px) for other in kept):
            kept.append(number)
    rows = np.array(sorted(kept), np.int64)
    return Strands(
        tips=read_only(strands.tips[rows]),
        kind=read_only(strands.kind[rows]),
        tip_sigma_px=read_only(strands.tip_sigma_px[rows]),
        reach_px=read_only(strands.reach_px[rows]),
        direction=read_only(strands.direction[rows]),
        line_sigma_px=read_only(strands.line_sigma_px[rows]),
        width_px=read_only(strands.width_px[rows]),
        seen=read_only(strands.seen[rows]),
        middle_seen=read_only(strands.middle_seen[rows]),
    )


def _lies_along(strands: Strands, number: int, other: int, width_px: float) -> bool:
    axis = strands.direction[other]
    relative = strands.tips[number] - strands.tips[other, 0]
    across = np.abs(relative @ np.array([-axis[1], axis[0]]))
    along = np.sort(relative @ axis)
    length = float(strands.length_px[other])
    shared = min(along[1], length) - max(along[0], 0.0)
    return bool(across.max() < 0.45 * width_px and shared > 0.6 * (along[1] - along[0]))
