"""Lines of one picture on which parts may lie, and what the picture shows along each.

Two sources. The skeleton graph: its straight pieces between nodes. And votes of single edges, each for the
centre line half a width to its bright side (a Hough transform in the line's normal form, Duda and Hart 1972,
with directed edges), which also finds parts whose skeleton is lost in a heap. Both are fitted to the
same votes, so a line is found once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vision.edges import Edges, Ids, Reals
from vision.flank import nearest_edge
from vision.jit import compiled
from vision.types import Floats, Ints, read_only

TURNS = 180
SPREAD = 5
"""Directions in half a turn, and how many to each side an edge votes for: short edges are crooked."""
FAINTEST_LENGTHS = 0.06
"""Least votes of a line, in part lengths."""
MOST_LINES = 1200
WINDOWS = 3
REACH_LENGTHS = 1.6
"""How far beyond its middle a line is looked along, in part lengths."""
FLANK_SIGMA_PX = 0.8


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lines:
    """N lines: ``table`` (N, 4) a point and the unit direction, downwards or to the right; ``total``
    (N, 2 R + 2) running sum of the evidence at whole px from -R to R; ``tips`` (N, 2 R + 1, 2) evidence of
    an end that looks backwards, forwards; ``reach_px`` R."""

    table: Floats
    total: Floats
    tips: Reals
    reach_px: int


def lines(found: Edges, pieces: Floats, width_px: float, length_px: float) -> Lines:
    """Lines with their evidence.

    Parameters
    ----------
    pieces : (K, 4)
        Straight pieces of the skeleton graph on the canvas: a point and the unit direction.
    width_px, length_px
        Of the part, as it looks at the table.
    """
    reach = int(REACH_LENGTHS * length_px)
    if len(found.table) == 0:
        # closed for writing like every other table: to the compiler an open one is another type
        return Lines(
            table=read_only(np.zeros((0, 4))),
            total=np.zeros((0, 2 * reach + 2)),
            tips=np.zeros((0, 2 * reach + 1, 2), np.float32),
            reach_px=reach,
        )
    votes, order, starts, around = _votes(found.table, found.at, found.ground, width_px)
    least = FAINTEST_LENGTHS * length_px
    board, middle, radius = _board(votes, order, around)
    peaks = np.concatenate([_as_peaks(pieces, middle, radius), _peaks(board, radius, least)])
    table, count = _fit(votes, starts, peaks, middle, radius, length_px, least)
    table = table[:count].copy()
    total, tips = _along(found.table, found.ground, starts, order, table, width_px, reach)
    return Lines(table=read_only(table), total=total, tips=tips, reach_px=reach)


@compiled
def _votes(
    table: Reals, at: Ids, ground: npt.NDArray[np.uint8], width: float
) -> tuple[Floats, Ints, Ints, Floats]:
    """Centre and weight of every edge's vote, sorted by direction of the line; rows x, y, angle, weight.

    Returns
    -------
    votes : (N, 4), order : (N,) edge of each vote, starts : (TURNS + 1,), around : (4,) least and greatest
    x and y"""
    count = len(table)
    raw = np.empty((count, 4))
    turn = np.empty(count, np.int64)
    free = np.zeros(count, np.uint16)
    starts = np.zeros(TURNS + 1, np.int64)
    around = np.array([1e9, -1e9, 1e9, -1e9])
    for edge in range(count):
        x, y, ux, uy = table[edge, 0], table[edge, 1], table[edge, 2], table[edge, 3]
        cx, cy = x + 0.5 * width * ux, y + 0.5 * width * uy
        angle = np.arctan2(ux, -uy) % np.pi
        turn[edge] = int(angle / np.pi * TURNS + 0.5) % TURNS
        starts[turn[edge] + 1] += 1
        column, row = int(cx + 0.5), int(cy + 0.5)
        weight = 0.0
        if 0 <= column < ground.shape[1] and 0 <= row < ground.shape[0] and ground[row, column] != 0:
            other, off = nearest_edge(table, at, free, x + width * ux, y + width * uy, -ux, -uy, 1.6)
            weight = 0.3
            if other >= 0:
                weight += 0.7 * table[other, 4] * np.exp(-0.5 * (off / FLANK_SIGMA_PX) ** 2)
        raw[edge, 0], raw[edge, 1], raw[edge, 2], raw[edge, 3] = cx, cy, angle, weight
        around[0], around[1] = min(around[0], cx), max(around[1], cx)
        around[2], around[3] = min(around[2], cy), max(around[3], cy)
    for k in range(TURNS):
        starts[k + 1] += starts[k]
    place = starts[:-1].copy()
    votes = np.empty((count, 4))
    order = np.empty(count, np.int64)
    for edge in range(count):
        k = place[turn[edge]]
        place[turn[edge]] += 1
        votes[k] = raw[edge]
        order[k] = edge
    return votes, order, starts, around


@compiled
def _board(votes: Floats, order: Ints, around: Floats) -> tuple[Reals, Floats, int]:
    """The voting board (TURNS, 2 radius): direction by signed distance from the middle of all votes."""
    middle = np.array([0.5 * (around[0] + around[1]), 0.5 * (around[2] + around[3])])
    radius = int(0.5 * np.hypot(around[1] - around[0], around[3] - around[2])) + 3
    board = np.zeros((TURNS, 2 * radius), np.float32)
    sines = np.sin(np.arange(TURNS) * np.pi / TURNS)
    cosines = np.cos(np.arange(TURNS) * np.pi / TURNS)
    for k in range(len(order)):
        weight = votes[k, 3]
        if weight == 0.0:
            continue
        x, y = votes[k, 0] - middle[0], votes[k, 1] - middle[1]
        centre = int(votes[k, 2] / np.pi * TURNS + 0.5)
        for step in range(-SPREAD, SPREAD + 1):
            turn = (centre + step) % TURNS
            distance = -sines[turn] * x + cosines[turn] * y + radius
            cell = int(distance)
            share = distance - cell
            part = weight * (1 - 0.5 * abs(step) / SPREAD)
            if cell >= 0 and cell + 1 < 2 * radius:
                board[turn, cell] += part * (1 - share)
                board[turn, cell + 1] += part * share
    return board, middle, radius


def _as_peaks(pieces: Floats, middle: Floats, radius: int) -> Floats:
    """(K, 3) board places of straight pieces: direction, distance, more votes than any peak has."""
    if len(pieces) == 0:
        return np.zeros((0, 3))
    angle = np.arctan2(pieces[:, 3], pieces[:, 2]) % np.pi
    away = pieces[:, :2] - middle
    distance = -np.sin(angle) * away[:, 0] + np.cos(angle) * away[:, 1] + radius
    return np.stack([angle / np.pi * TURNS, distance, np.full(len(pieces), np.inf)], axis=1)


def _peaks(board: Reals, radius: int, least: float) -> Floats:
    """(K, 3) direction, distance, votes of the places that no neighbour exceeds, most votes first."""
    found, count = _local_maxima(board, radius, least)
    found = found[:count]
    return np.asarray(found[np.argsort(-found[:, 2], kind="stable")], np.float64)


@compiled
def _local_maxima(board: Reals, radius: int, least: float) -> tuple[Floats, int]:
    turns, size = board.shape
    found = np.zeros((4000, 3))
    count = 0
    for turn in range(turns):
        for cell in range(2, size - 2):
            value = board[turn, cell]
            if value < least:
                continue
            highest = True
            for dt in range(-2, 3):
                for dc in range(-1, 2):
                    if dt == 0 and dc == 0:
                        continue
                    t, c = turn + dt, cell + dc
                    if t < 0 or t >= turns:
                        t = t % turns
                        c = 2 * radius - c
                    if c < 0 or c >= size:
                        continue
                    if board[t, c] > value or (board[t, c] == value and (dt < 0 or (dt == 0 and dc < 0))):
                        highest = False
                if not highest:
                    break
            if highest and count < len(found):
                found[count, 0], found[count, 1], found[count, 2] = turn, cell, value
                count += 1
    return found, count


@compiled
def _fit(
    votes: Floats, starts: Ints, peaks: Floats, middle: Floats, radius: int, length: float, least: float
) -> tuple[Floats, int]:
    """Robust lines through the votes near each peak, for up to `WINDOWS` stretches of a part's length.

    Tukey's weights over the distance from the line, the window narrowing from 2 to 1 px.
    """
    table = np.empty((MOST_LINES, 4))
    count = 0
    size = len(votes)
    along, across, which = np.empty(size), np.empty(size), np.empty(size, np.int64)
    band = int(0.2 / np.pi * TURNS) + 1
    for peak in range(len(peaks)):
        angle = peaks[peak, 0] * np.pi / TURNS
        distance = peaks[peak, 1] - radius
        ux, uy = np.cos(angle), np.sin(angle)
        bx, by = middle[0] - uy * distance, middle[1] + ux * distance
        near = 0
        low, high = 1e9, -1e9
        for step in range(-band, band + 1):
            turn = (int(peaks[peak, 0] + 0.5) + step) % TURNS
            for k in range(starts[turn], starts[turn + 1]):
                if votes[k, 3] == 0.0:
                    continue
                off = -(votes[k, 0] - bx) * uy + (votes[k, 1] - by) * ux
                if abs(off) > 2.2:
                    continue
                t = (votes[k, 0] - bx) * ux + (votes[k, 1] - by) * uy
                along[near], across[near], which[near] = t, off, k
                low, high = min(low, t), max(high, t)
                near += 1
        if near < 8:
            continue
        bins = int(high - low) + 2
        total = np.zeros(bins + 1)
        for q in range(near):
            total[int(along[q] - low) + 1] += votes[which[q], 3] * (1 - abs(across[q]) / 2.5)
        for q in range(bins):
            total[q + 1] += total[q]
        span = int(1.02 * length)
        for _ in range(WINDOWS):
            best, at = 0.0, 0
            for s in range(5 - span, bins):
                a, b = max(s, 0), min(s + span, bins)
                if b > a and total[b] - total[a] > best:
                    best, at = total[b] - total[a], s
            if best < least:
                break
            a, b = max(at, 0), min(at + span, bins)
            for q in range(a, bins + 1):
                total[q] = total[a] if q < b else total[q] - best
            cx, cy = bx + (low + 0.5 * (a + b)) * ux, by + (low + 0.5 * (a + b)) * uy
            vx, vy = ux, uy
            window = 2.0
            good = True
            along_m = 0.0
            for turn_of in range(4):
                sw = sx = sy = sxx = sxy = syy = 0.0
                for q in range(near):
                    if along[q] - low < a - 2 or along[q] - low > b + 2:
                        continue
                    k = which[q]
                    x, y = votes[k, 0] - cx, votes[k, 1] - cy
                    off = -x * vy + y * vx
                    if abs(off) >= window:
                        continue
                    weight = votes[k, 3] * (1 - (off / window) ** 2) ** 2
                    sw += weight
                    sx += weight * x
                    sy += weight * y
                    sxx += weight * x * x
                    sxy += weight * x * y
                    syy += weight * y * y
                if sw < 4:
                    good = False
                    break
                sx, sy = sx / sw, sy / sw
                sxx, sxy, syy = sxx / sw - sx * sx, sxy / sw - sx * sy, syy / sw - sy * sy
                turned = 0.5 * np.arctan2(2 * sxy, sxx - syy)
                vx, vy = np.cos(turned), np.sin(turned)
                cx += sx
                cy += sy
                along_m = np.sqrt(max(sxx * vx * vx + 2 * sxy * vx * vy + syy * vy * vy, 0.0))
                window = 2.0 if turn_of == 0 else (1.5 if turn_of == 1 else 1.0)
            if not good or along_m < 3:
                continue
            if vy < 0 or (vy == 0 and vx < 0):
                vx, vy = -vx, -vy
            double = False
            for q in range(count):
                cross = abs(table[q, 2] * vy - table[q, 3] * vx)
                if cross < 0.012 and table[q, 2] * vx + table[q, 3] * vy > -2:
                    x, y = cx - table[q, 0], cy - table[q, 1]
                    if (
                        abs(x * table[q, 2] + y * table[q, 3]) < 0.5 * length
                        and abs(-x * table[q, 3] + y * table[q, 2]) < 0.7
                    ):
                        double = True
                        break
            if double:
                continue
            if count >= len(table):
                return table, count
            table[count, 0], table[count, 1], table[count, 2], table[count, 3] = cx, cy, vx, vy
            count += 1
    return table, count


@compiled
def _along(
    edge_table: Reals,
    ground: npt.NDArray[np.uint8],
    starts: Ints,
    order: Ints,
    table: Floats,
    width: float,
    reach: int,
) -> tuple[Floats, Reals]:
    """Evidence along every line, gathered from the edges of fitting direction.

    A place without part in it counts -1.5, one without flanks -0.15, one flank +0.3, both +1.35.
    """
    count = len(table)
    size = 2 * reach + 1
    total = np.zeros((count, size + 1))
    tips = np.zeros((count, size, 2), np.float32)
    low, high = np.zeros(size), np.zeros(size)
    band = int(0.3 / np.pi * TURNS) + 1
    tip_band = int(0.4 / np.pi * TURNS) + 1
    for line in range(count):
        ox, oy, ux, uy = table[line, 0], table[line, 1], table[line, 2], table[line, 3]
        low[:] = 0.0
        high[:] = 0.0
        own = int((np.arctan2(uy, ux) % np.pi) / np.pi * TURNS + 0.5)
        for step in range(-band, band + 1):
            turn = (own + step) % TURNS
            for k in range(starts[turn], starts[turn + 1]):
                e = order[k]
                x, y = edge_table[e, 0] - ox, edge_table[e, 1] - oy
                off = -x * uy + y * ux
                if abs(abs(off) - 0.5 * width) > 2.0:
                    continue
                looks = -edge_table[e, 2] * uy + edge_table[e, 3] * ux
                # the bright side is the line's side
                if looks * off > 0:
                    continue
                place = int(x * ux + y * uy + reach + 0.5)
                if place < 0 or place >= size:
                    continue
                miss = abs(off) - 0.5 * width
                value = edge_table[e, 4] * np.exp(-0.5 * (miss / FLANK_SIGMA_PX) ** 2)
                if off > 0:
                    high[place] = max(high[place], value)
                else:
                    low[place] = max(low[place], value)
        across = own + TURNS // 2
        for step in range(-tip_band, tip_band + 1):
            turn = (across + step) % TURNS
            for k in range(starts[turn], starts[turn + 1]):
                e = order[k]
                x, y = edge_table[e, 0] - ox, edge_table[e, 1] - oy
                off = -x * uy + y * ux
                if abs(off) > 0.4 * width:
                    continue
                forward = edge_table[e, 2] * ux + edge_table[e, 3] * uy
                end = 0 if forward > 0 else 1
                centre = x * ux + y * uy + reach
                # an end face of width w gives about w edges
                for place in range(int(centre) - 1, int(centre) + 3):
                    if 0 <= place < size:
                        off_t = place - centre
                        tips[line, place, end] += (
                            edge_table[e, 4] * np.exp(-0.5 * off_t * off_t) / max(0.8 * width, 1.0)
                        )
        for q in range(1, size - 1):
            if low[q] == 0.0 and low[q - 1] > 0.0 and low[q + 1] > 0.0:
                low[q] = min(low[q - 1], low[q + 1])
            if high[q] == 0.0 and high[q - 1] > 0.0 and high[q + 1] > 0.0:
                high[q] = min(high[q - 1], high[q + 1])
        for q in range(size):
            x, y = int(ox + (q - reach) * ux + 0.5), int(oy + (q - reach) * uy + 0.5)
            if x < 0 or y < 0 or x >= ground.shape[1] or y >= ground.shape[0]:
                value = -1.0
            elif ground[y, x] == 0:
                value = -1.5
            else:
                value = -0.15 + 0.45 * (low[q] + high[q]) + 0.6 * min(low[q], high[q])
            total[line, q + 1] = total[line, q] + value
            tips[line, q, 0] = min(tips[line, q, 0], 1.0)
            tips[line, q, 1] = min(tips[line, q, 1], 1.0)
    return total, tips
