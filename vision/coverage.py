"""What views of a board cover, and what is still missing: places in the picture, tilts, distances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from vision.types import Floats, Ints, Transform, read_only

PLACES: Final = (
    ("upper left", "upper middle", "upper right"),
    ("middle left", "centre", "middle right"),
    ("lower left", "lower middle", "lower right"),
)

GOOD_VIEWS: Final = 10
GOOD_TILT_RAD: Final = np.deg2rad(20.0)
"""Zhang's error falls with tilt up to about 45 degrees; below 20 the focal length is badly known."""
TILTED_VIEWS: Final = 4
GOOD_RANGE: Final = 1.15
"""Farthest over nearest distance of the board."""
_FEW: Final = 0.02
"""A place with a smaller share of the corners counts as empty."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Coverage:
    """``left``, ``right`` (3, 3): corners seen in each ninth of the picture. Of each view: ``tilt_rad`` (V,)
    of the board against the picture plane, ``leans`` (V, 2) its normal sideways and down, ``distance_m`` (V,)
    of its middle. ``missing`` in words, empty when nothing is.
    """

    left: Ints
    right: Ints
    tilt_rad: Floats
    leans: Floats
    distance_m: Floats
    missing: tuple[str, ...]


def coverage(
    left_px: Sequence[Floats],
    right_px: Sequence[Floats],
    poses: Sequence[Transform],
    centre_m: Floats,
    size: tuple[int, int],
) -> Coverage:
    """Coverage by views of a board.

    Parameters
    ----------
    left_px, right_px
        (N, 2) corners of each view that camera saw.
    poses
        ``left_from_board`` of each view.
    centre_m
        (3,) the middle of the board in its own frame.
    size
        Width and height of the pictures, px.
    """
    grids = [_ninths(parts, size) for parts in (left_px, right_px)]
    normals = np.array([pose.rotation[:, 2] for pose in poses]).reshape(-1, 3)
    middles = np.array([pose.rotation @ centre_m + pose.translation for pose in poses]).reshape(-1, 3)
    tilt = np.arccos(np.clip(np.abs(normals[:, 2]), 0.0, 1.0))
    distance = middles[:, 2]
    return Coverage(
        left=grids[0],
        right=grids[1],
        tilt_rad=read_only(tilt),
        leans=read_only(normals[:, :2].copy()),
        distance_m=read_only(distance.copy()),
        missing=_missing(grids, tilt, normals, distance),
    )


def _ninths(parts: Sequence[Floats], size: tuple[int, int]) -> Ints:
    grid = np.zeros((3, 3), dtype=np.int64)
    if parts:
        points = np.concatenate(list(parts))
        columns = np.clip((3 * points[:, 0] / size[0]).astype(np.int64), 0, 2)
        rows = np.clip((3 * points[:, 1] / size[1]).astype(np.int64), 0, 2)
        np.add.at(grid, (rows, columns), 1)
    grid.setflags(write=False)
    return grid


def _missing(grids: list[Ints], tilt: Floats, normals: Floats, distance: Floats) -> tuple[str, ...]:
    said = []
    if len(tilt) < GOOD_VIEWS:
        said.append(f"only {len(tilt)} views: take {GOOD_VIEWS} or more")
    empty = [grid < _FEW * max(grid.sum(), 1) for grid in grids]
    for j, row in enumerate(PLACES):
        for i, place in enumerate(row):
            eyes = [eye for eye, blank in zip(("left", "right"), empty, strict=True) if blank[j, i]]
            if len(eyes) == 2:
                said.append(f"no view in the {place} of either picture")
            elif eyes:
                said.append(f"no view in the {place} of the {eyes[0]} picture")
    if len(tilt):
        tilted = int((tilt >= GOOD_TILT_RAD).sum())
        if tilted < TILTED_VIEWS:
            said.append(
                f"tilt more: {tilted} views are tilted by {np.rad2deg(GOOD_TILT_RAD):.0f} degrees or more "
                f"(largest {np.rad2deg(tilt.max()):.0f}); {TILTED_VIEWS} at least, up to 45"
            )
        else:
            enough = np.sin(0.75 * GOOD_TILT_RAD)
            for axis, words in ((0, "to the side"), (1, "up and down")):
                if np.abs(normals[:, axis]).max() < enough:
                    said.append(f"tilt the board {words} too: so far it leans the other way only")
        if distance.min() > 0 and distance.max() / distance.min() < GOOD_RANGE:
            said.append(
                f"all views are from {1e3 * distance.min():.0f} to {1e3 * distance.max():.0f} mm: hold it "
                "nearer and farther too"
            )
    return tuple(said)
