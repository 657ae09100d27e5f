"""Windows of lines along the baseline, which have no disparity of their own: place and steepness are told by
the left line, disparity by where the right line's window lies."""

from __future__ import annotations

import numpy as np

from vision.along import NOTHING, window_value
from vision.edges import Reals
from vision.jit import compiled, lean
from vision.refine import DA, DB, SCORE, XA, XB, YA, YB
from vision.types import Floats

STEEPEST, SLANTS = 0.8, 17
"""Greatest height difference of the ends in lengths; in how many steps it is tried."""
TILT_LENGTHS = 0.1
"""What a steep part costs."""
ROW_PX = 1.6
NEAR_BASELINE = 0.2
"""Sine of the angle up to which a line may be one of these."""
MOST = 20000
SLACK_LENGTHS = 0.3
"""In lengths, how much evidence at another height may exceed what was read."""
END_PX = 2
STEP_S, STEP_D = 4, 2
FINE_S, FINE_D, FINE_R = 5, 3, 3
"""How wide an end is taken at first; steps along the line and of disparity; places, disparities and slants
tried round a best."""


@compiled
def wide(lines: Floats, tips: Reals) -> Reals:
    """Evidence of ends along lines near the baseline, each place having the most within `END_PX`."""
    found = np.empty_like(tips)
    size = tips.shape[1]
    for line in range(len(tips)):
        if lines[line, 3] >= NEAR_BASELINE:
            continue
        for q in range(size):
            for way in range(2):
                most = tips[line, q, way]
                for other in range(max(0, q - END_PX), min(size, q + END_PX + 1)):
                    most = max(most, tips[line, other, way])
                found[line, q, way] = most
    return found


@lean
def slanted(
    left: Floats, i: int, total: Floats, wide: Reals, alone: Floats, reach: int, focal: float,
    baseline: float, cx: float, cy: float, planes: Floats, length: float, length_px: float, tip: float,
    beyond: int, least: float, reaches: Floats, value: Floats,
) -> None:  # fmt: skip
    """For every fourth place of a line along the baseline and every steepness, (2 R + 1, SLANTS): how long
    the part looks at a far end one metre away, its evidence at a middle height, `NOTHING` if too little."""
    for s in range(-reach + beyond, reach - beyond - 8, STEP_S):
        x, y = left[i, 0] + s * left[i, 2], left[i, 1] + s * left[i, 3]
        low_d = planes[0, 0] * x + planes[0, 1] * y + planes[0, 2]
        middle_d = 0.5 * (low_d + planes[1, 0] * x + planes[1, 1] * y + planes[1, 2])
        value[s + reach, :] = NOTHING
        if alone[i, s + reach] < -0.4 * length_px:
            continue
        for slant in range(SLANTS):
            rise = STEEPEST * (2.0 * slant / (SLANTS - 1) - 1.0)
            long = _reaches(left, i, float(s), rise, focal, cx, cy, length)
            middle_z = focal * baseline / middle_d - 0.5 * rise * length
            first = window_value(total, wide, i, reach, float(s), s + long / middle_z, tip, beyond)
            if long > 0.0 and first >= 0.15 * least:
                reaches[s + reach, slant] = long
                value[s + reach, slant] = first


@lean
def _reaches(
    lines: Floats, i: int, s: float, rise: float, focal: float, cx: float, cy: float, length: float
) -> float:
    """How long a part looks whose far end is one metre away and ``rise`` of its length nearer than the other.

    Across the rays it reaches ``f L sqrt(1 - r^2)``. With k the distance along the line from the foot of the
    principal point and c that of the foot it is ``r L k + sqrt((f L)^2 (1 - r^2) - (r L c)^2)`` long; 0:
    there is no such part.
    """
    x, y, ux, uy = lines[i, 0] - cx, lines[i, 1] - cy, lines[i, 2], lines[i, 3]
    across = (focal * length) ** 2 * (1 - rise * rise) - (rise * length * (y * ux - x * uy)) ** 2
    if across <= 0.0:
        return 0.0
    return float(rise * length * (ux * x + uy * y + s) + np.sqrt(across))


@compiled
def flat_pair(
    left: Floats, right: Floats, i: int, j: int, total_l: Floats, total_r: Floats, tips_l: Reals,
    tips_r: Reals, wide_l: Reals, wide_r: Reals, reaches: Floats, value_l: Floats, alone_r: Floats,
    most_r: float, reach: int, focal: float, baseline: float, cx: float, cy: float, planes: Floats,
    length: float, length_px: float, tip: float, beyond: int, least: float, best: Floats, which: Floats,
    found: Floats, count: int,
) -> int:  # fmt: skip
    """Windows of two lines along the baseline: place and steepness on the left, disparity on the right.

    First at every fourth place and every second disparity with ends `END_PX` wide, then the best more finely.
    """
    ax, ay, ux, uy = left[i, 0], left[i, 1], left[i, 2], left[i, 3]
    bx, by, vx, vy = right[j, 0], right[j, 1], right[j, 2], right[j, 3]
    turned = 1.0
    if ux * vx + uy * vy < 0:
        vx, vy, turned = -vx, -vy, -1.0
    fb = focal * baseline
    slack = SLACK_LENGTHS * length_px
    low_0 = planes[0, 0] * ax + planes[0, 1] * ay + planes[0, 2]
    high_0 = planes[1, 0] * ax + planes[1, 1] * ay + planes[1, 2]
    low_k = planes[0, 0] * ux + planes[0, 1] * uy
    high_k = planes[1, 0] * ux + planes[1, 1] * uy
    # how far the left line lies off the right one: off_0 + off_k s + vy d
    off_0 = -(ax - bx) * vy + (ay - by) * vx
    off_k = -ux * vy + uy * vx
    any_good = False
    start, stop = -reach + beyond, reach - beyond - 8
    places = (stop - start + STEP_S - 1) // STEP_S
    for place in range(places):
        best[place] = NOTHING
        s = start + STEP_S * place
        low_d, high_d = low_0 + s * low_k, high_0 + s * high_k
        off_s = off_0 + s * off_k
        near, far = off_s + low_d * vy, off_s + high_d * vy
        if min(near, far) > ROW_PX or max(near, far) < -ROW_PX:
            continue
        # the far end lies half to one and a half lengths on
        near, far = off_s + 0.5 * length_px * off_k, off_s + 1.5 * length_px * off_k
        least_d, most_d = min(low_d * vy, high_d * vy), max(low_d * vy, high_d * vy)
        if min(near, far) + least_d > ROW_PX or max(near, far) + most_d < -ROW_PX:
            continue
        q = s + reach
        for step in range(0, int(high_d - low_d) + 1, STEP_D):
            da = low_d + step
            off_a = off_s + da * vy
            if da < 1.0 or abs(off_a) > ROW_PX:
                continue
            ta = ((ax + s * ux - da - bx) * vx + (ay + s * uy - by) * vy) * turned
            begin = int(ta + reach + 0.5) if turned > 0 else int(ta + reach - length_px + 0.5)
            if begin < 0 or begin >= len(alone_r[j]) or alone_r[j, begin] < -0.3 * length_px:
                continue
            other = min(alone_r[j, begin] + slack, most_r) + slack
            # rises whose far end is between the planes, about
            e = s + length_px
            highest, lowest = fb / (high_0 + e * high_k), fb / max(low_0 + e * low_k, 1.0)
            middle, per_slant = fb / da / length, 0.5 * (SLANTS - 1) / STEEPEST
            first = max(0, int((STEEPEST + middle - lowest / length) * per_slant))
            last = min(SLANTS - 1, int((STEEPEST + middle - highest / length) * per_slant) + 1)
            for slant in range(first, last + 1):
                if value_l[q, slant] + other < max(least, best[place]):
                    continue
                rise = STEEPEST * (2.0 * slant / (SLANTS - 1) - 1.0)
                zb = fb / da - rise * length
                if zb <= 0.0:
                    continue
                per_z = 1.0 / zb
                m, db = reaches[q, slant] * per_z, fb * per_z
                e = s + m
                if db < low_0 + e * low_k or db > high_0 + e * high_k:
                    continue
                off_b = off_0 + e * off_k + db * vy
                if abs(off_b) > ROW_PX:
                    continue
                tb = ((ax + e * ux - db - bx) * vx + (ay + e * uy - by) * vy) * turned
                one = window_value(total_l, wide_l, i, reach, float(s), e, tip, beyond)
                if one + other < max(least, best[place]):
                    continue
                value = (
                    one
                    + window_value(total_r, wide_r, j, reach, min(ta, tb), max(ta, tb), tip, beyond)
                    - 2 * (off_a * off_a + off_b * off_b)
                    - TILT_LENGTHS * length_px * abs(rise)
                )
                if value > best[place]:
                    best[place] = value
                    which[place, 0], which[place, 1] = da, rise
                    any_good = True
    if not any_good:
        return count
    fine = np.empty(4)
    for _ in range(4):
        place = int(np.argmax(best[:places]))
        if best[place] < least or count >= MOST:
            break
        score = NOTHING
        for step in range(FINE_S * FINE_D * FINE_R):
            at = float(start + STEP_S * place) + (step % FINE_S - FINE_S // 2)
            da = which[place, 0] + (step // FINE_S % FINE_D - FINE_D // 2)
            rise = which[place, 1] + (step // (FINE_S * FINE_D) - FINE_R // 2) * STEEPEST / (SLANTS - 1)
            zb = fb / max(da, 1.0) - rise * length
            long = _reaches(left, i, at, rise, focal, cx, cy, length)
            if zb <= 0.0 or long <= 0.0:
                continue
            m, db = long / zb, fb / zb
            e = at + m
            off_a, off_b = off_0 + at * off_k + da * vy, off_0 + e * off_k + db * vy
            ta = ((ax + at * ux - da - bx) * vx + (ay + at * uy - by) * vy) * turned
            tb = ((ax + e * ux - db - bx) * vx + (ay + e * uy - by) * vy) * turned
            value = (
                window_value(total_l, tips_l, i, reach, at, e, tip, beyond)
                + window_value(total_r, tips_r, j, reach, min(ta, tb), max(ta, tb), tip, beyond)
                - 2 * (off_a * off_a + off_b * off_b)
                - TILT_LENGTHS * length_px * abs(rise)
            )
            if value > score:
                score = value
                fine[0], fine[1], fine[2], fine[3] = at, da, m, db
        for z in range(max(0, place - 1), min(places, place + 2)):
            best[z] = NOTHING
        if score < least:
            continue
        at, e = fine[0], fine[0] + fine[2]
        found[count, SCORE] = score
        found[count, XA], found[count, YA], found[count, DA] = ax + at * ux, ay + at * uy, fine[1]
        found[count, XB], found[count, YB], found[count, DB] = ax + e * ux, ay + e * uy, fine[3]
        count += 1
    return count
