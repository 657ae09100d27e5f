"""The arm and its hand as seen by an eye: capsules for the links, boxes for hand and jaws.

A picture taken too early shows a big bright thing over the parts, as a real one would. Camera frame, metres;
colours linear light, BGR.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from drivers.sim.arm import link_frames
from drivers.sim.geometry import Floats, apply
from drivers.sim.jaws import jaw_boxes
from drivers.sim.layout import WorldLayout
from drivers.sim.world import Snapshot

GREY = np.array([0.50, 0.50, 0.49])
BLUE = np.array([0.55, 0.33, 0.16])
STEEL = np.array([0.22, 0.22, 0.21])
HAND = np.array([0.05, 0.05, 0.055])
UPPER_ARM_ASIDE_M = 0.136
FOREARM_ASIDE_M = 0.02


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solid:
    """A capsule from ``start`` to ``end`` (3,) m, base frame."""

    start: Floats
    end: Floats
    radius_m: float
    colour: Floats


class Sight:
    """The rays of an eye, slopes (H, W, 2), with the bounds of each row and column."""

    def __init__(self, slopes: Floats) -> None:
        self.height, self.width, _ = slopes.shape
        self.flat = slopes.reshape(-1, 2)
        self.low, self.high = slopes.min(axis=(0, 1)), slopes.max(axis=(0, 1))
        self.row_low, self.row_high = slopes[:, :, 1].min(axis=1), slopes[:, :, 1].max(axis=1)
        self.column_low, self.column_high = slopes[:, :, 0].min(axis=0), slopes[:, :, 0].max(axis=0)

    def near(self, start: Floats, end: Floats, radius_m: float) -> npt.NDArray[np.int64]:
        """Flat indices of the rays that may meet anything within ``radius_m`` of a line in space.

        The line is covered by balls; balls outside the field of view are left out, and one that nearly
        touches the eye counts as everywhere.
        """
        count = max(2, int(np.ceil(float(np.linalg.norm(end - start)) / radius_m)) + 1)
        balls = start + np.linspace(0.0, 1.0, count)[:, None] * (end - start)
        size = 1.2 * radius_m
        inside = balls[:, 2] > -size
        for axis in (0, 1):
            low, high = self.low[axis], self.high[axis]
            inside &= balls[:, axis] - low * balls[:, 2] > -size * np.hypot(1.0, low)
            inside &= high * balls[:, 2] - balls[:, axis] > -size * np.hypot(1.0, high)
        balls = balls[inside]
        if not len(balls):
            return np.empty(0, dtype=np.int64)
        closest = float(balls[:, 2].min()) - size
        if closest < 0.02:
            return np.arange(self.height * self.width)
        seen = balls[:, :2] / balls[:, 2:3]
        grow = size / closest * (1.0 + float(np.abs(seen).max()))
        (left, top), (right, bottom) = seen.min(axis=0) - grow, seen.max(axis=0) + grow
        rows = np.flatnonzero((self.row_high >= top) & (self.row_low <= bottom))
        columns = np.flatnonzero((self.column_high >= left) & (self.column_low <= right))
        return np.asarray((rows[:, None] * self.width + columns[None, :]).ravel())


def links(q_rad: Floats) -> tuple[Solid, ...]:
    """The arm's body for six joint angles."""
    frames = link_frames(q_rad)
    origin = frames[:, :3, 3]
    aside = frames[1, :3, 2]
    shoulder, elbow = origin[1] + UPPER_ARM_ASIDE_M * aside, origin[2] + UPPER_ARM_ASIDE_M * aside
    fore, wrist = origin[2] + FOREARM_ASIDE_M * aside, origin[3] + FOREARM_ASIDE_M * aside
    body = (
        (origin[0], origin[1], 0.070, GREY),
        (origin[1], shoulder, 0.062, BLUE),
        (shoulder, elbow, 0.055, GREY),
        (elbow, fore, 0.056, BLUE),
        (fore, wrist, 0.045, GREY),
        (wrist, origin[4], 0.042, BLUE),
        (origin[4], origin[5], 0.040, GREY),
        (origin[5], origin[6], 0.036, BLUE),
    )
    return tuple(Solid(start=a, end=b, radius_m=r, colour=c) for a, b, r, c in body)


def boxes(snapshot: Snapshot, world: WorldLayout) -> tuple[tuple[Floats, Floats], ...]:
    """Hand and jaws as (corners (2, 3) m in the tool frame, colour)."""
    gripper = world.gripper
    top = gripper.tip_beyond_tool_m - gripper.jaw_length_m
    flange_z = -float(np.linalg.norm(world.arm.tcp_m_rad[:3]))
    wide = 0.5 * gripper.opening_m + gripper.jaw_thickness_m + 0.012
    hand = np.array([[-wide, -0.025, flange_z], [wide, 0.025, top]])
    right, left = jaw_boxes(gripper, snapshot.jaw_gap_m)
    return ((hand, HAND), (right, STEEL), (left, STEEL))


def draw(
    sight: Sight,
    base_from_camera: Floats,
    snapshot: Snapshot,
    world: WorldLayout,
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Depth (H, W), m along the camera's z, infinite where there is no arm, and colour (H, W, 3)."""
    height, width = sight.height, sight.width
    depth = np.full(height * width, np.inf)
    colour = np.zeros((height * width, 3))
    rotation, eye = base_from_camera[:3, :3], base_from_camera[:3, 3]
    lamp = (np.array(world.light.position_m) - eye) @ rotation
    for solid in links(snapshot.q):
        _capsule(
            sight,
            (solid.start - eye) @ rotation,
            (solid.end - eye) @ rotation,
            solid,
            lamp,
            depth,
            colour,
            world,
        )
    camera_from_tool = np.linalg.inv(base_from_camera) @ snapshot.base_from_tool
    for corners, tint in boxes(snapshot, world):
        _box(sight, camera_from_tool, corners, tint, lamp, depth, colour, world)
    return depth.reshape(height, width).astype(np.float32), colour.reshape(height, width, 3).astype(
        np.float32
    )


def _paint(
    at: npt.NDArray[np.int64],
    found: Floats,
    points: Floats,
    normals: Floats,
    tint: Floats,
    lamp: Floats,
    depth: Floats,
    colour: Floats,
    world: WorldLayout,
) -> None:
    """Write what is nearer than what is there, lit by the lamp, into ``depth`` and ``colour``."""
    near = found < depth[at]
    at, points, normals = at[near], points[near], normals[near]
    depth[at] = found[near]
    to_lamp = lamp - points
    to_lamp /= np.linalg.norm(to_lamp, axis=1, keepdims=True)
    lit = world.light.ambient + world.light.strength * np.maximum(np.sum(to_lamp * normals, axis=1), 0.0)
    colour[at] = tint * lit[:, None]


def _capsule(
    sight: Sight,
    start: Floats,
    end: Floats,
    solid: Solid,
    lamp: Floats,
    depth: Floats,
    colour: Floats,
    world: WorldLayout,
) -> None:
    at = sight.near(start, end, solid.radius_m)
    if not at.size:
        return
    rays = np.column_stack([sight.flat[at], np.ones(at.size)])
    best = np.full(at.size, np.inf)
    axis = end - start
    length = float(np.linalg.norm(axis))
    axis = axis / length
    for centre, is_side in ((start, True), (start, False), (end, False)):
        if is_side:
            m = -start
            direct, offset = rays - (rays @ axis)[:, None] * axis, m - (m @ axis) * axis
        else:
            direct, offset = rays, -centre
        a = np.sum(direct * direct, axis=1)
        b = direct @ offset
        c = float(offset @ offset) - solid.radius_m**2
        discriminant = b * b - a * c
        hit = (-b - np.sqrt(np.maximum(discriminant, 0.0))) / np.maximum(a, 1e-12)
        valid = (discriminant >= 0.0) & (hit > 0.005)
        if is_side:
            along = (hit[:, None] * rays - start) @ axis
            valid &= (along >= 0.0) & (along <= length)
        best = np.where(valid & (hit < best), hit, best)
    met = np.isfinite(best)
    points = best[met, None] * rays[met]
    along = np.clip((points - start) @ axis, 0.0, length)
    normals = (points - start - along[:, None] * axis) / solid.radius_m
    _paint(at[met], best[met], points, normals, solid.colour, lamp, depth, colour, world)


def _box(
    sight: Sight,
    camera_from_tool: Floats,
    corners: Floats,
    tint: Floats,
    lamp: Floats,
    depth: Floats,
    colour: Floats,
    world: WorldLayout,
) -> None:
    middle = apply(camera_from_tool, corners.mean(axis=0))
    around = 0.5 * float(np.linalg.norm(corners[1] - corners[0]))
    at = sight.near(middle, middle, around)
    if not at.size:
        return
    rotation = camera_from_tool[:3, :3]
    rays = np.column_stack([sight.flat[at], np.ones(at.size)])
    local = rays @ rotation
    local = np.where(np.abs(local) < 1e-12, 1e-12, local)
    origin = -rotation.T @ camera_from_tool[:3, 3]
    first, second = (corners[0] - origin) / local, (corners[1] - origin) / local
    entering, leaving = np.minimum(first, second), np.maximum(first, second)
    enter, leave = entering.max(axis=1), leaving.min(axis=1)
    met = (enter <= leave) & (enter > 0.005)
    face = entering[met].argmax(axis=1)
    normals = np.zeros((int(met.sum()), 3))
    normals[np.arange(len(face)), face] = -np.sign(local[met][np.arange(len(face)), face])
    points = enter[met, None] * rays[met]
    _paint(at[met], enter[met], points, normals @ rotation.T, tint, lamp, depth, colour, world)
