"""Which hypotheses together explain both pictures, and nothing else.

Greedy choice of what gains most beside those already chosen (`claims`), then exchanges that raise the sum
of all gains: of one part against its rivals, and of one part with its surroundings chosen anew.
"""

from __future__ import annotations

import numpy as np

from vision.claims import PARALLEL, THROUGH, State, gain_of, give_back, lay, lift, relate, take
from vision.jit import compiled, lean
from vision.neighbours import cells_of, row_of_cells
from vision.types import Bools, Floats, Ints

ACCEPT_LENGTHS, KEEP_LENGTHS = 0.15, 0.15
"""Least gain of a part that is taken, and that stays, in part lengths and view."""
LEAST_ALONE, RIVAL_SHARE = -0.5, 0.65
SAME_WIDTHS, SAME_LENGTHS = 0.7, 0.35
"""How far aside and beyond the ends of a rival a hypothesis lies in its place."""
LEAST_RISE = 0.02


@compiled
def promising(s: State) -> Bools:
    """(N,) what may be chosen: enough evidence of its own, and not far less than a rival in the same
    place."""
    count = len(s.gain)
    keep = np.ones(count, np.bool_)
    least = 2 * ACCEPT_LENGTHS * s.size_px
    for h in range(count):
        s.gain[h] = gain_of(h, s)
        # what is unseen may be hidden, and the state does not know by what
        if s.gain[h] < LEAST_ALONE * least:
            keep[h] = False
    middle, longest = np.empty((count, 2)), 1.0
    for h in range(count):
        xa, ya, xb, yb = s.ends[h, 0, 0], s.ends[h, 0, 1], s.ends[h, 0, 2], s.ends[h, 0, 3]
        middle[h, 0], middle[h, 1] = 0.5 * (xa + xb), 0.5 * (ya + yb)
        longest = max(longest, np.hypot(xb - xa, yb - ya))
    # the middle of what lies in a rival's place lies on the rival
    cells = cells_of(middle, 0.5 * longest + SAME_LENGTHS * s.size_px + SAME_WIDTHS * s.width_px)
    for h in range(count):
        for turn in range(3):
            first, last = row_of_cells(cells, h, turn)
            for q in range(first, last):
                k = cells.members[q]
                if keep[h] and s.gain[k] * RIVAL_SHARE > s.gain[h] and _same_place(s, h, k):
                    keep[h] = False
    return keep


@lean
def _same_place(s: State, h: int, k: int) -> bool:
    """Whether two hypotheses show nearly the same stretch of both pictures."""
    for view in range(2):
        xa, ya = s.ends[k, view, 0], s.ends[k, view, 1]
        dx, dy = s.ends[k, view, 2] - xa, s.ends[k, view, 3] - ya
        size = np.hypot(dx, dy)
        ux, uy = dx / size, dy / size
        for end in range(2):
            px, py = s.ends[h, view, 2 * end] - xa, s.ends[h, view, 2 * end + 1] - ya
            if abs(-px * uy + py * ux) > SAME_WIDTHS * s.width_px:
                return False
            along = px * ux + py * uy
            if along < -SAME_LENGTHS * s.size_px or along > size + SAME_LENGTHS * s.size_px:
                return False
    return True


@compiled
def greedy(s: State, chosen: Bools) -> None:
    """Adds to what is chosen the best that is left, while it gains enough."""
    count = len(chosen)
    alive = np.zeros(count, np.bool_)
    least = 2 * ACCEPT_LENGTHS * s.size_px
    for h in range(count):
        if not chosen[h]:
            s.gain[h] = gain_of(h, s)
            # what is not half good enough now may become so when others cover it, but that is rare
            alive[h] = s.gain[h] > 0.5 * least
    while True:
        best = -1
        for h in range(count):
            if alive[h] and (best < 0 or s.gain[h] > s.gain[best]):
                best = h
        if best < 0 or s.gain[best] < least:
            return
        chosen[best] = True
        alive[best] = False
        take(s, best, alive)


@compiled
def exchange(s: State, chosen: Bools) -> bool:
    """Every chosen part against its rivals, with all others as they are; True when anything changed."""
    changed = False
    count = len(chosen)
    alive = np.zeros(count, np.bool_)
    for i in range(count):
        if not chosen[i]:
            continue
        give_back(s, i)
        chosen[i] = False
        best, most = i, gain_of(i, s)
        for at_near in range(s.near_at[i], s.near_at[i + 1]):
            k = s.near[at_near]
            if s.rival[at_near] and not chosen[k]:
                value = gain_of(k, s)
                if value > most:
                    best, most = k, value
        if most < 2 * KEEP_LENGTHS * s.size_px:
            changed = True
            continue
        chosen[best] = True
        take(s, best, alive)
        changed = changed or best != i
    return changed


@compiled
def deepen(s: State, chosen: Bools, margin: float, most: int) -> int:
    """Exchanges that look worse at first: a rival is forced in, its surroundings are chosen anew, and the
    exchange stays where the sum of all gains about it has risen. Returns how many stayed."""
    count = len(chosen)
    nobody = np.zeros(count, np.bool_)
    loss = np.empty(4 * most)
    pairs = np.empty((4 * most, 2), np.int64)
    found = 0
    for i in range(count):
        if not chosen[i]:
            continue
        give_back(s, i)
        own = gain_of(i, s)
        for at_near in range(s.near_at[i], s.near_at[i + 1]):
            k = s.near[at_near]
            if not s.rival[at_near] or chosen[k] or found >= len(loss):
                continue
            # conflicts with others are theirs to solve
            blocked = s.hard[k]
            s.hard[k] = 0
            value = gain_of(k, s)
            s.hard[k] = blocked
            if own - value < margin:
                loss[found] = own - value
                pairs[found, 0], pairs[found, 1] = i, k
                found += 1
        take(s, i, nobody)
    order = np.argsort(loss[:found])[:most]
    stayed = 0
    for at in order:
        i, k = pairs[at, 0], pairs[at, 1]
        if not chosen[i] or chosen[k]:
            continue
        stayed += _try(s, chosen, i, k)
    return stayed


@compiled
def _try(s: State, chosen: Bools, i: int, k: int) -> int:
    """Force k in for i; 1 if it stayed. Only what is near either of them is touched."""
    count = len(chosen)
    nobody = np.zeros(count, np.bool_)
    about = np.zeros(count, np.bool_)
    for centre in (i, k):
        for at_near in range(s.near_at[centre], s.near_at[centre + 1]):
            about[s.near[at_near]] = True
    about[i] = True
    about[k] = True
    before = energy(s, chosen, about)
    was = chosen.copy()
    relate(s, k)
    give_back(s, i)
    chosen[i] = False
    for at_near in range(s.near_at[k], s.near_at[k + 1]):
        j = s.near[at_near]
        if chosen[j] and s.pair[at_near, 0] < THROUGH * s.diameter and s.pair[at_near, 1] > PARALLEL:
            give_back(s, j)
            chosen[j] = False
    chosen[k] = True
    take(s, k, nobody)
    least = 2 * ACCEPT_LENGTHS * s.size_px
    alive = np.zeros(count, np.bool_)
    for j in range(count):
        if about[j] and not chosen[j] and s.hard[j] == 0:
            s.gain[j] = gain_of(j, s)
            alive[j] = s.gain[j] > 0.5 * least
    while True:
        best, most = -1, least
        for j in range(count):
            if alive[j] and s.gain[j] > most:
                best, most = j, s.gain[j]
        if best < 0:
            break
        chosen[best] = True
        alive[best] = False
        take(s, best, alive)
    if energy(s, chosen, about) > before + LEAST_RISE * s.size_px:
        return 1
    for j in range(count):
        if chosen[j] and not was[j]:
            give_back(s, j)
    for j in range(count):
        if was[j] and not chosen[j]:
            take(s, j, nobody)
        chosen[j] = was[j]
    return 0


@compiled
def energy(s: State, chosen: Bools, about: Bools) -> float:
    """Sum of the gains of the chosen parts in a place, nearest first, all others as they are."""
    among = chosen & about
    rows = np.flatnonzero(among)
    order = rows[np.argsort(-(s.disparity[rows, 0] + s.disparity[rows, 1]))]
    for k in order:
        lift(s, k, among)
    total = 0.0
    for k in order:
        total += gain_of(k, s)
        lay(s, k, among)
    return total


@compiled
def margins(s: State, rows: Ints) -> Floats:
    """(C,) what each of the chosen parts adds to all others."""
    nobody = np.zeros(len(s.gain), np.bool_)
    found = np.empty(len(rows))
    for place in range(len(rows)):
        give_back(s, rows[place])
        found[place] = gain_of(rows[place], s)
        take(s, rows[place], nobody)
    return found
