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

from vision.along import FLANK_SIGMA_PX, along
from vision.edges import SAME_WAY, Edges, Ids, Reals
from vision.jit import compiled, compiled_sums, lean
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
OPPOSITE_PX = 1.6
VOTE_PX, CELL_PX = 2.2, 4
"""How far from a line votes for it are; votes of one direction are sorted by such stretches of distance."""


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
    votes, starts, middle, radius = _votes(found.table, found.at, found.ground, width_px)
    least = FAINTEST_LENGTHS * length_px
    board = _board(votes, radius)
    peaks = np.concatenate([_as_peaks(pieces, middle, radius), _peaks(board, radius, least)])
    table, count = _fit(votes, starts, peaks, middle, radius, length_px, least)
    table = table[:count].copy()
    total, tips = along(found.table, found.ground, table, width_px, reach)
    return Lines(table=read_only(table), total=total, tips=tips, reach_px=reach)


@compiled
def _votes(
    table: Reals, at: Ids, ground: npt.NDArray[np.uint8], width: float
) -> tuple[Floats, Ints, Floats, int]:
    """Centre and weight of the votes, sorted by direction of their line and by its distance from the middle.

    Returns
    -------
    votes : (N, 4)
        Rows x, y from the middle, direction as a number of turns, weight.
    starts : (TURNS, C + 1)
        Where those of each direction, and in it of every `CELL_PX` of distance from -radius on, begin.
    middle : (2,)
        Of all votes.
    radius : int
        No vote is further from there.
    """
    count = len(table)
    raw = np.empty((count, 4))
    kept = 0
    low_x, low_y, high_x, high_y = 1e9, 1e9, -1e9, -1e9
    for edge in range(count):
        x, y, ux, uy = table[edge, 0], table[edge, 1], table[edge, 2], table[edge, 3]
        # every second one, however many lie in a row
        if (edge + int(y) // 2) % 2 == 1:
            continue
        cx, cy = x + 0.5 * width * ux, y + 0.5 * width * uy
        column, row = int(cx + 0.5), int(cy + 0.5)
        if not (0 <= column < ground.shape[1] and 0 <= row < ground.shape[0]) or ground[row, column] == 0:
            continue
        other, off = _opposite(table, at, x + width * ux, y + width * uy, -ux, -uy)
        weight = 0.6
        if other >= 0:
            weight += 1.4 * table[other, 4] * np.exp(-0.5 * (off / FLANK_SIGMA_PX) ** 2)
        angle = np.arctan2(ux, -uy)
        if angle < 0.0:
            angle += np.pi
        raw[kept, 0], raw[kept, 1], raw[kept, 2], raw[kept, 3] = cx, cy, angle / np.pi * TURNS, weight
        low_x, high_x = min(low_x, cx), max(high_x, cx)
        low_y, high_y = min(low_y, cy), max(high_y, cy)
        kept += 1
    if kept == 0:
        return np.empty((0, 4)), np.zeros((TURNS, 2), np.int64), np.zeros(2), 3
    middle = np.array([0.5 * (low_x + high_x), 0.5 * (low_y + high_y)])
    radius = int(0.5 * np.hypot(high_x - low_x, high_y - low_y)) + 3
    cells = 2 * radius // CELL_PX + 1
    starts = np.zeros((TURNS, cells + 1), np.int64)
    place = np.empty(kept, np.int64)
    for vote in range(kept):
        raw[vote, 0] -= middle[0]
        raw[vote, 1] -= middle[1]
        turn = int(raw[vote, 2] + 0.5) % TURNS
        turned = turn * np.pi / TURNS
        distance = raw[vote, 1] * np.cos(turned) - raw[vote, 0] * np.sin(turned)
        place[vote] = turn * (cells + 1) + int(distance + radius) // CELL_PX
        starts.reshape(-1)[place[vote]] += 1
    begin = 0
    flat = starts.reshape(-1)
    for k in range(len(flat)):
        begin, flat[k] = begin + flat[k], begin
    votes = np.empty((kept, 4))
    filled = flat.copy()
    for vote in range(kept):
        k = filled[place[vote]]
        filled[place[vote]] += 1
        for n in range(4):
            votes[k, n] = raw[vote, n]
    return votes, starts, middle, radius


@lean
def _opposite(table: Reals, at: Ids, x: float, y: float, nx: float, ny: float) -> tuple[int, float]:
    """The edge nearest to (x, y) along the unit direction (nx, ny) that looks that way, -1: none within
    `OPPOSITE_PX`; its offset. As `nearest_edge`, at five places and with nothing taken."""
    best, best_off = -1, 0.0
    nearest = OPPOSITE_PX
    for step in range(-2, 3):
        off = 0.5 * step * OPPOSITE_PX
        column, row = int(x + off * nx + 0.5), int(y + off * ny + 0.5)
        if column < 0 or row < 0 or column >= at.shape[1] or row >= at.shape[0]:
            continue
        edge = at[row, column]
        if edge < 0 or edge == best or table[edge, 2] * nx + table[edge, 3] * ny < SAME_WAY:
            continue
        along = (table[edge, 0] - x) * nx + (table[edge, 1] - y) * ny
        if abs(along) <= nearest:
            nearest = abs(along)
            best, best_off = edge, along
    return best, best_off


@compiled
def _board(votes: Floats, radius: int) -> Reals:
    """The voting board (TURNS, 2 radius): direction by signed distance from the middle of all votes."""
    board = np.zeros((TURNS, 2 * radius), np.float32)
    # directions beyond half a turn and below zero too, so that steps need not be taken round
    sines = np.sin(np.arange(-SPREAD, TURNS + SPREAD + 1) * np.pi / TURNS)
    cosines = np.cos(np.arange(-SPREAD, TURNS + SPREAD + 1) * np.pi / TURNS)
    for k in range(len(votes)):
        weight = votes[k, 3]
        x, y = votes[k, 0], votes[k, 1]
        centre = int(votes[k, 2] + 0.5)
        for step in range(-SPREAD, SPREAD + 1):
            turn = centre + step
            distance = -sines[turn + SPREAD] * x + cosines[turn + SPREAD] * y
            # the same line the other way round lies on the other side
            if turn < 0:
                turn, distance = turn + TURNS, -distance
            elif turn >= TURNS:
                turn, distance = turn - TURNS, -distance
            distance += radius
            cell = int(distance)
            share = distance - cell
            part = weight * (1 - 0.5 * abs(step) / SPREAD)
            board[turn, cell] += part * (1 - share)
            board[turn, cell + 1] += part * share
    return board


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

    Tukey's weights over the distance from the line, the window narrowing from 2 to 1 px. All in the frame of
    the peak's line: along it and across it.
    """
    table = np.empty((MOST_LINES, 4))
    count = 0
    size = len(votes)
    along, across, weights = np.empty(size), np.empty(size), np.empty(size)
    x, y, w = np.empty(size), np.empty(size), np.empty(size)
    total = np.empty(2 * radius + 4)
    band = int(0.2 / np.pi * TURNS) + 1
    cells = starts.shape[1] - 1
    span = int(1.02 * length)
    line = np.empty(4)
    for peak in range(len(peaks)):
        angle = peaks[peak, 0] * np.pi / TURNS
        distance = peaks[peak, 1] - radius
        ux, uy = np.cos(angle), np.sin(angle)
        bx, by = -uy * distance, ux * distance
        near = 0
        low, high = 1e9, -1e9
        # half of what of the line is within the radius
        half = np.sqrt(max(radius * radius - distance * distance, 0.0))
        for turn in range(int(peaks[peak, 0] + 0.5) - band, int(peaks[peak, 0] + 0.5) + band + 1):
            # where, votes of the line may be; beyond half a turn the other way round
            off_turn = turn * np.pi / TURNS - angle
            centre, spread = distance * np.cos(off_turn), half * abs(np.sin(off_turn)) + VOTE_PX + 0.1
            if turn < 0 or turn >= TURNS:
                centre = -centre
            own = turn % TURNS
            first = max(0, int(centre - spread + radius) // CELL_PX)
            last = min(cells - 1, int(max(0.0, centre + spread + radius)) // CELL_PX)
            for k in range(starts[own, first], starts[own, max(first, last + 1)]):
                off = -(votes[k, 0] - bx) * uy + (votes[k, 1] - by) * ux
                if abs(off) > VOTE_PX:
                    continue
                t = (votes[k, 0] - bx) * ux + (votes[k, 1] - by) * uy
                along[near], across[near], weights[near] = t, off, votes[k, 3]
                low, high = min(low, t), max(high, t)
                near += 1
        if near < 5:
            continue
        bins = int(high - low) + 2
        total[: bins + 1] = 0.0
        for q in range(near):
            total[int(along[q] - low) + 1] += weights[q] * (1 - abs(across[q]) / 2.5)
        for q in range(bins):
            total[q + 1] += total[q]
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
            within = 0
            for q in range(near):
                if a - 2 <= along[q] - low <= b + 2:
                    x[within], y[within], w[within] = along[q], across[q], weights[q]
                    within += 1
            line[0], line[1], line[2], line[3] = low + 0.5 * (a + b), 0.0, 1.0, 0.0
            if not _settle(x[:within], y[:within], w[:within], line):
                continue
            cx = middle[0] + bx + line[0] * ux - line[1] * uy
            cy = middle[1] + by + line[0] * uy + line[1] * ux
            vx, vy = line[2] * ux - line[3] * uy, line[2] * uy + line[3] * ux
            if vy < 0 or (vy == 0 and vx < 0):
                vx, vy = -vx, -vy
            double = False
            for q in range(count):
                if abs(table[q, 2] * vy - table[q, 3] * vx) < 0.012:
                    dx, dy = cx - table[q, 0], cy - table[q, 1]
                    if (
                        abs(dx * table[q, 2] + dy * table[q, 3]) < 0.5 * length
                        and abs(-dx * table[q, 3] + dy * table[q, 2]) < 0.7
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


@compiled_sums
def _settle(x: Floats, y: Floats, w: Floats, line: Floats) -> bool:
    """Moves a line, a point and the unit direction, onto weighted points; False: too few lie on it."""
    cx, cy, vx, vy = line[0], line[1], line[2], line[3]
    window = 2.0
    along = 0.0
    for turn_of in range(4):
        sw = sx = sy = sxx = sxy = syy = 0.0
        per_window = 1.0 / (window * window)
        for q in range(len(x)):
            dx, dy = x[q] - cx, y[q] - cy
            off = dy * vx - dx * vy
            near = max(0.0, 1.0 - off * off * per_window)
            weight = w[q] * near * near
            sw += weight
            sx += weight * dx
            sy += weight * dy
            sxx += weight * dx * dx
            sxy += weight * dx * dy
            syy += weight * dy * dy
        if sw < 4:
            return False
        sx, sy = sx / sw, sy / sw
        sxx, sxy, syy = sxx / sw - sx * sx, sxy / sw - sx * sy, syy / sw - sy * sy
        turned = 0.5 * np.arctan2(2 * sxy, sxx - syy)
        vx, vy = np.cos(turned), np.sin(turned)
        cx += sx
        cy += sy
        along = np.sqrt(max(sxx * vx * vx + 2 * sxy * vx * vy + syy * vy * vy, 0.0))
        window = 2.0 if turn_of == 0 else (1.5 if turn_of == 1 else 1.0)
    line[0], line[1], line[2], line[3] = cx, cy, vx, vy
    return along >= 3
