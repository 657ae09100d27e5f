"""How much of a round lamp and of the room's light reaches the table and the skin of every rod. Compiled.

The formulas are those of `drivers.sim.light` (the lamp's disc cut by straight bands, the room dimmed near
parts), here for every place around a rod and not only along it. Base frame, metres.
"""

from __future__ import annotations

import numpy as np

from bench.meet import Small, slab
from vision.jit import compiled
from vision.types import Floats

MARKS, AROUND = 96, 10
"""Places along and around a rod for which its light is worked out."""
ROOM_REACH = 9.0
"""Radii beyond which a rod takes no light of the room from the table."""
LAMP_POINTS = 12
"""Points of the lamp's disc that are tested against blocks."""
BACK = 0.22
"""Share of the lamp's light that reaches a part in full shadow by way of the pale parts around it."""


@compiled
def _disc_share(offset: float) -> float:
    """Area share of the unit disc left of a chord at ``offset``."""
    x = min(1.0, max(-1.0, offset))
    return float(0.5 + (x * np.sqrt(1.0 - x * x) + np.arcsin(x)) / np.pi)


@compiled
def through(px: float, py: float, pz: float, rod: Floats, lamp: Floats) -> tuple[float, float]:
    """Shares of lamp and of room light that a rod (8,, base frame) lets through to a point.

    The formulas of `drivers.sim.light`; ``lamp`` (4,): position and radius.
    """
    lx, ly, lz = lamp[0] - px, lamp[1] - py, lamp[2] - pz
    far = np.sqrt(lx * lx + ly * ly + lz * lz)
    lx, ly, lz = lx / far, ly / far, lz / far
    sx, sy, sz = px - rod[0], py - rod[1], pz - rod[2]
    ax, ay, az, half, radius = rod[3], rod[4], rod[5], rod[6], rod[7]
    axis_start = sx * ax + sy * ay + sz * az
    square = sx * sx + sy * sy + sz * sz
    beyond = max(abs(axis_start) - half, 0.0)
    near = np.sqrt(max(square - axis_start * axis_start + beyond * beyond, radius * radius))
    above = (rod[2] + az * axis_start - pz) / near
    room = 1.0 - 0.75 * min(radius / near, 1.0) * min(max(above + 0.25, 0.0), 1.0)
    qx, qy, qz = ly * az - lz * ay, lz * ax - lx * az, lx * ay - ly * ax
    size = max(np.sqrt(qx * qx + qy * qy + qz * qz), 1e-9)
    cosine = lx * ax + ly * ay + lz * az
    ray_start = sx * lx + sy * ly + sz * lz
    ahead = (cosine * axis_start - ray_start) / (size * size)
    if ahead <= 1e-4:
        return 1.0, room
    gap = abs(sx * qx + sy * qy + sz * qz) / size
    cone = max(lamp[3] * ahead / far, 1e-4)
    if gap > radius + cone:
        return 1.0, room
    along = (axis_start - cosine * ray_start) / (size * size)
    ends = min(max((half - abs(along)) / (2.0 * cone) + 0.5, 0.0), 1.0)
    hidden = _disc_share((gap + radius) / cone) - _disc_share((gap - radius) / cone)
    return 1.0 - hidden * ends, room


@compiled
def _past_blocks(px: float, py: float, pz: float, blocks: Floats, floor_z: float, lamp: Floats) -> float:
    """Share of the lamp's disc that is seen past all blocks."""
    if len(blocks) == 0:
        return 1.0
    free = 0
    for k in range(LAMP_POINTS):
        ring = lamp[3] * np.sqrt((k + 0.5) / LAMP_POINTS)
        lx, ly = lamp[0] + ring * np.cos(2.399963 * k), lamp[1] + ring * np.sin(2.399963 * k)
        clear = 1
        for b in range(len(blocks)):
            c, s = blocks[b, 4], blocks[b, 5]
            ex, ey = px - blocks[b, 0], py - blocks[b, 1]
            dx, dy = lx - px, ly - py
            t = slab(
                ex * c + ey * s,
                ey * c - ex * s,
                pz - floor_z,
                dx * c + dy * s,
                dy * c - dx * s,
                lamp[2] - pz,
                blocks[b],
            )
            if t > 1e-5:
                clear = 0
        free += clear
    return free / LAMP_POINTS


@compiled
def rod_light(
    rods: Floats, frames: Floats, blocks: Floats, floor_z: float, lamp: Floats, lit: Floats, room: Floats
) -> None:
    """Lamp and room light (N, MARKS, AROUND) that reach each rod's skin past the others.

    ``frames`` (N, 2, 3): each rod's sideways and upward directions.
    """
    for n in range(len(rods)):
        for m in range(MARKS):
            s = (2.0 * m / (MARKS - 1) - 1.0) * rods[n, 6]
            for k in range(AROUND):
                angle = 2.0 * np.pi * k / AROUND
                side, up = np.sin(angle) * rods[n, 7], np.cos(angle) * rods[n, 7]
                px = rods[n, 0] + s * rods[n, 3] + side * frames[n, 0, 0] + up * frames[n, 1, 0]
                py = rods[n, 1] + s * rods[n, 4] + side * frames[n, 0, 1] + up * frames[n, 1, 1]
                pz = rods[n, 2] + s * rods[n, 5] + side * frames[n, 0, 2] + up * frames[n, 1, 2]
                one, two = 1.0, 1.0
                for other in range(len(rods)):
                    if other == n:
                        continue
                    a, b = through(px, py, pz, rods[other], lamp)
                    one *= a
                    two *= b
                # parts light one another: of what they keep away some comes back
                lit[n, m, k] = (BACK + (1.0 - BACK) * one) * _past_blocks(px, py, pz, blocks, floor_z, lamp)
                # the table below keeps the room's light from what lies low and looks down
                low = min(max((pz - floor_z) / (4.0 * rods[n, 7]), 0.0), 1.0)
                room[n, m, k] = two ** (1.0 - 2.5 * BACK) * (0.6 + 0.4 * low)


@compiled
def _away(x: float, y: float, ends: Floats) -> float:
    """Square of the distance of (x, y) to a segment (2, 2)."""
    ux, uy = ends[1, 0] - ends[0, 0], ends[1, 1] - ends[0, 1]
    dx, dy = x - ends[0, 0], y - ends[0, 1]
    t = min(max((dx * ux + dy * uy) / max(ux * ux + uy * uy, 1e-18), 0.0), 1.0)
    return float((dx - t * ux) ** 2 + (dy - t * uy) ** 2)


@compiled
def table_light(
    rods: Floats,
    blocks: Floats,
    floor_z: float,
    lamp: Floats,
    origin: Floats,
    cell: float,
    lit: Small,
    room: Small,
) -> None:
    """Lamp and room light (R, C) on the table's cells; cell (0, 0) centred at ``origin`` (2,) m."""
    rows, columns = lit.shape
    for n in range(len(rods)):
        near = ROOM_REACH * rods[n, 7]
        # plan of the rod, and of its shadow: two segments, each with what lies within reach of it
        ends = np.empty((2, 2, 2))
        soft = 0.0
        for end in range(2):
            sign = 2.0 * end - 1.0
            x = rods[n, 0] + sign * rods[n, 6] * rods[n, 3]
            y = rods[n, 1] + sign * rods[n, 6] * rods[n, 4]
            z = rods[n, 2] + sign * rods[n, 6] * rods[n, 5] - floor_z
            drop = z / (lamp[2] - floor_z - z)
            soft = max(soft, (1.0 + drop) * 3.0 * rods[n, 7] + 2.0 * lamp[3] * drop)
            ends[0, end, 0], ends[0, end, 1] = x, y
            ends[1, end, 0], ends[1, end, 1] = x + (x - lamp[0]) * drop, y + (y - lamp[1]) * drop
        reach = max(near, soft)
        first = max(0, int((ends[:, :, 1].min() - reach - origin[1]) / cell))
        last = min(rows - 1, int((ends[:, :, 1].max() + reach - origin[1]) / cell))
        start = max(0, int((ends[:, :, 0].min() - reach - origin[0]) / cell))
        stop = min(columns - 1, int((ends[:, :, 0].max() + reach - origin[0]) / cell))
        for i in range(first, last + 1):
            for j in range(start, stop + 1):
                x, y = origin[0] + j * cell, origin[1] + i * cell
                if _away(x, y, ends[0]) > near * near and _away(x, y, ends[1]) > soft * soft:
                    continue
                past, above = through(x, y, floor_z, rods[n], lamp)
                lit[i, j] *= past
                room[i, j] *= above
    for i in range(rows if len(blocks) else 0):
        for j in range(columns):
            x, y = origin[0] + j * cell, origin[1] + i * cell
            lit[i, j] *= _past_blocks(x, y, floor_z, blocks, floor_z, lamp)
            for b in range(len(blocks)):
                c, s = blocks[b, 4], blocks[b, 5]
                dx, dy = x - blocks[b, 0], y - blocks[b, 1]
                u, v = abs(dx * c + dy * s) - blocks[b, 2], abs(dy * c - dx * s) - blocks[b, 3]
                away = np.hypot(max(u, 0.0), max(v, 0.0))
                room[i, j] *= 1.0 - 0.5 * np.exp(-away / (0.5 * blocks[b, 6]))
