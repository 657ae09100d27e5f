"""What two parallel jaws touch and grip, as geometry in the tool frame.

Tool frame: z out of the hand, x the direction the jaws close in, y along the part; origin at the tool point.
Metres.
"""

from __future__ import annotations

import numpy as np

from drivers.sim.geometry import Floats, apply, inverse
from drivers.sim.layout import GripperLayout, TrayLayout
from drivers.sim.piles import Stick

POINTS_PER_STICK = 101


def in_tool(base_from_tool: Floats, stick: Stick) -> tuple[Floats, Floats]:
    """Centre and axis (3,) of a stick in the tool frame, the axis pointing to +y."""
    back = inverse(base_from_tool)
    centre, axis = apply(back, stick.centre), back[:3, :3] @ stick.axis
    return centre, -axis if axis[1] < 0.0 else axis


def grip_offset(stick: Stick, base_from_tool: Floats, layout: GripperLayout) -> float | None:
    """Where along a stick's axis the closing jaws would hold it, m from its centre; None if they would not.

    The axis must cross the plane y = 0 of the tool inside the stick, between the jaws with room for its
    diameter, within the jaws' height, and within the largest angle in plan.
    """
    centre, axis = in_tool(base_from_tool, stick)
    if abs(axis[1]) < 1e-6 or abs(np.arctan2(axis[0], axis[1])) > layout.max_angle_rad:
        return None
    offset = -float(centre[1] / axis[1])
    x, _, z = centre + offset * axis
    held = (
        abs(offset) <= 0.5 * stick.length_m
        and abs(x) <= 0.5 * (layout.opening_m - stick.diameter_m)
        and -layout.jaw_depth_m <= z <= layout.tip_beyond_tool_m
    )
    return offset if held else None


def held_pose(stick: Stick, base_from_tool: Floats, offset: float) -> tuple[Floats, Floats]:
    """Centre and axis (3,) in the tool frame once the jaws have closed: centred in x and turned along y."""
    centre, axis = in_tool(base_from_tool, stick)
    point = centre + offset * axis
    straight = np.array([0.0, axis[1], axis[2]])
    straight /= np.linalg.norm(straight)
    return np.array([0.0, 0.0, point[2]]) - offset * straight, straight


def jaw_boxes(layout: GripperLayout, opening_m: float) -> Floats:
    """(2, 2, 3) lower and upper corner of the two jaws at an opening, tool frame, metres."""
    inner, half = 0.5 * opening_m, 0.5 * layout.jaw_width_m
    outer = inner + layout.jaw_thickness_m
    top, tip = layout.tip_beyond_tool_m - layout.jaw_length_m, layout.tip_beyond_tool_m
    return np.array([[[inner, -half, top], [outer, half, tip]], [[-outer, -half, top], [-inner, half, tip]]])


def struck(sticks: tuple[Stick, ...], base_from_tool: Floats, layout: GripperLayout) -> frozenset[int]:
    """Numbers of the sticks that the open jaws run into by more than a brush."""
    if not sticks:
        return frozenset()
    along = np.linspace(-0.5, 0.5, POINTS_PER_STICK)
    centres = np.array([s.centre for s in sticks])
    axes = np.array([s.axis * s.length_m for s in sticks])
    points = centres[:, None, :] + along[None, :, None] * axes[:, None, :]
    local = apply(inverse(base_from_tool), points)
    boxes = jaw_boxes(layout, layout.opening_m)
    outside = np.maximum(
        np.maximum(boxes[:, None, None, 0] - local[None], local[None] - boxes[:, None, None, 1]), 0.0
    )
    nearest = np.linalg.norm(outside, axis=-1).min(axis=(0, 2))
    radii = np.array([0.5 * s.diameter_m for s in sticks])
    hit = nearest < np.maximum(radii - layout.touch_m, 0.0)
    return frozenset(s.number for s, is_hit in zip(sticks, hit, strict=True) if is_hit)


def crash(base_from_tool: Floats, layout: GripperLayout, tray: TrayLayout) -> str | None:
    """What hard thing the open jaws have been driven into, or None: ``floor`` or ``wall``."""
    boxes = jaw_boxes(layout, layout.opening_m)
    corners = np.array([[box[i, 0], box[j, 1], box[1, 2]] for box in boxes for i in (0, 1) for j in (0, 1)])
    tips = apply(base_from_tool, corners)
    offset = np.abs(tips[:, :2] - np.array(tray.centre_m[:2]))
    half = 0.5 * np.array(tray.inner_m)
    inside = np.all(offset <= half, axis=1)
    over_wall = np.all(offset <= half + tray.wall_thickness_m, axis=1) & ~inside
    floor_z = tray.centre_m[2]
    if bool(np.any(tips[over_wall, 2] < floor_z + tray.wall_height_m)):
        return "wall"
    if bool(np.any(tips[inside, 2] < floor_z - layout.spring_m)):
        return "floor"
    return None
