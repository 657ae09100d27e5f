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
from vision.refine import COLUMNS, DA, DB, KIND, LENGTH, SCORE, UNIT, XA, XB, YA, YB
from vision.types import Floats, Ints

FLAT = 0.17
"""Sine of the angle to the baseline below which disparity along a line means little."""
MIXED, SHALLOW = 0.07, 0.4
STEEPEST = 0.8
SLANTS = 17
"""Greatest height difference of the ends in lengths; in how many steps it is tried along the baseline."""
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
MOST_SQUARES = 400
"""Squares of the picture along either side in which hypotheses are sought that are one before them."""
SLACK_LENGTHS = 0.3
END_PX = 2
STEP_S, STEP_D = 4, 2
FINE_S, FINE_D, FINE_R = 5, 3, 3
"""Along the baseline: in lengths, how much evidence at other heights may exceed what was read; how wide an end
is taken at first; steps along the line and of disparity; places, disparities and slants tried round a best."""
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
    """Rows of sorted hypotheses that are not, within ``near_px`` in every number, one before them.

    Whichever way round two of them lie, their middles are within ``near_px`` then, so only those of a few
    squares of the picture are compared.
    """
    rows = len(found)
    kept = np.empty(rows, np.int64)
    if rows == 0:
        return kept
    low_x, low_y, high_x, high_y = 1e9, 1e9, -1e9, -1e9
    for row in range(rows):
        x, y = found[row, XA] + found[row, XB], found[row, YA] + found[row, YB]
        low_x, high_x = min(low_x, x), max(high_x, x)
        low_y, high_y = min(low_y, y), max(high_y, y)
    # squares of twice the middles
    side = max(2.0 * near_px + 1e-6, (high_x - low_x) / MOST_SQUARES, (high_y - low_y) / MOST_SQUARES)
    across, down = int((high_x - low_x) / side) + 3, int((high_y - low_y) / side) + 3
    head = np.full((down, across), -1, np.int32)
    following = np.empty(rows, np.int32)
    count = 0
    for row in range(rows):
        i = int((found[row, XA] + found[row, XB] - low_x) / side) + 1
        j = int((found[row, YA] + found[row, YB] - low_y) / side) + 1
        double = False
        for square in range(9):
            other = head[j + square // 3 - 1, i + square % 3 - 1]
            while other >= 0 and not double:
                same, turned = 0.0, 0.0
                for n in range(3):
                    same = max(same, abs(found[row, 1 + n] - found[other, 1 + n]))
                    same = max(same, abs(found[row, 4 + n] - found[other, 4 + n]))
                    turned = max(turned, abs(found[row, 1 + n] - found[other, 4 + n]))
                    turned = max(turned, abs(found[row, 4 + n] - found[other, 1 + n]))
                double = min(same, turned) < near_px
                other = following[other]
            if double:
                break
        if not double:
            kept[count] = row
            count += 1
            following[row] = head[j, i]
            head[j, i] = row
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
    left: Floats, right: Floats, total_l: Floats, total_r: Floats, tips_l: Reals, tips_r: Reals, reach: int,
    focal: float, baseline: float, cx: float, cy: float, planes: Floats, length: float, width: float,
    length_px: float,
) -> tuple[Floats, int]:  # fmt: skip
    """Best windows of every two lines, (MOST, 7) score and ends, of which so many are filled.

    Two lines are one line in space: with x(s) = x0 + s u and the disparity d(s) = d0 + s k its point is
    ``B x(s) / d(s)``, so two places m px apart lie ``B |u d0 - x0 k| m / (d(s) d(s + m))`` metres apart. The
    window of a known length therefore ends ``m = d^2 / (K - k d)`` px on, K = B |u d0 - x0 k| / length,
    and all windows are equally steep.
    """
    found = np.empty((MOST, 7))
    count = 0
    tip, beyond = TIP_WIDTHS * width, int(BEYOND_WIDTHS * width) + 1
    least = 2 * LEAST_LENGTHS * length_px
    alone_l = _alone(total_l, tips_l, reach, length_px, tip, beyond)
    alone_r = _alone(total_r, tips_r, reach, length_px, tip, beyond)
    most_r = np.empty(len(right))
    for j in range(len(right)):
        most_r[j] = alone_r[j].max()
    wide_l, wide_r = _wide(left, tips_l), _wide(right, tips_r)
    score, span, which = np.empty(reach + 2), np.empty(reach + 2), np.empty((reach + 2, 2))
    reaches, value_l = np.empty((2 * reach + 1, SLANTS)), np.empty((2 * reach + 1, SLANTS))
    slanted = -1
    start, stop = -reach + beyond, reach - beyond - 8
    for i in range(len(left)):
        ax, ay, ux, uy = left[i, 0], left[i, 1], left[i, 2], left[i, 3]
        low_d = planes[0, 0] * ax + planes[0, 1] * ay + planes[0, 2]
        high_d = planes[1, 0] * ax + planes[1, 1] * ay + planes[1, 2]
        low_k = planes[0, 0] * ux + planes[0, 1] * uy
        high_k = planes[1, 0] * ux + planes[1, 1] * uy
        for j in range(len(right)):
            bx, by, vx, vy = right[j, 0], right[j, 1], right[j, 2], right[j, 3]
            if abs(ay - by) > length_px or ax - bx < low_d - 1.6 * length_px:
                continue
            if ax - bx > high_d + 1.6 * length_px:
                continue
            same = ux * vx + uy * vy
            if abs(same) < 0.9:
                continue
            if uy < FLAT and vy < 0.2:
                if slanted < i:
                    _slanted(
                        left, i, total_l, wide_l, alone_l, reach, focal, baseline, cx, cy, planes, length,
                        length_px, tip, beyond, least, reaches, value_l,
                    )  # fmt: skip
                    slanted = i
                count = _flat_pair(
                    left, right, i, j, total_l, total_r, tips_l, tips_r, wide_l, wide_r, reaches, value_l,
                    alone_r, most_r[j], reach, focal, baseline, cx, cy, planes, length, length_px, tip, beyond,
                    least, score, which, found, count,
                )  # fmt: skip
            if uy <= MIXED or vy <= 0.03 or same <= 0.9:
                continue
            fall = uy / vy
            back = (ay - by) / vy
            d0 = ax - bx - back * vx
            slope = ux - fall * vx
            gx, gy, gz = ux * d0 - (ax - cx) * slope, uy * d0 - (ay - cy) * slope, focal * slope
            size = np.sqrt(gx * gx + gy * gy + gz * gz)
            steep = focal * abs(slope) / size
            if steep > STEEPEST:
                continue
            # where the line lies between the planes: low_d + low_k s <= d0 + slope s <= high_d + high_k s
            first, last = where_positive(d0 - low_d, slope - low_k, float(start), float(reach))
            first, last = where_positive(high_d - d0, high_k - slope, first, last)
            first, last = where_positive(d0 - 1.0, slope, first, last)
            # every other px: refinement does the rest
            begin = start + 2 * max(0, int(np.ceil(0.5 * (first - start))))
            per_length = baseline * size / length
            tilt = TILT_LENGTHS * length_px * steep
            places = 0
            any_good = False
            for s in range(begin, min(stop, int(last) + 1), 2):
                score[places] = NOTHING
                places += 1
                if alone_l[i, s + reach] < -0.15 * length_px:
                    continue
                d = d0 + s * slope
                m = d * d / (per_length - d * slope)
                # m < 0: the line leaves towards the camera before it is long enough
                if m < 0.0 or s + m > last:
                    continue
                one = window_value(total_l, tips_l, i, reach, float(s), s + m, tip, beyond)
                if one < 0.15 * least:
                    continue
                other = window_value(
                    total_r, tips_r, j, reach, back + fall * s, back + fall * (s + m), tip, beyond
                )
                score[places - 1] = one + other - tilt
                span[places - 1] = m
                any_good = True
            if not any_good:
                continue
            for _ in range(4):
                q = int(np.argmax(score[:places]))
                if score[q] < least or count >= MOST:
                    break
                s, m = begin + 2 * q, span[q]
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
                for z in range(max(0, q - 4), min(places, q + 5)):
                    score[z] = NOTHING
    return found, count


@compiled
def _alone(total: Floats, tips: Reals, reach: int, length_px: float, tip: float, beyond: int) -> Floats:
    """(N, 2 R + 1) evidence of a window of the usual length from each place of each line of one picture."""
    found = np.empty((len(total), 2 * reach + 1))
    for line in range(len(total)):
        for q in range(2 * reach + 1):
            found[line, q] = window_value(
                total, tips, line, reach, float(q - reach), q - reach + length_px, tip, beyond
            )
    return found


@compiled
def _wide(lines: Floats, tips: Reals) -> Reals:
    """Evidence of ends along lines near the baseline, each place having the most within `END_PX`."""
    found = np.empty_like(tips)
    size = tips.shape[1]
    for line in range(len(tips)):
        if lines[line, 3] >= 0.2:
            continue
        for q in range(size):
            for way in range(2):
                most = tips[line, q, way]
                for other in range(max(0, q - END_PX), min(size, q + END_PX + 1)):
                    most = max(most, tips[line, other, way])
                found[line, q, way] = most
    return found


@compiled
def where_positive(at_zero: float, slope: float, first: float, last: float) -> tuple[float, float]:
    """The stretch of [first, last] where ``at_zero + slope s`` is not negative; empty: last < first."""
    if slope > 1e-12:
        return max(first, -at_zero / slope), last
    if slope < -1e-12:
        return first, min(last, -at_zero / slope)
    return first, (last if at_zero >= 0.0 else first - 1.0)


@compiled
def within(planes: Floats, x: float, y: float, d: float) -> bool:
    low = planes[0, 0] * x + planes[0, 1] * y + planes[0, 2]
    high = planes[1, 0] * x + planes[1, 1] * y + planes[1, 2]
    return bool(low <= d <= high)


@compiled
def _slanted(
    left: Floats, i: int, total: Floats, wide: Reals, alone: Floats, reach: int, focal: float,
    baseline: float, cx: float, cy: float, planes: Floats, length: float, length_px: float, tip: float,
    beyond: int, least: float, reaches: Floats, value: Floats,
) -> None:  # fmt: skip
    """For every fourth place of a line along the baseline and every steepness, (2 R + 1, SLANTS): how long
    the part looks at a far end one metre away, and its evidence at a middle height, `NOTHING` if too little."""
    for s in range(-reach + beyond, reach - beyond - 8, STEP_S):
        x, y = left[i, 0] + s * left[i, 2], left[i, 1] + s * left[i, 3]
        middle_d = 0.5 * (
            (planes[0, 0] + planes[1, 0]) * x
            + (planes[0, 1] + planes[1, 1]) * y
            + planes[0, 2]
            + planes[1, 2]
        )
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


@compiled
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
def _flat_pair(
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
            s = float(start + STEP_S * place) + (step % FINE_S - FINE_S // 2)
            da = which[place, 0] + (step // FINE_S % FINE_D - FINE_D // 2)
            rise = which[place, 1] + (step // (FINE_S * FINE_D) - FINE_R // 2) * STEEPEST / (SLANTS - 1)
            zb = fb / max(da, 1.0) - rise * length
            long = _reaches(left, i, s, rise, focal, cx, cy, length)
            if zb <= 0.0 or long <= 0.0:
                continue
            m, db = long / zb, fb / zb
            e = s + m
            off_a, off_b = off_0 + s * off_k + da * vy, off_0 + e * off_k + db * vy
            ta = ((ax + s * ux - da - bx) * vx + (ay + s * uy - by) * vy) * turned
            tb = ((ax + e * ux - db - bx) * vx + (ay + e * uy - by) * vy) * turned
            value = (
                window_value(total_l, tips_l, i, reach, s, e, tip, beyond)
                + window_value(total_r, tips_r, j, reach, min(ta, tb), max(ta, tb), tip, beyond)
                - 2 * (off_a * off_a + off_b * off_b)
                - TILT_LENGTHS * length_px * abs(rise)
            )
            if value > score:
                score = value
                fine[0], fine[1], fine[2], fine[3] = s, da, m, db
        for z in range(max(0, place - 1), min(places, place + 2)):
            best[z] = NOTHING
        if score < least:
            continue
        s, e = fine[0], fine[0] + fine[2]
        found[count, SCORE] = score
        found[count, XA], found[count, YA], found[count, DA] = ax + s * ux, ay + s * uy, fine[1]
        found[count, XB], found[count, YB], found[count, DB] = ax + e * ux, ay + e * uy, fine[3]
        count += 1
    return count
