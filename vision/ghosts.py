"""Parts that seem to be there but were not chosen: too little of them is seen, or there is no room for them.

Two parts one on the other and nearly along each other share edges; where the lower one is read a little too
high, the upper one would lie in it, and it is missing among the chosen. But its own edges stay unexplained.
It is not certain enough to be told; what lies below it is not the first thing to take.
"""

from __future__ import annotations

import numpy as np

from vision import claims
from vision.crossings import BRUSH_DIAMETERS, END_DIAMETERS, laid, meet, nearest
from vision.explain import Explanation, Frame
from vision.jit import compiled
from vision.types import Bools, Floats

LEAST_LENGTHS = 0.03
"""What a part explains beside the chosen ones, in part lengths and view, to be a ghost."""
OVER_DIAMETERS = 0.3


def below_ghosts(found: Explanation, parts: Floats, frame: Frame) -> Bools:
    """(C,) whether a ghost would pass over each of the measured parts (C, `COLUMNS`)."""
    chosen = np.zeros(len(found.hypotheses), np.bool_)
    chosen[found.chosen] = True
    rows = _ghosts(found.state, chosen, LEAST_LENGTHS * 2 * frame.length_px)
    ghosts = np.ascontiguousarray(found.hypotheses[rows])
    return _below(laid(parts, frame), laid(ghosts, frame), frame.part.diameter_m)


@compiled
def _ghosts(s: claims.State, chosen: Bools, least: float) -> Bools:
    """(N,) what explains something still, whether or not it would lie in another."""
    found = np.zeros(len(chosen), np.bool_)
    for k in range(len(chosen)):
        if chosen[k]:
            continue
        blocked = s.hard[k]
        s.hard[k] = 0
        found[k] = claims.gain_of(k, s) > least
        s.hard[k] = blocked
    return found


@compiled
def _below(lying: Floats, ghosts: Floats, diameter_m: float) -> Bools:
    pad_m, longer_m = (0.5 + BRUSH_DIAMETERS) * diameter_m, END_DIAMETERS * diameter_m
    found = np.zeros(len(lying), np.bool_)
    for c in range(len(lying)):
        for g in range(len(ghosts)):
            if not meet(lying[c], ghosts[g], 0.0, 1.0, longer_m, pad_m):
                continue
            s, t = nearest(lying[c], ghosts[g])
            higher = (1 - t) * ghosts[g, 0, 2] + t * ghosts[g, 1, 2]
            higher -= (1 - s) * lying[c, 0, 2] + s * lying[c, 1, 2]
            if higher > OVER_DIAMETERS * diameter_m:
                found[c] = True
                break
    return found
