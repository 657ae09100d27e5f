"""Parts of other lengths than the product's, which would otherwise be taken for it.

A long part holds many windows of a shorter one. So whatever is seen from one end to another, or runs on in
both pictures, is a hypothesis of its own, and takes its edges away from the products.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vision.baseline import MOST, STEEPEST
from vision.canvas import Canvas
from vision.edges import Reals
from vision.jit import compiled, lean
from vision.proposals import Lines
from vision.refine import SCORE, axis_length
from vision.types import Floats
from vision.windows import MIXED, by_score, where_positive, within

SEEN_TIP = 0.4
SHORTEST_LENGTHS, LONGEST, OWN_SHARE = 0.25, 2.5, 0.05
STRAY_EVIDENCE = 0.7
RUN_LEVEL, RUN_SHARE = 0.45, 0.1
"""Least evidence of an end; lengths of other parts, in lengths, and how near they must not come; their least
evidence per px; evidence that a run must keep up, and how far its length must be from the known one."""


def strays(
    left: Lines, right: Lines, on: Canvas, planes: Floats, length_m: float, length_px: float, unit: float
) -> Floats:
    """Hypotheses of parts of any other length, from one end that is seen to another.

    They take what belongs to them away from the products: a long part holds many windows of a shorter one.
    """
    found, count = _between_ends(
        left.table, right.table, left.total, right.total, left.tips, right.tips, left.reach_px,
        on.focal_px, on.baseline_m, on.centre_px[0], on.centre_px[1], planes, length_m, length_px,
    )  # fmt: skip
    return by_score(found[:count], unit, 0.0, -1.0)


@compiled
def _between_ends(
    left: Floats, right: Floats, total_l: Floats, total_r: Floats, tips_l: Reals, tips_r: Reals, reach: int,
    focal: float, baseline: float, cx: float, cy: float, planes: Floats, length: float, length_px: float,
) -> tuple[Floats, int]:  # fmt: skip
    """Every two ends seen in both pictures with part between them and a length that is not the known one."""
    found = np.empty((MOST // 10, 7))
    count = 0
    fb = focal * baseline
    most = 12
    p = np.empty(6)
    ends_l = np.zeros((len(left), 2, most), np.int64)
    many_l = np.zeros((len(left), 2), np.int64)
    ends_r = np.zeros((len(right), 2, most), np.int64)
    many_r = np.zeros((len(right), 2), np.int64)
    _seen_ends(tips_l, ends_l, many_l)
    _seen_ends(tips_r, ends_r, many_r)
    for i in range(len(left)):
        ax, ay, ux, uy = left[i, 0], left[i, 1], left[i, 2], left[i, 3]
        for j in range(len(right)):
            bx, by, vx, vy = right[j, 0], right[j, 1], right[j, 2], right[j, 3]
            same = ux * vx + uy * vy
            if abs(same) < 0.9 or abs(ay - by) > 2 * length_px:
                continue
            turned = 1.0 if same > 0 else -1.0
            if uy > MIXED and vy > 0.03 and same > 0.9:
                count = _longest_run(
                    left, right, i, j, total_l, total_r, reach, fb, focal, cx, cy, planes, length, length_px,
                    p, found, count,
                )  # fmt: skip
            for a in range(many_l[i, 0]):
                s = float(ends_l[i, 0, a] - reach)
                xa, ya = ax + s * ux, ay + s * uy
                for b in range(many_l[i, 1]):
                    e = float(ends_l[i, 1, b] - reach)
                    if e - s < SHORTEST_LENGTHS * length_px:
                        continue
                    inner = total_l[i, int(e) + reach] - total_l[i, int(s) + reach]
                    if inner < STRAY_EVIDENCE * (e - s):
                        continue
                    xb, yb = ax + e * ux, ay + e * uy
                    # the ends of the right line that lie in the same rows
                    for c in range(many_r[j, 0 if turned > 0 else 1]):
                        sr = float(ends_r[j, 0 if turned > 0 else 1, c] - reach)
                        if abs(by + sr * vy - ya) > 3.0:
                            continue
                        da = xa - bx - sr * vx
                        if not within(planes, xa, ya, da):
                            continue
                        for g in range(many_r[j, 1 if turned > 0 else 0]):
                            er = float(ends_r[j, 1 if turned > 0 else 0, g] - reach)
                            if abs(by + er * vy - yb) > 3.0 or (er - sr) * turned < 3.0:
                                continue
                            db = xb - bx - er * vx
                            if not within(planes, xb, yb, db):
                                continue
                            p[0], p[1], p[2], p[3], p[4], p[5] = xa, ya, da, xb, yb, db
                            long = axis_length(p, fb, focal, cx, cy)
                            if long > LONGEST * length or abs(long / length - 1) < OWN_SHARE:
                                continue
                            if abs(fb / da - fb / db) > 0.6 * STEEPEST * long:
                                continue
                            low, high = min(sr, er), max(sr, er)
                            other = total_r[j, int(high) + reach] - total_r[j, int(low) + reach]
                            if other < STRAY_EVIDENCE * (high - low) or count >= len(found):
                                continue
                            found[count, SCORE] = inner + other
                            for n in range(6):
                                found[count, 1 + n] = p[n]
                            count += 1
    return found, count


@lean
def _seen_ends(tips: Reals, ends: npt.NDArray[np.int64], many: npt.NDArray[np.int64]) -> None:
    """Up to as many places per line and way as there is room for, where an end stands out."""
    for line in range(len(tips)):
        for way in range(2):
            for q in range(2, tips.shape[1] - 2):
                value = tips[line, q, way]
                if value < SEEN_TIP or many[line, way] >= ends.shape[2]:
                    continue
                if value >= tips[line, q - 1, way] and value > tips[line, q + 1, way]:
                    ends[line, way, many[line, way]] = q
                    many[line, way] += 1


@lean
def _longest_run(
    left: Floats, right: Floats, i: int, j: int, total_l: Floats, total_r: Floats, reach: int, fb: float,
    focal: float, cx: float, cy: float, planes: Floats, length: float, length_px: float, p: Floats,
    found: Floats, count: int,
) -> int:  # fmt: skip
    """The stretch of a line in space that both pictures show as part, whatever its length (Kadane's sum)."""
    ax, ay, ux, uy = left[i, 0], left[i, 1], left[i, 2], left[i, 3]
    bx, by, vx, vy = right[j, 0], right[j, 1], right[j, 2], right[j, 3]
    fall = uy / vy
    d0 = ax - bx - (ay - by) / vy * vx
    slope = ux - fall * vx
    back = (ay - by) / vy
    # how steep it is, as in `vision.windows`
    gx, gy, gz = ux * d0 - (ax - cx) * slope, uy * d0 - (ay - cy) * slope, focal * slope
    if focal * abs(slope) > STEEPEST * np.sqrt(gx * gx + gy * gy + gz * gz):
        return count
    # only where the line lies between the planes: low <= d0 + slope t <= high
    low_d = planes[0, 0] * ax + planes[0, 1] * ay + planes[0, 2]
    high_d = planes[1, 0] * ax + planes[1, 1] * ay + planes[1, 2]
    low_k, high_k = planes[0, 0] * ux + planes[0, 1] * uy, planes[1, 0] * ux + planes[1, 1] * uy
    first, last = where_positive(d0 - low_d, slope - low_k, float(-reach), reach - 1.0)
    first, last = where_positive(high_d - d0, high_k - slope, first, last)
    # and where the right line has evidence: 0 <= back + fall t + reach < 2 reach
    first, last = where_positive(back + reach, fall, first, last)
    first, last = where_positive(reach - 1.0 - back, -fall, first, last)
    if last - first < SHORTEST_LENGTHS * length_px - 1.0:
        return count
    best, best_from, best_to = 0.0, 0, 0
    total, begun = 0.0, int(np.ceil(first))
    for t in range(int(np.ceil(first)), int(last) + 1):
        at = int(back + fall * t + reach)
        value = min(total_l[i, t + reach + 1] - total_l[i, t + reach], total_r[j, at + 1] - total_r[j, at])
        total += value - RUN_LEVEL
        if total <= 0.0:
            total, begun = 0.0, t + 1
        elif total > best:
            best, best_from, best_to = total, begun, t + 1
    if best_to - best_from < SHORTEST_LENGTHS * length_px or count >= len(found):
        return count
    for end in range(2):
        t = best_from if end == 0 else best_to
        p[3 * end], p[3 * end + 1], p[3 * end + 2] = ax + t * ux, ay + t * uy, d0 + t * slope
    long = axis_length(p, fb, focal, cx, cy)
    if long > LONGEST * length or abs(long / length - 1) < RUN_SHARE:
        return count
    inner = total_l[i, best_to + reach] - total_l[i, best_from + reach]
    found[count, SCORE] = 2 * inner
    for n in range(6):
        found[count, 1 + n] = p[n]
    return count + 1
