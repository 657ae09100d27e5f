"""What is certain at first sight: parts seen whole in both pictures, before anything else is explained.

A part whose flanks both pictures show from end to end has hardly anything on it. What can still be wrong is
the pair: the left picture of one part with the right picture of its neighbour. So a hypothesis counts only
where no other one of like evidence has its place in either picture, and none crosses above.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vision import claims
from vision.crossings import BRUSH_DIAMETERS, END_DIAMETERS, laid, meet, nearest
from vision.edges import Edges, Reals
from vision.explain import LONGEST_LENGTHS, TILT_SHARE, Explanation, Frame, settle, sound, state_of
from vision.jit import compiled, lean
from vision.refine import KIND, SCORE
from vision.traits import SAMPLE_PX, traits
from vision.types import Bools, Floats, Ints

MOST = 12
"""Hypotheses that are looked at."""
RIVAL_SHARE = 0.6
"""Evidence of another hypothesis in the same place of one picture, above which neither is certain."""
WHOLE_LENGTHS, WHOLE_TIP, WHOLE_BOTH, GAP_WIDTHS = 0.8, 0.35, 0.6, 0.5
"""Evidence in lengths and view, least strength of every end, least share with both flanks in either picture,
longest stretch without any: what lies across a part hides both flanks for its own width. The median gap of
parts with nothing on them is 0.5 widths, that of others 1.7 (82 heaps of 20 and 40)."""

ALONG = 0.05
"""Sine of the angle below which two lie along each other."""
OVER_SHARE, BRUSH_SHARE, BETTER = 0.6, 0.25, 1.2
"""Evidence of a hypothesis that crosses above, as a share of the part's own. The second is enough unless
another one has its place in one of the pictures with so many times its evidence: then it is a false pair."""
UNSURE_DIAMETERS = 0.8
"""Before they are laid on their edges, hypotheses may seem to lie lower than they do by this much."""


def at_first_sight(pool: Floats, left: Edges, right: Edges, frame: Frame) -> Explanation | None:
    """Parts of the first product out of a pool of hypotheses (N, `COLUMNS`), its own best first, that no
    later choice will take away; None where there are none. ``frame`` is that of the product."""
    rows = _lone(pool, frame.width_px, frame.length_px)
    if not len(rows):
        return None
    hypotheses = np.ascontiguousarray(pool[rows])
    free = (np.zeros(len(left.table) + 1, np.uint16), np.zeros(len(right.table) + 1, np.uint16))
    settle(hypotheses, left, right, free, frame, TILT_SHARE, 4, 3.0)
    hypotheses = np.ascontiguousarray(hypotheses[sound(hypotheses, frame)])
    seen = traits(hypotheses, left, right, frame.camera, LONGEST_LENGTHS * frame.length_px)
    now = state_of(hypotheses, seen, left, right, frame, True)
    gain = np.array([claims.gain_of(k, now) for k in range(len(hypotheses))])
    whole = _whole(seen.count, seen.value, seen.ground, seen.tip_value, frame.width_px)
    whole &= gain > WHOLE_LENGTHS * 2 * frame.length_px
    nobody = np.zeros(len(hypotheses), np.bool_)
    ends, diameter_m = laid(hypotheses, frame), frame.part.diameter_m
    about = _about(hypotheses[whole], ends[whole], pool, laid(pool, frame), diameter_m)
    others = np.ascontiguousarray(pool[about])
    settle(others, left, right, free, frame, TILT_SHARE, 3, 6.0)
    lying = laid(others, frame)
    chosen: list[int] = []
    for k in np.argsort(-gain, kind="stable").tolist():
        if not whole[k] or _under(
            hypotheses[k], ends[k], pool, about, lying, diameter_m, frame.width_px, frame.length_px
        ):
            continue
        if claims.gain_of(k, now) > WHOLE_LENGTHS * 2 * frame.length_px:
            claims.take(now, k, nobody)
            chosen.append(k)
    if not chosen:
        return None
    return Explanation(
        hypotheses=hypotheses, chosen=chosen, margin=gain[np.array(chosen)], state=now, seen=seen
    )


@compiled
def _lone(pool: Floats, width_px: float, length_px: float) -> Ints:
    """Rows of the best hypotheses of the first product without a rival in either picture."""
    kept = np.empty(MOST, np.int64)
    count = 0
    for row in range(min(len(pool), 8 * MOST)):
        if pool[row, KIND] != 0 or count == MOST:
            continue
        alone = True
        for k in range(len(pool)):
            if k == row or pool[k, SCORE] < RIVAL_SHARE * pool[row, SCORE]:
                continue
            first = _in_place_of(pool, row, k, 0, width_px, length_px)
            second = _in_place_of(pool, row, k, 1, width_px, length_px)
            # in both it is the same part, and the better one goes first
            if first != second or (first and k < row):
                alone = False
                break
        if alone:
            kept[count] = row
            count += 1
    return kept[:count]


@lean
def _in_place_of(pool: Floats, row: int, k: int, view: int, width_px: float, length_px: float) -> bool:
    """Whether one picture shows k on the line of row, and on most of its stretch."""
    xa, ya = pool[row, 1] - view * pool[row, 3], pool[row, 2]
    dx, dy = pool[row, 4] - view * pool[row, 6] - xa, pool[row, 5] - ya
    size = np.hypot(dx, dy)
    ux, uy = dx / size, dy / size
    low, high = 1e9, -1e9
    for end in range(2):
        px = pool[k, 1 + 3 * end] - view * pool[k, 3 + 3 * end] - xa
        py = pool[k, 2 + 3 * end] - ya
        if abs(-px * uy + py * ux) > 0.7 * width_px:
            return False
        along = px * ux + py * uy
        low, high = min(low, along), max(high, along)
    return bool(min(high, size) - max(low, 0.0) > 0.4 * length_px)


@compiled
def _about(parts: Floats, ends: Floats, pool: Floats, lying: Floats, diameter_m: float) -> Ints:
    """Rows of the pool that may lie over any of some parts (C, `COLUMNS`); ``ends`` (C, 2, 3), ``lying``
    (N, 2, 3) are their own and the pool's ends as `laid` has them."""
    found = np.empty(len(pool), np.int64)
    count = 0
    for k in range(len(pool)):
        for c in range(len(parts)):
            if pool[k, SCORE] > BRUSH_SHARE * parts[c, SCORE] and (
                _above(ends[c], lying[k], diameter_m) > -UNSURE_DIAMETERS * diameter_m
            ):
                found[count] = k
                count += 1
                break
    return found[:count]


@lean
def _above(ends: Floats, other: Floats, diameter_m: float) -> float:
    """How much higher another part (2, 3) lies where it crosses or brushes one, m; -inf: nowhere."""
    pad_m, longer_m = (0.5 + BRUSH_DIAMETERS) * diameter_m, END_DIAMETERS * diameter_m
    dx, dy = ends[1, 0] - ends[0, 0], ends[1, 1] - ends[0, 1]
    ex, ey = other[1, 0] - other[0, 0], other[1, 1] - other[0, 1]
    if abs(dx * ey - dy * ex) < ALONG * np.hypot(dx, dy) * np.hypot(ex, ey):
        return -np.inf
    if not meet(ends, other, 0.0, 1.0, longer_m, pad_m):
        return -np.inf
    s, t = nearest(ends, other)
    return float((1 - t) * other[0, 2] + t * other[1, 2] - (1 - s) * ends[0, 2] - s * ends[1, 2])


@lean
def _under(
    part: Floats,
    ends: Floats,
    pool: Floats,
    about: Ints,
    lying: Floats,
    diameter_m: float,
    width_px: float,
    length_px: float,
) -> bool:
    """Whether one of the rows ``about`` of the pool passes over a part; ``ends`` (2, 3), ``lying`` (A, 2, 3)
    are its own and theirs as `laid` has them."""
    for place in range(len(about)):
        score = pool[about[place], SCORE]
        if score < BRUSH_SHARE * part[SCORE]:
            continue
        if _above(ends, lying[place], diameter_m) < 0:
            continue
        if score > OVER_SHARE * part[SCORE] or not _false(pool, about[place], width_px, length_px):
            return True
    return False


@lean
def _false(pool: Floats, k: int, width_px: float, length_px: float) -> bool:
    """Whether a hypothesis with much more evidence has the place of k in one of the pictures."""
    for other in range(len(pool)):
        if pool[other, SCORE] > BETTER * pool[k, SCORE]:
            for view in range(2):
                if _in_place_of(pool, k, other, view, width_px, length_px):
                    return True
    return False


@compiled
def _whole(
    count: npt.NDArray[np.int32],
    value: Reals,
    ground: npt.NDArray[np.uint8],
    tip_value: Reals,
    width_px: float,
) -> Bools:
    """(N,) every end seen in one picture at least, flanks nearly everywhere in both, all in the picture."""
    good = np.ones(len(count), np.bool_)
    for k in range(len(count)):
        for end in range(2):
            if max(tip_value[k, 0, end].mean(), tip_value[k, 1, end].mean()) < WHOLE_TIP:
                good[k] = False
        for view in range(2):
            both = gap = 0
            for q in range(count[k, view]):
                if ground[k, view, q] == 2:
                    good[k] = False
                low, high = value[k, view, q, 0] > 0, value[k, view, q, 1] > 0
                if low and high:
                    both += 1
                inside = 0 < q < count[k, view] - 1
                gap = gap + 1 if inside and not low and not high else 0
                if gap * SAMPLE_PX >= GAP_WIDTHS * width_px:
                    good[k] = False
            if both < WHOLE_BOTH * count[k, view]:
                good[k] = False
    return good
