"""Light in the simulated cell: how much of a round lamp and of the room reaches the floor and the sticks.

A stick is thin and long, so the lamp's disc seen from a point is cut by a straight band: the hidden share is
the area of a disc between two parallel chords. That gives soft shadows that are sharp where a part touches
and fade with height. Base frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.sim.geometry import Floats
from drivers.sim.layout import LightLayout, TrayLayout
from drivers.sim.piles import Stick

CELL_M = 0.001
MARKS = 128
"""Places along a stick for which its light is worked out."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LightMap:
    """Shares of lamp and room light, 0..1.

    ``floor_lamp``, ``floor_room`` (H, W) over the tray, cell (0, 0) centred at ``origin_m``; ``stick_lamp``,
    ``stick_room`` (N, MARKS) along the sticks, in the order they were given.
    """

    origin_m: tuple[float, float]
    floor_lamp: Floats
    floor_room: Floats
    stick_lamp: Floats
    stick_room: Floats


def _disc_share(offset: Floats) -> Floats:
    """Area share of the unit disc left of a chord at ``offset``."""
    x = np.clip(offset, -1.0, 1.0)
    return np.asarray(0.5 + (x * np.sqrt(1.0 - x * x) + np.arcsin(x)) / np.pi)


def _through(points: Floats, stick: Stick, light: LightLayout) -> tuple[Floats, Floats]:
    """Shares (K,) of lamp and of room light that a stick lets through to points (K, 3)."""
    lamp = np.array(light.position_m)
    radius = 0.5 * stick.diameter_m
    to_lamp = lamp - points
    far = np.linalg.norm(to_lamp, axis=1)
    to_lamp = to_lamp / far[:, None]
    start = points - stick.centre
    # nearest approach of the ray to the lamp and the axis (two skew lines)
    across = np.cross(to_lamp, stick.axis)
    size = np.maximum(np.linalg.norm(across, axis=1), 1e-9)
    gap = np.abs(np.einsum("kc,kc->k", start, across)) / size
    cosine = to_lamp @ stick.axis
    ray_start = np.einsum("kc,kc->k", start, to_lamp)
    axis_start = start @ stick.axis
    ahead = (cosine * axis_start - ray_start) / size**2
    along = (axis_start - cosine * ray_start) / size**2
    cone = np.maximum(light.radius_m * np.maximum(ahead, 0.0) / far, 1e-4)
    hidden = _disc_share((gap + radius) / cone) - _disc_share((gap - radius) / cone)
    ends = np.clip((0.5 * stick.length_m - np.abs(along)) / (2.0 * cone) + 0.5, 0.0, 1.0)
    lamp_share = 1.0 - np.where(ahead > 1e-4, hidden * ends, 0.0)
    # the room: a band of the sky as wide as the stick looks from here
    beyond = np.maximum(np.abs(axis_start) - 0.5 * stick.length_m, 0.0)
    near = np.sqrt(np.maximum(np.einsum("kc,kc->k", start, start) - axis_start**2 + beyond**2, radius**2))
    above = (stick.centre[2] + stick.axis[2] * axis_start - points[:, 2]) / near
    room_share = 1.0 - 0.75 * np.clip(radius / near, 0.0, 1.0) * np.clip(above + 0.25, 0.0, 1.0)
    return lamp_share, room_share


def light_map(sticks: tuple[Stick, ...], tray: TrayLayout, light: LightLayout) -> LightMap:
    """Light on the tray's floor and on every stick."""
    half = 0.5 * np.array(tray.inner_m)
    columns, rows = (int(np.ceil(2.0 * h / CELL_M)) + 1 for h in half)
    origin = (tray.centre_m[0] - half[0], tray.centre_m[1] - half[1])
    floor_lamp, floor_room = np.ones((rows, columns)), np.ones((rows, columns))
    marks = np.linspace(-0.5, 0.5, MARKS)
    stick_lamp, stick_room = np.ones((len(sticks), MARKS)), np.ones((len(sticks), MARKS))
    lamp = np.array(light.position_m)
    surface = []
    for stick in sticks:
        axis_points = stick.centre + marks[:, None] * stick.length_m * stick.axis
        upward = lamp - axis_points
        upward = upward / np.linalg.norm(upward, axis=1, keepdims=True) + np.array([0.0, 0.0, 1.0])
        upward -= (upward @ stick.axis)[:, None] * stick.axis
        upward *= 0.5 * stick.diameter_m / np.linalg.norm(upward, axis=1, keepdims=True)
        surface.append(axis_points + upward)
    for stick in sticks:
        rows_of, columns_of = _shaded_cells(stick, tray, lamp, origin, floor_lamp.shape)
        if rows_of.size:
            points = np.column_stack(
                [
                    origin[0] + columns_of * CELL_M,
                    origin[1] + rows_of * CELL_M,
                    np.full(rows_of.size, tray.centre_m[2]),
                ]
            )
            lamp_share, room_share = _through(points, stick, light)
            floor_lamp[rows_of, columns_of] *= lamp_share
            floor_room[rows_of, columns_of] *= room_share
        for i, other in enumerate(sticks):
            if other is stick or np.linalg.norm(other.centre - stick.centre) > 1.5 * stick.length_m:
                continue
            lamp_share, room_share = _through(surface[i], stick, light)
            stick_lamp[i] *= lamp_share
            stick_room[i] *= room_share
    return LightMap(
        origin_m=origin,
        floor_lamp=floor_lamp,
        floor_room=floor_room,
        stick_lamp=stick_lamp,
        stick_room=stick_room,
    )


def _shaded_cells(
    stick: Stick, tray: TrayLayout, lamp: Floats, origin: tuple[float, float], shape: tuple[int, ...]
) -> tuple[np.ndarray[tuple[int], np.dtype[np.int64]], np.ndarray[tuple[int], np.dtype[np.int64]]]:
    """Rows and columns of the floor cells that a stick may darken: near it, or near its shadow."""
    ends = np.array(stick.ends)
    drop = (ends[:, 2] - tray.centre_m[2]) / (lamp[2] - ends[:, 2])
    shadow = ends[:, :2] + (ends[:, :2] - lamp[:2]) * drop[:, None]
    reach = 3.0 * stick.diameter_m + 0.25 * float(np.max(ends[:, 2] - tray.centre_m[2]))
    corners = np.concatenate([ends[:, :2], shadow])
    low = np.floor((corners.min(axis=0) - reach - np.array(origin)) / CELL_M).astype(np.int64)
    high = np.ceil((corners.max(axis=0) + reach - np.array(origin)) / CELL_M).astype(np.int64)
    columns = np.arange(max(0, low[0]), min(shape[1], high[0] + 1))
    rows = np.arange(max(0, low[1]), min(shape[0], high[1] + 1))
    row, column = (part.ravel() for part in np.meshgrid(rows, columns, indexing="ij"))
    x, y = origin[0] + column * CELL_M, origin[1] + row * CELL_M
    near = np.zeros(row.shape, dtype=np.bool_)
    for a, b in ((ends[0, :2], ends[1, :2]), (shadow[0], shadow[1])):
        way = b - a
        t = np.clip(((x - a[0]) * way[0] + (y - a[1]) * way[1]) / max(float(way @ way), 1e-12), 0.0, 1.0)
        near |= (x - a[0] - t * way[0]) ** 2 + (y - a[1] - t * way[1]) ** 2 < reach**2
    return row[near], column[near]
