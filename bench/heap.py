"""Dense heaps: rods of any length and width dropped on one another, each in its lowest stable pose.

The rule is that of `drivers.sim.piles` (lowest centre such that the axis passes above every obstacle; roll
and slide off flanks too steep for friction). Here every rod has its own size, may also turn in plan to slip
off its neighbours, and is thrown more than once; blocks can stand on the table. It is compiled, because a
bench wants thousands of heaps; only the part of a rod that can touch another is looked at. Base frame,
metres, z up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vision.jit import compiled
from vision.types import Floats, Ints, read_only

COARSE_M = 0.001
FINE_M = 0.00025
"""Spacing of the points at which an axis is held above the others, while it moves and at the end."""
ROLL_M = 0.0006
SLIDE_M = 0.002
TURN_RAD = 0.012
FRICTION = 0.2
"""A rod moves while a step lowers its centre by more than this share of the step."""
MOVES = 60
"""Most steps a rod takes before it lies still."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rod:
    """One thin part: a cylinder with flat ends.

    ``centre`` (3,) m and ``axis`` (3,) unit, base frame. ``colour`` (3,) linear light, BGR; ``colour_name``
    and ``material`` are words for the truth file; ``shade`` is this very rod's brightness; ``gloss`` 0..1.
    """

    length_m: float
    radius_m: float
    colour: Floats
    colour_name: str
    material: str
    shade: float
    gloss: float
    target: bool
    centre: Floats
    axis: Floats

    @property
    def ends(self) -> Floats:
        """(2, 3) m, both ends of the axis."""
        half = 0.5 * self.length_m * self.axis
        return np.stack([self.centre - half, self.centre + half])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Block:
    """A cuboid that stands on the table, turned by ``turn_rad`` about z; ``half_m`` (2,) half its sides."""

    middle: Floats
    half_m: Floats
    turn_rad: float
    height_m: float
    colour: Floats


def blocks_array(blocks: tuple[Block, ...]) -> Floats:
    """(B, 7): middle x, y, half sides, cosine and sine of the turn, height."""
    rows = [
        [*b.middle.tolist(), *b.half_m.tolist(), np.cos(b.turn_rad), np.sin(b.turn_rad), b.height_m]
        for b in blocks
    ]
    return np.array(rows, np.float64).reshape(-1, 7)


@compiled
def _tube_top(x: float, y: float, tube: Floats, reach: float) -> float:
    """Height of the upper side of a round-ended tube of radius ``reach`` above (x, y); -1e9 where none.

    ``tube`` (7,): start, axis, length. The quadratic is that of `drivers.sim.piles.tube_top`.
    """
    dx, dy, slope = x - tube[0], y - tube[1], tube[5]
    along = dx * tube[3] + dy * tube[4]
    a = max(1.0 - slope * slope, 1e-12)
    b = -along * slope
    c = dx * dx + dy * dy - along * along - reach * reach
    disc = b * b - a * c
    top = -1e9
    if disc >= 0.0:
        height = (-b + np.sqrt(disc)) / a
        at = along + height * slope
        if 0.0 <= at <= tube[6]:
            top = tube[2] + height
    for end in range(2):
        far = end * tube[6]
        ex, ey = dx - far * tube[3], dy - far * tube[4]
        inside = reach * reach - ex * ex - ey * ey
        if inside >= 0.0:
            top = max(top, tube[2] + far * slope + np.sqrt(inside))
    return top


@compiled
def _bounds(
    pose: Floats,
    half: float,
    radius: float,
    tubes: Floats,
    radii: Floats,
    blocks: Floats,
    floor_z: float,
    at: Floats,
    bound: Floats,
) -> None:
    """How high an axis has to be (``bound``) at the places ``at`` (K,) ascending along it in plan."""
    cx, cy, hx, hy = pose[0], pose[1], np.cos(pose[2]), np.sin(pose[2])
    count = len(at)
    for k in range(count):
        bound[k] = floor_z + radius
    for b in range(len(blocks)):
        for k in range(count):
            dx, dy = cx + at[k] * hx - blocks[b, 0], cy + at[k] * hy - blocks[b, 1]
            u = abs(dx * blocks[b, 4] + dy * blocks[b, 5]) - blocks[b, 2]
            v = abs(dy * blocks[b, 4] - dx * blocks[b, 5]) - blocks[b, 3]
            away = max(u, 0.0) ** 2 + max(v, 0.0) ** 2
            if away < radius * radius:
                bound[k] = max(bound[k], floor_z + blocks[b, 6] + np.sqrt(radius * radius - away))
    for n in range(len(tubes)):
        reach = radius + radii[n]
        # the tube's plan in the rod's own coordinates, cut to what is within reach sideways
        ax, ay = tubes[n, 0] - cx, tubes[n, 1] - cy
        bx, by = ax + tubes[n, 6] * tubes[n, 3], ay + tubes[n, 6] * tubes[n, 4]
        la, lb = ax * hx + ay * hy, bx * hx + by * hy
        sa, sb = ay * hx - ax * hy, by * hx - bx * hy
        if min(sa, sb) > reach or max(sa, sb) < -reach:
            continue
        span = sb - sa
        t0, t1 = 0.0, 1.0
        if abs(span) > 1e-12:
            p, q = (-reach - sa) / span, (reach - sa) / span
            t0, t1 = max(0.0, min(p, q)), min(1.0, max(p, q))
        one, two = la + t0 * (lb - la), la + t1 * (lb - la)
        low, high = min(one, two) - reach, max(one, two) + reach
        if low > half or high < -half:
            continue
        first, last = np.searchsorted(at, low), np.searchsorted(at, high)
        for k in range(first, last):
            top = _tube_top(cx + at[k] * hx, cy + at[k] * hy, tubes[n], reach)
            bound[k] = max(bound[k], top)


@compiled
def _places(half: float, spacing: float) -> Floats:
    """Places along a rod, none of them 0, symmetric and ascending."""
    count = max(2, int(np.ceil(half / spacing)))
    at = np.empty(2 * count)
    for k in range(count):
        at[k] = (k - count) * half / count
        at[count + k] = (k + 1) * half / count
    return at


@compiled
def _lowest(at: Floats, height: Floats, hull: Ints) -> tuple[float, float]:
    """The line above all points that is lowest at 0: the edge of their upper hull that spans 0.

    ``hull`` is room for as many indices as there are points. Returns value at 0 and slope.
    """
    size = 0
    for k in range(len(at)):
        while size >= 2:
            i, j = hull[size - 2], hull[size - 1]
            turn = (at[j] - at[i]) * (height[k] - height[i]) - (height[j] - height[i]) * (at[k] - at[i])
            if turn < 0.0:
                break
            size -= 1
        hull[size] = k
        size += 1
    for n in range(1, size):
        i, j = hull[n - 1], hull[n]
        if at[j] > 0.0:
            slope = (height[j] - height[i]) / (at[j] - at[i])
            return height[i] - slope * at[i], slope
    return height[0], 0.0


@compiled
def _rest(
    pose: Floats,
    length: float,
    radius: float,
    tubes: Floats,
    radii: Floats,
    blocks: Floats,
    floor_z: float,
    spacing: float,
) -> tuple[float, float]:
    """Centre height and slope of a rod held at ``pose`` (3,): x, y and heading in plan."""
    half = 0.5 * length
    slope, height = 0.0, floor_z + radius
    at = _places(half, spacing)
    bound = np.empty(len(at))
    hull = np.empty(len(at), np.int64)
    full = at.copy()
    for turn in range(12):  # tilting shortens the rod in plan, which moves the points it rests on
        reach = half / np.sqrt(1.0 + slope * slope)
        at[:] = full * (reach / half)
        _bounds(pose, reach, radius, tubes, radii, blocks, floor_z, at, bound)
        height, found = _lowest(at, bound, hull)
        done = abs(found - slope) < 1e-5
        slope = found if turn < 4 else 0.5 * (slope + found)
        if done:
            break
    for k in range(len(at)):  # the last turn of the slope must not press it into anything
        height = max(height, bound[k] - slope * at[k])
    return height, slope


@compiled
def _settle(
    pose: Floats,
    length: float,
    radius: float,
    tubes: Floats,
    radii: Floats,
    blocks: Floats,
    floor_z: float,
    moves: int,
    out: Floats,
) -> None:
    """Settle one rod; ``out`` (6,) gets centre and axis."""
    pose = pose.copy()
    height, slope = _rest(pose, length, radius, tubes, radii, blocks, floor_z, COARSE_M)
    trial = pose.copy()
    best = pose.copy()
    for _ in range(moves):
        gain, best_height, best_slope = 0.0, height, slope
        cosine, sine = np.cos(pose[2]), np.sin(pose[2])
        for way in range(6):
            sign = 1.0 if way % 2 else -1.0
            trial[:] = pose
            if way < 2:
                trial[0] -= sign * ROLL_M * sine
                trial[1] += sign * ROLL_M * cosine
                cost = ROLL_M
            elif way < 4:
                trial[0] += sign * SLIDE_M * cosine
                trial[1] += sign * SLIDE_M * sine
                cost = SLIDE_M
            else:
                trial[2] += sign * TURN_RAD
                cost = 0.25 * length * TURN_RAD
            h, s = _rest(trial, length, radius, tubes, radii, blocks, floor_z, COARSE_M)
            won = height - h - FRICTION * cost
            if won > gain:
                gain, best_height, best_slope = won, h, s
                best[:] = trial
        if gain <= 0.0:
            break
        pose[:] = best
        height, slope = best_height, best_slope
    height, slope = _rest(pose, length, radius, tubes, radii, blocks, floor_z, FINE_M)
    size = np.sqrt(1.0 + slope * slope)
    out[0], out[1], out[2] = pose[0], pose[1], height
    out[3], out[4], out[5] = np.cos(pose[2]) / size, np.sin(pose[2]) / size, slope / size


def settle(
    throws: Floats,
    lengths: Floats,
    radii: Floats,
    floor_z: float,
    *,
    blocks: tuple[Block, ...] = (),
    moves: int = MOVES,
) -> tuple[Floats, Floats]:
    """Drop rods one after another and let each settle over those before it.

    Of several throws of a rod the one whose higher end comes to lie lowest is kept: rods that fall from a
    height run down from the top, which rods that only settle do not.

    Parameters
    ----------
    throws : (N, K, 3) float
        x, y m and heading rad at which each is dropped; it may roll, slide and turn away from there.
    lengths, radii : (N,) float
        Metres.
    floor_z : float
        Height of the table, m.
    moves
        Most steps away from where it was dropped; 0 holds each rod in place.

    Returns
    -------
    centres, axes : (N, 3) float
        Metres; unit.
    """
    count = len(throws)
    tubes, placed = np.empty((count, 7)), np.empty((count, 6))
    obstacles = blocks_array(blocks)
    found = np.empty(6)
    for n in range(count):
        lowest = np.inf
        for pose in np.ascontiguousarray(throws[n], np.float64):
            _settle(
                pose,
                float(lengths[n]),
                float(radii[n]),
                tubes[:n],
                radii[:n],
                obstacles,
                floor_z,
                moves if n or len(obstacles) else 0,
                found,
            )
            top = found[2] + 0.5 * lengths[n] * abs(found[5])
            if top < lowest:
                lowest = top
                placed[n] = found
        tubes[n, :3] = placed[n, :3] - 0.5 * lengths[n] * placed[n, 3:]
        tubes[n, 3:6], tubes[n, 6] = placed[n, 3:], lengths[n]
    return read_only(placed[:, :3].copy()), read_only(placed[:, 3:].copy())
