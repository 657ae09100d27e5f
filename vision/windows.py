"""Lines of both pictures to parts in space: a window of the known length slid along each line in space.

Two lines of one part, one in each picture, are one line in space. Where on it the part lies, a window of
exactly the part's length tells that gathers the most evidence in both pictures, ends included; so a hidden
end completes itself. Lines along the baseline have no disparity of their own: there the windows of both
pictures are placed one by one.
"""

from __future__ import annotations

import numpy as np

from vision.canvas import Canvas
from vision.edges import Reals
from vision.jit import compiled
from vision.proposals import Lines
from vision.refine import COLUMNS, DA, DB, KIND, LENGTH, SCORE, UNIT, XA, XB, YA, YB, axis_length
from vision.types import Floats, Ints

FLAT = 0.17
"""Sine of the angle to the baseline below which disparity along a line means little."""
MIXED, SHALLOW = 0.07, 0.4
STEEPEST = 0.8
"""Height difference of the ends in lengths."""
LEAST_LENGTHS = 0.1
"""Least evidence of a window in both pictures together, in twice the part's length."""
TIP_WIDTHS = 1.3
BEYOND_WIDTHS = 2.5
BEYOND_WEIGHT = 0.5
TILT_LENGTHS = 0.1
"""What an end is worth, how far beyond it evidence must not continue, what that costs, what a steep part
costs."""
ROW_PX = 1.6
MOST = 20000
BEATEN = 0.6
"""A hypothesis with a smaller share of the evidence of another in its place is not looked at further."""
NOTHING = -1e9


def windows(
    left: Lines,
    right: Lines,
    on: Canvas,
    planes: Floats,
    length_m: float,
    width_px: float,
    length_px: float,
    unit: float,
) -> Floats:
    """Hypotheses (N, `COLUMNS`). Best first, doubles removed.

    Parameters
    ----------
    planes : (2, 3)
        Disparity of the lowest and the highest place a part's axis may be, see `disparity_planes`.
    """
    found, count = _slide(
        left.table, right.table, left.total, right.total, left.tips, right.tips, left.reach_px,
        on.focal_px, on.baseline_m, on.centre_px[0], on.centre_px[1], planes, length_m, width_px, length_px,
    )  # fmt: skip
    return by_score(found[:count], unit, length_m, 0.0)


def by_score(found: Floats, unit: float, length_m: float, kind: float) -> Floats:
    rows = np.zeros((len(found), COLUMNS))
    rows[:, :7] = found
    rows[:, UNIT], rows[:, LENGTH], rows[:, KIND] = unit, length_m, kind
    rows = np.ascontiguousarray(rows[np.argsort(-rows[:, SCORE], kind="stable")])
    return np.asarray(rows[distinct(rows, 1.5)], np.float64)


@compiled
def distinct(found: Floats, near_px: float) -> Ints:
    """Rows of sorted hypotheses that are not, within ``near_px`` in every number, one before them."""
    kept = np.empty(len(found), np.int64)
    count = 0
    for row in range(len(found)):
        double = False
        for k in range(count):
            other = kept[k]
            same, turned = 0.0, 0.0
            for n in range(3):
                same = max(same, abs(found[row, 1 + n] - found[other, 1 + n]))
                same = max(same, abs(found[row, 4 + n] - found[other, 4 + n]))
                turned = max(turned, abs(found[row, 1 + n] - found[other, 4 + n]))
                turned = max(turned, abs(found[row, 4 + n] - found[other, 1 + n]))
            if min(same, turned) < near_px:
                double = True
                break
        if not double:
            kept[count] = row
            count += 1
    return kept[:count]


@compiled
def outstanding(found: Floats, width_px: float, length_px: float) -> Ints:
    """Rows of sorted hypotheses that no much better one of the same kind shows the place of, in both
    pictures."""
    kept = np.empty(len(found), np.int64)
    count = 0
    for row in range(len(found)):
        beaten = False
        for q in range(count):
            k = kept[q]
            if found[k, KIND] != found[row, KIND] or found[row, SCORE] > BEATEN * found[k, SCORE]:
                continue
            same = True
            for view in range(2):
                xa, ya = found[k, XA] - view * found[k, DA], found[k, YA]
                dx, dy = found[k, XB] - view * found[k, DB] - xa, found[k, YB] - ya
                size = np.hypot(dx, dy)
                ux, uy = dx / size, dy / size
                for end in range(2):
                    px = found[row, 1 + 3 * end] - view * found[row, 3 + 3 * end] - xa
                    py = found[row, 2 + 3 * end] - ya
                    along = px * ux + py * uy
                    if (
                        abs(-px * uy + py * ux) > 0.7 * width_px
                        or along < -0.3 * length_px
                        or along > size + 0.3 * length_px
                    ):
                        same = False
                if not same:
                    break
            if same:
                beaten = True
                break
        if not beaten:
            kept[count] = row
            count += 1
    return kept[:count]


@compiled
def window_value(
    total: Floats, tips: Reals, line: int, reach: int, a: float, b: float, tip: float, beyond: int
) -> float:
    """Evidence between two places of a line, with its ends, less what goes on beyond them."""
    i, j = int(a + reach + 0.5), int(b + reach + 0.5)
    if i < beyond or j >= 2 * reach - beyond or j <= i:
        return NOTHING
    value = total[line, j] - total[line, i] + tip * (tips[line, i, 0] + tips[line, j, 1])
    before = total[line, i - 2] - total[line, i - beyond]
    after = total[line, j + beyond] - total[line, j + 2]
    return float(value - BEYOND_WEIGHT * (max(0.0, before) + max(0.0, after)))


@compiled
def _slide(
    left: Floats,
    right: Floats,
    total_l: Floats,
    total_r: Floats,
    tips_l: Reals,
    tips_r: Reals,
    reach: int,
    focal: float,
    baseline: float,
    cx: float,
    cy: float,
    planes: Floats,
    length: float,
    width: float,
    length_px: float,
) -> tuple[Floats, int]:
    found = np.empty((MOST, 7))
    count = 0
    fb = focal * baseline
    tip, beyond = TIP_WIDTHS * width, int(BEYOND_WIDTHS * width) + 1
    least = 2 * LEAST_LENGTHS * length_px
    size = 2 * reach + 1
    score, span, p = np.empty(size), np.empty(size), np.empty(6)
    alone = np.empty((len(left), size))
    for i in range(len(left)):
        for q in range(size):
            alone[i, q] = window_value(
                total_l, tips_l, i, reach, float(q - reach), q - reach + length_px, tip, beyond
            )
    for i in range(len(left)):
        ax, ay, ux, uy = left[i, 0], left[i, 1], left[i, 2], left[i, 3]
        low_d = planes[0, 0] * ax + planes[0, 1] * ay + planes[0, 2]
        high_d = planes[1, 0] * ax + planes[1, 1] * ay + planes[1, 2]
        slack = 0.5 * abs(high_d - low_d) + 2.0
        for j in range(len(right)):
            bx, by, vx, vy = right[j, 0], right[j, 1], right[j, 2], right[j, 3]
            same = ux * vx + uy * vy
            if abs(ay - by) > length_px or ax - bx < low_d - 1.6 * length_px:
                continue
            if ax - bx > high_d + 1.6 * length_px:
                continue
            if uy > MIXED and vy > 0.03 and same > 0.9:
                fall = uy / vy
                d0 = ax - bx - (ay - by) / vy * vx
                slope = ux - fall * vx
                back = (ay - by) / vy
                # the steepest part changes its disparity by this much along its length
                if abs(slope) * length_px > STEEPEST * length * high_d * high_d / fb + 2.0:
                    continue
                any_good = False
                for q in range(size):
                    score[q] = NOTHING
                # every other px: refinement does the rest
                for s in range(-reach + beyond, reach - beyond - 8, 2):
                    if alone[i, s + reach] < -0.15 * length_px:
                        continue
                    da = d0 + s * slope
                    if da < low_d - slack or da > high_d + slack or da < 1.0:
                        continue
                    xa, ya = ax + s * ux, ay + s * uy
                    m = length * da / baseline
                    db = d0 + (s + m) * slope
                    if db < 1.0:
                        continue
                    for _ in range(2):
                        p[0], p[1], p[2], p[3], p[4], p[5] = xa, ya, da, xa + m * ux, ya + m * uy, db
                        m *= length / axis_length(p, fb, focal, cx, cy)
                        db = max(d0 + (s + m) * slope, 1.0)
                    xb, yb = xa + m * ux, ya + m * uy
                    if not within(planes, xa, ya, da) or not within(planes, xb, yb, db):
                        continue
                    steep = abs(fb / da - fb / db) / length
                    if steep > STEEPEST:
                        continue
                    first = window_value(total_l, tips_l, i, reach, float(s), s + m, tip, beyond)
                    if first < 0.3 * 0.5 * least:
                        continue
                    second = window_value(
                        total_r, tips_r, j, reach, back + fall * s, back + fall * (s + m), tip, beyond
                    )
                    score[s + reach] = first + second - TILT_LENGTHS * length_px * steep
                    span[s + reach] = m
                    any_good = True
                if any_good:
                    for _ in range(4):
                        q = int(np.argmax(score))
                        if score[q] < least or count >= MOST:
                            break
                        s, m = q - reach, span[q]
                        found[count, SCORE] = score[q]
                        found[count, XA], found[count, YA] = ax + s * ux, ay + s * uy
                        found[count, DA] = d0 + s * slope
                        found[count, XB], found[count, YB] = ax + (s + m) * ux, ay + (s + m) * uy
                        found[count, DB] = d0 + (s + m) * slope
                        count += 1
                        if uy < SHALLOW and count < MOST:
                            # the two lines tell the middle's disparity better than its slope: lying flat too
                            middle = d0 + (s + 0.5 * m) * slope
                            rise = planes[0, 0] * m * ux + planes[0, 1] * m * uy
                            for n in range(7):
                                found[count, n] = found[count - 1, n]
                            found[count, DA], found[count, DB] = middle - 0.5 * rise, middle + 0.5 * rise
                            count += 1
                        for z in range(max(0, q - 8), min(size, q + 9)):
                            score[z] = NOTHING
            if uy < FLAT and vy < 0.2 and abs(same) > 0.9:
                count = _flat_pair(
                    left, right, i, j, total_l, total_r, tips_l, tips_r, reach, focal, baseline, cx, cy,
                    planes, length, length_px, tip, beyond, least, found, count,
                )  # fmt: skip
    return found, count


@compiled
def within(planes: Floats, x: float, y: float, d: float) -> bool:
    low = planes[0, 0] * x + planes[0, 1] * y + planes[0, 2]
    high = planes[1, 0] * x + planes[1, 1] * y + planes[1, 2]
    return bool(low <= d <= high)


@compiled
def _flat_pair(
    left: Floats, right: Floats, i: int, j: int, total_l: Floats, total_r: Floats, tips_l: Reals,
    tips_r: Reals, reach: int, focal: float, baseline: float, cx: float, cy: float, planes: Floats,
    length: float, length_px: float, tip: float, beyond: int, least: float, found: Floats, count: int,
) -> int:  # fmt: skip
    """Windows of two lines along the baseline: place and steepness on the left, disparity on the right."""
    ax, ay, ux, uy = left[i, 0], left[i, 1], left[i, 2], left[i, 3]
    bx, by, vx, vy = right[j, 0], right[j, 1], right[j, 2], right[j, 3]
    if ux * vx + uy * vy < 0:
        vx, vy, turned = -vx, -vy, -1.0
    else:
        turned = 1.0
    fb = focal * baseline
    size = 2 * reach + 1
    slants = 17
    best = np.full(size, NOTHING)
    which, p = np.zeros((size, 3)), np.empty(6)
    # in steps of 2 px along the line; refinement does the rest
    for s in range(-reach + beyond, reach - beyond - 8, 2):
        xa, ya = ax + s * ux, ay + s * uy
        low_d = planes[0, 0] * xa + planes[0, 1] * ya + planes[0, 2]
        high_d = planes[1, 0] * xa + planes[1, 1] * ya + planes[1, 2]
        middle_d = 0.5 * (low_d + high_d)
        for slant in range(slants):
            rise = STEEPEST * (2.0 * slant / (slants - 1) - 1.0)
            flat = np.sqrt(1 - rise * rise)
            # nearer at the far end: longer in the picture; the first guess uses the middle height
            m = length * flat * middle_d / baseline
            first = window_value(total_l, tips_l, i, reach, float(s), s + m, tip, beyond)
            if first < 0.15 * least or first + 1.5 * length_px < best[s + reach]:
                continue
            for step in range(int(high_d - low_d) + 1):
                da = low_d + step
                if da < 1.0:
                    continue
                off_a = -(xa - da - bx) * vy + (ya - by) * vx
                if abs(off_a) > ROW_PX:
                    continue
                za = fb / da
                db = fb / max(za - rise * length, 1e-3)
                m = length * flat * 0.5 * (da + db) / baseline
                p[0], p[1], p[2], p[3], p[4], p[5] = xa, ya, da, xa + m * ux, ya + m * uy, db
                m *= length / axis_length(p, fb, focal, cx, cy)
                xb, yb = xa + m * ux, ya + m * uy
                if not within(planes, xb, yb, db):
                    continue
                off_b = -(xb - db - bx) * vy + (yb - by) * vx
                if abs(off_b) > ROW_PX:
                    continue
                ta = ((xa - da - bx) * vx + (ya - by) * vy) * turned
                tb = ((xb - db - bx) * vx + (yb - by) * vy) * turned
                value = (
                    window_value(total_l, tips_l, i, reach, float(s), s + m, tip, beyond)
                    + window_value(total_r, tips_r, j, reach, min(ta, tb), max(ta, tb), tip, beyond)
                    - 2 * (off_a * off_a + off_b * off_b)
                    - TILT_LENGTHS * length_px * abs(rise)
                )
                if value > best[s + reach]:
                    best[s + reach] = value
                    which[s + reach, 0], which[s + reach, 1], which[s + reach, 2] = da, db, m
    for _ in range(4):
        q = int(np.argmax(best))
        if best[q] < least or count >= MOST:
            break
        s = q - reach
        da, db, m = which[q, 0], which[q, 1], which[q, 2]
        found[count, SCORE] = best[q]
        found[count, XA], found[count, YA], found[count, DA] = ax + s * ux, ay + s * uy, da
        found[count, XB], found[count, YB], found[count, DB] = ax + (s + m) * ux, ay + (s + m) * uy, db
        count += 1
        for z in range(max(0, q - 4), min(size, q + 5)):
            best[z] = NOTHING
    return count
