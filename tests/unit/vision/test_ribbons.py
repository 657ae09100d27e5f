"""Ribbons of one part's width from directed edges, on drawn bands."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from vision.ribbons import Ribbons, ribbons
from vision.sampling import Picture
from vision.types import Floats

WIDTH_PX, LEAST_PX, FLOOR = 6.0, 9.0, 6.0


def bands(offsets_px: list[float], angle_deg: float, seam: float = 0.4) -> Picture:
    """Parallel bands of one width about the middle of the picture, darker by ``seam`` at their flanks."""
    v, u = np.mgrid[0:160, 0:160].astype(np.float64) - 80.0
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    along, across = c * u + s * v, c * v - s * u
    picture = np.full(u.shape, 40.0)
    for offset in offsets_px:
        from_axis = np.abs(across - offset) / (0.5 * WIDTH_PX)
        lit = (from_axis <= 1.0) & (np.abs(along) <= 50.0)
        picture[lit] = (40.0 + 150.0 * (1.0 - seam * from_axis**2))[lit]
    return cv2.GaussianBlur(picture, (0, 0), 0.8).astype(np.float32)


def found(picture: Picture, width_px: float = WIDTH_PX) -> Ribbons:
    return ribbons(picture, picture > 100.0, width_px, FLOOR, LEAST_PX)


def offsets_px(pieces: Ribbons, angle_deg: float) -> Floats:
    """(K, 2) how far either end of each piece is off the middle of the picture, across the bands."""
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    ends = np.stack([pieces.start, pieces.end], axis=1) - 80.0
    return np.asarray(c * ends[..., 1] - s * ends[..., 0], np.float64)


@pytest.mark.parametrize("angle_deg", [0.0, 17.0, 45.0, 90.0, 141.0])
@pytest.mark.parametrize("offsets", [[0.0], [-3.0, 3.0], [-9.5, -3.5, 3.5, 9.5]])
def test_each_of_some_touching_bands_is_one_ribbon(angle_deg: float, offsets: list[float]) -> None:
    pieces = found(bands(offsets, angle_deg))

    # where bands touch, their edges at the seam lie a little inside: a middle is off by half of that
    off = np.abs(offsets_px(pieces, angle_deg)[:, :, None] - np.array(offsets)).max(axis=1)
    whole = np.linalg.norm(pieces.end - pieces.start, axis=1) > 85.0
    assert (off[whole].min(axis=0) < 0.8).all()
    assert (off.min(axis=1) < 1.2).all()


def test_a_band_of_another_width_is_no_ribbon() -> None:
    assert len(found(bands([0.0], 20.0), width_px=12.0).start) == 0
    assert len(found(bands([-3.0, 3.0], 20.0, seam=0.0)).start) == 0


def test_a_dark_gap_between_bands_is_no_ribbon() -> None:
    pieces = found(bands([-6.0, 6.0], 30.0))

    assert np.abs(offsets_px(pieces, 30.0)).min() > 5.0


def test_what_is_not_foreground_is_no_ribbon() -> None:
    picture = bands([0.0], 30.0)

    pieces = ribbons(picture, np.zeros(picture.shape, np.bool_), WIDTH_PX, FLOOR, LEAST_PX)

    assert pieces.start.shape == (0, 2)
    assert pieces.end.shape == (0, 2)
