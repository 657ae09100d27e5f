"""Lines of both pictures to parts in space: a window of the known length slid along each line in space.

Two lines of one part, one in each picture, are one line in space. Where on it the part lies, a window of
exactly the part's length tells that gathers the most evidence in both pictures, ends included; so a hidden
end completes itself. Lines along the baseline have no disparity of their own: there the windows of both
pictures are placed one by one.
"""

from __future__ import annotations

import numpy as np

from vision.along import NOTHING, window_value
from vision.baseline import MOST, NEAR_BASELINE, SLANTS, STEEPEST, TILT_LENGTHS, flat_pair, slanted, wide
from vision.canvas import Canvas
from vision.edges import Reals
from vision.jit import compiled, inlined, lean
from vision.neighbours import cells_of, row_of_cells
from vision.proposals import Lines
from vision.refine import COLUMNS, DA, DB, KIND, LENGTH, SCORE, UNIT, XA, XB, YA, YB
from vision.types import Floats, Ints

FLAT = 0.17
"""Sine of the angle to the baseline below which disparity along a line means little."""
MIXED, SHALLOW = 0.07, 0.4
LEAST_LENGTHS = 0.1
"""Least evidence of a window in both pictures together, in twice the part's length."""
TIP_WIDTHS = 1.3
BEYOND_WIDTHS = 2.5
"""What an end is worth, how far beyond it evidence must not continue."""
BEATEN = 0.45
"""A hypothesis with a smaller share of the evidence of another in its place is not looked at further."""
SAME_WIDTHS, SAME_LENGTHS = 0.7, 0.3
"""How far aside and beyond the ends of another a hypothesis lies in its place."""
MOST_SQUARES = 400
"""Squares of the picture along either side in which hypotheses are sought that are one before them."""


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
    kept, is_kept = np.empty(rows, np.int64), np.zeros(rows, np.bool_)
    if rows == 0:
        return kept
    middle = _middles(found)
    span = max(np.ptp(middle[:, 0]), np.ptp(middle[:, 1]))
    cells = cells_of(middle, max(near_px + 1e-6, span / MOST_SQUARES))
    count = 0
    for row in range(rows):
        double = False
        for turn in range(3):
            first, last = row_of_cells(cells, row, turn)
            for q in range(first, last):
                other = cells.members[q]
                if not is_kept[other]:
                    continue
                same, turned = 0.0, 0.0
                for n in range(3):
                    same = max(same, abs(found[row, 1 + n] - found[other, 1 + n]))
                    same = max(same, abs(found[row, 4 + n] - found[other, 4 + n]))
                    turned = max(turned, abs(found[row, 1 + n] - found[other, 4 + n]))
                    turned = max(turned, abs(found[row, 4 + n] - found[other, 1 + n]))
                if min(same, turned) < near_px:
                    double = True
                    break
            if double:
                break
        if not double:
            is_kept[row] = True
            kept[count] = row
            count += 1
    return kept[:count]


@compiled
def _middles(found: Floats) -> Floats:
    """(N, 2) of hypotheses in the left picture."""
    middle = np.empty((len(found), 2))
    for row in range(len(found)):
        middle[row, 0] = 0.5 * (found[row, XA] + found[row, XB])
        middle[row, 1] = 0.5 * (found[row, YA] + found[row, YB])
    return middle


@compiled
def outstanding(found: Floats, width_px: float, length_px: float) -> Ints:
    """Rows of sorted hypotheses that no much better one of the same kind shows the place of, in both
    pictures."""
    longest = 1.0
    for row in range(len(found)):
        longest = max(longest, np.hypot(found[row, XB] - found[row, XA], found[row, YB] - found[row, YA]))
    # the middle of what shows the same place lies on the better one
    cells = cells_of(_middles(found), 0.5 * longest + SAME_LENGTHS * length_px + SAME_WIDTHS * width_px)
    is_kept = np.zeros(len(found), np.bool_)
    kept = np.empty(len(found), np.int64)
    count = 0
    for row in range(len(found)):
        beaten = False
        for turn in range(3):
            first, last = row_of_cells(cells, row, turn)
            for q in range(first, last):
                k = cells.members[q]
                if (
                    is_kept[k]
                    and found[k, KIND] == found[row, KIND]
                    and found[row, SCORE] <= BEATEN * found[k, SCORE]
                    and _shows(found, k, row, width_px, length_px)
                ):
                    beaten = True
                    break
            if beaten:
                break
        if not beaten:
            is_kept[row] = True
            kept[count] = row
            count += 1
    return kept[:count]


@lean
def _shows(found: Floats, k: int, row: int, width_px: float, length_px: float) -> bool:
    """Whether one hypothesis shows the place of another in both pictures."""
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
                abs(-px * uy + py * ux) > SAME_WIDTHS * width_px
                or along < -SAME_LENGTHS * length_px
                or along > size + SAME_LENGTHS * length_px
            ):
                return False
    return True


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
    wide_l, wide_r = wide(left, tips_l), wide(right, tips_r)
    score, span, which = np.empty(reach + 2), np.empty(reach + 2), np.empty((reach + 2, 2))
    reaches, value_l = np.empty((2 * reach + 1, SLANTS)), np.empty((2 * reach + 1, SLANTS))
    done = -1
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
            if uy < FLAT and vy < NEAR_BASELINE:
                if done < i:
                    slanted(
                        left, i, total_l, wide_l, alone_l, reach, focal, baseline, cx, cy, planes, length,
                        length_px, tip, beyond, least, reaches, value_l,
                    )  # fmt: skip
                    done = i
                count = flat_pair(
                    left, right, i, j, total_l, total_r, tips_l, tips_r, wide_l, wide_r, reaches, value_l,
                    alone_r, most_r[j], reach, focal, baseline, cx, cy, planes, length, length_px, tip,
                    beyond, least, score, which, found, count,
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


@inlined
def where_positive(at_zero: float, slope: float, first: float, last: float) -> tuple[float, float]:
    """The stretch of [first, last] where ``at_zero + slope s`` is not negative; empty: last < first."""
    if slope > 1e-12:
        return max(first, -at_zero / slope), last
    if slope < -1e-12:
        return first, min(last, -at_zero / slope)
    return first, (last if at_zero >= 0.0 else first - 1.0)


@lean
def within(planes: Floats, x: float, y: float, d: float) -> bool:
    low = planes[0, 0] * x + planes[0, 1] * y + planes[0, 2]
    high = planes[1, 0] * x + planes[1, 1] * y + planes[1, 2]
    return bool(low <= d <= high)
