"""Straight bright ribbons of one part's width, from directed edges of the grey picture alone.

Parts that lie side by side are one wide thing to the mask, and its skeleton runs along their seam or
nowhere. The grey picture still shows a dip there: an edge that falls to the seam faces the outer edge that
rises. So every edge looks for its counterpart one width ahead, in the direction from dark to bright; the
middles of such couples lie on centre lines of parts, whatever the outline of the heap is, and neighbouring
middles of one direction are gathered to straight pieces. They are proposals: `shape_search` lays the bars of
flat parts on them.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from vision.jit import compiled, lean, steady
from vision.sampling import Picture, sample
from vision.types import Floats, Ints, Mask, read_only

_SMOOTH_PX = 0.7
_NEAREST_WIDTHS, _FARTHEST_WIDTHS = 0.5, 1.3
"""Where the counterpart of an edge is looked for: nearer parts look wider, those beside others narrower."""
_COUNTER_COSINE = -0.8
_STEP_PX = 0.5
_REACH_PX = 2
"""Middles of one ribbon are neighbours or next but one: not every edge has a clear counterpart."""
_ALIGNED_COSINE = 0.94
_ASIDE_PX = 1.0
_STEADY_POINTS = 8
"""From so many middles on a ribbon has a line, from which others may be ``_ASIDE_PX`` off."""
_DENSITY = 0.6
"""Least number of middles per px; a ribbon in the open has about two."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ribbons:
    """``start``, ``end`` (K, 2) of straight stretches."""

    start: Floats
    end: Floats


def ribbons(grey: Picture, mask: Mask, width_px: float, slope_floor: float, least_px: float) -> Ribbons:
    """Straight stretches along which two opposite edges are about one part's width apart.

    Parameters
    ----------
    grey : (H, W) float32
        Raw picture.
    mask : (H, W) bool
        Foreground; middles elsewhere do not count.
    width_px : float
        Of a part.
    slope_floor : float
        Least steepness of an edge, grey per px.
    least_px : float
        Shorter stretches are left out.

    Returns
    -------
    Ribbons
        Raw pixels.
    """
    smooth = cv2.GaussianBlur(grey, (0, 0), _SMOOTH_PX)
    # Scharr's kernel sums to 32 for a slope of one per px
    rise_u = cv2.Scharr(smooth, cv2.CV_32F, 1, 0, scale=1.0 / 32.0)
    rise_v = cv2.Scharr(smooth, cv2.CV_32F, 0, 1, scale=1.0 / 32.0)
    near = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    middles = _middles(
        np.ascontiguousarray(rise_u, np.float32),
        np.ascontiguousarray(rise_v, np.float32),
        near,
        steady(mask),
        float(width_px),
        float(slope_floor),
    )
    order = np.argsort(-middles[:, 4], kind="stable")
    found = _gather(middles, order, mask.shape[0], mask.shape[1], float(least_px))
    return Ribbons(start=read_only(found[:, :2].copy()), end=read_only(found[:, 2:].copy()))


@compiled
def _middles(rise_u: Picture, rise_v: Picture, near: Mask, mask: Mask, width: float, floor: float) -> Floats:
    """(N, 5) middles between an edge and its counterpart: u, v, unit normal, steepness of the weaker."""
    rows, columns = rise_u.shape
    found = np.empty((rows * columns, 5))
    count = 0
    steps = int(np.ceil((_FARTHEST_WIDTHS - _NEAREST_WIDTHS) * width / _STEP_PX)) + 1
    for row in range(1, rows - 1):
        for column in range(1, columns - 1):
            if not near[row, column]:
                continue
            gu = rise_u[row, column]
            gv = rise_v[row, column]
            steep = np.sqrt(gu * gu + gv * gv)
            if steep < floor:
                continue
            nu = gu / steep
            nv = gv / steep
            before = nu * sample(rise_u, column - nu, row - nv) + nv * sample(rise_v, column - nu, row - nv)
            after = nu * sample(rise_u, column + nu, row + nv) + nv * sample(rise_v, column + nu, row + nv)
            if steep < before or steep <= after:
                continue
            bend = before - 2.0 * steep + after
            first = 0.5 * (before - after) / bend if bend < -1e-6 else 0.0
            best = 0.0
            where = 0.0
            inside = False
            for k in range(steps):
                s = first + _NEAREST_WIDTHS * width + k * _STEP_PX
                slope = nu * sample(rise_u, column + s * nu, row + s * nv)
                slope += nv * sample(rise_v, column + s * nu, row + s * nv)
                if slope < best:
                    best = slope
                    where = s
                    # at either end of the window it may be the foot of an edge that lies outside
                    inside = 0 < k < steps - 1
            if best > -floor or not inside:
                continue
            cu = sample(rise_u, column + where * nu, row + where * nv)
            cv = sample(rise_v, column + where * nu, row + where * nv)
            size = np.sqrt(cu * cu + cv * cv)
            if best > _COUNTER_COSINE * size:
                continue
            u = column + 0.5 * (first + where) * nu
            v = row + 0.5 * (first + where) * nv
            iu = int(u + 0.5)
            iv = int(v + 0.5)
            if iu < 0 or iv < 0 or iu >= columns or iv >= rows or not mask[iv, iu]:
                continue
            mu = gu - cu
            mv = gv - cv
            size_m = np.sqrt(mu * mu + mv * mv)
            found[count, 0] = u
            found[count, 1] = v
            found[count, 2] = mu / size_m
            found[count, 3] = mv / size_m
            found[count, 4] = min(steep, -best)
            count += 1
    return found[:count].copy()


@compiled
def _gather(middles: Floats, order: Ints, rows: int, columns: int, least: float) -> Floats:
    """(R, 4) straight stretches u, v, u, v of neighbouring middles of one direction, strongest first."""
    total = len(middles)
    first_at = np.full((rows, columns), -1, np.int32)
    next_of = np.full(total, -1, np.int32)
    for k in range(total):
        iu = int(middles[k, 0] + 0.5)
        iv = int(middles[k, 1] + 0.5)
        next_of[k] = first_at[iv, iu]
        first_at[iv, iu] = k
    used = np.zeros(total, np.bool_)
    members = np.empty(total, np.int64)
    found = np.empty((total, 4))
    kept = 0
    for seed in order:
        if used[seed]:
            continue
        used[seed] = True
        members[0] = seed
        count = 1
        done = 0
        double_u = middles[seed, 2] ** 2 - middles[seed, 3] ** 2
        double_v = 2.0 * middles[seed, 2] * middles[seed, 3]
        sum_u = middles[seed, 0]
        sum_v = middles[seed, 1]
        while done < count:
            here = members[done]
            done += 1
            iu = int(middles[here, 0] + 0.5)
            iv = int(middles[here, 1] + 0.5)
            for jv in range(max(iv - _REACH_PX, 0), min(iv + _REACH_PX + 1, rows)):
                for ju in range(max(iu - _REACH_PX, 0), min(iu + _REACH_PX + 1, columns)):
                    other = first_at[jv, ju]
                    while other >= 0:
                        if not used[other]:
                            turn = 0.5 * np.arctan2(double_v, double_u)
                            nu = np.cos(turn)
                            nv = np.sin(turn)
                            cosine = abs(nu * middles[other, 2] + nv * middles[other, 3])
                            if count < _STEADY_POINTS:
                                from_u = middles[other, 0] - middles[here, 0]
                                from_v = middles[other, 1] - middles[here, 1]
                            else:
                                from_u = middles[other, 0] - sum_u / count
                                from_v = middles[other, 1] - sum_v / count
                            if cosine > _ALIGNED_COSINE and abs(nu * from_u + nv * from_v) < _ASIDE_PX:
                                used[other] = True
                                members[count] = other
                                count += 1
                                double_u += middles[other, 2] ** 2 - middles[other, 3] ** 2
                                double_v += 2.0 * middles[other, 2] * middles[other, 3]
                                sum_u += middles[other, 0]
                                sum_v += middles[other, 1]
                        other = next_of[other]
        if count < 3:
            continue
        mean_u, mean_v, du, dv, low, high = _span(middles, members[:count])
        if high - low < least or count < _DENSITY * (high - low):
            continue
        found[kept, 0] = mean_u + low * du
        found[kept, 1] = mean_v + low * dv
        found[kept, 2] = mean_u + high * du
        found[kept, 3] = mean_v + high * dv
        kept += 1
    return found[:kept].copy()


@lean
def _span(middles: Floats, members: Ints) -> tuple[float, float, float, float, float, float]:
    """Mean u, v, direction u, v and least and largest place along it of some middles."""
    count = len(members)
    mean_u = 0.0
    mean_v = 0.0
    for k in members:
        mean_u += middles[k, 0] / count
        mean_v += middles[k, 1] / count
    suu = 0.0
    suv = 0.0
    svv = 0.0
    for k in members:
        pu = middles[k, 0] - mean_u
        pv = middles[k, 1] - mean_v
        suu += pu * pu
        suv += pu * pv
        svv += pv * pv
    turn = 0.5 * np.arctan2(2.0 * suv, suu - svv)
    du = np.cos(turn)
    dv = np.sin(turn)
    low = 0.0
    high = 0.0
    for k in members:
        t = (middles[k, 0] - mean_u) * du + (middles[k, 1] - mean_v) * dv
        low = min(low, t)
        high = max(high, t)
    return mean_u, mean_v, du, dv, low, high
