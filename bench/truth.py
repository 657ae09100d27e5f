"""What is true of a heap: who lies on whom, what is free, what may be picked; and its crossings.

"Over" is meant straight down on the table: two rods cross where their footprints meet, and the upper one
there is the one whose axis is higher. Left camera frame where a field does not say otherwise; metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.heap import Rod
from bench.views import View
from drivers.sim.geometry import apply, inverse, segment_distance
from vision.types import Bools, Floats

TOUCH_M = 0.00005


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Crossing:
    """Rod ``above`` passes over rod ``below`` at ``point`` (3,); ``gap_m`` from skin to skin.

    ``place`` 0..1 along the lower rod, from its first end.
    """

    above: int
    below: int
    point: Floats
    gap_m: float
    place: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Truth:
    """All that is known of N rods.

    ``ends`` (N, 2, 3); ``target`` (N,) whether it is what was asked for; ``visible`` (N, 2) seen share in
    the left and the right picture; ``ends_visible`` (N, 2 pictures, 2 ends); ``in_frame`` (N, 2);
    ``pickable`` (N,) nothing over the central third, ``free`` (N,) nothing over it at all. ``touching``
    pairs of rods.
    """

    ends: Floats
    target: Bools
    visible: Floats
    ends_visible: Bools
    in_frame: Bools
    pickable: Bools
    free: Bools
    crossings: tuple[Crossing, ...]
    touching: tuple[tuple[int, int], ...]

    def covered_by(self, rod: int) -> tuple[int, ...]:
        """What lies over a rod."""
        return tuple(sorted(c.above for c in self.crossings if c.below == rod))

    @property
    def crossings_per_rod(self) -> float:
        """How many others a rod crosses, on average."""
        return 2.0 * len(self.crossings) / max(1, len(self.ends))


def _nearest(a: Floats, b: Floats) -> tuple[float, float, float]:
    """Places (0..1) on two plan segments (2, 2) where they cross or come nearest, and their distance."""
    u, v, w = a[1] - a[0], b[1] - b[0], b[0] - a[0]
    turn = u[0] * v[1] - u[1] * v[0]
    if abs(turn) > 1e-12:
        s, t = (w[0] * v[1] - w[1] * v[0]) / turn, (w[0] * u[1] - w[1] * u[0]) / turn
        if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
            return float(s), float(t), 0.0
    best = (0.0, 0.0, np.inf)
    for end in (0, 1):
        t = float(np.clip((a[end] - b[0]) @ v / (v @ v), 0.0, 1.0))
        away = float(np.linalg.norm(b[0] + t * v - a[end]))
        best = min(best, (float(end), t, away), key=lambda found: found[2])
        s = float(np.clip((b[end] - a[0]) @ u / (u @ u), 0.0, 1.0))
        away = float(np.linalg.norm(a[0] + s * u - b[end]))
        best = min(best, (s, float(end), away), key=lambda found: found[2])
    return best


def _footprints_meet(a: Floats, b: Floats, a_radius_m: float, b_radius_m: float) -> bool:
    """Whether the rectangles about two plan segments (2, 2) overlap: no line between them parts them."""
    half, ways, reach = [], [], (a_radius_m, b_radius_m)
    for line in (a, b):
        span = line[1] - line[0]
        length = float(np.linalg.norm(span))
        ways.append(span / length)
        half.append(0.5 * length)
    apart = 0.5 * (b[0] + b[1] - a[0] - a[1])
    for way in ways:
        for axis in (way, np.array([-way[1], way[0]])):
            width = sum(
                h * abs(float(axis @ w)) + r * abs(float(axis[0] * w[1] - axis[1] * w[0]))
                for h, w, r in zip(half, ways, reach, strict=True)
            )
            if abs(float(axis @ apart)) >= width:
                return False
    return True


def truth_of(rods: tuple[Rod, ...], views: tuple[View, View], base_from_left: Floats) -> Truth:
    """The truth about rods that were photographed; ``base_from_left`` (4, 4)."""
    count = len(rods)
    left_from_base = inverse(base_from_left)
    ends = np.array([rod.ends for rod in rods]).reshape(-1, 2, 3)
    crossings, touching = [], []
    pickable, free = np.ones(count, np.bool_), np.ones(count, np.bool_)
    for i in range(count):
        for j in range(i):
            radii = rods[i].radius_m, rods[j].radius_m
            if not _footprints_meet(ends[i, :, :2], ends[j, :, :2], *radii):
                continue
            s, t, _ = _nearest(ends[i, :, :2], ends[j, :, :2])
            here, there = (
                ends[i, 0] + s * (ends[i, 1] - ends[i, 0]),
                ends[j, 0] + t * (ends[j, 1] - ends[j, 0]),
            )
            above, below, place = (i, j, t) if here[2] >= there[2] else (j, i, s)
            gap_m = segment_distance(*ends[i], *ends[j]) - sum(radii)
            crossings.append(
                Crossing(
                    above=above,
                    below=below,
                    point=apply(left_from_base, 0.5 * (here + there)),
                    gap_m=gap_m,
                    place=place,
                )
            )
            if gap_m < TOUCH_M:
                touching.append((j, i))
            free[below] = False
            third = ends[below, 0] + np.array([[1 / 3], [2 / 3]]) * (ends[below, 1] - ends[below, 0])
            if _footprints_meet(third[:, :2], ends[above, :, :2], rods[below].radius_m, rods[above].radius_m):
                pickable[below] = False
    return Truth(
        ends=apply(left_from_base, ends),
        target=np.array([rod.target for rod in rods], np.bool_),
        visible=np.stack([view.visible for view in views], axis=1),
        ends_visible=np.stack([view.ends_visible for view in views], axis=1),
        in_frame=np.stack([view.in_frame for view in views], axis=1),
        pickable=pickable,
        free=free,
        crossings=tuple(crossings),
        touching=tuple(touching),
    )
