"""Poses about a point: a dome of tilts in all directions, turns about the axis and small shifts."""

from __future__ import annotations

from typing import Final

import numpy as np

from vision import transforms
from vision.types import Transform

GOLDEN_RAD: Final = 2.399963
"""Successive directions turned by this never bunch, however many are taken."""
TURN_RAD: Final = 0.6
"""Turns about the tool's own axis go this far to both sides."""


def dome(
    base_from_tool: Transform,
    count: int,
    tilt_rad: float,
    shift_m: float,
    pivot_m: tuple[float, float, float],
) -> tuple[Transform, ...]:
    """``count`` tool poses about where the tool is now.

    Parameters
    ----------
    tilt_rad, shift_m
        Largest tilt against the pose now, and largest shift of the pivot along the tool's x and y (half of it
        along z).
    pivot_m
        What is turned about, tool frame: the middle of a held board, or the point before a carried camera.
    """
    poses = [base_from_tool]
    pivot = transforms.make(np.eye(3), np.array(pivot_m))
    back = transforms.invert(pivot)
    for k in range(1, count):
        direction = GOLDEN_RAD * k
        tilt = tilt_rad * (0.55 + 0.45 * ((k * 0.618034) % 1.0))
        axis = np.array([np.cos(direction), np.sin(direction), 0.0])
        turn = TURN_RAD * (2.0 * ((k * 0.754878) % 1.0) - 1.0)
        rotation = transforms.matrix_from_vector(tilt * axis) @ transforms.matrix_from_vector(
            np.array([0.0, 0.0, turn])
        )
        aside = shift_m * np.sqrt((k * 0.569840) % 1.0)
        along = 2.0 * direction + 1.0
        shift = np.array(
            [aside * np.cos(along), aside * np.sin(along), shift_m * (((k * 0.419) % 1.0) - 0.5)]
        )
        poses.append(transforms.compose(base_from_tool, pivot, transforms.make(rotation, shift), back))
    return tuple(poses)
