"""A part in space moved until its flanks and ends lie on the edges of both pictures.

Six unknowns: column, row and disparity of both ends. Where the axis passes between two flanks the residual is
their middle's offset, where one flank is seen it is that flank's offset at half the part's width, which is
known in space: ``D d / B`` px. Ends are measured along the axis. Gauss-Newton with Tukey's weights; the known
length and a weak belief that parts lie flat are two more observations.
"""

from __future__ import annotations

import numpy as np

from vision.edges import Signposts
from vision.ends import add_end, cap_px
from vision.flank import Counts, nearest_edge, tip_offset
from vision.jit import compiled, inlined, lean
from vision.types import Floats

SCORE, XA, YA, DA, XB, YB, DB, UNIT, LENGTH, KIND = 0, 1, 2, 3, 4, 5, 6, 7, 8, 9
COLUMNS = 10
"""A hypothesis: score, both ends (x, y, d), width over disparity, known length m (0: unknown), which
product it is (-1: none of them)."""
NARROWEST, WIDEST = 0.65, 1.35
FLANK_SIGMA_PX = 0.33
ROW_SIGMA_PX = 0.05
"""What a good calibration leaves between the rows of the two pictures."""
ONE_FLANK_WEIGHT = 0.25
"""One flank tells the middle only as well as the width is known."""
DAMPING = 0.3
LONGEST_STEP_PX = 3.0
SEARCHED, MOST_SAMPLES = 2, 1024
"""In how many first rounds edges are looked up anew, then in every second; how many places of an axis."""


@lean
def axis_length(p: Floats, fb: float, focal: float, cx: float, cy: float) -> float:
    """Metres between the ends (x, y, d) of p (6,)."""
    za, zb = fb / p[2], fb / p[5]
    x = ((p[0] - cx) * za - (p[3] - cx) * zb) / focal
    y = ((p[1] - cy) * za - (p[4] - cy) * zb) / focal
    return float(np.sqrt(x * x + y * y + (za - zb) ** 2))


@lean
def _length_and_slope(p: Floats, fb: float, focal: float, cx: float, cy: float, slope: Floats) -> float:
    """`axis_length`, and into ``slope`` (6,) what it changes by with each number of p."""
    za, zb = fb / p[2], fb / p[5]
    xa, ya, xb, yb = (p[0] - cx) / focal, (p[1] - cy) / focal, (p[3] - cx) / focal, (p[4] - cy) / focal
    x, y, z = xa * za - xb * zb, ya * za - yb * zb, za - zb
    length = np.sqrt(x * x + y * y + z * z)
    ux, uy, uz = x / length, y / length, z / length
    slope[0], slope[1], slope[2] = ux * za / focal, uy * za / focal, -(ux * xa + uy * ya + uz) * za / p[2]
    slope[3], slope[4], slope[5] = -ux * zb / focal, -uy * zb / focal, (ux * xb + uy * yb + uz) * zb / p[5]
    return float(length)


@lean
def solve(matrix: Floats, right: Floats) -> None:
    """Solve a positive definite system of six in place, by Cholesky; ``right`` becomes the solution."""
    for a in range(6):
        for b in range(a + 1):
            total = matrix[a, b]
            for c in range(b):
                total -= matrix[a, c] * matrix[b, c]
            matrix[a, b] = np.sqrt(max(total, 1e-12)) if a == b else total / matrix[b, b]
    for a in range(6):
        for c in range(a):
            right[a] -= matrix[a, c] * right[c]
        right[a] /= matrix[a, a]
    for a in range(5, -1, -1):
        for c in range(a + 1, 6):
            right[a] -= matrix[c, a] * right[c]
        right[a] /= matrix[a, a]


@inlined
def add_flanks(
    view: int, nx: float, ny: float, scale: float, loose: float, squares: tuple[float, float, float],
    misses: tuple[float, float], whole: tuple[float, float, float, float], matrix: Floats, right: Floats,
) -> None:  # fmt: skip
    """Adds what the flanks of one view say across the axis, to the normal equations of the six numbers.

    ``squares`` sums of weights by the shares of both ends, ``misses`` of weighted offsets by either,
    ``whole`` sums of weights, of weights by either share and of weighted offsets; ``loose`` the variance of
    what light and calibration shift the whole view by: an unknown too, eliminated (Schur).
    """
    common = scale / (scale * whole[0] + 1 / loose)
    aa = squares[0] - common * whole[1] * whole[1]
    ab = squares[1] - common * whole[1] * whole[2]
    bb = squares[2] - common * whole[2] * whole[2]
    ra, rb = misses[0] - common * whole[1] * whole[3], misses[1] - common * whole[2] * whole[3]
    row = (nx, ny, -view * nx)
    for a in range(3):
        right[a] += scale * row[a] * ra
        right[3 + a] += scale * row[a] * rb
        for b in range(3):
            both = scale * row[a] * row[b]
            matrix[a, b] += both * aa
            matrix[a, 3 + b] += both * ab
            matrix[3 + a, b] += both * ab
            matrix[3 + a, 3 + b] += both * bb


@inlined
def add_flat(p: Floats, level: Floats, usual: float, matrix: Floats, right: Floats) -> None:
    """Adds that most parts lie flat: by Cauchy's law, one that clearly does not is believed. ``usual`` is the
    deviation of the difference of both disparities, px."""
    tilt = p[2] - p[5] - level[0] * (p[0] - p[3]) - level[1] * (p[1] - p[4])
    weight = 1 / (usual * usual + tilt * tilt)
    matrix[2, 2] += weight
    matrix[5, 5] += weight
    matrix[2, 5] -= weight
    matrix[5, 2] -= weight
    right[2] -= weight * tilt
    right[5] += weight * tilt


@compiled
def refine(
    hypotheses: Floats,
    posts_l: Signposts,
    taken_l: Counts,
    posts_r: Signposts,
    taken_r: Counts,
    camera: Floats,
    level: Floats,
    length_sigma: float,
    unit: float,
    tilt_share: float,
    step_d: float,
    rounds: int,
    spacing: float,
    shift: Floats,
    bias_sigma: Floats,
) -> Floats:
    """Refines each hypothesis (N, `COLUMNS`) in place.

    Parameters
    ----------
    taken_l, taken_r
        Edges that count as somebody else's where not 0.
    camera : (4,)
        Focal length px, baseline m, principal point px.
    level : (3,)
        Disparity of the table as a plane; flat parts follow its slope.
    length_sigma
        As a share of the length.
    unit
        Expected width over disparity: diameter over baseline.
    tilt_share, step_d
        Deviation of the height difference of the ends, as a share of the length; disparity per metre of
        height, px.

    shift : (N, 2, 2)
        Where the low and the high flank are seen from their outlines in either view, along the normal, px.

    bias_sigma : (N, 2)
        Deviation of what still shifts all flanks of a part in one view alike, px.

    Returns
    -------
    (N, 6, 6)
        Normal matrix of the last step: its inverse is the covariance of the six numbers, px.
    """
    focal, baseline, cx, cy = camera[0], camera[1], camera[2], camera[3]
    fb = focal * baseline
    normals = np.zeros((len(hypotheses), 6, 6))
    matrix, own = np.zeros((6, 6)), np.zeros((6, 6))
    right, row = np.zeros(6), np.zeros(6)
    met, steps_of = np.full((2, MOST_SAMPLES, 2), -1, np.int64), np.zeros(2, np.int64)
    for h in range(len(hypotheses)):
        p = hypotheses[h, 1:7].copy()
        wide = hypotheses[h, UNIT]
        length = hypotheses[h, LENGTH]
        for turn in range(rounds):
            reach = 2.4 if turn == 0 else (1.6 if turn < 3 else (1.1 if turn < 4 else 0.8))
            matrix[:] = 0.0
            right[:] = 0.0
            spread, spread_of = 0.0, 0
            for view in range(2):
                posts = posts_l if view == 0 else posts_r
                table = posts.table
                taken = taken_l if view == 0 else taken_r
                xa, ya = p[0] - view * p[2], p[1]
                xb, yb = p[3] - view * p[5], p[4]
                size = np.hypot(xb - xa, yb - ya)
                if size < 5:
                    continue
                ux, uy = (xb - xa) / size, (yb - ya) / size
                nx, ny = -uy, ux
                again = turn < SEARCHED or turn % 2 == 0
                if again:
                    steps_of[view] = min(int(size / spacing), MOST_SAMPLES)
                steps = steps_of[view]
                aa = ab = bb = ra = rb = 0.0
                whole = whole_a = whole_b = missed = 0.0
                for q in range(steps):
                    share = (q + 0.5) / steps
                    # within a width of the ends the edge turns round the corner
                    x, y = xa + share * (xb - xa), ya + share * (yb - ya)
                    width = wide * (p[2] + share * (p[5] - p[2]))
                    half = 0.5 * width
                    if share * size < half or (1 - share) * size < half:
                        if again:
                            met[view, q, 0], met[view, q, 1] = -1, -1
                        continue
                    hx, hy, lx, ly = x + nx * half, y + ny * half, x - nx * half, y - ny * half
                    if again:
                        high, off_high = nearest_edge(posts, taken, hx, hy, -nx, -ny, reach)
                        low, off_low = nearest_edge(posts, taken, lx, ly, nx, ny, reach)
                        met[view, q, 0], met[view, q, 1] = low, high
                    else:
                        # what was met a moment ago is met again, a little further off or nearer
                        low, high, off_low, off_high = met[view, q, 0], met[view, q, 1], 0.0, 0.0
                        if high >= 0:
                            off_high = -(table[high, 0] - hx) * nx - (table[high, 1] - hy) * ny
                            high = high if abs(off_high) <= reach else -1
                        if low >= 0:
                            off_low = (table[low, 0] - lx) * nx + (table[low, 1] - ly) * ny
                            low = low if abs(off_low) <= reach else -1
                    if high < 0 and low < 0:
                        continue
                    off_low -= shift[h, view, 0]
                    off_high += shift[h, view, 1]
                    if high >= 0 and low >= 0:
                        miss = 0.5 * (off_low - off_high)
                        weight = 1.0
                        spread += (width - off_high - off_low) / width
                        spread_of += 1
                    elif high >= 0:
                        miss, weight = -off_high, ONE_FLANK_WEIGHT
                    else:
                        miss, weight = off_low, ONE_FLANK_WEIGHT
                    weight *= (1 - (miss / (reach + 0.3)) ** 2) ** 2
                    one = 1 - share
                    aa += weight * one * one
                    ab += weight * one * share
                    bb += weight * share * share
                    ra += weight * one * miss
                    rb += weight * share * miss
                    whole += weight
                    whole_a += weight * one
                    whole_b += weight * share
                    missed += weight * miss
                scale = spacing / (FLANK_SIGMA_PX * FLANK_SIGMA_PX)
                loose = bias_sigma[h, view] ** 2 + view * (ny * ROW_SIGMA_PX) ** 2
                add_flanks(
                    view, nx, ny, scale, loose, (aa, ab, bb), (ra, rb), (whole, whole_a, whole_b, missed),
                    matrix, right,
                )  # fmt: skip
                for end in range(2):
                    ox, oy = (-ux, -uy) if end == 0 else (ux, uy)
                    x, y = (xa, ya) if end == 0 else (xb, yb)
                    width = wide * p[3 * end + 2]
                    # looked for where it would be seen
                    cap, doubt = cap_px(p, end, view, width, camera, False)
                    off, lanes, _ = tip_offset(
                        posts, taken, x + cap * ox, y + cap * oy, ox, oy, width, 3.5 if turn < 2 else 2.5
                    )
                    add_end(view, end, ox, oy, off, lanes, doubt, matrix, right)
            now = _length_and_slope(p, fb, focal, cx, cy, row)
            weight = 1 / (length_sigma * length) ** 2 if length > 0 else 0.0
            for a in range(6):
                right[a] += weight * row[a] * (length - now)
                for b in range(6):
                    matrix[a, b] += weight * row[a] * row[b]
            add_flat(p, level, tilt_share * now * step_d, matrix, right)
            own[:] = matrix
            for a in range(6):
                matrix[a, a] += DAMPING
            solve(matrix, right)
            for a in range(6):
                p[a] += min(max(right[a], -LONGEST_STEP_PX), LONGEST_STEP_PX)
            p[2], p[5] = max(p[2], 1.0), max(p[5], 1.0)
            if spread_of * spacing > 20:
                wide = min(max(wide * (0.5 + 0.5 * spread / spread_of), NARROWEST * unit), WIDEST * unit)
        hypotheses[h, 1:7] = p
        hypotheses[h, UNIT] = wide
        normals[h] = own
    return normals
