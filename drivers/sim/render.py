"""The simulated cell as a picture: what one eye sees of a world at one instant.

Sticks are exact cylinders with flat ends, hit by nine rays per pixel; the light is that of
`drivers.sim.light`; then comes what a camera does to light: blur, vignetting, tone curve, noise that is new
for every picture.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from drivers.sim import armlook
from drivers.sim.boardlook import BoardLook
from drivers.sim.geometry import Floats
from drivers.sim.layout import WorldLayout
from drivers.sim.light import MARKS, LightMap, light_map
from drivers.sim.optics import Eye
from drivers.sim.piles import Stick
from drivers.sim.surfaces import GRAIN_SHAPE, WOOD, Backdrop, Picture, backdrop, wood_grain
from drivers.sim.world import Snapshot
from drivers.types import Pixels

FINE = 3
"""Rays per pixel, along each side."""
VIGNETTING = 0.14
"""How much darker the corners are than the middle."""
GAMMA = 2.2
STICK_MARGIN_PX = 1.5
SAME_PLACE = 2e-5
"""Metres and radians: an eye on the arm that moved by less shows the standing scene within 0.02 px."""
NEAREST_M = 0.03
"""Sticks nearer to an eye's plane or behind it are not drawn; the hand keeps eyes on the arm farther off."""


class Lighting:
    """The light map of the newest pile, shared by both eyes. One thread at a time."""

    def __init__(self, world: WorldLayout) -> None:
        self._world = world
        self._version = -1
        self._map: LightMap | None = None

    def of(self, snapshot: Snapshot) -> LightMap:
        """Light on the floor and on the lying sticks of a snapshot."""
        if self._map is None or self._version != snapshot.pile_version:
            self._map = light_map(snapshot.lying, self._world.tray, self._world.light)
            self._version = snapshot.pile_version
        return self._map


class Renderer:
    """Pictures of one eye. Everything that never changes is worked out when it is made; of an eye on the arm
    the standing scene is worked out anew where the arm stands elsewhere."""

    def __init__(self, eye: Eye, world: WorldLayout, seed: int) -> None:
        self.eye = eye
        self._on_arm = world.cameras.mount == "tool"
        self._world = world
        self._rng = np.random.default_rng()
        self._seed = seed
        height, width = eye.height_px, eye.width_px
        u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
        self._slopes = eye.slopes(np.stack([u, v], axis=-1))
        self._sight = armlook.Sight(self._slopes)
        self._per_u = np.gradient(self._slopes, axis=1)
        self._per_v = np.gradient(self._slopes, axis=0)
        spread = (np.arange(FINE) - 0.5 * (FINE - 1)) / FINE
        dv, du = (part.ravel() for part in np.meshgrid(spread, spread, indexing="ij"))
        self._du, self._dv = du, dv
        self._behind_from = eye.base_from_camera
        self._backdrop = None if self._on_arm else self._behind()
        off = (u - 0.5 * (width - 1)) ** 2 + (v - 0.5 * (height - 1)) ** 2
        self._vignette = (1.0 - VIGNETTING * off / off.max()).astype(np.float32)[:, :, None]
        self._tone = (255.0 * np.linspace(0.0, 1.0, 4096) ** (1.0 / GAMMA)).astype(np.float32)
        self._grain: dict[int, npt.NDArray[np.float32]] = {}
        self._board = BoardLook(world, self._slopes, self._per_u, self._per_v)

    def picture(self, snapshot: Snapshot, light: LightMap) -> Pixels:
        """(H, W, 3) uint8 BGR, read-only; never twice the same, because of the noise."""
        linear = self._floor(light, self._stand(snapshot))
        arm_depth, arm_colour = armlook.draw(self._sight, self.eye.base_from_camera, snapshot, self._world)
        nearest = self._sticks(linear, snapshot, light)
        if snapshot.base_from_board is not None:
            self._board.paint(linear, nearest, self.eye.camera_from_base @ snapshot.base_from_board, self.eye)
        visible = np.isfinite(arm_depth) & (arm_depth < nearest)
        linear[visible] = arm_colour[visible]
        return self._develop(linear)

    # ------------------------------------------------------------------ what is there

    def _stand(self, snapshot: Snapshot) -> Backdrop:
        """The standing scene, from where the eye is at this instant."""
        if self._on_arm:
            self.eye = self.eye.carried(snapshot.base_from_flange)
        now = self.eye.base_from_camera
        if self._backdrop is None or np.abs(now - self._behind_from).max() > SAME_PLACE:
            self._behind_from = now
            self._backdrop = self._behind()
        return self._backdrop

    def _behind(self) -> Backdrop:
        order = np.argsort(self._du * self._du + self._dv * self._dv, kind="stable")
        slopes = [self._slopes + self._du[i] * self._per_u + self._dv[i] * self._per_v for i in order]
        return backdrop(np.stack(slopes), self.eye.base_from_camera, self._world, self._seed)

    def _floor(self, light: LightMap, drop: Backdrop) -> Picture:
        lamp = self._world.light
        shine = (lamp.ambient * light.floor_room + lamp.strength * light.floor_lamp).astype(np.float32)
        row = np.clip(drop.row, 0.0, shine.shape[0] - 1.001)
        column = np.clip(drop.column, 0.0, shine.shape[1] - 1.001)
        i, j = row.astype(np.int64), column.astype(np.int64)
        a, b = row - i, column - j
        value = (1 - a) * ((1 - b) * shine[i, j] + b * shine[i, j + 1]) + a * (
            (1 - b) * shine[i + 1, j] + b * shine[i + 1, j + 1]
        )
        picture = drop.still.copy()
        picture.reshape(-1, 3)[drop.floor_pixels] += drop.albedo * value[:, None]
        return picture

    def _sticks(self, linear: Picture, snapshot: Snapshot, light: LightMap) -> Picture:
        """Paint all sticks into ``linear``; returns their depth (H, W), m, infinite where there is none."""
        per_pixel = FINE * FINE
        depth = np.full(linear.shape[0] * linear.shape[1] * per_pixel, np.inf, dtype=np.float32)
        paint = np.empty((depth.size, 3), dtype=np.float32)
        full = np.ones(MARKS)
        drawn = [(s, light.stick_lamp[i], light.stick_room[i]) for i, s in enumerate(snapshot.lying)]
        if snapshot.held is not None:
            drawn.append((snapshot.held, full, full))
        for stick, lamp_share, room_share in drawn:
            samples, found, colour = self._stick(stick, lamp_share, room_share)
            near = found < depth[samples]
            samples = samples[near]
            depth[samples] = found[near]
            paint[samples] = colour[near]
        nearest = np.full(linear.shape[:2], np.inf, dtype=np.float32)
        samples = np.flatnonzero(depth < np.inf)
        if not samples.size:
            return nearest
        pixels = samples // per_pixel
        first = np.flatnonzero(np.diff(pixels, prepend=-1))
        covered = pixels[first]
        share = np.diff(np.append(first, len(pixels))).astype(np.float32) / per_pixel
        mixed = np.add.reduceat(paint[samples], first, axis=0) / per_pixel
        nearest.reshape(-1)[covered] = np.minimum.reduceat(depth[samples], first)
        flat = linear.reshape(-1, 3)
        flat[covered] = (1.0 - share[:, None]) * flat[covered] + mixed
        return nearest

    def _stick(
        self, stick: Stick, lamp_share: Floats, room_share: Floats
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """Fine samples (K,) that a stick covers, their depth (K,) and colour (K, 3)."""
        eye, radius = self.eye, 0.5 * stick.diameter_m
        rotation = eye.camera_from_base[:3, :3]
        centre = rotation @ stick.centre + eye.camera_from_base[:3, 3]
        axis = rotation @ stick.axis
        half = 0.5 * stick.length_m
        pixels = self._candidates(centre, axis, half, radius)
        slopes = (
            self._slopes.reshape(-1, 2)[pixels][:, None, :]
            + self._du[:, None] * self._per_u.reshape(-1, 2)[pixels][:, None, :]
            + self._dv[:, None] * self._per_v.reshape(-1, 2)[pixels][:, None, :]
        ).reshape(-1, 2)
        samples = (pixels[:, None] * (FINE * FINE) + np.arange(FINE * FINE)).ravel()
        x, y = slopes[:, 0], slopes[:, 1]
        # ray t * (x, y, 1) against the cylinder about centre + s * axis
        ray_axis = x * axis[0] + y * axis[1] + axis[2]
        ray_centre = x * centre[0] + y * centre[1] + centre[2]
        middle = float(centre @ axis)
        a = x * x + y * y + 1.0 - ray_axis**2
        b = ray_centre - middle * ray_axis
        c = float(centre @ centre) - middle**2 - radius**2
        discriminant = b * b - a * c
        t = (b - np.sqrt(np.maximum(discriminant, 0.0))) / a
        s = t * ray_axis - middle
        side = (discriminant >= 0.0) & (np.abs(s) <= half)
        # of the two flat ends only the one turned to the eye can be met
        end = np.where(ray_axis > 0.0, -half, half)
        with np.errstate(divide="ignore", invalid="ignore"):
            t_end = (middle + end) / ray_axis
            off = t_end * t_end * (x * x + y * y + 1.0) - 2.0 * t_end * ray_centre + float(centre @ centre)
            capped = ~side & (t_end > 0.0) & (off - end * end <= radius**2)
        hit = side | capped
        t, s = np.where(capped, t_end, t)[hit], np.where(capped, end, s)[hit]
        points = t[:, None] * np.column_stack([x[hit], y[hit], np.ones(len(t))])
        normals = (points - centre - s[:, None] * axis) / radius
        facing = np.sign(end[hit])[:, None] * axis
        on_cap = capped[hit]
        normals = np.where(on_cap[:, None], facing, normals)
        colour = self._wood(stick, s, points, normals, on_cap, lamp_share, room_share)
        return samples[hit], t.astype(np.float32), colour.astype(np.float32)

    def _candidates(self, centre: Floats, axis: Floats, half: float, radius: float) -> npt.NDArray[np.int64]:
        """Flat indices of the pixels whose rays pass near a stick."""
        ends = np.stack([centre - half * axis, centre + half * axis])
        if float(ends[:, 2].min()) < NEAREST_M:
            return np.empty(0, dtype=np.int64)
        grow = radius + STICK_MARGIN_PX * float(ends[:, 2].max()) / self.eye.focal_px
        seen = ends[:, :2] / ends[:, 2:3]
        pad = 1.5 * grow / float(ends[:, 2].min())
        base = self.eye.base_from_camera
        corners = np.array(
            [
                [seen[i, 0] + sx * pad, seen[j, 1] + sy * pad]
                for i in (0, 1)
                for j in (0, 1)
                for sx in (-1, 1)
                for sy in (-1, 1)
            ]
        )
        placed = np.column_stack([corners, np.ones(len(corners))]) @ base[:3, :3].T + base[:3, 3]
        around = self.eye.project(placed)
        low = np.floor(around.min(axis=0)).astype(int) - 1
        high = np.ceil(around.max(axis=0)).astype(int) + 2
        u0, u1 = max(0, low[0]), min(self.eye.width_px, high[0])
        v0, v1 = max(0, low[1]), min(self.eye.height_px, high[1])
        if u0 >= u1 or v0 >= v1:
            return np.empty(0, dtype=np.int64)
        # distance of a ray to the axis line: |ray . (axis x centre)| / |ray x axis|
        normal = np.cross(axis, centre)
        patch = self._slopes[v0:v1, u0:u1]
        away = np.abs(patch[..., 0] * normal[0] + patch[..., 1] * normal[1] + normal[2])
        size = patch[..., 0] * axis[0] + patch[..., 1] * axis[1] + axis[2]
        square = (patch * patch).sum(axis=-1) + 1.0 - size**2
        row, column = np.nonzero(away * away <= grow * grow * square)
        return np.asarray((row + v0) * self.eye.width_px + column + u0)

    def _wood(
        self,
        stick: Stick,
        along: Floats,
        points: Floats,
        normals: Floats,
        on_cap: npt.NDArray[np.bool_],
        lamp_share: Floats,
        room_share: Floats,
    ) -> Floats:
        light, rotation = self._world.light, self.eye.camera_from_base[:3, :3]
        lamp = rotation @ np.array(light.position_m) + self.eye.camera_from_base[:3, 3]
        to_lamp = lamp - points
        to_lamp /= np.sqrt(np.einsum("kc,kc->k", to_lamp, to_lamp))[:, None]
        cosine = np.maximum(np.einsum("kc,kc->k", to_lamp, normals), 0.0)
        up = rotation[:, 2]
        sky = 0.62 + 0.38 * (normals @ up)
        place = np.clip((along / stick.length_m + 0.5) * (MARKS - 1), 0, MARKS - 1)
        marks = np.arange(MARKS)
        lit = light.ambient * sky * np.interp(place, marks, room_share)
        lit += light.strength * cosine * np.interp(place, marks, lamp_share)
        aside = np.cross(stick.axis, np.array([0.0, 0.0, 1.0]))
        aside = rotation @ (aside / np.linalg.norm(aside))
        turn = np.arctan2(normals @ aside, normals @ up) / (2.0 * np.pi) + 0.5
        if stick.number not in self._grain:
            self._grain[stick.number] = wood_grain(stick.number + 1000 * self._seed)
        grain = self._grain[stick.number]
        i = np.clip((place / MARKS * GRAIN_SHAPE[0]).astype(np.int64), 0, GRAIN_SHAPE[0] - 1)
        j = np.clip((turn * GRAIN_SHAPE[1]).astype(np.int64), 0, GRAIN_SHAPE[1] - 1)
        tone = stick.shade * np.where(on_cap, 0.75, grain[i, j])
        return np.asarray(WOOD * (tone * lit)[:, None])

    # ------------------------------------------------------------------ what a camera makes of it

    def _develop(self, linear: Picture) -> Pixels:
        layout = self._world.cameras
        linear *= self._vignette
        if layout.blur_px > 0.0:
            linear = _blurred(linear, layout.blur_px)
        index = np.minimum(linear * 4095.0, 4095.0).astype(np.int16)
        grey = self._tone[index]
        noise = self._rng.standard_normal(grey.shape, dtype=np.float32)
        grey += noise * np.float32(layout.noise)
        pixels: Pixels = np.clip(grey + 0.5, 0.0, 255.0).astype(np.uint8)
        pixels.setflags(write=False)
        return pixels


def _blurred(picture: Picture, sigma_px: float) -> Picture:
    """A Gaussian of five taps along both axes; borders are repeated."""
    weights = np.exp(-0.5 * (np.arange(3) / sigma_px) ** 2)
    weights = (weights / (weights[0] + 2.0 * weights[1:].sum())).astype(np.float32)
    for axis in (0, 1):
        pad = [(0, 0), (0, 0), (0, 0)]
        pad[axis] = (2, 2)
        wide = np.pad(picture, pad, mode="edge")
        n = picture.shape[axis]

        def part(i: int, wide: Picture = wide, n: int = n, axis: int = axis) -> Picture:
            return wide[i : i + n] if axis == 0 else wide[:, i : i + n]

        picture = weights[0] * part(2) + weights[1] * (part(1) + part(3)) + weights[2] * (part(0) + part(4))
    return picture
