"""A heap photographed by a rig: both pictures, and how much of every rod each of them shows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
import numpy.typing as npt

from bench.heap import Block, Rod, blocks_array
from bench.meet import FINE, Owners, Small, raster, raster_blocks
from bench.picture import shade
from bench.rigs import MIDDLE_M, TABLE_Z_M, Rig, rays
from bench.shine import AROUND, MARKS, rod_light, table_light
from drivers.sim.optics import Eye
from drivers.sim.surfaces import GRAIN_SHAPE, mottled, wood_grain
from vision.types import Bools, Floats, Ints

GRAINS = 24
TABLES = 3
TABLE_STEP_M = 0.0005
CELL_M = 0.0005
REACH_M = 0.17
"""Half the side of the square about the middle in which shadows on the table are worked out."""
GAMMA = 2.2
VIGNETTING = 0.12
END_SEEN = 0.15
"""An end is seen when this share of its last radius is; agrees best with path-traced sets (98 %)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Look:
    """Light, table and exposure of one scene.

    ``lamp_m`` (3,) base frame; ``lamp`` and ``room`` their strengths on a white sheet; ``table`` kind of
    surface and its ``table_tone`` (3,) linear BGR; ``pattern`` (5,), ``glare`` (2,) and ``field`` (9,) as in
    `bench.picture.shade`; ``exposure`` factor of all light; ``noise`` factor of the rig's noise.
    """

    lamp_m: Floats
    lamp_radius_m: float
    lamp: float
    room: float
    table: str
    table_number: int
    table_tone: Floats
    pattern: Floats
    glare: Floats
    field: Floats
    exposure: float = 1.0
    noise: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """What one eye shows.

    ``pixels`` (H, W, 3) BGR or (H, W) grey; ``owner`` (H, W) the rod at each pixel's middle, -1 the table,
    from `bench.meet.BLOCK_OWNER` up a block. ``visible`` (N,) seen share of each rod's outline inside the
    picture; ``ends_px`` (N, 2, 2); ``ends_visible`` (N, 2) whether `END_SEEN` of an end's last radius is.
    """

    pixels: npt.NDArray[np.uint8]
    owner: Owners
    visible: Floats
    ends_px: Floats
    ends_visible: Bools
    in_frame: Bools


@cache
def _grains() -> Small:
    grains: Small = np.stack([wood_grain(5000 + n) for n in range(GRAINS)])
    assert grains.shape[1:] == GRAIN_SHAPE
    return grains


@cache
def table_pattern(kind: str, number: int) -> Small:
    """Factors (T, T) about 1 of a table: dark ``wood`` with its grain along x, or a rubber ``mat``."""
    rng = np.random.default_rng([number, 19 if kind == "wood" else 23])
    size = 640
    if kind == "wood":
        streaks = mottled((size, 1), 0.75, rng).repeat(size, axis=1)
        wide = cv2.resize(mottled((size, 16), 0.9, rng), (size, size), interpolation=cv2.INTER_CUBIC)
        fine = cv2.resize(mottled((size, 80), 0.35, rng), (size, size), interpolation=cv2.INTER_LINEAR)
        pattern = 1.0 + 0.13 * streaks + 0.17 * wide + 0.10 * fine + 0.05 * mottled((size, size), 0.3, rng)
    else:
        pattern = 1.0 + 0.10 * mottled((size, size), 0.9, rng) + 0.12 * mottled((size, size), 0.2, rng)
        grit = rng.random((size, size)) > 0.9996
        pattern = np.where(grit, pattern + rng.uniform(0.8, 2.2, (size, size)), pattern)
        scratches = np.zeros((size, size), np.float32)
        for _ in range(7):
            a, angle, reach = rng.uniform(0, size, 2), rng.uniform(0, 2 * np.pi), rng.uniform(60, 240)
            b = a + reach * np.array([np.cos(angle), np.sin(angle)])
            (x0, y0), (x1, y1) = np.round(16 * a).astype(int).tolist(), np.round(16 * b).astype(int).tolist()
            cv2.line(scratches, (x0, y0), (x1, y1), 1.0, 1, cv2.LINE_AA, 4)
        pattern = pattern + 0.4 * scratches
    closed: Small = np.clip(pattern, 0.25, 4.0).astype(np.float32)
    closed.setflags(write=False)
    return closed


def _array(rods: tuple[Rod, ...]) -> Floats:
    """(N, 8): centre, axis, half length, radius."""
    rows = [[*r.centre.tolist(), *r.axis.tolist(), 0.5 * r.length_m, r.radius_m] for r in rods]
    return np.array(rows, np.float64).reshape(-1, 8)


def _frames(rods: Floats) -> Floats:
    """(N, 2, 3) a sideways and an upward direction of each rod."""
    frames = np.empty((len(rods), 2, 3))
    for n, rod in enumerate(rods):
        side = np.cross(rod[3:6], [0.0, 0.0, 1.0])
        frames[n, 0] = side / np.linalg.norm(side)
        frames[n, 1] = np.cross(frames[n, 0], rod[3:6])
    return frames


def _spans(eye: Eye, rods: Floats) -> Floats:
    """(N, 5) for `bench.meet.raster`: ends in rays, and half the width of the strip that holds the rod."""
    spans = np.empty((len(rods), 5))
    for n, rod in enumerate(rods):
        places = rod[:3] + np.array([[-1.0], [0.0], [1.0]]) * rod[6] * rod[3:6]
        seen = FINE * eye.project(places) + 0.5 * (FINE - 1)
        sag = float(np.linalg.norm(seen[1] - 0.5 * (seen[0] + seen[2])))
        depth = (eye.camera_from_base[2, :3] @ places.T + eye.camera_from_base[2, 3]).min()
        spans[n, :2], spans[n, 2:4] = seen[0], seen[2]
        spans[n, 4] = 1.15 * FINE * eye.focal_px * rod[7] / depth + sag + 3.0
    return spans


def photograph(
    rods: tuple[Rod, ...], blocks: tuple[Block, ...], rig: Rig, look: Look, rng: np.random.Generator
) -> tuple[View, View]:
    """Both eyes' views of what lies on the table."""
    array, obstacles = _array(rods), blocks_array(blocks)
    frames = _frames(array)
    count, side = len(rods), round(2 * REACH_M / CELL_M) + 1
    lamp = np.array([*look.lamp_m.tolist(), look.lamp_radius_m, look.lamp, look.room])
    lit, room = np.ones((count, MARKS, AROUND)), np.ones((count, MARKS, AROUND))
    table_lit, table_room = np.ones((side, side), np.float32), np.ones((side, side), np.float32)
    cells = np.array([MIDDLE_M[0] - REACH_M, MIDDLE_M[1] - REACH_M, CELL_M])
    rod_light(array, frames, obstacles, TABLE_Z_M, lamp, lit, room)
    table_light(array, obstacles, TABLE_Z_M, lamp, cells, CELL_M, table_lit, table_room)
    tones = np.array([[*(r.colour * r.shade).tolist(), r.gloss] for r in rods]).reshape(-1, 4)
    block_tones = np.array([b.colour for b in blocks]).reshape(-1, 3)
    which: Ints = rng.integers(0, GRAINS, count)
    views = []
    for eye, slopes in rays(rig):
        rotation = np.ascontiguousarray(eye.base_from_camera[:3, :3])
        place = np.ascontiguousarray(eye.base_from_camera[:3, 3])
        depth = np.full(slopes.shape[:2], np.inf, np.float32)
        owner = np.full(slopes.shape[:2], -1, np.int16)
        whole, whole_end = np.zeros(count, np.int64), np.zeros((count, 2), np.int64)
        visible, visible_end = np.zeros(count, np.int64), np.zeros((count, 2), np.int64)
        seen = array.copy()
        seen[:, :3] = (array[:, :3] - place) @ rotation
        seen[:, 3:6] = array[:, 3:6] @ rotation
        raster(slopes, seen, _spans(eye, array), depth, owner, whole, whole_end)
        if blocks:
            raster_blocks(slopes, rotation, place, obstacles, TABLE_Z_M, depth, owner)
        linear = np.empty((eye.height_px, eye.width_px, 3), np.float32)
        shade(
            slopes,
            rotation,
            place,
            depth,
            owner,
            TABLE_Z_M,
            array,
            frames,
            tones,
            _grains(),
            which,
            lit,
            room,
            block_tones,
            obstacles,
            table_pattern(look.table, look.table_number),
            look.table_tone,
            look.pattern,
            cells,
            table_lit,
            table_room,
            lamp,
            look.glare,
            look.field,
            visible,
            visible_end,
            linear,
        )
        ends_px = eye.project(np.array([r.ends for r in rods]).reshape(-1, 3)).reshape(-1, 2, 2)
        inside = np.all((ends_px > 1.0) & (ends_px < [eye.width_px - 2.0, eye.height_px - 2.0]), axis=2)
        views.append(
            View(
                pixels=_developed(linear, rig, look, rng),
                owner=owner[FINE // 2 :: FINE, FINE // 2 :: FINE].copy(),
                visible=visible / np.maximum(whole, 1),
                ends_px=ends_px,
                ends_visible=inside & (visible_end >= END_SEEN * np.maximum(whole_end, 1)),
                in_frame=np.asarray(inside.all(axis=1)),
            )
        )
    return views[0], views[1]


@cache
def _vignette(height: int, width: int) -> Small:
    v, u = np.mgrid[:height, :width]
    off = (u - 0.5 * (width - 1)) ** 2 + (v - 0.5 * (height - 1)) ** 2
    return np.asarray(1.0 - VIGNETTING * off / off.max(), np.float32)


def _developed(linear: Small, rig: Rig, look: Look, rng: np.random.Generator) -> npt.NDArray[np.uint8]:
    """What the camera makes of the light: lens, exposure, tone curve, noise."""
    if rig.mono:
        linear = linear @ np.array([0.114, 0.587, 0.299], np.float32)
    bright = _vignette(*linear.shape[:2]) * np.float32(look.exposure)
    linear = linear * (bright if rig.mono else bright[:, :, None])
    linear = cv2.GaussianBlur(linear, (0, 0), rig.cameras.blur_px).astype(np.float32)
    tone = (255.0 * np.linspace(0.0, 1.0, 4096) ** (1.0 / GAMMA)).astype(np.float32)
    grey = tone[np.clip(linear * 4095.0, 0.0, 4095.0).astype(np.int16)]
    # three independent channels come to two thirds of their noise in the grey picture
    sigma = rig.cameras.noise * look.noise * (1.0 if rig.mono else 1.5)
    grey += np.float32(sigma) * rng.standard_normal(grey.shape, dtype=np.float32)
    pixels: npt.NDArray[np.uint8] = np.clip(grey + 0.5, 0.0, 255.0).astype(np.uint8)
    pixels.setflags(write=False)
    return pixels
