"""The chosen parts measured once more, each on its own edges and with its shading, and how well each is
known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vision import claims, shading
from vision.canvas import in_space
from vision.edges import Edges, Ids, Reals
from vision.explain import UNSHADED_SIGMA_PX, Explanation, Frame, settle
from vision.flank import Counts
from vision.jit import compiled
from vision.refine import LENGTH
from vision.traits import traits
from vision.types import Bools, Floats, Grey

SEEN = 0.3
"""Least strength of a flank that is read for shading."""
CLEAR_SAMPLES = 3
"""Samples next to the ends that are not read: there the outline turns."""
SHADED_SIGMA_PX = 0.03
"""What light still shifts the flanks of one view by after the profile has been read."""
TILT_SHARE = 0.05
ROUNDS, SPACING_PX = 5, 1.5
MOST_PROFILES = 12
MOST_MOVED_PX, LEAST_KEPT = 2.5, 0.6
"""A part that moves further, or keeps less of what tells its place, has jumped to something else."""
STEP_PX = 1e-3
BEYOND_SHARES = (0.03, 0.28)
"""Where, in lengths beyond an end, a part is looked for that is longer than it should be."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measured:
    """C parts, in the order they were chosen.

    ``parts`` (C, `COLUMNS`); ``covariance`` (C, 6, 6) of x, y, d at both ends, px; ``bow_px`` (C,) how far
    the middle is off the line through the ends, the straighter view; ``free_length_m`` (C,) length as its
    ends alone have it, NaN where they are not all seen; ``goes_on`` (C,) share of the way just beyond an
    unseen end on which both flanks are seen in both pictures; ``gamma``, ``blur`` of the cameras as the
    profiles have them."""

    parts: Floats
    covariance: Floats
    bow_px: Floats
    free_length_m: Floats
    goes_on: Floats
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
    chosen = found.chosen if rows is None else rows
    parts = np.ascontiguousarray(found.hypotheses[np.array(chosen, np.int64)])
    count = len(chosen)
    nobody = np.zeros(len(found.hypotheses), np.bool_)
    now = found.state
    flanks, profiles, bow = _read(found, chosen, left, right, greys, row_shift_px, frame)
    shift, loose, gamma, blur = _shift(flanks, profiles, parts, frame)
    covariance = np.zeros((count, 6, 6))
    free_length = np.full(count, np.nan)
    for place, k in enumerate(chosen):
        claims.give_back(now, k)
        taken = (now.taken_l, now.taken_r)
        one = parts[place : place + 1].copy()
        own = slice(place, place + 1)
        plain = one.copy()
        before = settle(plain, left, right, taken, frame, TILT_SHARE, 2, SPACING_PX)
        normals = settle(
            one, left, right, taken, frame, TILT_SHARE, ROUNDS, SPACING_PX, shift[own], loose[own]
        )
        moved = np.abs(one[0, 1:7] - parts[place, 1:7]).max()
        if moved > MOST_MOVED_PX or np.trace(normals[0]) < LEAST_KEPT * np.trace(before[0]):
            # it lost its own edges on the way: the first measurement stands, without the shading
            one, normals = plain, before
            shift[own] = 0.0
            loose[own] = UNSHADED_SIGMA_PX
        covariance[place] = np.linalg.inv(normals[0] + 1e-6 * np.eye(6))
        if (now.tip_value[k].mean(axis=2) > SEEN).all():
            free = one.copy()
            free[:, LENGTH] = 0.0
            settle(free, left, right, taken, frame, TILT_SHARE, 3, SPACING_PX, shift[own], loose[own])
            free_length[place] = _length_m(free[0], frame)
        parts[place] = one[0]
        claims.take(now, k, nobody)
    return Measured(
        parts=parts,
        covariance=covariance,
        bow_px=bow,
        free_length_m=free_length,
        goes_on=_goes_on(found, chosen, left, right, frame),
        gamma=gamma,
        blur=blur,
    )


def _goes_on(found: Explanation, chosen: list[int], left: Edges, right: Edges, frame: Frame) -> Floats:
    """(C,) the larger of both ends, 0 where the end itself is seen."""
    beyond = np.repeat(found.hypotheses[chosen], 2, axis=0)
    if len(beyond) == 0:
        return np.zeros(0)
    ends = beyond[:, 1:7].reshape(-1, 2, 3).copy()
    way = ends[:, 1] - ends[:, 0]
    first, last = BEYOND_SHARES
    for end, sign in ((0, -1.0), (1, 1.0)):
        at, along = ends[end::2, end], sign * way[end::2]
        beyond[end::2, 1:7] = np.stack([at + first * along, at + last * along], axis=1).reshape(-1, 6)
    seen = traits(beyond, left, right, frame.length_px)
    shares = np.zeros((2, len(beyond)))
    for view in range(2):
        for row in range(len(beyond)):
            steps = int(seen.count[row, view])
            shares[view, row] = float((seen.value[row, view, :steps] > SEEN).all(axis=1).mean())
    tips = found.seen.tip_value[chosen].mean(axis=(1, 3)).reshape(-1)
    return np.asarray(np.where(tips < SEEN, shares.min(axis=0), 0.0).reshape(-1, 2).max(axis=1), np.float64)


def sigmas(part: Floats, covariance: Floats, frame: Frame) -> tuple[float, float]:
    """Standard deviation of the centre in its worst direction, m, and of the axis, rad.

    Propagated from the covariance of the six numbers through the triangulation, numerically.
    """
    ends = part[1:7].reshape(2, 3)
    here = in_space(ends, frame.on)
    moved = np.repeat(part[1:7][None], 6, axis=0) + STEP_PX * np.eye(6)
    slope = ((in_space(moved.reshape(6, 2, 3), frame.on) - here) / STEP_PX).reshape(6, 6).T
    in_metres = slope @ covariance @ slope.T
    mean = 0.5 * np.concatenate([np.eye(3), np.eye(3)], axis=1)
    centre = mean @ in_metres @ mean.T
    way = here[1] - here[0]
    length = float(np.linalg.norm(way))
    difference = np.concatenate([-np.eye(3), np.eye(3)], axis=1)
    across = np.eye(3) - np.outer(way, way) / length**2
    turn = across @ (difference @ in_metres @ difference.T) @ across / length**2
    return (
        float(np.sqrt(max(np.linalg.eigvalsh(centre)[-1], 0.0))),
        float(np.sqrt(max(np.linalg.eigvalsh(turn)[-1], 0.0))),
    )


def _length_m(part: Floats, frame: Frame) -> float:
    ends = in_space(part[1:7].reshape(2, 3), frame.on)
    return float(np.linalg.norm(ends[1] - ends[0]))


def _read(
    found: Explanation,
    chosen: list[int],
    left: Edges,
    right: Edges,
    greys: tuple[Grey, Grey],
    row_shift_px: float,
    frame: Frame,
) -> tuple[shading.Flanks, dict[float, Floats], Floats]:
    """Flanks and profiles of the chosen parts in both views, and how far they are bent."""
    count = len(chosen)
    now = found.state
    unit = frame.unit
    low, high, bow = np.zeros((count, 2)), np.zeros((count, 2)), np.zeros((count, 2))
    stations, normal = np.zeros((count, 2)), np.zeros((count, 2, 2))
    profiles = {gamma: np.zeros((count, 2, shading.SAMPLES)) for gamma in shading.GAMMAS}
    for view, (edges, grey) in enumerate(zip((left, right), greys, strict=True)):
        taken = now.taken_l if view == 0 else now.taken_r
        for place, k in enumerate(chosen):
            near, far = found.hypotheses[k, 3], found.hypotheses[k, 6]
            own, low[place, view], high[place, view], bow[place, view], nx, ny = _own(
                int(now.samples[k, view]), now.ends[k, view], near, far, unit, now.edge[k, view],
                now.value[k, view], taken, edges.table,
            )  # fmt: skip
            normal[place, view] = nx, ny
            for gamma in shading.GAMMAS:
                stations[place, view] = shading.mean_profile(
                    shading.light_of_grey(gamma), grey, frame.on.to_raw[view], row_shift_px * view,
                    now.ends[k, view], 0.5 * unit * near, 0.5 * unit * far, own, profiles[gamma][place, view],
                )  # fmt: skip
    flanks = shading.Flanks(low_px=low, high_px=high, stations=stations, normal=normal)
    return flanks, profiles, np.abs(bow).min(axis=1) if count else np.zeros(0)


@compiled
def _own(
    steps: int,
    ends: Floats,
    near: float,
    far: float,
    unit: float,
    edge: Ids,
    value: Reals,
    taken: Counts,
    table: Reals,
) -> tuple[Bools, float, float, float, float, float]:
    """Samples whose flanks are both seen and no other's; mean place of either flank from where the outline
    would be; how far the middle bends; the normal."""
    own = np.zeros(steps, np.bool_)
    dx, dy = ends[2] - ends[0], ends[3] - ends[1]
    size = np.hypot(dx, dy)
    nx, ny = -dy / size, dx / size
    low = high = 0.0
    count = 0
    # offset against share: constant, slope and parabola, by their normal equations
    normal, right = np.zeros((3, 3)), np.zeros(3)
    basis = np.zeros(3)
    for q in range(CLEAR_SAMPLES, steps - CLEAR_SAMPLES):
        a, b = edge[q, 0], edge[q, 1]
        if a < 0 or b < 0 or value[q, 0] < SEEN or value[q, 1] < SEEN or taken[a] > 1 or taken[b] > 1:
            continue
        share = (q + 0.5) / steps
        x, y = ends[0] + share * dx, ends[1] + share * dy
        radius = 0.5 * unit * (near + share * (far - near))
        first = (table[a, 0] - x) * nx + (table[a, 1] - y) * ny + radius
        second = (table[b, 0] - x) * nx + (table[b, 1] - y) * ny - radius
        low += first
        high += second
        basis[0], basis[1], basis[2] = 1.0, 2 * share - 1, 4 * share * (1 - share)
        for i in range(3):
            right[i] += basis[i] * 0.5 * (first + second)
            for j in range(3):
                normal[i, j] += basis[i] * basis[j]
        own[q] = True
        count += 1
    bow = 0.0
    if count > 0:
        low /= count
        high /= count
        for i in range(3):
            normal[i, i] += 1.0
        bow = float(np.linalg.solve(normal, right)[2])
    return own, low, high, bow, nx, ny


def _shift(
    flanks: shading.Flanks, profiles: dict[float, Floats], parts: Floats, frame: Frame
) -> tuple[Floats, Floats, float, float]:
    """Where light shifts the flanks to, (C, 2, 2) px; how sure that is (C, 2) px; gamma and blur."""
    count = len(parts)
    radius = 0.25 * frame.unit * (parts[:, 3] + parts[:, 6])
    good = flanks.stations >= shading.LEAST_STATIONS
    unsure = np.full((count, 2), UNSHADED_SIGMA_PX)
    if not good.any():
        return np.zeros((count, 2, 2)), unsure, shading.GAMMAS[0], shading.BLURS[0]
    best = np.argsort(-flanks.stations[good])[:MOST_PROFILES]
    gamma, blur = shading.best_optics({of: all_[good][best] for of, all_ in profiles.items()})
    place, left = shading.fit_rods(profiles[gamma].reshape(-1, shading.SAMPLES), blur)
    place, left = place.reshape(-1, 2) * radius[:, None], left.reshape(-1, 2)
    sound: npt.NDArray[np.bool_] = good & (left < shading.WORST_SHARE)
    shift = shading.pooled(
        shading.Flanks(
            low_px=flanks.low_px - place,
            high_px=flanks.high_px - place,
            stations=np.where(sound, flanks.stations, 0.0),
            normal=flanks.normal,
        )
    )
    limit = shading.LARGEST_RADII * radius[:, None, None]
    loose = np.where(sound, np.hypot(SHADED_SIGMA_PX, left * radius[:, None]), unsure)
    return np.clip(shift, -limit, limit), loose, gamma, blur
