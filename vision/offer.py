"""Measured parts to candidates: what may be picked and in which order; each refusal with its number."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from vision.canvas import in_space
from vision.colour import Colour, among_colours, colour_of
from vision.crossings import Crossed, ranked
from vision.edges import Reals
from vision.explain import PLAIN_END, Explanation, Frame, along_baseline
from vision.jit import compiled
from vision.polish import BEYOND_SHARES, SEEN, Measured, sigmas
from vision.refine import KIND, UNIT
from vision.sizes import LEAST_LEAD, Size, size_of
from vision.types import (
    Bools,
    Candidate,
    Crossing,
    Floats,
    Ints,
    PartModel,
    Plane,
    Refusal,
    Refused,
    Tuning,
    read_only,
)

GOES_ON = 0.3
"""A part whose flanks go on beyond an unseen end on this share of the way is longer than it should be."""
LEAST_BOTH = 0.15
"""Least share of a part along which both its flanks are clearly seen: one edge alone is anything, and the
grain of what lies beside it makes faint ones."""
WIDTH_SHARE = (0.72, 1.25)
BOW_WIDTHS = 0.09
OUTSIDE_SHARE = 0.02
NEAR_LENGTHS = 1.6
"""Parts longer or shorter than this many times the product are somebody else's, not refused ones."""
WORTH_OF_SCORE = (0.15, 1.0)
"""Evidence, in lengths and view, at a score of 0.3 (the least that is taken) and of 1."""
DOUBT_DIAMETERS = 0.3
"""Of two parts with nothing on them the better known goes first; a centre known only to this counts half."""
VAGUE_WEIGHT, HAUNTED_WEIGHT = 1.0, 0.6
SEEN_END, UNSEEN_WEIGHT, BLIND_WEIGHT = 0.05, 0.06, 0.3
"""Least strength of an end that is seen; what it weighs that two or more of four are not, or that one picture
shows none."""
HALF_SEEN, HALF_SEEN_WEIGHT = 0.5, 0.3
FLAT_WEIGHT, STRAINED, STRAINED_WEIGHT = 0.2, 5.0, 0.15
"""What it weighs that a part lies along the baseline and not all its ends are clear, and that its flanks
contradict each other so many times more than they should. Weights are about the share of parts with that sign
over which nothing seems to lie and which are wrong. `bench.doubts` counted in 960 heaps 3,055 such parts, 73
wrong; of 59 blind ones 15, of 17 half seen ones 6, of 179 strained ones 21; and in 600 of these heaps of 151
along the baseline 17, of 97 others there 3."""
VAGUE_DIAMETERS = 1.0
"""A centre that is not known better than this would be gripped above or below."""
MOST_ROW_OFFSET_PX = 3.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Offered:
    """``candidates`` in order; ``crossings`` among them; ``rows`` (K,) the measured part of each."""

    candidates: tuple[Candidate, ...]
    crossings: tuple[Crossing, ...]
    rows: list[int]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Seen:
    """Of C measured parts: ``ends_m`` (C, 2, 3), ``centre_m``, ``axis`` (C, 3), ``length_m`` (C,) and both
    deviations (C,); ``both`` share with both flanks; ``outside`` share off the picture; ``over_middle`` how
    many parts lie over the middle third; ``lowest_m``, ``highest_m`` of the ends above the table, or their
    depth; ``tilt_rad`` to the table."""

    ends_m: Floats
    centre_m: Floats
    axis: Floats
    length_m: Floats
    sigma_m: Floats
    sigma_rad: Floats
    both: Floats
    outside: Floats
    over_middle: Ints
    lowest_m: Floats
    highest_m: Floats
    tilt_rad: Floats


def candidates(
    measured: Measured,
    found: Explanation,
    over: Crossed,
    frame: Frame,
    tuning: Tuning,
    table: Plane | None,
    colour: Colour | None,
    row_offset_px: float,
    sizes: tuple[Size, ...] = (),
    ahead: Floats | None = None,
    haunted: Bools | None = None,
) -> Offered:
    """Every part near a product's length: offered ones first, those with nothing on them before others.

    ``sizes`` the products of the look, by the kind of their hypotheses, and ``ahead`` (C,) what each part
    explains more than one of another size would; without them the one of the frame. ``haunted`` (C,) whether
    something may lie over it that is not certain enough to be told, see `vision.ghosts`.
    """
    sizes = sizes or (Size(parts=(frame.part,), frame=frame),)
    bounds = _bounds_m(frame.part, tuning, table)
    seen = _seen(measured, found, over, frame, table if tuning.depth_m is None else None, table)
    made: list[tuple[int, Candidate]] = []
    for row, length in enumerate(seen.length_m.tolist()):
        of = size_of(measured.parts[row, KIND], length, sizes)
        known_m = of.frame.part.length_m
        if not known_m / NEAR_LENGTHS < length < known_m * NEAR_LENGTHS:
            continue
        one = _candidate(row, seen, measured, found, of, tuning, bounds, colour, row_offset_px)
        if ahead is not None and ahead[row] < LEAST_LEAD:
            either = Refused(reason=Refusal.AMBIGUOUS, value=float(ahead[row]), limit=LEAST_LEAD, unit="1")
            one = replace(one, refusals=(*one.refusals, either))
        made.append((row, one))
    known = dict(made)
    count = len(measured.parts)
    is_product = [row in known and known[row].recognised for row in range(count)]
    doubt = seen.sigma_m / (DOUBT_DIAMETERS * frame.part.diameter_m)
    unsure = VAGUE_WEIGHT * (seen.sigma_m / (VAGUE_DIAMETERS * frame.part.diameter_m)) ** 2
    unsure = unsure + _barely_seen(found) + STRAINED_WEIGHT * (measured.strain > STRAINED)
    if haunted is not None:
        unsure = unsure + HAUNTED_WEIGHT * haunted
    order = ranked(over, found.margin / (1.0 + doubt**2), is_product, unsure)
    order = sorted(order, key=lambda row: not known[row].offered)
    rest = sorted((row for row in known if not is_product[row]), key=lambda row: -known[row].score)
    rows = [*order, *rest]
    place = {row: n for n, row in enumerate(rows)}
    return Offered(
        candidates=tuple(known[row] for row in rows),
        crossings=_crossings(measured, over, frame, place),
        rows=rows,
    )


class HowSeen(NamedTuple):
    """Of C parts: ``blind`` one picture shows no end at all; ``lacking`` two or more of the four ends in both
    pictures are not seen; ``half_seen`` a picture shows both flanks on less than half of it; ``flat`` it lies
    along the baseline and not all of the four are seen clearly. All (C,)."""

    blind: Bools
    lacking: Bools
    half_seen: Bools
    flat: Bools


def how_seen(found: Explanation) -> HowSeen:
    """Of which of the chosen parts too little is seen: perhaps one picture shows another part there, or
    something lies over it."""
    seen, rows = found.seen, found.chosen
    clear = seen.tip_value[rows].mean(axis=3)
    end = clear >= SEEN_END
    both = (seen.value[rows] > 0).all(axis=3).sum(axis=2) / seen.count[rows]
    return HowSeen(
        blind=~end.any(axis=2).all(axis=1),
        lacking=(~end).sum(axis=(1, 2)) >= 2,
        half_seen=both.min(axis=1) < HALF_SEEN,
        flat=along_baseline(found.hypotheses[rows]) & (clear < PLAIN_END).any(axis=(1, 2)),
    )


def _barely_seen(found: Explanation) -> Floats:
    """(C,) doubt about parts of which too little is seen."""
    of = how_seen(found)
    doubt = np.where(of.blind, BLIND_WEIGHT, np.where(of.lacking, UNSEEN_WEIGHT, 0.0))
    return np.asarray(doubt + HALF_SEEN_WEIGHT * of.half_seen + FLAT_WEIGHT * of.flat, np.float64)


def _seen(
    measured: Measured,
    found: Explanation,
    over: Crossed,
    frame: Frame,
    floor: Plane | None,
    table: Plane | None,
) -> _Seen:
    """``floor`` what heights are above; without it the depth counts."""
    rows = np.array(found.chosen, np.int64)
    ends = read_only(in_space(measured.parts[:, 1:7].reshape(-1, 2, 3), frame.on))
    way = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(way, axis=1)
    doubt = measured.covariance * measured.strain[:, None, None]
    sigma_m, sigma_rad = sigmas(measured.parts, doubt, frame)
    both, outside = _coverage(rows, found.seen.count, found.seen.value, found.seen.ground)
    height = ends[..., 2] if floor is None else ends @ floor.normal + floor.offset_m
    up = np.array([0.0, 0.0, -1.0]) if table is None else table.normal
    return _Seen(
        ends_m=ends,
        centre_m=read_only(ends.mean(axis=1)),
        axis=read_only(way / length[:, None]),
        length_m=length,
        sigma_m=sigma_m,
        sigma_rad=sigma_rad,
        both=both,
        outside=outside,
        over_middle=(over.middle & (over.above.T > 0)).sum(axis=1),
        lowest_m=height.min(axis=1),
        highest_m=height.max(axis=1),
        tilt_rad=np.arcsin(np.minimum(1.0, np.abs(way @ up) / length)),
    )


@compiled
def _coverage(
    rows: Ints, count: npt.NDArray[np.int32], value: Reals, ground: npt.NDArray[np.uint8]
) -> tuple[Floats, Floats]:
    """(C,) mean share of the samples of both views with both flanks, `SEEN` or more; the larger share off the
    picture."""
    both, outside = np.zeros(len(rows)), np.zeros(len(rows))
    for place in range(len(rows)):
        k = rows[place]
        for view in range(2):
            steps = count[k, view]
            flanks = off = 0
            for q in range(steps):
                if value[k, view, q, 0] > SEEN and value[k, view, q, 1] > SEEN:
                    flanks += 1
                if ground[k, view, q] == 2:
                    off += 1
            both[place] += 0.5 * flanks / steps
            outside[place] = max(outside[place], off / steps)
    return both, outside


def _candidate(
    row: int,
    seen: _Seen,
    measured: Measured,
    found: Explanation,
    size: Size,
    tuning: Tuning,
    bounds: tuple[float, float] | None,
    colour: Colour | None,
    row_offset_px: float,
) -> Candidate:
    k = found.chosen[row]
    shade = None
    if colour is not None and any(part.colour is not None for part in size.parts):
        shade = colour_of(measured.parts[row], found, k, colour, size.frame)
    part, other_colour = among_colours(shade, size.parts)
    frame = size.frame if part is size.frame.part else replace(size.frame, part=part)
    ends, length, sigma_m = seen.ends_m[row], float(seen.length_m[row]), float(seen.sigma_m[row])
    worth = float(found.margin[row]) / (2 * frame.length_px)
    low, high = WORTH_OF_SCORE
    score = min(1.0, max(0.0, 0.3 + 0.7 * (worth - low) / (high - low)))
    reasons = _shape_reasons(row, k, seen, measured, found, frame)
    reasons += _place_reasons(row, seen, bounds, tuning.max_tilt_rad)
    reasons += other_colour
    crossing = int(seen.over_middle[row])
    if crossing > 0:
        reasons.append(Refused(reason=Refusal.CROSSED, value=float(crossing), limit=0.0, unit="1"))
    vague = VAGUE_DIAMETERS * part.diameter_m
    if sigma_m > vague:
        reasons.append(Refused(reason=Refusal.VAGUE, value=sigma_m, limit=vague, unit="m"))
    if abs(row_offset_px) > MOST_ROW_OFFSET_PX:
        reasons.append(Refused(reason=Refusal.ROWS, value=row_offset_px, limit=MOST_ROW_OFFSET_PX, unit="px"))
    if score < tuning.min_score - 1e-9:
        reasons.append(Refused(reason=Refusal.LOW_SCORE, value=score, limit=tuning.min_score, unit="1"))
    return Candidate(
        part_code=part.code,
        start=ends[0],
        end=ends[1],
        centre=seen.centre_m[row],
        axis=seen.axis[row],
        length_m=length,
        nodes=ends,
        score=score,
        residual_px=float(measured.bow_px[row]),
        refusals=tuple(reasons),
        sigma_m=sigma_m,
        sigma_rad=float(seen.sigma_rad[row]),
        width_m=_width(row, k, measured, found, frame) * part.diameter_m,
    )


def _shape_reasons(
    row: int, k: int, seen: _Seen, measured: Measured, found: Explanation, frame: Frame
) -> list[Refused]:
    """Length, width, flanks, straightness, border."""
    part = frame.part
    reasons = []
    length_m, free_m = float(seen.length_m[row]), float(measured.free_length_m[row])
    long_m = length_m if measured.parts[row, KIND] < 0 or not np.isfinite(free_m) else free_m
    error = long_m - part.length_m
    if abs(error) > part.length_tolerance_m or measured.parts[row, KIND] < 0:
        limit = part.length_m + float(np.copysign(part.length_tolerance_m, error))
        reasons.append(Refused(reason=Refusal.LENGTH, value=long_m, limit=limit, unit="m"))
    elif measured.goes_on[row] > GOES_ON:
        limit = part.length_m + part.length_tolerance_m
        reasons.append(
            Refused(reason=Refusal.LENGTH, value=length_m * (1 + BEYOND_SHARES[1]), limit=limit, unit="m")
        )
    width = _width(row, k, measured, found, frame)
    low, high = WIDTH_SHARE
    if not low < width < high:
        limit = (low if width <= low else high) * part.diameter_m
        reasons.append(Refused(reason=Refusal.WIDTH, value=width * part.diameter_m, limit=limit, unit="m"))
    share, outside = float(seen.both[row]), float(seen.outside[row])
    if share < LEAST_BOTH:
        reasons.append(Refused(reason=Refusal.FLANKS, value=share, limit=LEAST_BOTH, unit="1"))
    if outside > OUTSIDE_SHARE:
        reasons.append(Refused(reason=Refusal.EDGE, value=outside, limit=OUTSIDE_SHARE, unit="1"))
    most = BOW_WIDTHS * frame.width_px
    if measured.bow_px[row] > most:
        value = float(measured.bow_px[row])
        reasons.append(Refused(reason=Refusal.BENT, value=value, limit=most, unit="px"))
    return reasons


def _width(row: int, k: int, measured: Measured, found: Explanation, frame: Frame) -> float:
    """In nominal widths, as the edges had it, because the shading model believes the nominal width, unless
    they lost it since."""
    raw, last = (float(of[n, UNIT]) / frame.unit for of, n in ((found.hypotheses, k), (measured.parts, row)))
    return last if last < WIDTH_SHARE[0] else raw


def _place_reasons(
    row: int, seen: _Seen, bounds: tuple[float, float] | None, most_tilt_rad: float
) -> list[Refused]:
    """Out of the depth range, or out of the height range where only a table is known; too steep."""
    reasons = []
    if bounds is not None:
        lowest, highest = float(seen.lowest_m[row]), float(seen.highest_m[row])
        if lowest < bounds[0]:
            reasons.append(Refused(reason=Refusal.DEPTH, value=lowest, limit=bounds[0], unit="m"))
        elif highest > bounds[1]:
            reasons.append(Refused(reason=Refusal.DEPTH, value=highest, limit=bounds[1], unit="m"))
    tilt = float(seen.tilt_rad[row])
    if tilt > most_tilt_rad:
        reasons.append(Refused(reason=Refusal.TILT, value=tilt, limit=most_tilt_rad, unit="rad"))
    return reasons


def _bounds_m(part: PartModel, tuning: Tuning, table: Plane | None) -> tuple[float, float] | None:
    """Depth range, or the height range of axes where only a table is known."""
    if tuning.depth_m is not None or table is None:
        return tuning.depth_m
    return tuning.height_m[0] - part.diameter_m, tuning.height_m[1] + part.diameter_m


def _crossings(
    measured: Measured, over: Crossed, frame: Frame, place: dict[int, int]
) -> tuple[Crossing, ...]:
    where = np.full(len(measured.parts), -1, np.int64)
    where[list(place)] = list(place.values())
    upper, lower = np.nonzero(over.above)
    known = (where[upper] >= 0) & (where[lower] >= 0)
    upper, lower = upper[known], lower[known]
    ends = measured.parts[upper, 1:7].reshape(-1, 2, 3)
    at = ends[:, 0] + over.place[upper, lower][:, None] * (ends[:, 1] - ends[:, 0])
    points = read_only(in_space(at, frame.on))
    gap = over.gap[upper, lower] - frame.part.diameter_m
    rows = zip(
        where[upper].tolist(), where[lower].tolist(), points, gap.tolist(),
        over.sure[upper, lower].tolist(), strict=True,
    )  # fmt: skip
    return tuple(
        Crossing(above=above, below=below, point=point, gap_m=gap_m, sure=sure)
        for above, below, point, gap_m, sure in rows
    )


def unexplained(pieces: Floats, measured: Measured, width_px: float) -> Floats:
    """(U, 2, 2) left canvas ends of straight skeleton pieces (K, 2, 2) that no part lies along."""
    if len(measured.parts) == 0 or len(pieces) == 0:
        return pieces
    start, end = measured.parts[:, 1:3], measured.parts[:, 4:6]
    size = np.linalg.norm(end - start, axis=1)
    along = (end - start) / size[:, None]
    way = pieces[:, 1] - pieces[:, 0]
    away = pieces.mean(axis=1)[:, None] - start[None]
    place = (away * along[None]).sum(axis=2)
    off = np.abs(away[..., 1] * along[:, 0] - away[..., 0] * along[:, 1])
    aligned = np.abs(way @ along.T) > 0.9 * np.linalg.norm(way, axis=1)[:, None]
    own = aligned & (off < 0.7 * width_px) & (place > -width_px) & (place < size[None] + width_px)
    return np.asarray(pieces[~own.any(axis=1)], np.float64)
