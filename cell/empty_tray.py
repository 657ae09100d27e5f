"""The reference of the empty tray: two pictures, loaded with the configuration, compared with a look."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from cell.config import CellConfig, WorkspaceConfig
from cell.emptiness import in_box, on_plane
from cell.errors import ConfigError
from vision import transforms
from vision.empty import change
from vision.types import CameraModel, EmptyTray, Floats, Grey, Plane, Transform, Tuning, read_only

NAMES: Final = ("left.png", "right.png")
TAKE: Final = "take it anew: mikado area empty CONFIG --take"
_SPECK_PX: Final = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Foreign:
    """A connected spot that the empty tray has not: its middle (x, y) m and area, as if it lay on the floor,
    base frame."""

    x_m: float
    y_m: float
    area_m2: float


def load(config: CellConfig) -> EmptyTray | None:
    """The reference of a configuration; None where there is none.

    Raises
    ------
    ConfigError
        It is configured and not there, or of another size than the cameras' pictures.
    """
    folder = config.files.empty_tray
    if folder is None:
        return None
    left, right = (
        _picture(folder / name, camera.width_px, camera.height_px)
        for name, camera in zip(NAMES, (config.cameras.left, config.cameras.right), strict=True)
    )
    return EmptyTray(left=left, right=right)


def tuning_of(config: CellConfig) -> Tuning:
    """The gates of a configuration, with its reference of the empty tray. Raises as `load`."""
    return config.tuning.tuning(load(config))


def _picture(path: Path, width_px: int, height_px: int) -> Grey:
    try:
        content = np.frombuffer(path.read_bytes() or b"\0", dtype=np.uint8)
    except OSError as error:
        raise ConfigError(
            path, None, f"files.empty_tray: cannot be read: {error.strerror}; {TAKE}, or leave the key out"
        ) from error
    picture = cv2.imdecode(content, cv2.IMREAD_GRAYSCALE)
    if picture is None:
        raise ConfigError(path, None, f"files.empty_tray: not a picture; {TAKE}")
    if picture.shape != (height_px, width_px):
        raise ConfigError(
            path,
            None,
            f"files.empty_tray: the picture is {picture.shape[1]}x{picture.shape[0]}, the cameras give "
            f"{width_px}x{height_px}; {TAKE}",
        )
    return read_only(np.asarray(picture, dtype=np.uint8))


def foreign(
    left: Grey,
    empty: EmptyTray,
    camera: CameraModel,
    table: Plane,
    base_from_camera: Transform,
    workspace: WorkspaceConfig,
) -> tuple[Foreign, ...]:
    """What lies in the workspace box and did not in the empty tray, the largest first; by the left camera.

    Nothing where the reference does not suit the picture: see `vision.empty.change`.
    """
    here = change(left, empty.left)
    if not here.usable:
        return ()
    square = np.ones((_SPECK_PX, _SPECK_PX), np.uint8)
    mask = np.asarray(cv2.morphologyEx(here.mask.view(np.uint8), cv2.MORPH_OPEN, square), np.uint8)
    count, labels = cv2.connectedComponents(mask)
    if count == 1:
        return ()
    rows, columns = np.nonzero(mask)
    met = on_plane(np.column_stack([columns, rows]).astype(np.float64), camera, table)
    places = transforms.apply(base_from_camera, met)[:, :2]
    inside = in_box(places, workspace)
    # a pixel's share of the floor: the square of distance over focal length, more where the floor is slanted
    slant = np.abs(met @ table.normal) / np.linalg.norm(met, axis=1)
    area = met[:, 2] ** 2 / (camera.matrix[0, 0] * camera.matrix[1, 1] * slant)
    label = labels[rows, columns][inside]
    areas = np.bincount(label, area[inside], count)
    spots = [
        Foreign(x_m=x, y_m=y, area_m2=float(areas[k]))
        for k in np.flatnonzero(areas)
        for x, y in [_middle(places[inside][label == k])]
    ]
    return tuple(sorted(spots, key=lambda spot: -spot.area_m2))


def _middle(places_m: Floats) -> tuple[float, float]:
    x, y = places_m.mean(axis=0)
    return float(x), float(y)
