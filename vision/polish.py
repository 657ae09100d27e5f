"""The chosen parts measured once more, each on its own edges and with its shading, and how well each is
known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vision import shading
from vision.canvas import in_space
from vision.edges import Edges, Ids, Reals, Signposts
from vision.explain import UNSHADED_SIGMA_PX, Explanation, Frame
from vision.flank import Counts, nearest_edge
from vision.jit import compiled, lean
from vision.measure import measure
from vision.refine import UNIT
from vision.traits import FLANK_REACH_PX, FLANK_SIGMA_PX, SAMPLE_PX, Traits
from vision.types import Bools, Floats, Grey, Ints

SEEN = 0.3
"""Least strength of a flank that is read for shading."""
CLEAR_SAMPLES = 3
"""Samples next to the ends that are not read: there the outline turns."""
SHADED_SIGMA_PX = 0.03
"""What light still shifts the flanks of one view by after the profile has been read."""
MOST_PROFILES = 12
BEYOND_SHARES = (0.03, 0.28)
"""Where, in lengths beyond an end, a part is looked for that is longer than it should be."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measured:
    """C parts, in the order they were chosen.

    ``parts`` (C, `COLUMNS`); ``covariance`` (C, 6, 6) of x, y, d at both ends, px, and
    ``strain`` (C,) how many times larger it is where flanks contradict each other; ``bow_px`` (C,) how far
    the middle is off the line through the ends, the straighter view; ``free_length_m`` (C,) length as its
    ends alone have it, NaN where they are not all seen; ``goes_on`` (C,) share of the way just beyond an
    unseen end on which both flanks are seen in both pictures; ``missed`` (C, 2) by which share of contrast a
    round rod misses the profile of a part in either view, NaN where it was not read; ``gamma``, ``blur`` of
    the cameras as the profiles have them."""

    parts: Floats
    covariance: Floats
    strain: Floats
    bow_px: Floats
    free_length_m: Floats
    goes_on: Floats
    missed: Floats
    gamma: float
    blur: float


def polish(
    found: Explanation,
    left: Edges,
    right: Edges,
    greys: tuple[Grey, Grey],
    row_shift_px: float,
    frame: Frame,
    rows: list[int] | None = None,
) -> Measured:
    """Measure chosen parts; ``rows`` some of them, all without."""
    chosen = np.array(found.chosen if rows is None else rows, np.int64)
    parts = np.ascontiguousarray(found.hypotheses[chosen])
    count, now, seen = len(chosen), found.state, found.seen
    edges = (left, right)
    flanks, own, bow = _flanks(parts, chosen, seen, (now.taken_l, now.taken_r), edges, frame)
    shift, loose, missed, gamma, blur = _shift(flanks, own, parts, chosen, seen, greys, row_shift_px, frame)
    covariance, strain = np.zeros((count, 6, 6)), np.ones(count)
    free, goes_on = parts.copy(), np.zeros(count)
    ends_seen = (seen.tip_value[chosen].mean(axis=3) > SEEN).all(axis=(1, 2))
    measure(
        parts, chosen, ends_seen, seen.ends, seen.width, seen.edge,
        left.posts, left.at, now.taken_l.copy(), right.posts, right.at, now.taken_r.copy(),
        frame.camera, frame.level, frame.unit, frame.diameter_d / frame.part.diameter_m, shift, loose,
        covariance, strain, free,
    )  # fmt: skip
    unseen = seen.tip_value[chosen].mean(axis=(1, 3)) < SEEN
    _goes_on(found.hypotheses, chosen, unseen, left.posts, right.posts, goes_on)
    return Measured(
        parts=parts,
        covariance=covariance,
        strain=strain,
        bow_px=bow,
        free_length_m=np.where(ends_seen, _length_m(free, frame), np.nan),
        goes_on=goes_on,
        missed=missed,
        gamma=gamma,
        blur=blur,
    )


@compiled
def _goes_on(
    hypotheses: Floats, chosen: Ints, unseen: Bools, left: Signposts, right: Signposts,
    goes_on: Floats,
) -> None:  # fmt: skip
    """(C,) the larger of both ends, 0 where the end itself is seen."""
    first, last = BEYOND_SHARES
    nobody = np.zeros(max(len(left.table), len(right.table)) + 1, np.uint16)
    for place in range(len(chosen)):
        p = hypotheses[chosen[place]]
        for end in range(2):
            if not unseen[place, end]:
                continue
            here, there = 1 + 3 * end, 4 - 3 * end
            share = 1.0
            for view in range(2):
                xa, ya, da = p[here] - view * p[here + 2], p[here + 1], p[here + 2]
                wx, wy = xa - (p[there] - view * p[there + 2]), ya - p[there + 1]
                wd = da - p[there + 2]
                size = (last - first) * np.hypot(wx, wy)
                steps = max(int(size / SAMPLE_PX), 1)
                ux, uy = wx * (last - first) / size, wy * (last - first) / size
                both = 0
                for q in range(steps):
                    share_on = first + (last - first) * (q + 0.5) / steps
                    x, y, d = xa + share_on * wx, ya + share_on * wy, da + share_on * wd
                    if _two_flanks(left if view == 0 else right,
                                   nobody, x, y, -uy, ux, 0.5 * p[UNIT] * d):  # fmt: skip
                        both += 1
                share = min(share, both / steps)
            goes_on[place] = max(goes_on[place], share)


@lean
def _two_flanks(
    posts: Signposts, nobody: Counts, x: float, y: float, nx: float, ny: float, half: float
) -> bool:
    """Whether both flanks of a part with its axis at (x, y) are seen there, whoever's they are."""
    for side in range(2):
        sign = -1.0 if side == 0 else 1.0
        e, off = nearest_edge(
            posts, nobody, x + sign * nx * half, y + sign * ny * half, -sign * nx, -sign * ny,
            FLANK_REACH_PX,
        )  # fmt: skip
        if e < 0 or posts.table[e, 4] * np.exp(-0.5 * (off / FLANK_SIGMA_PX) ** 2) <= SEEN:
            return False
    return True


def sigmas(parts: Floats, covariance: Floats, frame: Frame) -> tuple[Floats, Floats]:
    """Standard deviation of the centres of parts (C, `COLUMNS`) in their worst direction, m, and of their
    axes, rad, both (C,).

    Propagated from the covariance (C, 6, 6) of the six numbers through the triangulation.
    """
    centre, turn = _sigmas(parts, covariance, frame.camera)
    return centre, turn


@compiled
def _sigmas(parts: Floats, covariance: Floats, camera: Floats) -> tuple[Floats, Floats]:
    focal, baseline, cx, cy = camera[0], camera[1], camera[2], camera[3]
    centre, turn = np.zeros(len(parts)), np.zeros(len(parts))
    ends, slope, across = np.zeros((2, 3)), np.zeros((2, 3, 3)), np.zeros((3, 3))
    both = np.zeros((2, 3, 6))
    for h in range(len(parts)):
        for end in range(2):
            x, y, d = parts[h, 1 + 3 * end] - cx, parts[h, 2 + 3 * end] - cy, parts[h, 3 + 3 * end]
            z = focal * baseline / d
            ends[end, 0], ends[end, 1], ends[end, 2] = x * z / focal, y * z / focal, z
            slope[end, 0, 0] = slope[end, 1, 1] = z / focal
            for n in range(3):
                slope[end, n, 2] = -ends[end, n] / d
        way = ends[1] - ends[0]
        square = way[0] ** 2 + way[1] ** 2 + way[2] ** 2
        for i in range(3):
            for j in range(3):
                across[i, j] = (1.0 if i == j else 0.0) - way[i] * way[j] / square
        # rows: the mean of the ends, and their difference across the axis in lengths
        both[0, :, :3], both[0, :, 3:] = 0.5 * slope[0], 0.5 * slope[1]
        for end in range(2):
            sign = -1.0 if end == 0 else 1.0
            for i in range(3):
                for j in range(3):
                    total = 0.0
                    for n in range(3):
                        total += across[i, n] * slope[end, n, j]
                    both[1, i, 3 * end + j] = sign * total / np.sqrt(square)
        centre[h] = _worst(both[0], covariance[h])
        turn[h] = _worst(both[1], covariance[h])
    return centre, turn


@compiled
def _worst(by: Floats, covariance: Floats) -> float:
    """Largest standard deviation of ``by @ x``, (3, 6), in any direction."""
    spread = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for a in range(6):
                for b in range(6):
                    spread[i, j] += by[i, a] * covariance[a, b] * by[j, b]
    return float(np.sqrt(max(np.linalg.eigvalsh(spread)[2], 0.0)))


def _length_m(parts: Floats, frame: Frame) -> Floats:
    ends = in_space(parts[:, 1:7].reshape(-1, 2, 3), frame.on)
    return np.asarray(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1), np.float64)


def _flanks(
    parts: Floats,
    chosen: Ints,
    seen: Traits,
    taken: tuple[Counts, Counts],
    edges: tuple[Edges, Edges],
    frame: Frame,
) -> tuple[shading.Flanks, Bools, Floats]:
    """Where the flanks of the chosen parts are in both views; (C, 2, S) the samples that say so; how far
    the parts are bent, the straighter view."""
    count = len(parts)
    flanks = shading.Flanks(
        low_px=np.zeros((count, 2)),
        high_px=np.zeros((count, 2)),
        stations=np.zeros((count, 2)),
        normal=np.zeros((count, 2, 2)),
    )
    own = np.zeros((count, 2, seen.value.shape[2]), np.bool_)
    bow = np.zeros((count, 2))
    for view in range(2):
        _own(
            parts, chosen, view, frame.unit, seen.count, seen.ends, seen.edge, seen.value, taken[view],
            edges[view].table, own, flanks.low_px, flanks.high_px, flanks.stations, flanks.normal, bow,
        )  # fmt: skip
    return flanks, own, np.abs(bow).min(axis=1) if count else np.zeros(0)


@compiled
def _own(
    parts: Floats, chosen: Ints, view: int, unit: float, samples: npt.NDArray[np.int32], ends: Floats,
    edge: Ids, value: Reals, taken: Counts, table: Reals,
    own: Bools, low_px: Floats, high_px: Floats, stations: Floats, normal: Floats, bow: Floats,
) -> None:  # fmt: skip
    """Samples of each part in one view whose flanks are both seen and no other's; mean place of either flank
    from where the outline would be; how far the middle bends; the normal."""
    square, right, basis = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    for place in range(len(chosen)):
        k = chosen[place]
        steps, near, far = samples[k, view], parts[place, 3], parts[place, 6]
        xa, ya = ends[k, view, 0], ends[k, view, 1]
        dx, dy = ends[k, view, 2] - xa, ends[k, view, 3] - ya
        size = np.hypot(dx, dy)
        nx, ny = -dy / size, dx / size
        normal[place, view, 0], normal[place, view, 1] = nx, ny
        low = high = 0.0
        count = 0
        # offset against share: constant, slope and parabola, by their normal equations
        square[:] = 0.0
        right[:] = 0.0
        for q in range(CLEAR_SAMPLES, steps - CLEAR_SAMPLES):
            a, b = edge[k, view, q, 0], edge[k, view, q, 1]
            if a < 0 or b < 0 or value[k, view, q, 0] < SEEN or value[k, view, q, 1] < SEEN:
                continue
            if taken[a] > 1 or taken[b] > 1:
                continue
            share = (q + 0.5) / steps
            x, y = xa + share * dx, ya + share * dy
            radius = 0.5 * unit * (near + share * (far - near))
            first = (table[a, 0] - x) * nx + (table[a, 1] - y) * ny + radius
            second = (table[b, 0] - x) * nx + (table[b, 1] - y) * ny - radius
            low += first
            high += second
            basis[0], basis[1], basis[2] = 1.0, 2 * share - 1, 4 * share * (1 - share)
            for i in range(3):
                right[i] += basis[i] * 0.5 * (first + second)
                for j in range(3):
                    square[i, j] += basis[i] * basis[j]
            own[place, view, q] = True
            count += 1
        stations[place, view] = count
        if count > 0:
            low_px[place, view], high_px[place, view] = low / count, high / count
            for i in range(3):
                square[i, i] += 1.0
            bow[place, view] = np.linalg.solve(square, right)[2]


def _shift(
    flanks: shading.Flanks,
    own: Bools,
    parts: Floats,
    chosen: Ints,
    seen: Traits,
    greys: tuple[Grey, Grey],
    row_shift_px: float,
    frame: Frame,
) -> tuple[Floats, Floats, Floats, float, float]:
    """Where light shifts the flanks to, (C, 2, 2) px; how sure that is (C, 2) px; by how much a rod misses
    the profiles (C, 2); gamma and blur."""
    count = len(parts)
    unsure = np.full((count, 2), UNSHADED_SIGMA_PX)
    good = flanks.stations >= shading.LEAST_STATIONS
    if not good.any():
        unread = np.full((count, 2), np.nan)
        return np.zeros((count, 2, 2)), unsure, unread, shading.GAMMAS[0], shading.BLURS[0]
    near, far = 0.5 * frame.unit * parts[:, 3], 0.5 * frame.unit * parts[:, 6]
    ends, steps = seen.ends[chosen], seen.count[chosen]

    light = shading.light_of_grey()
    profiles, stations = np.zeros((len(shading.GAMMAS), count, 2, shading.SAMPLES)), np.zeros((count, 2))

    def read(which: Bools, first: int, last: int) -> None:
        for view, grey in enumerate(greys):
            shading.mean_profiles(
                np.ascontiguousarray(light[:, first:last]), grey, frame.on.to_raw[view], row_shift_px * view,
                view, which, ends, steps, near, far, own, profiles[first:last], stations,
            )  # fmt: skip

    best = np.zeros(2 * count, np.bool_)
    best[np.argsort(-flanks.stations.reshape(-1), kind="stable")[:MOST_PROFILES]] = True
    best = best.reshape(count, 2) & good
    read(best, 0, len(shading.GAMMAS))
    kind, blur = shading.best_optics(profiles[:, best])
    read(good & ~best, kind, kind + 1)
    good &= stations >= shading.LEAST_STATIONS
    radius = 0.5 * (near + far)
    place, left = shading.fit_rods(profiles[kind].reshape(-1, shading.SAMPLES), blur)
    place, left = place.reshape(-1, 2) * radius[:, None], left.reshape(-1, 2)
    sound = good & (left < shading.WORST_SHARE)
    shift = shading.pooled(
        shading.Flanks(
            low_px=flanks.low_px - place,
            high_px=flanks.high_px - place,
            stations=np.where(sound, stations, 0.0),
            normal=flanks.normal,
        )
    )
    limit = shading.LARGEST_RADII * radius[:, None, None]
    loose = np.where(sound, np.hypot(SHADED_SIGMA_PX, shading.MISS_RADII * left * radius[:, None]), unsure)
    return np.clip(shift, -limit, limit), loose, np.where(good, left, np.nan), shading.GAMMAS[kind], blur
