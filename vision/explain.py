"""Both pictures explained at once: the set of parts of known length that makes their edges, and nothing else.

Lines of both pictures propose parts in space (`proposals`, `windows`), each is laid on its edges (`refine`),
the set that explains the most is chosen (`choice`), then every chosen part is refined again on the edges
nobody else claims, from several places near by, and the set is chosen anew.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from vision import choice, claims
from vision.canvas import Canvas, in_space
from vision.edges import Edges, Reals, Signposts
from vision.flank import Counts
from vision.jit import compiled, lean
from vision.refine import COLUMNS, DA, DB, KIND, LENGTH, SCORE, XA, XB, YA, YB, refine
from vision.traits import Traits, joined, some, traits
from vision.types import Bools, Floats, PartModel
from vision.windows import distinct, outstanding

TILT_SHARE = 0.06
"""Usual height difference of the ends, in lengths."""
LENGTH_SIGMA_SHARE = 0.005
LENGTH_SHARE = 0.08
SAME_PX = 0.6
ROUNDS = 2
DEEP_MARGIN, DEEP_TRIALS = 0.25, 60
"""Exchanges that lose up to this much at first are tried, in part lengths and view; how many of them."""
NUDGE_PX, SLIDES_PX = 2.0, (-12.0, -6.0, -3.0, 3.0, 6.0, 12.0)
PLAIN_END, WEAK_END = 0.6, 0.2
FLAT, END_STEPS_PX = 0.2, (-6.0, -3.0, 3.0, 6.0)
"""Places from which a chosen part is tried anew: tilted a little; slid along itself, where not all its ends
are clear; and where it lies along the baseline, by the sine of the angle to it, so that only its ends tell
how high it lies, with either end or both moved in one picture. See decision 13."""
PLAIN_LENGTHS = 1.05
"""A part with more evidence of its own and no weak end, along the baseline only clear ones, is not tried anew
from other places."""
TILT_COST, MOST_TILT_COST = 0.8, 0.2
"""Cost of tilt squared (rad), and its most, in part lengths and view."""
STRAY_LENGTHS = 0.25
"""What a part of a length that is no product's must earn beyond others, in part lengths and view."""
LONGEST_LENGTHS = 2.8
UNSHADED_SIGMA_PX = 0.1
"""What light shifts the flanks of one view by while nobody has looked."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """What is the same for all hypotheses of a look.

    ``camera`` (4,) focal px, baseline m, principal point px; ``level`` (3,) disparity of the table as a
    plane; ``low``, ``high`` (3,) disparity of the least and greatest height of an axis; ``width_px``,
    ``length_px`` of the part at the table; ``diameter_d`` disparity of one diameter of height.
    """

    on: Canvas
    camera: Floats
    level: Floats
    low: Floats
    high: Floats
    part: PartModel
    width_px: float
    length_px: float
    diameter_d: float

    @property
    def unit(self) -> float:
        """Width over disparity of a part, both px."""
        return self.part.diameter_m / self.on.baseline_m


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Explanation:
    """``hypotheses`` (N, 8) of which ``chosen`` (C,) explain the pictures; ``margin`` (C,) what each adds;
    ``seen`` what the pictures show of all."""

    hypotheses: Floats
    chosen: list[int]
    margin: Floats
    state: claims.State
    seen: Traits


def explain(pool: Floats, left: Edges, right: Edges, frame: Frame) -> Explanation:
    """Choose from a pool of hypotheses (N, `COLUMNS`), best first, the parts that explain both pictures."""
    free = (np.zeros(len(left.table) + 1, np.uint16), np.zeros(len(right.table) + 1, np.uint16))
    hypotheses = np.ascontiguousarray(pool[outstanding(pool, frame.width_px, frame.length_px)])
    settle(hypotheses, left, right, free, frame, TILT_SHARE, 3, 6.0)
    hypotheses = hypotheses[np.argsort(-hypotheses[:, SCORE], kind="stable")]
    hypotheses = np.ascontiguousarray(hypotheses[sound(hypotheses, frame)])
    hypotheses = np.ascontiguousarray(hypotheses[distinct(hypotheses, SAME_PX)])
    seen = traits(hypotheses, left, right, frame.camera, LONGEST_LENGTHS * frame.length_px)
    kept = np.flatnonzero(choice.promising(state_of(hypotheses, seen, left, right, frame, False)))
    hypotheses, seen = np.ascontiguousarray(hypotheses[kept]), some(seen, kept)
    chosen = np.zeros(len(hypotheses), np.bool_)
    for turn in range(ROUNDS):
        now = state_of(hypotheses, seen, left, right, frame, True)
        chosen[:] = False
        choice.greedy(now, chosen)
        for _ in range(2):
            if not choice.exchange(now, chosen):
                break
            choice.greedy(now, chosen)
        if turn == ROUNDS - 1:
            choice.deepen(now, chosen, DEEP_MARGIN * 2 * frame.length_px, DEEP_TRIALS)
            # what was exchanged in one place may have made room for a better one in another
            choice.deepen(now, chosen, 0.0, DEEP_TRIALS)
            break
        added = _on_own_edges(hypotheses, chosen, now, left, right, frame)
        seen = joined(seen, traits(added, left, right, frame.camera, LONGEST_LENGTHS * frame.length_px))
        grown = np.concatenate([hypotheses, added])
        kept = distinct(grown, SAME_PX)
        hypotheses, seen = np.ascontiguousarray(grown[kept]), some(seen, kept)
        chosen = np.zeros(len(hypotheses), np.bool_)
    return _explanation(hypotheses, chosen, now, seen)


def _explanation(hypotheses: Floats, chosen: Bools, now: claims.State, seen: Traits) -> Explanation:
    rows = [int(k) for k in np.flatnonzero(chosen)]
    margin = choice.margins(now, np.array(rows, np.int64))
    return Explanation(hypotheses=hypotheses, chosen=rows, margin=margin, state=now, seen=seen)


def settle(
    hypotheses: Floats,
    left: Edges,
    right: Edges,
    taken: tuple[Counts, Counts],
    frame: Frame,
    tilt_share: float,
    rounds: int,
    spacing: float,
    shift: Floats | None = None,
    bias_sigma_px: Floats | None = None,
) -> Floats:
    """`refine` with what the look knows."""
    part = frame.part
    return refine(
        hypotheses, left.posts, taken[0], right.posts, taken[1], frame.camera,
        frame.level, LENGTH_SIGMA_SHARE, frame.unit, tilt_share,
        frame.diameter_d / part.diameter_m, rounds, spacing,
        np.zeros((len(hypotheses), 2, 2)) if shift is None else shift,
        np.full((len(hypotheses), 2), UNSHADED_SIGMA_PX) if bias_sigma_px is None else bias_sigma_px,
    )  # fmt: skip


def sound(hypotheses: Floats, frame: Frame) -> Bools:
    """(N,) of the right length, and not in the table or in the air."""
    ends = in_space(hypotheses[:, 1:7].reshape(-1, 2, 3), frame.on)
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    known = hypotheses[:, LENGTH]
    good = np.where(
        known > 0, np.abs(length / np.where(known > 0, known, 1.0) - 1) < LENGTH_SHARE, length > 0
    )
    for x, y, d in ((XA, YA, DA), (XB, YB, DB)):
        at = hypotheses[:, [x, y]]
        good &= hypotheses[:, d] > at @ frame.low[:2] + frame.low[2] - 0.3
        good &= hypotheses[:, d] < at @ frame.high[:2] + frame.high[2] + 3.0
    return np.asarray(good, np.bool_)


def along_baseline(hypotheses: Floats) -> Bools:
    """(N,) whether only its ends tell how high a part lies."""
    way = hypotheses[:, [XB, YB]] - hypotheses[:, [XA, YA]]
    return np.asarray(np.abs(way[:, 1]) < FLAT * np.linalg.norm(way, axis=1), np.bool_)


def state_of(
    hypotheses: Floats, seen: Traits, left: Edges, right: Edges, frame: Frame, related: bool
) -> claims.State:
    part = frame.part
    space = in_space(hypotheses[:, 1:7].reshape(-1, 2, 3), frame.on)
    rise = hypotheses[:, DA] - hypotheses[:, DB]
    rise = rise - (hypotheses[:, [XA, YA]] - hypotheses[:, [XB, YB]]) @ frame.level[:2]
    tilt = rise / frame.diameter_d * part.diameter_m / part.length_m
    prior = -2 * frame.length_px * np.minimum(TILT_COST * tilt**2, MOST_TILT_COST)
    prior = prior - np.where(hypotheses[:, KIND] < 0, 2 * STRAY_LENGTHS * frame.length_px, 0.0)
    return claims.state(
        hypotheses, seen, left, right, space, prior, frame.length_px, frame.width_px, part.diameter_m,
        frame.diameter_d, related,
    )  # fmt: skip


def _on_own_edges(
    hypotheses: Floats, chosen: Bools, now: claims.State, left: Edges, right: Edges, frame: Frame
) -> Floats:
    """Every chosen part refined on the edges that no other claims, from many places; what is plain to see is
    left as it is."""
    moves, usual = _moves()
    found = _refined(
        hypotheses, chosen, moves, usual, PLAIN_LENGTHS * 2 * frame.length_px, now, left.posts, right.posts,
        frame.camera, frame.level, frame.unit, frame.diameter_d / frame.part.diameter_m,
        np.zeros((len(moves), 2, 2)), np.full((len(moves), 2), UNSHADED_SIGMA_PX),
    )  # fmt: skip
    return np.asarray(found[sound(found, frame)], np.float64)


@lru_cache(maxsize=1)
def _moves() -> tuple[Floats, int]:
    """(M, 7) px by which a part is moved: x, y, d of both ends, and along itself; how many of them, the first
    ones, are for every part, the others for parts along the baseline."""
    tilts = [[0.0] * 7]
    for a, b in ((1, 1), (-1, -1), (1, -1), (-1, 1)):
        tilts.append([a * NUDGE_PX / 2, 0, a * NUDGE_PX, b * NUDGE_PX / 2, 0, b * NUDGE_PX, 0])
    slides = [[0.0] * 6 + [by] for by in SLIDES_PX]
    ends = []
    for first, last in ((1, 0), (0, 1), (1, 1)):
        for by in END_STEPS_PX:
            # the right picture shows an end at x - d: there it stays if both move, else it moves there only
            ends += [[first * x, 0, first * by, last * x, 0, last * by, 0] for x in (0.0, by)]
    return np.array(tilts + slides + ends), len(tilts) + len(slides)


@lean
def _weakest_end(tip_value: Reals) -> float:
    """How strongly the worst of both ends is seen in the worse picture; (2, 2, `LANES`)."""
    least = 1.0
    for view in range(2):
        for end in range(2):
            least = min(least, tip_value[view, end].mean())
    return float(least)


@compiled
def _refined(
    hypotheses: Floats, chosen: Bools, moves: Floats, usual: int, plain: float, now: claims.State,
    left: Signposts, right: Signposts, camera: Floats, level: Floats, unit: float, step_d: float,
    shift: Floats, bias: Floats,
) -> Floats:  # fmt: skip
    """(N, `COLUMNS`) the chosen parts that gain less than ``plain`` or have a weak end, moved as `_moves` has
    it."""
    found = np.empty((len(moves) * chosen.sum(), COLUMNS))
    nobody = np.zeros(len(chosen), np.bool_)
    count = 0
    for k in range(len(chosen)):
        if not chosen[k]:
            continue
        claims.give_back(now, k)
        weakest = _weakest_end(now.tip_value[k])
        way = hypotheses[k, XB : DB + 1] - hypotheses[k, XA : DA + 1]
        size = np.hypot(way[0], way[1])
        flat = abs(way[1]) < FLAT * size
        if claims.gain_of(k, now) <= plain or weakest < (PLAIN_END if flat else WEAK_END):
            many = len(moves) if flat else usual
            if not flat and weakest >= PLAIN_END:
                many -= len(SLIDES_PX)
            near = found[count : count + many]
            for n in range(many):
                near[n] = hypotheses[k]
                near[n, 1:7] += moves[n, :6]
                for end in range(2):
                    near[n, 1 + 3 * end : 4 + 3 * end] += moves[n, 6] / size * way
            refine(
                near, left, now.taken_l, right, now.taken_r, camera, level,
                LENGTH_SIGMA_SHARE, unit, TILT_SHARE, step_d, 4, 3.0, shift, bias,
            )  # fmt: skip
            count += many
        claims.take(now, k, nobody)
    return found[:count]
