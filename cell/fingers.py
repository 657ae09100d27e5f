"""What room the two fingers have on their way to a grasp: boxes in the tool's frame against points of parts.

``hand`` is ``base_from_tool``'s (3, 3) rotation: x the direction the jaws close in, z out of the hand.
"""

from __future__ import annotations

import math

import numpy as np

from cell.config import JawsConfig, WorkspaceConfig
from vision.types import Floats


def _fingers(jaws: JawsConfig) -> tuple[float, float]:
    """Distance of a finger's centre plane from the tool axis, and half its thickness."""
    return jaws.opening_m / 2 + jaws.thickness_m / 2, jaws.thickness_m / 2


def beyond_box(tips: Floats, hand: Floats, workspace: WorkspaceConfig, jaws: JawsConfig) -> float:
    """How far (m) the farthest finger corner lies outside the workspace box, at the tips and, of a hand that
    leans, where the fingers leave the box by its top; <= 0 inside. A hand that leans also keeps its lower
    finger above the floor."""
    reach = jaws.opening_m / 2 + jaws.thickness_m
    low, high = np.array(workspace.box_min_m), np.array(workspace.box_max_m)
    up = -hand[:, 2]
    leans = up[2] < 1.0
    beyond = []
    for x in (-reach, reach):
        for y in (-jaws.width_m / 2, jaws.width_m / 2):
            corner = tips + hand[:, 0] * x + hand[:, 1] * y
            beyond.append(max(np.max(low - corner), np.max(corner - high)))
            if leans:
                top = corner + up * max(0.0, (high[2] - corner[2]) / up[2])
                beyond.append(max(np.max((low - top)[:2]), np.max((top - high)[:2])))
                beyond.append(workspace.floor_z_m + workspace.floor_clearance_m - corner[2])
    return float(max(beyond))


def seen_from(tips: Floats, hand: Floats, points: Floats) -> Floats:
    """(P, 3) points seen from the finger tips: x along the closing direction, y along the part, z out of the
    parts."""
    return np.asarray(((points - tips) @ hand) * np.array([1.0, 1.0, -1.0]))


def gap(near: Floats, jaws: JawsConfig) -> float:
    """Distance (m) from the obstacle points to the space between the open fingers; <= 0 inside."""
    if not len(near):
        return math.inf
    half = np.array([jaws.opening_m / 2, jaws.width_m / 2, jaws.depth_m / 2])
    return float(_box_distance(near, np.array([0.0, 0.0, jaws.depth_m / 2]), half).min())


def clearance(
    near: Floats, tips: Floats, hand: Floats, workspace: WorkspaceConfig, jaws: JawsConfig
) -> float:
    """Distance (m) from the obstacle points to the nearer of fingers and palm on their whole way in."""
    if not len(near):
        return math.inf
    middle, half = _fingers(jaws)
    # fingers and hand sweep the column behind them, from the grasp up to where the descent begins
    rise = max(workspace.approach_height_m, workspace.travel_z_m - float(tips[2])) / -float(hand[2, 2])
    top = jaws.depth_m + rise
    boxes = [
        (np.array([side * middle, 0.0, top / 2]), np.array([half, jaws.width_m / 2, top / 2]))
        for side in (-1.0, 1.0)
    ]
    palm = (top + jaws.depth_m) / 2
    boxes.append(
        (np.array([0.0, 0.0, palm]), np.array([middle + half, jaws.width_m / 2, palm - jaws.depth_m]))
    )
    return min(float(_box_distance(near, centre, extent).min()) for centre, extent in boxes)


def _box_distance(points: Floats, centre: Floats, extent: Floats) -> Floats:
    """(P,) distance of points from a box, negative inside."""
    q = np.abs(points - centre) - extent
    outside = np.linalg.norm(np.maximum(q, 0.0), axis=1)
    inside = np.minimum(q.max(axis=1), 0.0)
    return np.asarray(outside + inside, dtype=np.float64)
