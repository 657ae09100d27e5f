"""What the standing things look like: the tray, its floor, the table, the drop box; and the wood's grain.

Worked out once per eye and place of it. Colours are linear light, BGR, 0..1. Base frame, metres.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from drivers.sim.geometry import Bools, Floats
from drivers.sim.layout import LightLayout, WorldLayout
from drivers.sim.light import CELL_M

Picture = npt.NDArray[np.float32]
"""(H, W, 3) float32 linear light, BGR."""

FLOOR = np.array([0.036, 0.032, 0.029])
WALL = np.array([0.46, 0.47, 0.48])
TABLE = np.array([0.17, 0.19, 0.20])
BOX = np.array([0.30, 0.20, 0.10])
WOOD = np.array([0.47, 0.68, 0.84])
TABLE_BELOW_M = 0.004
EDGE_STEP = 0.01
"""Neighbouring pixels that differ by more than this lie on an edge."""
GRAIN_SHAPE = (256, 48)
"""Places along and around a stick for which the grain is kept."""
MAT_SIZE, MAT_STEP_M = 512, 0.0006
"""Cells of the floor's pattern along each side, which is laid again and again, and their size."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Backdrop:
    """The cell without sticks and arm as one eye sees it.

    ``still`` (H, W, 3) what never changes, in linear light; black where the floor shows. ``floor_pixels``
    (F,) flat indices of pixels that show the floor, ``albedo`` (F, 3) their colour times the share of the
    pixel that is floor, ``row``, ``column`` (F,) their place in the light map, in cells.
    """

    still: Picture
    floor_pixels: npt.NDArray[np.int64]
    albedo: npt.NDArray[np.float32]
    row: npt.NDArray[np.float32]
    column: npt.NDArray[np.float32]


def mottled(shape: tuple[int, int], roughness: float, rng: np.random.Generator) -> Floats:
    """Noise (H, W), mean 0, deviation 1; its amplitude falls with frequency to the power ``roughness``."""
    spectrum = np.fft.rfft2(rng.standard_normal(shape))
    fy, fx = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None, :]
    spectrum *= np.maximum(np.hypot(fy, fx), 2.0 / max(shape)) ** -roughness
    spectrum[0, 0] = 0.0
    noise = np.fft.irfft2(spectrum, s=shape)
    return np.asarray(noise / noise.std())


def wood_grain(seed: int) -> npt.NDArray[np.float32]:
    """`GRAIN_SHAPE` factors about 1: streaks along the stick, a few darker patches."""
    rng = np.random.default_rng([seed, 77])
    streaks = mottled((64, GRAIN_SHAPE[1]), 0.6, rng)[:1].repeat(GRAIN_SHAPE[0], axis=0)
    fine = mottled(GRAIN_SHAPE, 0.7, rng)
    patches = mottled((GRAIN_SHAPE[0], 8), 1.3, rng)[:, :1]
    return np.asarray(np.clip(1.0 + 0.025 * streaks + 0.035 * fine + 0.035 * patches, 0.7, 1.25), np.float32)


def lambert(normal: Floats, points: Floats, light: LightLayout) -> Floats:
    """Cosine (K,) of the lamp's direction to the normal, (3,) or (K, 3), at points (K, 3); never below 0."""
    to_lamp = np.array(light.position_m) - points
    far = np.sqrt(np.einsum("...c,...c->...", to_lamp, to_lamp))
    return np.asarray(np.maximum(np.einsum("...c,...c->...", to_lamp, normal) / far, 0.0))


def _plane(eye: Floats, rays: Floats, axis: int, value: float) -> tuple[Floats, Floats]:
    """Depth (K,) and points (K, 3) where rays (K, 3) from ``eye`` meet the plane coordinate[axis] = value."""
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (value - eye[axis]) / rays[:, axis]
        depth = np.where(depth > 0.0, depth, np.inf)
        points = eye + np.where(np.isfinite(depth), depth, 0.0)[:, None] * rays
    return depth, points


def _within(points: Floats, centre: Floats, half: Floats) -> Bools:
    x, y = np.abs(points[:, 0] - centre[0]), np.abs(points[:, 1] - centre[1])
    return np.asarray((x <= half[0]) & (y <= half[1]))


def _shade(eye: Floats, rays: Floats, world: WorldLayout) -> tuple[Floats, Bools, Floats]:
    """Colour (K, 3), whether a ray ends on the floor (K,), and where (K, 3)."""
    tray, box, light = world.tray, world.drop_box, world.light
    middle, inner = np.array(tray.centre_m[:2]), 0.5 * np.array(tray.inner_m)
    outer = inner + tray.wall_thickness_m
    floor_z, rim_z = tray.centre_m[2], tray.centre_m[2] + tray.wall_height_m
    up = np.array([0.0, 0.0, 1.0])

    depth, points = _plane(eye, rays, 2, floor_z - TABLE_BELOW_M)
    on_box = _within(points, np.array(box.centre_m[:2]), 0.5 * np.array(box.size_m))
    colour = np.where(on_box[:, None], BOX, TABLE)
    lit = light.ambient + light.strength * lambert(up, points, light)
    # the tray's own soft shadow on the table
    beside = np.hypot(*np.maximum(np.abs(points[:, :2] - middle) - outer, 0.0).T)
    lit *= 1.0 - 0.5 * np.exp(-beside / 0.012)
    colour = colour * lit[:, None]
    floor = np.zeros(len(rays), dtype=np.bool_)

    floor_depth, floor_points = _plane(eye, rays, 2, floor_z)
    is_floor = _within(floor_points, middle, inner)
    depth, floor = np.where(is_floor, floor_depth, depth), is_floor
    for axis in (0, 1):
        for side in (-1.0, 1.0):
            wall_depth, wall_points = _plane(eye, rays, axis, middle[axis] + side * inner[axis])
            other = 1 - axis
            hit = (np.abs(wall_points[:, other] - middle[other]) <= inner[other]) & (
                (wall_points[:, 2] >= floor_z) & (wall_points[:, 2] <= rim_z)
            )
            hit &= (side * rays[:, axis] > 0.0) & (wall_depth <= depth)  # inner faces only
            normal = np.zeros(3)
            normal[axis] = -side
            wall_points = wall_points[hit]
            low = np.clip((wall_points[:, 2] - floor_z) / tray.wall_height_m, 0.0, 1.0)
            lit = light.ambient * (0.45 + 0.35 * low) + light.strength * lambert(normal, wall_points, light)
            colour[hit] = WALL * lit[:, None]
            depth, floor = np.where(hit, wall_depth, depth), floor & ~hit
    rim_depth, rim_points = _plane(eye, rays, 2, rim_z)
    rim = _within(rim_points, middle, outer) & ~_within(rim_points, middle, inner)
    lit = light.ambient + light.strength * lambert(up, rim_points[rim], light)
    colour[rim] = WALL * lit[:, None]
    for axis in (0, 1):  # outer faces, for an eye that stands beside the tray
        for side in (-1.0, 1.0):
            face_depth, face_points = _plane(eye, rays, axis, middle[axis] + side * outer[axis])
            other = 1 - axis
            hit = (np.abs(face_points[:, other] - middle[other]) <= outer[other]) & (
                (face_points[:, 2] >= floor_z - TABLE_BELOW_M) & (face_points[:, 2] <= rim_z)
            )
            hit &= (side * rays[:, axis] < 0.0) & (face_depth < np.where(rim, rim_depth, depth))
            normal = np.zeros(3)
            normal[axis] = side
            lit = 0.6 * light.ambient + light.strength * lambert(normal, face_points[hit], light)
            colour[hit] = WALL * lit[:, None]
            rim = rim | hit
    return colour, floor & ~rim, floor_points


def backdrop(slopes: Floats, base_from_camera: Floats, world: WorldLayout, seed: int) -> Backdrop:
    """The standing scene for rays of slopes (S, H, W, 2), S spread over each pixel, the middle one first.

    Only where neighbours differ are all S rays followed.
    """
    samples, height, width, _ = slopes.shape
    eye, rotation = base_from_camera[:3, 3], base_from_camera[:3, :3]
    flat = slopes.reshape(samples, -1, 2)

    def look(which: Floats) -> tuple[Floats, Floats]:
        rays = np.column_stack([which, np.ones(len(which))]) @ rotation.T
        colour, is_floor, _ = _shade(eye, rays, world)
        return np.where(is_floor[:, None], 0.0, colour), is_floor.astype(np.float64)

    still, share = look(flat[0])
    grid = still.reshape(height, width, 3)
    edge = np.zeros((height, width), dtype=np.bool_)
    across = np.abs(np.diff(grid, axis=1)).max(axis=2) > EDGE_STEP
    down = np.abs(np.diff(grid, axis=0)).max(axis=2) > EDGE_STEP
    edge[:, 1:] |= across
    edge[:, :-1] |= across
    edge[1:] |= down
    edge[:-1] |= down
    at = np.flatnonzero(edge)
    fine = [look(sample[at]) for sample in flat]
    still[at] = np.mean([colour for colour, _ in fine], axis=0)
    share[at] = np.mean([is_floor for _, is_floor in fine], axis=0)
    pixels = np.flatnonzero(share > 0.0)
    rays = np.column_stack([flat[0][pixels], np.ones(len(pixels))]) @ rotation.T
    _, points = _plane(eye, rays, 2, world.tray.centre_m[2])
    corner = np.array(world.tray.centre_m[:2]) - 0.5 * np.array(world.tray.inner_m)
    place = (points[:, :2] - corner) / CELL_M
    albedo = FLOOR * (share[pixels] * _floor_texture(points[:, :2], seed))[:, None]
    albedo *= lambert(np.array([0.0, 0.0, 1.0]), points, world.light).mean()
    return Backdrop(
        still=still.reshape(height, width, 3).astype(np.float32),
        floor_pixels=pixels,
        albedo=albedo.astype(np.float32),
        row=place[:, 1].astype(np.float32),
        column=place[:, 0].astype(np.float32),
    )


def _floor_texture(points: Floats, seed: int) -> Floats:
    """Factors (K,) about 1 at x, y (K, 2)."""
    pattern = _mat(seed)
    index = np.floor(points / MAT_STEP_M).astype(np.int64) % MAT_SIZE
    nearby = np.floor(points / MAT_STEP_M + 0.5).astype(np.int64) % MAT_SIZE
    value = 0.5 * (pattern[index[:, 1], index[:, 0]] + pattern[nearby[:, 1], nearby[:, 0]])
    return np.asarray(np.clip(value, 0.2, 4.0))


# the same for every eye and from everywhere
@lru_cache(maxsize=2)
def _mat(seed: int) -> Floats:
    """A rubber mat with mottle, grit and a few scratches."""
    rng = np.random.default_rng([seed, 5])
    size = (MAT_SIZE, MAT_SIZE)
    pattern = 1.0 + 0.16 * mottled(size, 1.0, rng) + 0.14 * mottled(size, 0.15, rng)
    grit = rng.random(size) > 0.9994
    pattern = np.where(grit, pattern + rng.uniform(0.8, 2.0, size), pattern)
    yy, xx = np.mgrid[: size[0], : size[1]]
    for _ in range(6):
        angle, reach = rng.uniform(0.0, np.pi), rng.uniform(30.0, 110.0)
        x0, y0 = rng.uniform(0.0, size[1]), rng.uniform(0.0, size[0])
        along = (xx - x0) * np.cos(angle) + (yy - y0) * np.sin(angle)
        across = -(xx - x0) * np.sin(angle) + (yy - y0) * np.cos(angle) + 0.0008 * along**2
        scratch = (np.abs(along) < reach) * np.exp(-((across / 0.8) ** 2))
        pattern += 0.45 * scratch
    return np.asarray(pattern)
