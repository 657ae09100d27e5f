"""Where rays meet rods and blocks: the nearest thing along every ray of a picture. Compiled; metres."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vision.jit import compiled
from vision.types import Floats, Ints

FINE = 3
"""Rays per pixel, along each side."""
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
    # on the end's plane, what |p - centre|^2 has beyond end^2 is the square of the distance to the axis
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
                t = slab(ox, oy, oz, dx, dy, rz, blocks[b])
                if 0.0 < t < depth[row, column]:
                    depth[row, column] = t
                    owner[row, column] = BLOCK_OWNER + b


@compiled
def slab(ox: float, oy: float, oz: float, dx: float, dy: float, dz: float, block: Floats) -> float:
    """Where a ray enters a block, in the block's own turned frame, foot at z = 0; -1 if it does not."""
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
