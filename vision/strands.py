"""Whole straight parts in one picture, with their tips.

The pieces of a part are joined (`links`), its line is fitted again to both flanks wherever either is
seen, followed outwards as long as the picture supports it, and its two tips are located where five
lanes fall to background. Everything here is in rectified pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from vision.lines import INNER_LANES, Line, Pieces, end_fall
from vision.links import SHADOW_WIDTHS, join, lie_in, link, measure
from vision.look import Evidence, Look, Run, evidence, refine
from vision.ribbons import ribbons
from vision.stereo import unrectify_points
from vision.types import Bools, Floats, Ints, read_only

FREE_TIP_PX, HALF_TIP_PX, HIDDEN_TIP_PX = 0.25, 0.9, 30.0
"""Deviation along the axis of a tip that is seen whole, seen in part, or lies under something."""
SINGLE_FLANK_BLINDNESS = 0.4
RIBBON_WIDTHS = 1.5
"""The shortest ribbon; shorter ones are mostly corners of crossings."""
OUTER_LANES = (-2.0, 2.0)
"""In half widths: an edge that goes on there is the flank of a part across, not the end of this one."""
DOUBT_WIDTHS = 3.0
"""A tip with foreground ahead of it this near may be the edge of a shadow across the part."""


class Tip(IntEnum):
    """How an end of a strand is seen; HALF is either in part, or with something else close ahead."""

    FREE = 0
    HALF = 1
    HIDDEN = 2
    BORDER = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Strands:
    """Straight parts of one picture, in columns, rectified px.

    ``tips`` (S, 2, 2) both ends; ``kind`` (S, 2) of `Tip`; ``tip_sigma_px`` (S, 2) along the axis;
    ``reach_px`` (S, 2) how far beyond the tip the part could go on under others; ``sure`` (S, 2) False for
    a tip that is half seen or found beyond a stretch that shows nothing, for which ``cautious_tips``
    (S, 2, 2) and ``cautious_reach_px`` (S, 2) say where the part was last seen; ``direction`` (S, 2)
    unit from the first tip to the second; ``line_sigma_px`` (S, 2) across the axis at either tip;
    ``width_px`` (S,); ``seen`` (S,) share of the length at which both flanks are seen.
    """

    tips: Floats
    kind: Ints
    tip_sigma_px: Floats
    reach_px: Floats
    sure: Bools
    cautious_tips: Floats
    cautious_reach_px: Floats
    direction: Floats
    line_sigma_px: Floats
    width_px: Floats
    seen: Floats

    def __len__(self) -> int:
        return len(self.tips)

    @property
    def length_px(self) -> Floats:
        """(S,) distance of the tips."""
        return np.asarray(np.linalg.norm(self.tips[:, 1] - self.tips[:, 0], axis=1), np.float64)


def find_strands(look: Look, pieces: Pieces, grow_px: float, longest_px: float) -> Strands:
    """Whole straight parts of one picture.

    Parameters
    ----------
    look : Look
    pieces : Pieces
        Raw pixels, from the skeleton. Ribbons found by their edges are added where no piece of skeleton
        could be measured: mostly where parts lie side by side and the mask shows them as one.
    grow_px : float
        How far a part is followed beyond its outermost piece,
    longest_px : float
        as long as it is not longer than this.
    """
    runs = measure(look, pieces)
    proposed = measure(look, _ribbons(look))
    told = lie_in(proposed, runs, look.width_px)
    runs += [run for run, known in zip(proposed, told, strict=True) if not known]
    # twice: lines refined on both flanks find partners that lines of short pieces miss
    runs = _refined(look, [join(runs, group) for group in link(look, runs)])
    runs = _longest(runs, look.width_px)
    groups = link(look, runs)
    alone = [runs[group[0]] for group in groups if len(group) == 1]
    runs = alone + _refined(look, [join(runs, group) for group in groups if len(group) > 1])
    rows = [_describe(look, run, grow_px, longest_px) for run in runs]
    return _without_doubles(_columns([row for row in rows if row is not None]), look.width_px)


def _ribbons(look: Look) -> Pieces:
    least_px = max(4.0, RIBBON_WIDTHS * look.width_px)
    return ribbons(look.grey, look.mask, look.width_px, look.slope_floor, least_px)


def _longest(runs: list[Run], width_px: float) -> list[Run]:
    """The runs that no longer ones tell of."""
    kept: list[Run] = []
    for run in sorted(runs, key=lambda run: run.low - run.high):
        if not lie_in([run], kept, width_px)[0]:
            kept.append(run)
    return kept


def _refined(look: Look, runs: list[Run]) -> list[Run]:
    """The lines again, those that their flanks bear out."""
    found = [refine(look, run) for run in runs]
    return [run for run in found if run is not None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Row:
    tips: Floats
    kind: tuple[Tip, Tip]
    reach_px: tuple[float, float]
    sure: tuple[bool, bool]
    cautious_tips: Floats
    cautious_reach_px: tuple[float, float]
    line_sigma_px: tuple[float, float]
    direction: Floats
    width_px: float
    seen: float


def _describe(look: Look, run: Run, grow_px: float, longest_px: float) -> _Row | None:
    window = max(1.2, 0.25 * look.width_px)
    seen = evidence(look, run, run.low - grow_px, run.high + grow_px, window)
    both = seen.has_low & seen.has_high & seen.on
    known = np.flatnonzero(both & (seen.along >= run.low - 0.5) & (seen.along <= run.high + 0.5))
    if len(known) < 3:
        return None
    reach = max(3.0, 6.0 * look.width_px)
    need = round(max(4.0, 0.8 * look.width_px))
    dark = round(max(2.0, SHADOW_WIDTHS * look.width_px))
    inner, outer = int(known[0]), int(known[-1])
    last = _grow(seen, outer, max(outer, inner + round(longest_px)), reach, need, dark)
    first = _grow(seen, inner, min(inner, last - round(longest_px)), reach, need, dark)
    tips, kinds, reaches, sure, cautious, cautious_reaches = [], [], [], [], [], []
    for known_end, grown_end, sign in ((inner, first, -1), (outer, last, 1)):
        place, kind, beyond = _tip(look, run, seen, grown_end, sign)
        tips.append(place)
        kinds.append(kind)
        reaches.append(beyond)
        # without the jumps over stretches that show nothing
        plain_end = _grow(seen, known_end, grown_end, 0.5 * look.width_px, need, 1)
        sure.append(plain_end == grown_end and kind != Tip.HALF)
        cautious.append(float(seen.along[plain_end]))
        cautious_reaches.append(_possible_px(seen, run, plain_end, sign))
    inside = both[first : last + 1]
    return _Row(
        tips=run.at(np.array(tips)),
        kind=(kinds[0], kinds[1]),
        reach_px=(reaches[0], reaches[1]),
        sure=(sure[0], sure[1]),
        cautious_tips=run.at(np.array(cautious)),
        cautious_reach_px=(cautious_reaches[0], cautious_reaches[1]),
        line_sigma_px=(_sigma_at(run.line, tips[0]), _sigma_at(run.line, tips[1])),
        direction=run.line.direction,
        width_px=run.width_px,
        seen=float(inside.mean()),
    )


def _sigma_at(line: Line, along: float) -> float:
    return float(np.sqrt(0.1**2 + line.sigma_px**2 + (line.sigma_rad * along) ** 2))


def _grow(seen: Evidence, at: int, stop: int, reach: float, need: int, dark: int) -> int:
    """Outermost sample still of this part: through foreground, to where both flanks are seen again.

    Not beyond `stop`; blind for at most `reach` samples, of which one with a single flank counts less,
    with at most `dark` of background on end, and only to where both flanks are seen for `need` samples.
    """
    both = (seen.has_low & seen.has_high & seen.on).tolist()
    single = (seen.has_low | seen.has_high).tolist()
    on = seen.on.tolist()
    sign = 1 if stop >= at else -1
    best = at
    run = missing = 0
    blind = 0.0
    for here in range(at + sign, min(max(stop, -1), len(both)) if sign > 0 else max(stop, -1), sign):
        missing = 0 if on[here] else missing + 1
        run = run + 1 if both[here] else 0
        blind += 0.0 if both[here] else (SINGLE_FLANK_BLINDNESS if single[here] else 1.0)
        if missing > dark or blind > reach:
            break
        if run >= need or (run > 0 and abs(here - best) == run):
            best = here
            run = 0
            blind = 0.0
    return best


def _tip(look: Look, run: Run, seen: Evidence, inner: int, sign: int) -> tuple[float, Tip, float]:
    """Place of an end along the line, how it is seen, and how far the part could go on beyond it."""
    width = run.width_px
    outwards = seen.on[inner:] if sign > 0 else seen.on[inner::-1]
    beyond = _foreground_run(outwards, 0)
    reach = _possible_px(seen, run, inner, sign)
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
        if close.sum() >= 2 and clear.sum() >= 2:
            found = guess + sign * float(lanes[close, 0].mean()) / step
            ahead_is_empty = not outwards[int(beyond) + 1 :][: round(DOUBT_WIDTHS * width)].any()
            outside = end_fall(look.grey, pair[0], along, 0.5 * width, max(2.0, 0.8 * width), OUTER_LANES)
            trend = np.polyfit(np.array(INNER_LANES)[close], lanes[close, 0], 1)
            expected = np.polyval(trend, np.array(OUTER_LANES))
            goes_on = (np.abs(outside[:, 0] - expected) < 1.5) & (outside[:, 1] > 2.0 * look.slope_floor)
            if close.sum() >= 4 and clear.sum() >= 4 and ahead_is_empty and not goes_on.any():
                return found, Tip.FREE, 0.0
            return found, Tip.HALF, max(reach - abs(found - start), 0.5 * width)
    return start, Tip.HIDDEN, reach


def _possible_px(seen: Evidence, run: Run, inner: int, sign: int) -> float:
    """How far the part could go on beyond a sample, under others and through their shadows."""
    outwards = seen.on[inner:] if sign > 0 else seen.on[inner::-1]
    return _foreground_run(outwards, round(SHADOW_WIDTHS * run.width_px)) + 0.5 * run.width_px


def _foreground_run(on: Bools, dark: int) -> float:
    """How far foreground goes on from the first sample, over at most `dark` samples of background."""
    last = missing = 0
    for number, lit in enumerate(on.tolist()):
        missing = 0 if lit else missing + 1
        if missing > dark:
            break
        if lit:
            last = number + 1
    return float(last)


def cautious(strands: Strands) -> Strands:
    """The same strands with every tip that is not sure taken back to where the part was last seen."""
    return replace(
        strands,
        tips=read_only(np.where(strands.sure[:, :, None], strands.tips, strands.cautious_tips)),
        kind=read_only(np.where(strands.sure, strands.kind, int(Tip.HIDDEN))),
        tip_sigma_px=read_only(np.where(strands.sure, strands.tip_sigma_px, HIDDEN_TIP_PX)),
        reach_px=read_only(np.where(strands.sure, strands.reach_px, strands.cautious_reach_px)),
    )


def _columns(rows: list[_Row]) -> Strands:
    kind = np.array([row.kind for row in rows], np.int64).reshape(-1, 2)
    sigma = np.array([FREE_TIP_PX, HALF_TIP_PX, HIDDEN_TIP_PX, HIDDEN_TIP_PX])[kind]
    return Strands(
        tips=read_only(np.array([row.tips for row in rows], np.float64).reshape(-1, 2, 2)),
        kind=read_only(kind),
        tip_sigma_px=read_only(sigma),
        reach_px=read_only(np.array([row.reach_px for row in rows], np.float64).reshape(-1, 2)),
        sure=read_only(np.array([row.sure for row in rows], np.bool_).reshape(-1, 2)),
        cautious_tips=read_only(np.array([row.cautious_tips for row in rows], np.float64).reshape(-1, 2, 2)),
        cautious_reach_px=read_only(
            np.array([row.cautious_reach_px for row in rows], np.float64).reshape(-1, 2)
        ),
        direction=read_only(np.array([row.direction for row in rows], np.float64).reshape(-1, 2)),
        line_sigma_px=read_only(np.array([row.line_sigma_px for row in rows], np.float64).reshape(-1, 2)),
        width_px=read_only(np.array([row.width_px for row in rows], np.float64)),
        seen=read_only(np.array([row.seen for row in rows], np.float64)),
    )


def _without_doubles(strands: Strands, width_px: float) -> Strands:
    """Strands that lie along a longer one, or within several, are fragments or their crossing."""
    kept: list[int] = []
    length = strands.length_px
    for number in np.argsort(-length * (0.3 + strands.seen)).tolist():
        if length[number] < 1.5 * width_px:
            continue
        others = np.array(kept, np.int64)
        if not _lies_along(strands, length, number, others, width_px) and not _lies_within(
            strands, length, number, others, width_px
        ):
            kept.append(number)
    return rows_of(strands, np.array(sorted(kept), np.int64))


def rows_of(strands: Strands, rows: Ints) -> Strands:
    """Some strands of many."""
    return Strands(
        tips=read_only(strands.tips[rows]),
        kind=read_only(strands.kind[rows]),
        tip_sigma_px=read_only(strands.tip_sigma_px[rows]),
        reach_px=read_only(strands.reach_px[rows]),
        sure=read_only(strands.sure[rows]),
        cautious_tips=read_only(strands.cautious_tips[rows]),
        cautious_reach_px=read_only(strands.cautious_reach_px[rows]),
        direction=read_only(strands.direction[rows]),
        line_sigma_px=read_only(strands.line_sigma_px[rows]),
        width_px=read_only(strands.width_px[rows]),
        seen=read_only(strands.seen[rows]),
    )


def _lies_along(strands: Strands, length: Floats, number: int, others: Ints, width_px: float) -> bool:
    """True where most of a strand runs along the axis of one of the others."""
    axis, start = strands.direction[others], strands.tips[others, 0]
    relative = strands.tips[number] - start[:, None]
    normal = np.stack([-axis[:, 1], axis[:, 0]], axis=1)
    across = np.abs(np.einsum("otk,ok->ot", relative, normal)).max(axis=1)
    along = np.einsum("otk,ok->ot", relative, axis)
    low, high = along.min(axis=1), along.max(axis=1)
    shared = np.minimum(high, length[others]) - np.maximum(low, 0.0)
    return bool(np.any((across < 0.45 * width_px) & (shared > 0.6 * (high - low))))


def _lies_within(strands: Strands, length: Floats, number: int, others: Ints, width_px: float) -> bool:
    """True where a strand's axis stays inside the bands of longer ones: the merged middle of a crossing."""
    start, end = strands.tips[number]
    points = start + np.linspace(0.1, 0.9, 9)[:, None] * (end - start)
    axis = strands.direction[others]
    relative = points - strands.tips[others, 0][:, None]
    normal = np.stack([-axis[:, 1], axis[:, 0]], axis=1)
    along = np.einsum("opk,ok->op", relative, axis)
    across = np.abs(np.einsum("opk,ok->op", relative, normal))
    inside = (across < 0.55 * width_px) & (along > 0.0) & (along < length[others, None])
    return bool(inside.any(axis=0).all())
