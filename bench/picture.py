"""Compiled pictures of a heap: which rod each ray meets, and how much light comes back along it.

The optics are `drivers.sim.optics`, the light is that of `drivers.sim.light` (a round lamp cut by straight
bands, the room's light dimmed near parts) worked out around each rod and not only along it, and the surfaces'
noise is `drivers.sim.surfaces`. Nine rays per pixel. Base frame, metres; colours linear light, BGR.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vision.jit import compiled
from vision.types import Floats, Ints

FINE = 3
"""Rays per pixel, along each side."""
MARKS, AROUND = 112, 12
"""Places along and around a rod for which its light is worked out."""
LAMP_POINTS = 12
"""Points of the lamp's disc that are tested against blocks."""
BLOCK_OWNER = 250
"""From here up an owner is a block, below it is a rod; -1 is the table."""

Small = npt.NDArray[np.float32]
Owners = npt.NDArray[np.int16]


@compiled
def _meet(x: float, y: float, rod: Floats) -> tuple[float, float]:
    """Depth and place along a rod (8,: centre, axis, half, radius; camera frame) met by a ray; -1 if none."""
    cx, cy, cz, ax, ay, az = rod[0], rod[1], rod[2], rod[3], rod[4], rod[5]
    half, radius = rod[6], rod[7]
    ray_axis = x * ax + y * ay + az
    ray_centre = x * cx + y * cy + cz
    middle = cx * ax + cy * ay + cz * az
    square = x * x + y * y + 1.0
    a = square - ray_axis * ray_axis
    b = ray_centre - middle * ray_axis
    own = cx * cx + cy * cy + cz * cz
    disc = b * b - a * (own - middle * middle - radius * radius)
    if disc < 0.0 or a < 1e-12:
        return -1.0, 0.0
    t = (b - np.sqrt(disc)) / a
    s = t * ray_axis - middle
    if abs(s) <= half:
        return t, s
    # of the two flat ends only the one turned to the eye can be met
    end = -half if ray_axis > 0.0 else half
    if abs(ray_axis) < 1e-12:
        return -1.0, 0.0
    t = (middle + end) / ray_axis
    off = t * t * square - 2.0 * t * ray_centre + own - end * end
    # |p - centre|^2 with p on the end's plane: what is left beyond end^2 is the square of the distance to the axis
    if t > 0.0 and off <= radius * radius:
        return t, end
    return -1.0, 0.0


@compiled
def raster(
    slopes: Small, rods: Floats, spans: Floats, depth: Small, owner: Owners, whole: Ints, whole_end: Ints
) -> None:
    """Nearest rod of every ray.

    Parameters
    ----------
    slopes : (FH, FW, 2) float32
        Slopes of all rays, camera frame.
    rods : (N, 8) float
        Centre, axis, half length, radius; camera frame, m.
    spans : (N, 5) float
        Both ends' places in rays (column, row), and how far from that line a rod may be seen.
    depth, owner : (FH, FW)
        Changed in place.
    whole : (N,) int, whole_end : (N, 2) int
        Rays that meet a rod, and its last radius at either end, whatever lies before it; changed in place.
    """
    rows, columns = depth.shape
    for n in range(len(rods)):
        u0, v0, u1, v1, pad = spans[n, 0], spans[n, 1], spans[n, 2], spans[n, 3], spans[n, 4]
        length = max(np.hypot(u1 - u0, v1 - v0), 1e-9)
        du, dv = (u1 - u0) / length, (v1 - v0) / length
        top, bottom = max(0, int(min(v0, v1) - pad)), min(rows - 1, int(max(v0, v1) + pad) + 1)
        for row in range(top, bottom + 1):
            low, high = min(u0, u1) - pad, max(u0, u1) + pad
            if abs(dv) > 1e-6:  # |(u - u0) dv - (v - v0) du| <= pad
                mid, wide = u0 + (row - v0) * du / dv, pad / abs(dv)
                low, high = max(low, mid - wide), min(high, mid + wide)
            for column in range(max(0, int(low)), min(columns - 1, int(high) + 1) + 1):
                t, s = _meet(slopes[row, column, 0], slopes[row, column, 1], rods[n])
                if t <= 0.0:
                    continue
                whole[n] += 1
                if abs(s) > rods[n, 6] - rods[n, 7]:
                    whole_end[n, 1 if s > 0.0 else 0] += 1
                if t < depth[row, column]:
                    depth[row, column] = t
                    owner[row, column] = n


@compiled
def raster_blocks(
    slopes: Small, rotation: Floats, eye: Floats, blocks: Floats, floor_z: float, depth: Small, owner: Owners
) -> None:
    """Blocks (B, 7, see `bench.heap.blocks_array`) into the buffers of `raster`."""
    rows, columns = depth.shape
    for b in range(len(blocks)):
        c, s = blocks[b, 4], blocks[b, 5]
        ex, ey = eye[0] - blocks[b, 0], eye[1] - blocks[b, 1]
        ox, oy, oz = ex * c + ey * s, ey * c - ex * s, eye[2] - floor_z
        for row in range(rows):
            for column in range(columns):
                x, y = slopes[row, column, 0], slopes[row, column, 1]
                rx = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2]
                ry = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2]
                rz = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2]
                dx, dy = rx * c + ry * s, ry * c - rx * s
                t = _slab(ox, oy, oz, dx, dy, rz, blocks[b])
                if 0.0 < t < depth[row, column]:
                    depth[row, column] = t
                    owner[row, column] = BLOCK_OWNER + b


@compiled
def _slab(ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, block: Floats) -> float:
    """Where a ray enters a block, in the block's own turned frame with its foot at z = 0; -1 if it does not."""
    near, far = -1e9, 1e9
    for axis in range(3):
        if axis == 0:
            o, d, low, high = ox, dx, -block[2], block[2]
        elif axis == 1:
            o, d, low, high = oy, dy, -block[3], block[3]
        else:
            o, d, low, high = oz, dz, 0.0, block[6]
        if abs(d) < 1e-12:
            if o < low or o > high:
                return -1.0
            continue
        p, q = (low - o) / d, (high - o) / d
        near, far = max(near, min(p, q)), min(far, max(p, q))
    return near if near <= far else -1.0


@compiled
def _disc_share(offset: float) -> float:
    """Area share of the unit disc left of a chord at ``offset``."""
    x = min(1.0, max(-1.0, offset))
    return 0.5 + (x * np.sqrt(1.0 - x * x) + np.arcsin(x)) / np.pi


@compiled
def _through(px: float, py: float, pz: float, rod: Floats, lamp: Floats) -> tuple[float, float]:
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
            t = _slab(
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
                    a, b = _through(px, py, pz, rods[other], lamp)
                    one *= a
                    two *= b
                lit[n, m, k] = one * _past_blocks(px, py, pz, blocks, floor_z, lamp)
                # the table below keeps the room's light from what lies low and looks down
                low = min(max((pz - floor_z) / (4.0 * rods[n, 7]), 0.0), 1.0)
                room[n, m, k] = two**0.6 * (0.6 + 0.4 * low)


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
        reach = 6.0 * rods[n, 7]
        low_x, high_x, low_y, high_y = 1e9, -1e9, 1e9, -1e9
        for end in (-1.0, 1.0):
            x = rods[n, 0] + end * rods[n, 6] * rods[n, 3]
            y = rods[n, 1] + end * rods[n, 6] * rods[n, 4]
            z = rods[n, 2] + end * rods[n, 6] * rods[n, 5] - floor_z
            drop = z / (lamp[2] - floor_z - z)
            soft = reach + lamp[3] * drop
            for shadow in (0.0, drop):
                sx, sy = x + (x - lamp[0]) * shadow, y + (y - lamp[1]) * shadow
                low_x, high_x = min(low_x, sx - soft), max(high_x, sx + soft)
                low_y, high_y = min(low_y, sy - soft), max(high_y, sy + soft)
        first, last = max(0, int((low_y - origin[1]) / cell)), min(rows - 1, int((high_y - origin[1]) / cell))
        start, stop = (
            max(0, int((low_x - origin[0]) / cell)),
            min(columns - 1, int((high_x - origin[0]) / cell)),
        )
        for i in range(first, last + 1):
            for j in range(start, stop + 1):
                past, above = _through(origin[0] + j * cell, origin[1] + i * cell, floor_z, rods[n], lamp)
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


@compiled
def _smooth(grid: Small, row: float, column: float) -> float:
    """A grid between its places; outside it the border goes on."""
    rows, columns = grid.shape
    row, column = min(max(row, 0.0), rows - 1.001), min(max(column, 0.0), columns - 1.001)
    i, j = int(row), int(column)
    a, b = row - i, column - j
    above = (1.0 - b) * grid[i, j] + b * grid[i, j + 1]
    return (1.0 - a) * above + a * ((1.0 - b) * grid[i + 1, j] + b * grid[i + 1, j + 1])


@compiled
def _field(x: float, y: float, field: Floats) -> tuple[float, float]:
    """How the lamp's light (first) and all light (second) change over the table.

    ``field`` (9,): brightness per metre in x and y about a place (2,); then a straight shadow's edge: normal
    (2,), offset, half width of its soft rim, and the share of the lamp it takes.
    """
    everywhere = max(0.05, 1.0 + field[0] * (x - field[2]) + field[1] * (y - field[3]))
    beyond = x * field[4] + y * field[5] - field[6]
    behind = min(max(0.5 + 0.5 * beyond / max(field[7], 1e-6), 0.0), 1.0)
    return 1.0 - field[8] * behind, everywhere


@compiled
def shade(
    slopes: Small,
    rotation: Floats,
    eye: Floats,
    depth: Small,
    owner: Owners,
    floor_z: float,
    rods: Floats,
    frames: Floats,
    tones: Floats,
    grain: Small,
    which: Ints,
    lit: Floats,
    room: Floats,
    block_tones: Floats,
    blocks: Floats,
    table: Small,
    table_tone: Floats,
    pattern: Floats,
    cells: Floats,
    table_lit: Small,
    table_room: Small,
    lamp: Floats,
    glare: Floats,
    field: Floats,
    visible: Ints,
    visible_end: Ints,
    linear: Small,
) -> None:
    """Linear light (H, W, 3) of every pixel from the buffers of `raster`.

    Parameters
    ----------
    tones : (N, 4) float
        Colour times brightness, and gloss.
    grain, which : (G, L, A) float32, (N,) int
        Factors about 1 along and around a rod, and the one of each rod.
    table, table_tone, pattern : (T, T) float32, (3,), (5,) float
        The table's factors about 1, repeated; its colour; cosine and sine of its turn, its shift, and its step, m.
    cells : (3,) float
        Origin and size of the cells of ``table_lit``, ``table_room``.
    lamp : (6,) float
        Position, radius, strength, the room's strength.
    glare : (2,) float
        Strength and sharpness of the lamp's reflection in the table.
    visible, visible_end : (N,), (N, 2) int
        As ``whole`` of `raster`, of what is really seen; changed in place.
    """
    height, width = linear.shape[0], linear.shape[1]
    size = table.shape[0]
    share = 1.0 / (FINE * FINE)
    colour = np.zeros(3)
    for row in range(height):
        for column in range(width):
            colour[:] = 0.0
            bare = 0
            for k in range(FINE * FINE):
                i, j = FINE * row + k // FINE, FINE * column + k % FINE
                n = owner[i, j]
                if n < 0:
                    bare += 1
                    continue
                x, y, t = slopes[i, j, 0], slopes[i, j, 1], depth[i, j]
                px = eye[0] + t * (rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2])
                py = eye[1] + t * (rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2])
                pz = eye[2] + t * (rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2])
                lx, ly, lz = lamp[0] - px, lamp[1] - py, lamp[2] - pz
                far = np.sqrt(lx * lx + ly * ly + lz * lz)
                lx, ly, lz = lx / far, ly / far, lz / far
                lamp_field, all_field = _field(px, py, field)
                if n >= BLOCK_OWNER:
                    b = n - BLOCK_OWNER
                    if pz > floor_z + blocks[b, 6] - 1e-6:
                        nx, ny, nz = 0.0, 0.0, 1.0
                    else:
                        c, s = blocks[b, 4], blocks[b, 5]
                        dx, dy = px - blocks[b, 0], py - blocks[b, 1]
                        u, v = dx * c + dy * s, dy * c - dx * s
                        if abs(u) / blocks[b, 2] > abs(v) / blocks[b, 3]:
                            u, v = (1.0 if u > 0.0 else -1.0), 0.0
                        else:
                            u, v = 0.0, (1.0 if v > 0.0 else -1.0)
                        nx, ny, nz = u * c - v * s, u * s + v * c, 0.0
                    bright = 1.0
                    if nz > 0.5:
                        for other in range(len(rods)):
                            past, _above = _through(px, py, pz, rods[other], lamp)
                            bright *= past
                    bright *= lamp[4] * max(lx * nx + ly * ny + lz * nz, 0.0) * lamp_field
                    total = (bright + lamp[5] * (0.5 + 0.5 * nz)) * all_field * share
                    for channel in range(3):
                        colour[channel] += block_tones[b, channel] * total
                    continue
                dx, dy, dz = px - rods[n, 0], py - rods[n, 1], pz - rods[n, 2]
                s = dx * rods[n, 3] + dy * rods[n, 4] + dz * rods[n, 5]
                dx, dy, dz = dx - s * rods[n, 3], dy - s * rods[n, 4], dz - s * rods[n, 5]
                off = np.sqrt(dx * dx + dy * dy + dz * dz)
                side = dx * frames[n, 0, 0] + dy * frames[n, 0, 1] + dz * frames[n, 0, 2]
                up = dx * frames[n, 1, 0] + dy * frames[n, 1, 1] + dz * frames[n, 1, 2]
                visible[n] += 1
                if abs(s) > rods[n, 6] - rods[n, 7]:
                    visible_end[n, 1 if s > 0.0 else 0] += 1
                if abs(s) > rods[n, 6] - 2e-6 and off < rods[n, 7] - 4e-6:
                    sign = 1.0 if s > 0.0 else -1.0
                    nx, ny, nz = sign * rods[n, 3], sign * rods[n, 4], sign * rods[n, 5]
                    tone = 0.75
                else:
                    nx, ny, nz = dx / off, dy / off, dz / off
                    tone = -1.0
                turn = np.arctan2(side, up) / (2.0 * np.pi)
                turn -= np.floor(turn)
                place = min(max(0.5 * (s / rods[n, 6] + 1.0), 0.0), 1.0)
                if tone < 0.0:
                    g = grain[which[n]]
                    tone = g[
                        min(int(place * g.shape[0]), g.shape[0] - 1), int(turn * g.shape[1]) % g.shape[1]
                    ]
                m, q = place * (MARKS - 1), turn * AROUND
                m0 = min(int(m), MARKS - 2)
                q0 = int(q) % AROUND
                q1, fm, fq = (q0 + 1) % AROUND, m - m0, q - int(q)
                lamp_share = (1.0 - fm) * ((1.0 - fq) * lit[n, m0, q0] + fq * lit[n, m0, q1]) + fm * (
                    (1.0 - fq) * lit[n, m0 + 1, q0] + fq * lit[n, m0 + 1, q1]
                )
                room_share = (1.0 - fm) * ((1.0 - fq) * room[n, m0, q0] + fq * room[n, m0, q1]) + fm * (
                    (1.0 - fq) * room[n, m0 + 1, q0] + fq * room[n, m0 + 1, q1]
                )
                bright = lamp[4] * max(lx * nx + ly * ny + lz * nz, 0.0) * lamp_share * lamp_field
                total = (bright + lamp[5] * (0.62 + 0.38 * nz) * room_share) * tone * all_field * share
                shine = 0.0
                if tones[n, 3] > 0.0:
                    vx, vy, vz = eye[0] - px, eye[1] - py, eye[2] - pz
                    away = np.sqrt(vx * vx + vy * vy + vz * vz)
                    hx, hy, hz = lx + vx / away, ly + vy / away, lz + vz / away
                    fit = (hx * nx + hy * ny + hz * nz) / np.sqrt(hx * hx + hy * hy + hz * hz)
                    shine = tones[n, 3] * max(fit, 0.0) ** 40.0 * lamp[4] * lamp_share * lamp_field * share
                for channel in range(3):
                    colour[channel] += tones[n, channel] * total + shine
            if bare:
                i, j = FINE * row + FINE // 2, FINE * column + FINE // 2
                x, y = slopes[i, j, 0], slopes[i, j, 1]
                rx = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2]
                ry = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2]
                rz = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2]
                t = (floor_z - eye[2]) / rz
                px, py = eye[0] + t * rx, eye[1] + t * ry
                lx, ly, lz = lamp[0] - px, lamp[1] - py, lamp[2] - floor_z
                far = np.sqrt(lx * lx + ly * ly + lz * lz)
                lamp_field, all_field = _field(px, py, field)
                u = (px * pattern[0] + py * pattern[1] + pattern[2]) / pattern[4]
                v = (py * pattern[0] - px * pattern[1] + pattern[3]) / pattern[4]
                i, j = int(np.floor(v)), int(np.floor(u))
                fv, fu = v - i, u - j
                i0, j0, i1, j1 = i % size, j % size, (i + 1) % size, (j + 1) % size
                tone = (1.0 - fv) * ((1.0 - fu) * table[i0, j0] + fu * table[i0, j1]) + fv * (
                    (1.0 - fu) * table[i1, j0] + fu * table[i1, j1]
                )
                r, c = (py - cells[1]) / cells[2], (px - cells[0]) / cells[2]
                bright = lamp[4] * lz / far * _smooth(table_lit, r, c) * lamp_field
                total = (bright + lamp[5] * _smooth(table_room, r, c)) * all_field
                shine = 0.0
                if glare[0] > 0.0:
                    vx, vy, vz = eye[0] - px, eye[1] - py, eye[2] - floor_z
                    away = np.sqrt(vx * vx + vy * vy + vz * vz)
                    hx, hy, hz = lx / far + vx / away, ly / far + vy / away, lz / far + vz / away
                    fit = hz / np.sqrt(hx * hx + hy * hy + hz * hz)
                    shine = glare[0] * fit ** glare[1] * _smooth(table_lit, r, c) * tone
                for channel in range(3):
                    colour[channel] += bare * share * (table_tone[channel] * tone * total + shine)
            for channel in range(3):
                linear[row, column, channel] = colour[channel]
