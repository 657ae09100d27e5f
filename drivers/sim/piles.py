"""Sticks dropped into a tray, each settled by gravity over the floor and the sticks below it.

A stick keeps its place and heading in plan and looks for its lowest stable pose: centre height and slope are
the solution of a two-variable linear programme, "the lowest centre such that the axis passes above every
obstacle". The optimum always touches on both sides of the centre of mass, which is what makes it stable. A
stick that would rest on a flank too steep for friction rolls off sideways or slides down lengthwise first.
Base frame, metres; z up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.sim.geometry import Bools, Floats
from drivers.sim.layout import SticksLayout, TrayLayout

COARSE_M = 0.001
FINE_M = 0.00025
"""Spacing of the points at which a stick's axis is held above the others, while it moves and at the end."""
ROLL_STEP_M = 0.0006
SLIDE_STEP_M = 0.002
MOVES = 60
"""Most steps a stick rolls sideways or slides lengthwise before it lies still."""
FRICTION = 0.3
"""A stick moves while a step lowers its centre by more than this share of the step."""
DROP_TRIES = 2000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stick:
    """One part. ``centre`` (3,) m and ``axis`` (3,) unit, base frame; ``shade`` its brightness."""

    number: int
    length_m: float
    diameter_m: float
    shade: float
    centre: Floats
    axis: Floats

    @property
    def ends(self) -> tuple[Floats, Floats]:
        """The two end points of the axis, (3,) m each."""
        half = 0.5 * self.length_m * self.axis
        return self.centre - half, self.centre + half

    def moved(self, centre: Floats, axis: Floats) -> Stick:
        """The same part in another pose."""
        return Stick(
            number=self.number,
            length_m=self.length_m,
            diameter_m=self.diameter_m,
            shade=self.shade,
            centre=_closed(centre),
            axis=_closed(axis),
        )


def _closed(array: Floats) -> Floats:
    copy = np.array(array, dtype=np.float64)
    copy.setflags(write=False)
    return copy


def tube_top(points: Floats, start: Floats, end: Floats, radius_m: float) -> Floats:
    """Height of the upper side of round-ended tubes above points of the plan.

    Parameters
    ----------
    points : (K, 2) float
        x, y in metres.
    start, end : (N, 3) float
        Axis ends of the tubes, metres.
    radius_m : float
        Radius of all tubes.

    Returns
    -------
    (N, K) float
        Largest z within ``radius_m`` of the axis; minus infinity where a tube is not met.
    """
    axis = end - start
    length = np.linalg.norm(axis, axis=1, keepdims=True)
    axis = axis / length
    to_point = points[None, :, :] - start[:, None, :2]
    along = np.einsum("nkc,nc->nk", to_point, axis[:, :2])
    # |w - (w.u)u|^2 = R^2 with w = (dx, dy, h): a quadratic in the height h above the tube's start
    slope = axis[:, 2:3]
    a = 1.0 - slope**2
    b = -along * slope
    c = np.einsum("nkc,nkc->nk", to_point, to_point) - along**2 - radius_m**2
    discriminant = b * b - a * c
    height = (-b + np.sqrt(np.maximum(discriminant, 0.0))) / np.maximum(a, 1e-12)
    at = along + height * slope
    side = (discriminant >= 0.0) & (at >= 0.0) & (at <= length)
    top = np.where(side, start[:, 2:3] + height, -np.inf)
    for cap in (start, end):
        flat = np.sum((points[None, :, :] - cap[:, None, :2]) ** 2, axis=2)
        inside = radius_m**2 - flat
        ball = cap[:, 2:3] + np.sqrt(np.maximum(inside, 0.0))
        top = np.maximum(top, np.where(inside >= 0.0, ball, -np.inf))
    return np.asarray(top)


def lowest_line(at: Floats, height: Floats) -> tuple[float, float]:
    """The line above all points that is lowest at 0.

    ``at`` (K,) ascending, none of them 0, on both sides of 0; ``height`` (K,). Returns value at 0 and slope.
    The dual of the linear programme: the highest value at 0 of all chords between the two sides.
    """
    left = at < 0.0
    xl, fl = at[left][:, None], height[left][:, None]
    xr, fr = at[~left][None, :], height[~left][None, :]
    crossing = (fl * xr - fr * xl) / (xr - xl)
    i, j = np.unravel_index(int(np.argmax(crossing)), crossing.shape)
    slope = (fr[0, j] - fl[i, 0]) / (xr[0, j] - xl[i, 0])
    return float(crossing[i, j]), float(slope)


def _rest(
    stick: Stick, centre: Floats, heading: Floats, starts: Floats, ends: Floats, floor_z: float
) -> tuple[float, float]:
    """Centre height and slope of a stick held at ``centre`` (2,) and ``heading`` (2,) in plan."""
    half = 0.5 * stick.length_m
    height, slope = floor_z + 0.5 * stick.diameter_m, 0.0
    at, bound = _bounds(stick, centre, heading, starts, ends, floor_z, COARSE_M, half)
    for turn in range(12):  # tilting shortens the stick in plan, which moves the points it rests on
        height, found = lowest_line(at, bound)
        if abs(found - slope) < 1e-4:
            break
        slope = found if turn < 4 else 0.5 * (slope + found)
        reach = half / float(np.hypot(1.0, slope))
        at, bound = _bounds(stick, centre, heading, starts, ends, floor_z, COARSE_M, reach)
    return height, slope


def _bounds(
    stick: Stick,
    centre: Floats,
    heading: Floats,
    starts: Floats,
    ends: Floats,
    floor_z: float,
    spacing_m: float,
    reach_m: float,
) -> tuple[Floats, Floats]:
    """Places (K,) along a stick in plan, none of them 0, and how high its axis has to be there."""
    count = max(2, int(np.ceil(reach_m / spacing_m)))
    steps = np.concatenate([np.arange(-count, 0), np.arange(1, count + 1)])
    at: Floats = steps * (reach_m / count)
    bound: Floats = np.full(at.shape, floor_z + 0.5 * stick.diameter_m)
    if len(starts):
        tops = tube_top(centre + at[:, None] * heading, starts, ends, stick.diameter_m)
        bound = np.maximum(bound, tops.max(axis=0))
    return at, bound


def fits(tray: TrayLayout, centre: Floats, axis: Floats, length_m: float, margin_m: float) -> bool:
    """Whether a stick lies between the walls with ``margin_m`` to spare."""
    reach = np.abs(axis[:2]) * 0.5 * length_m + margin_m
    middle = np.array(tray.centre_m[:2])
    return bool(np.all(np.abs(centre[:2] - middle) + reach <= 0.5 * np.array(tray.inner_m)))


def _crosses(ends: Floats, heading: Floats, sideways: Floats, half_m: float, reach_m: float) -> Bools:
    """(N,) which segments (N, 2, 2) in plan enter the rectangle ``half_m`` by ``reach_m`` about 0."""
    along, across = ends @ heading, ends @ sideways
    # the part of each segment within reach sideways, then whether any of it is within reach lengthwise
    span = across[:, 1] - across[:, 0]
    span = np.where(np.abs(span) < 1e-12, 1e-12, span)
    t = np.sort(np.stack([(-reach_m - across[:, 0]) / span, (reach_m - across[:, 0]) / span]), axis=0)
    low, high = np.clip(t[0], 0.0, 1.0), np.clip(t[1], 0.0, 1.0)
    at = along[:, :1] + np.stack([low, high], axis=1) * (along[:, 1:] - along[:, :1])
    return np.asarray(
        (t[0] <= 1.0) & (t[1] >= 0.0) & (at.min(axis=1) <= half_m) & (at.max(axis=1) >= -half_m)
    )


def settle(stick: Stick, below: tuple[Stick, ...], tray: TrayLayout, margin_m: float) -> Stick:
    """The stick in its lowest stable pose over the floor and the sticks ``below``, which stay as they are.

    Only its place and heading in plan are taken from ``stick``; it may roll sideways off a flank, but not
    nearer to a wall than ``margin_m``.
    """
    heading = stick.axis[:2] / np.linalg.norm(stick.axis[:2])
    sideways = np.array([-heading[1], heading[0]])
    centre = np.array(stick.centre[:2])
    reach_m = MOVES * ROLL_STEP_M + stick.diameter_m
    half_m = 0.5 * stick.length_m + MOVES * SLIDE_STEP_M
    ends = np.array([other.ends for other in below]).reshape(-1, 2, 3)
    near = _crosses(ends[:, :, :2] - centre, heading, sideways, half_m, reach_m)
    starts, ends = ends[near, 0], ends[near, 1]
    floor_z = tray.centre_m[2]
    height, slope = _rest(stick, centre, heading, starts, ends, floor_z)
    moves = (ROLL_STEP_M * sideways, -ROLL_STEP_M * sideways, SLIDE_STEP_M * heading, -SLIDE_STEP_M * heading)
    for _ in range(MOVES if len(starts) else 0):
        best_gain, best = 0.0, None
        for move in moves:
            moved = centre + move
            if not fits(tray, moved, heading, stick.length_m, margin_m):
                continue
            rest = _rest(stick, moved, heading, starts, ends, floor_z)
            gain = height - rest[0] - FRICTION * float(np.linalg.norm(move))
            if gain > best_gain:
                best_gain, best = gain, (rest, moved)
        if best is None:
            break
        (height, slope), centre = best
    reach_m = 0.5 * stick.length_m / float(np.hypot(1.0, slope))
    at, bound = _bounds(stick, centre, heading, starts, ends, floor_z, FINE_M, reach_m)
    height = float(np.max(bound - slope * at))
    axis = np.array([heading[0], heading[1], slope])
    return stick.moved(np.array([centre[0], centre[1], height]), axis / np.linalg.norm(axis))


def resettle(
    sticks: tuple[Stick, ...], removed: Stick, tray: TrayLayout, margin_m: float
) -> tuple[Stick, ...]:
    """What remains of a pile, in the order it was dropped, after ``removed`` was taken out of it.

    ``sticks`` no longer holds the removed one. Only sticks that could rest on something that moved settle
    anew; the others keep their very record.
    """
    result: list[Stick] = []
    moved = [removed]
    for stick in sticks:
        touched = stick.number > removed.number and any(
            np.linalg.norm(stick.centre[:2] - gone.centre[:2]) < 0.5 * (stick.length_m + gone.length_m) + 0.01
            for gone in moved
        )
        if not touched:
            result.append(stick)
            continue
        anew = settle(stick, tuple(result), tray, margin_m)
        same = np.allclose(anew.centre, stick.centre, atol=1e-7) and np.allclose(
            anew.axis, stick.axis, atol=1e-6
        )
        result.append(stick if same else anew)
        if not same:
            moved += [stick, anew]
    return tuple(result)


def drop_one(
    number: int, kind: SticksLayout, tray: TrayLayout, below: tuple[Stick, ...], rng: np.random.Generator
) -> Stick:
    """One stick dropped at a random place and heading, and settled.

    Raises
    ------
    ValueError
        When no place was found between the walls.
    """
    middle = np.array(tray.centre_m[:2])
    half = 0.5 * np.array(tray.inner_m)
    for _ in range(DROP_TRIES):
        angle = rng.uniform(0.0, np.pi)
        axis = np.array([np.cos(angle), np.sin(angle), 0.0])
        room = half - np.abs(axis[:2]) * 0.5 * kind.length_m - kind.wall_margin_m
        if np.any(room < 0.0):
            continue
        anywhere = rng.uniform(-1.0, 1.0, 2) * room
        on_heap = rng.normal(0.0, 0.15, 2) * half
        centre = middle + kind.spread * anywhere + (1.0 - kind.spread) * on_heap
        if not fits(tray, centre, axis, kind.length_m, kind.wall_margin_m):
            continue
        shade = kind.shade * float(np.clip(rng.normal(1.0, 0.06), 0.8, 1.2))
        stick = Stick(
            number=number,
            length_m=kind.length_m,
            diameter_m=kind.diameter_m,
            shade=shade,
            centre=_closed(np.array([centre[0], centre[1], tray.centre_m[2]])),
            axis=_closed(axis),
        )
        return settle(stick, below, tray, kind.wall_margin_m)
    raise ValueError(f"a stick of {kind.length_m} m finds no place in a tray of {tray.inner_m} m")


def drop_pile(kind: SticksLayout, tray: TrayLayout, rng: np.random.Generator) -> tuple[Stick, ...]:
    """``kind.count`` sticks, dropped one after another; numbers count up in that order."""
    pile: tuple[Stick, ...] = ()
    for number in range(kind.count):
        pile = (*pile, drop_one(number, kind, tray, pile, rng))
    return pile
