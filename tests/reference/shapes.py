"""Parts with a topology and pictures of them: rods are drawn as sticks, flat parts ray by ray.

What is inside a flat part is decided here by code of its own, point by point of a finer grid.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from tests.reference.sticks import DEPTH_M, Stick, rig
from vision.types import CameraModel, NodeKind, Outline, PartModel, Topology, Transform

Floats = npt.NDArray[np.float64]
Grey = npt.NDArray[np.uint8]

END, JUNCTION, CORNER, LOOP = NodeKind.END, NodeKind.JUNCTION, NodeKind.CORNER, NodeKind.LOOP_CENTRE
DIAMETER_M = 0.004
THICK_M = 0.003
FINER = 4


def rods(
    name: str, points_mm: list[tuple[float, float]], kinds: tuple[NodeKind, ...], edges: list[tuple[int, int]]
) -> PartModel:
    """A part of round rods; its axis is the line of its first two nodes."""
    points = np.column_stack([np.array(points_mm) * 1e-3, np.zeros(len(points_mm))])
    return PartModel(
        code=3,
        name=name,
        length_m=float(np.linalg.norm(points[1] - points[0])),
        length_tolerance_m=0.008,
        diameter_m=DIAMETER_M,
        topology=Topology(points=points, kinds=kinds, edges=np.array(edges), axis=(0, 1)),
    )


TEE = rods(
    "T", [(-30, -10), (30, -10), (0, 34), (0, -10)], (END, END, END, JUNCTION), [(0, 3), (1, 3), (2, 3)]
)
WYE = rods("Y", [(0, -48), (0, -3), (20, 29), (-20, 29)], (END, JUNCTION, END, END), [(0, 1), (2, 1), (3, 1)])
ELL = rods("L", [(50, -10), (-20, -10), (-20, 30)], (END, CORNER, END), [(0, 1), (1, 2)])
KEY = rods("key", [(64, -5), (-14, -5), (-14, 20)], (END, CORNER, END), [(0, 1), (1, 2)])


def flat(name: str, points_mm: list[tuple[float, float]], kinds: tuple[NodeKind, ...],
         edges: list[tuple[int, int]], axis: tuple[int, int], outline: Outline) -> PartModel:  # fmt: skip
    """A flat part of an outline."""
    points = np.column_stack([np.array(points_mm) * 1e-3, np.zeros(len(points_mm))])
    return PartModel(
        code=4,
        name=name,
        length_m=float(np.linalg.norm(points[axis[1]] - points[axis[0]])),
        length_tolerance_m=0.008,
        diameter_m=THICK_M,
        topology=Topology(points=points, kinds=kinds, edges=np.array(edges), axis=axis),
        outline=outline,
    )


def figure(
    bars_mm: list[list[float]],
    width_mm: float,
    discs_mm: list[list[float]],
    holes_mm: list[list[float]],
    slots_mm: list[list[float]],
) -> Outline:
    """An outline in mm: bars x, y, x, y; discs and holes x, y, radius; slots x, y, direction, width."""
    slots = np.array(slots_mm, np.float64).reshape(-1, 5) * np.array([1e-3, 1e-3, 1.0, 1.0, 1e-3])
    return Outline(
        bars=np.array(bars_mm, np.float64).reshape(-1, 2, 2) * 1e-3,
        bar_width_m=np.full(len(bars_mm), width_mm * 1e-3),
        discs=np.array(discs_mm, np.float64).reshape(-1, 3) * 1e-3,
        holes=np.array(holes_mm, np.float64).reshape(-1, 3) * 1e-3,
        slots=slots,
    )


BRACKET = flat(
    "bracket", [(40, 0), (-20, 0), (-20, 44), (38, 0)], (END, CORNER, END, LOOP), [(0, 1), (1, 2)], (0, 1),
    figure([[48, 0, -28, 0], [-20, -8, -20, 52]], 16, [], [[38, 0, 3.2]], []),
)  # fmt: skip
PLATE_TEE = flat(
    "tee", [(-37, 0), (37, 0), (0, 50), (0, 0)], (END, END, END, JUNCTION), [(0, 3), (1, 3), (2, 3)], (0, 1),
    figure([[-45, 0, 0, 0], [45, 0, 0, 0], [0, 58, 0, 0]], 16, [], [], []),
)  # fmt: skip
SPANNER = flat(
    "spanner", [(-52, 9), (-52, -9), (-36, 0), (34, 0), (43, 0)], (END, END, JUNCTION, JUNCTION, LOOP),
    [(0, 2), (1, 2), (2, 3)], (2, 4),
    figure([[-42, 0, 43, 0]], 12, [[43, 0, 12.5], [-42, 0, 14]], [[43, 0, 7]], [[-42, 0, -1, 0, 13]]),
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Laid:
    """A part on the table: ``rotation`` (3, 3) and ``origin_m`` (3,) to the left camera frame."""

    part: PartModel
    rotation: Floats
    origin_m: Floats

    @property
    def nodes(self) -> Floats:
        """(N, 3) m, left camera frame."""
        assert self.part.topology is not None
        return np.asarray(self.part.topology.points @ self.rotation.T + self.origin_m)


def laid(
    part: PartModel,
    x_m: float,
    y_m: float,
    yaw_deg: float,
    *,
    over: bool = False,
    height_m: float | None = None,
    tilt_deg: float = 0.0,
) -> Laid:
    """A part by its origin, its direction in the picture, the face it lies on, and a tilt about its y."""
    yaw, tilt = np.radians(yaw_deg), np.radians(tilt_deg)
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    lean = np.array([[np.cos(tilt), 0.0, np.sin(tilt)], [0.0, 1.0, 0.0], [-np.sin(tilt), 0.0, np.cos(tilt)]])
    face = np.diag([1.0, -1.0, -1.0]) if over else np.eye(3)
    height = 0.5 * part.diameter_m if height_m is None else height_m
    return Laid(part=part, rotation=turn @ lean @ face, origin_m=np.array([x_m, y_m, DEPTH_M - height]))


def sticks_of(one: Laid) -> list[Stick]:
    """The rods of a part as sticks to draw."""
    assert one.part.topology is not None
    ends = one.nodes[one.part.topology.edges]
    return [Stick(start=a, end=b, radius_m=0.5 * one.part.diameter_m) for a, b in ends]


def flat_pair(parts: list[Laid], *, seed: int = 0) -> tuple[Grey, Grey]:
    """Both pictures of flat parts lying apart, with blur and noise."""
    model = rig()
    still = Transform(rotation=np.eye(3), translation=np.zeros(3))
    random = np.random.default_rng(seed)
    views = []
    for camera, motion in ((model.left, still), (model.right, model.right_from_left)):
        picture = np.full((camera.height_px, camera.width_px), 40.0)
        for one in parts:
            picture += 160.0 * _share(one, camera, motion)
        soft = cv2.GaussianBlur(picture, (0, 0), 0.7)
        noisy = np.asarray(soft, np.float64) + random.normal(0.0, 2.0, soft.shape)
        views.append(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
    return views[0], views[1]


def _share(one: Laid, camera: CameraModel, motion: Transform) -> Floats:
    """(H, W) how much of each pixel shows the upper face."""
    rows, columns = camera.height_px * FINER, camera.width_px * FINER
    v, u = np.mgrid[0:rows, 0:columns] / FINER - 0.5 + 0.5 / FINER
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(camera.matrix).T @ motion.rotation
    eye = -motion.rotation.T @ motion.translation
    up = one.rotation[:, 2] * -np.sign(one.rotation[2, 2])
    top = one.origin_m + 0.5 * one.part.diameter_m * up
    depth = ((top - eye) @ up) / (rays @ up)
    flat_xy = ((eye + depth[..., None] * rays - top) @ one.rotation)[..., :2]
    assert one.part.outline is not None
    covered = _holds(one.part.outline, flat_xy[..., 0], flat_xy[..., 1])
    parts = covered.reshape(camera.height_px, FINER, camera.width_px, FINER)
    return np.asarray(parts.mean(axis=(1, 3)), np.float64)


def _holds(outline: Outline, x: Floats, y: Floats) -> Floats:
    """Whether points belong to the figure, as 0 or 1."""
    held = np.zeros(x.shape, np.bool_)
    for (a, b), width in zip(outline.bars, outline.bar_width_m, strict=True):
        way = (b - a) / np.linalg.norm(b - a)
        along = (x - a[0]) * way[0] + (y - a[1]) * way[1]
        aside = np.abs((y - a[1]) * way[0] - (x - a[0]) * way[1])
        held |= (along >= 0) & (along <= np.linalg.norm(b - a)) & (aside <= 0.5 * width)
    for cx, cy, radius in outline.discs:
        held |= (x - cx) ** 2 + (y - cy) ** 2 <= radius**2
    for cx, cy, radius in outline.holes:
        held &= (x - cx) ** 2 + (y - cy) ** 2 > radius**2
    for cx, cy, dx, dy, width in outline.slots:
        along = (x - cx) * dx + (y - cy) * dy
        aside = np.abs((y - cy) * dx - (x - cx) * dy)
        held &= np.where(along > 0, aside > 0.5 * width, np.hypot(along, aside) > 0.5 * width)
    return held.astype(np.float64)
