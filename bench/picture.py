"""What every pixel of a heap's picture is made of: rods, blocks and table under their light. Compiled.

Nine rays per pixel, from `bench.meet`; light from `bench.shine`. Base frame, metres; colours are linear
light, BGR.
"""

from __future__ import annotations

import numpy as np

from bench.meet import BLOCK_OWNER, FINE, Owners, Small
from bench.shine import AROUND, MARKS, through
from vision.jit import compiled
from vision.types import Floats, Ints


@compiled
def _smooth(grid: Small, row: float, column: float) -> float:
    """A grid between its places; outside it the border goes on."""
    rows, columns = grid.shape
    row, column = min(max(row, 0.0), rows - 1.001), min(max(column, 0.0), columns - 1.001)
    i, j = int(row), int(column)
    a, b = row - i, column - j
    above = (1.0 - b) * grid[i, j] + b * grid[i, j + 1]
    below = (1.0 - b) * grid[i + 1, j] + b * grid[i + 1, j + 1]
    return float((1.0 - a) * above + a * below)


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
    """Linear light (H, W, 3) of every pixel from the buffers of `bench.meet.raster`.

    Parameters
    ----------
    tones : (N, 4) float
        Colour times brightness, and gloss.
    grain, which : (G, L, A) float32, (N,) int
        Factors about 1 along and around a rod, and the one of each rod.
    table, table_tone, pattern : (T, T) float32, (3,), (5,) float
        The table's factors about 1, repeated; its colour; cosine and sine of its turn, shift and step, m.
    cells : (3,) float
        Origin and size of the cells of ``table_lit``, ``table_room``.
    lamp : (6,) float
        Position, radius, strength, the room's strength.
    glare : (2,) float
        Strength and sharpness of the lamp's reflection in the table.
    visible, visible_end : (N,), (N, 2) int
        As ``whole`` of `bench.meet.raster`, of what is really seen; changed in place.
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
                            past, _above = through(px, py, pz, rods[other], lamp)
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
