"""Where the axis is between a lit and a dark flank.

An edge detector puts a flank where grey changes most. On the lit side that is the outline; on the dark side
grey falls before the outline is reached, the more the further round a camera sees, so the two pictures
disagree in the same sense whatever the light: parts look too near. Here the mean light across each part
is explained by what it is, a round rod under any distant light: Lambert's law gives
``a + b x/r + c sqrt(1 - (x/r)^2)`` between the outlines at -r and r, blurred by the lens, whatever the light.
The radius is known, the place is fitted; the camera's gamma and its blur are those that explain the profiles
of the look best. What this says of flanks that look one way is common to a look, so it is pooled over all
parts by the way their flanks look.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from vision.canvas import through_grid
from vision.jit import compiled
from vision.types import Bools, Floats

HALF_SAMPLES = 14
SAMPLES = 2 * HALF_SAMPLES + 1
REACH = 1.5
"""How far the profile is read to both sides, in radii."""
LEAST_STATIONS = 8
BLURS = (0.12, 0.15, 0.18, 0.21, 0.24, 0.27, 0.3, 0.34, 0.38)
"""Lens, pixel and reading together, standard deviation in radii."""
GAMMAS = (1.0, 2.2)
"""Cameras either give numbers in proportion to light, or encoded as sRGB does."""
PLACES = np.arange(-10, 11) * 0.03
"""Places tried, in radii."""
QUADRATURE = 64
WORST_SHARE = 0.03
"""A profile that a rod misses by more of its contrast shows something else: a highlight, a neighbour."""
MISS_RADII = 4.0
"""How far off a place is, standard deviation in radii, per share of contrast that the profile is missed by.
`bench.doubts`, 15,078 views of 360 heaps: 0.10 px below 0.002 of contrast, 0.17 px at 0.005, 0.29 px at 0.01.
"""
LARGEST_RADII = 0.25
OWN_STATIONS = 20.0
"""Stations at which a part's own reading counts as much as that of all parts together."""
POOLED_SPREAD_PX = 0.08
POOLING_ROUNDS = 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Flanks:
    """Where the flanks of N parts are seen in two views, from their outlines along the part's normal, px.

    ``low_px``, ``high_px`` (N, 2); ``stations`` (N, 2) how many places are behind it, 0 where nothing is
    told; ``normal`` (N, 2, 2).
    """

    low_px: Floats
    high_px: Floats
    stations: Floats
    normal: Floats


@compiled
def mean_profiles(
    light: Floats, grey: npt.NDArray[np.uint8], grid: Floats, row_shift: float, view: int, which: Bools,
    ends: Floats, steps: npt.NDArray[np.int32], near: Floats, far: Floats, own: Bools,
    profiles: Floats, stations: Floats,
) -> None:  # fmt: skip
    """Mean light across parts at their own stations in one view, into ``profiles`` (G, N, 2, `SAMPLES`).

    Parameters
    ----------
    light : (256, G)
        What a grey value means, for G gammas.
    which : (N, 2)
        The profiles that are wanted.
    ends : (N, 2, 4)
        On the canvas.
    near, far : (N,)
        Radius at either end, px. Sample k is ``(k - HALF_SAMPLES) / HALF_SAMPLES * REACH * r`` off the axis.
    own : (N, 2, S)
        Stations to read, of the first ``steps`` (N, 2).
    stations : (N, 2)
        Is told how many lie inside the picture.
    """
    rows, columns = grey.shape
    gammas = light.shape[1]
    profile = np.empty((SAMPLES, gammas))
    for h in range(len(which)):
        if not which[h, view]:
            continue
        profile[:] = 0.0
        count = 0
        xa, ya = ends[h, view, 0], ends[h, view, 1] - row_shift
        dx, dy = ends[h, view, 2] - ends[h, view, 0], ends[h, view, 3] - ends[h, view, 1]
        size = np.hypot(dx, dy)
        nx, ny = -dy / size, dx / size
        for q in range(steps[h, view]):
            if not own[h, view, q]:
                continue
            share = (q + 0.5) / steps[h, view]
            x, y = xa + share * dx, ya + share * dy
            step = REACH / HALF_SAMPLES * (near[h] + share * (far[h] - near[h]))
            ax, ay = through_grid(grid, x, y)
            bx, by = through_grid(grid, x + nx, y + ny)
            ux, uy = step * (bx - ax), step * (by - ay)
            wide, high = HALF_SAMPLES * abs(ux), HALF_SAMPLES * abs(uy)
            if ax < wide or ay < high or ax + wide >= columns - 1 or ay + high >= rows - 1:
                continue
            for k in range(SAMPLES):
                px, py = ax + (k - HALF_SAMPLES) * ux, ay + (k - HALF_SAMPLES) * uy
                i, j = int(px), int(py)
                fx, fy = px - i, py - j
                a, b, c, e = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy
                here, beside = grey[j, i], grey[j, i + 1]
                below, across = grey[j + 1, i], grey[j + 1, i + 1]
                for g in range(gammas):
                    profile[k, g] += (
                        a * light[here, g] + b * light[beside, g] + c * light[below, g] + e * light[across, g]
                    )
            count += 1
        stations[h, view] = count
        if count > 0:
            for k in range(SAMPLES):
                for g in range(gammas):
                    profiles[g, h, view, k] = profile[k, g] / count


@lru_cache(maxsize=1)
def light_of_grey() -> Floats:
    """(256, G) light, 0..1, that a grey value stands for, for each of `GAMMAS`."""
    grey = np.arange(256) / 255.0
    return np.ascontiguousarray(np.stack([grey**gamma for gamma in GAMMAS], axis=1))


def fit_rods(profiles: Floats, blur: float) -> tuple[Floats, Floats]:
    """Place of a round rod in each profile (N, `SAMPLES`), in radii; what is left as a share of contrast.

    For a given place the five unknown levels (both backgrounds, a, b, c) are linear: what no choice of them
    explains is a projection, one matrix for each place. The place is the vertex of the parabola through the
    best three.
    """
    return _fit(np.ascontiguousarray(profiles), _explained(blur))


@compiled
def _fit(profiles: Floats, explained: Floats) -> tuple[Floats, Floats]:
    count, places = len(profiles), explained.shape[2]
    at, left = np.zeros(count), np.zeros(count)
    square, total, line = np.zeros(places), np.zeros(places), np.zeros(SAMPLES)
    step = PLACES[1] - PLACES[0]
    for h in range(count):
        # a constant is within what is explained: without it less is lost to rounding
        line[:] = profiles[h] - profiles[h].mean()
        whole = 0.0
        for k in range(SAMPLES):
            whole += line[k] * line[k]
        square[:] = whole
        for n in range(len(explained)):
            total[:] = 0.0
            for k in range(SAMPLES):
                for place in range(places):
                    total[place] += line[k] * explained[n, k, place]
            for place in range(places):
                square[place] -= total[place] * total[place]
        best = 1
        for place in range(1, places - 1):
            if square[place] < square[best]:
                best = place
        if square[places - 1] < square[best]:
            best = places - 2
        if square[0] < square[best]:
            best = 1
        before, here, after = square[best - 1], square[best], square[best + 1]
        bend = max(before - 2 * here + after, 1e-12)
        off = min(max(0.5 * (before - after) / bend, -1.0), 1.0)
        contrast = max(profiles[h].max() - profiles[h].min(), 1e-6)
        at[h] = PLACES[best] + step * off
        left[h] = np.sqrt(max(here - 0.25 * (before - after) * off, 0.0) / SAMPLES) / contrast
    return at, left


@lru_cache(maxsize=1)
def _all_explained() -> Floats:
    """(B, 5, `SAMPLES`, P) for each of `BLURS`."""
    return np.stack([_explained(blur) for blur in BLURS])


@lru_cache(maxsize=2 * len(BLURS))
def _explained(blur: float) -> Floats:
    """(5, `SAMPLES`, P) orthonormal bases of what a rod at each place explains."""
    angle = ((np.arange(QUADRATURE) + 0.5) / QUADRATURE - 0.5) * np.pi
    sine, cosine = np.sin(angle), np.cos(angle)
    where = (np.arange(SAMPLES) - HALF_SAMPLES) / HALF_SAMPLES * REACH
    bases = np.empty((5, SAMPLES, len(PLACES)))
    for p, place in enumerate(PLACES):
        x = where - place
        # x = r sin(angle): equal steps of the angle crowd at the outlines, where the light changes most
        spread = np.exp(-0.5 * ((x[:, None] - sine) / blur) ** 2) * cosine
        spread *= np.pi / QUADRATURE / (blur * np.sqrt(2 * np.pi))
        inside = spread.sum(axis=1)
        low = np.where(x < 0, 1 - inside, 0.0)
        levels = [low, (1 - inside) - low, inside, (spread * sine).sum(axis=1)]
        basis, _ = np.linalg.qr(np.column_stack([*levels, (spread * cosine).sum(axis=1)]))
        bases[:, :, p] = basis.T
    return bases


def best_optics(profiles: Floats) -> tuple[int, float]:
    """Which gamma and which blur explain the profiles best; ``profiles`` (G, K, `SAMPLES`) holds the same
    ones for each gamma."""
    kind, at = _best(np.ascontiguousarray(profiles), _all_explained())
    return kind, BLURS[at]


@compiled
def _best(profiles: Floats, explained: Floats) -> tuple[int, int]:
    kind, at, least = 0, 0, np.inf
    for place in range(len(profiles)):
        for blur in range(len(explained)):
            _, left = _fit(profiles[place], explained[blur])
            typical = np.median(left)
            if typical < least:
                kind, at, least = place, blur, typical
    return kind, at


def pooled(found: Flanks) -> Floats:
    """(N, 2, 2) px how far the low and the high flank are seen along the normal from their outlines.

    For each view the inward shift of a flank is ``k0 + k1 nx + k2 ny`` of the way it looks, fitted over all
    flanks with Huber's weights; a part's own reading counts beside it by its stations.
    """
    shift = np.zeros((len(found.stations), 2, 2))
    _pool(found.low_px, found.high_px, found.stations, found.normal, shift)
    return shift


@compiled
def _pool(low_px: Floats, high_px: Floats, stations: Floats, normal: Floats, shift: Floats) -> None:
    count = len(stations)
    model, right, matrix, basis = np.zeros(3), np.zeros(3), np.zeros((3, 3)), np.zeros(3)
    for view in range(2):
        if stations[:, view].max() <= 0:
            continue
        model[:] = 0.0
        for turn in range(POOLING_ROUNDS):
            matrix[:] = 0.0
            matrix[0, 0], matrix[1, 1], matrix[2, 2] = 1.0, 20.0, 20.0
            right[:] = 0.0
            for h in range(count):
                weight = stations[h, view]
                if weight <= 0:
                    continue
                for side in range(2):
                    sign = -1.0 if side == 0 else 1.0
                    inward = low_px[h, view] if side == 0 else -high_px[h, view]
                    basis[0], basis[1], basis[2] = 1.0, sign * normal[h, view, 0], sign * normal[h, view, 1]
                    robust = weight
                    if turn > 0:
                        miss = abs(inward - (basis * model).sum())
                        robust *= min(1.0, POOLED_SPREAD_PX / max(miss, 1e-9))
                    for i in range(3):
                        right[i] += robust * basis[i] * inward
                        for j in range(3):
                            matrix[i, j] += robust * basis[i] * basis[j]
            model[:] = np.linalg.solve(matrix, right)
        for h in range(count):
            own = stations[h, view] / (stations[h, view] + OWN_STATIONS)
            turned = model[1] * normal[h, view, 0] + model[2] * normal[h, view, 1]
            shift[h, view, 0] = own * low_px[h, view] + (1 - own) * (model[0] - turned)
            shift[h, view, 1] = own * high_px[h, view] - (1 - own) * (model[0] + turned)
