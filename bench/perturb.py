"""What goes wrong with pictures and calibrations in a shop, as pure functions: for robustness tables.

Pictures (H, W) uint8 in, new ones out; nothing is changed in place. Random ones take their generator, so
the two pictures of a pair can differ as they would.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from bench.scenes import Pile
from drivers.sim.surfaces import mottled
from vision.types import CameraModel, Floats, Grey, StereoModel, read_only


def both(pile: Pile, change: Callable[[Grey], Grey]) -> Pile:
    """A pile with both pictures changed the same way."""
    return replace(pile, left=change(pile.left), right=change(pile.right))


def noisy(picture: Grey, sigma: float, rng: np.random.Generator) -> Grey:
    """More noise, Gaussian, ``sigma`` grey levels."""
    return _whole(picture + sigma * rng.standard_normal(picture.shape))


def blurred(picture: Grey, sigma_px: float) -> Grey:
    """Out of focus: a Gaussian on top of the lens's own."""
    if sigma_px <= 0.0:
        return picture
    return _whole(np.asarray(cv2.GaussianBlur(picture.astype(np.float64), (0, 0), sigma_px)))


def brighter(picture: Grey, levels: float) -> Grey:
    """All grey levels moved: the same as a fixed threshold that drifted by minus ``levels``."""
    return _whole(picture.astype(np.float64) + levels)


def gained(picture: Grey, factor: float) -> Grey:
    """The camera's gain drifted; what is too bright stays white."""
    return _whole(factor * picture.astype(np.float64))


def gradient(picture: Grey, share: float, angle_rad: float) -> Grey:
    """Light that falls off from one side: factors from 1 - share to 1 + share across the picture."""
    height, width = picture.shape
    v, u = np.mgrid[:height, :width]
    u, v = (u - 0.5 * (width - 1)) / width, (v - 0.5 * (height - 1)) / height
    along = u * np.cos(angle_rad) + v * np.sin(angle_rad)
    return _whole(picture * (1.0 + share * along / np.abs(along).max()))


def textured(picture: Grey, sigma: float, rng: np.random.Generator, roughness: float = 0.9) -> Grey:
    """A mottled pattern over everything, ``sigma`` grey levels; ``roughness`` as in `mottled`."""
    return _whole(picture + sigma * mottled(picture.shape, roughness, rng))


def highlights(picture: Grey, count: int, levels: float, radius_px: float, rng: np.random.Generator) -> Grey:
    """Round soft spots of glare anywhere in the picture, ``levels`` bright in their middle."""
    height, width = picture.shape
    v, u = np.mgrid[:height, :width]
    light: Floats = picture.astype(np.float64)
    for _ in range(count):
        at = rng.random(2) * (width, height)
        light += levels * np.exp(-((u - at[0]) ** 2 + (v - at[1]) ** 2) / (2.0 * radius_px**2))
    return _whole(light)


def rows_moved(stereo: StereoModel, rows_px: float) -> StereoModel:
    """A calibration whose right camera looks ``rows_px`` lower than it believes.

    What it takes for row v is row v + ``rows_px`` of the true one: the error a knock to a camera leaves.
    """
    matrix = stereo.right.matrix.copy()
    matrix[1, 2] += rows_px
    right: CameraModel = replace(stereo.right, matrix=read_only(matrix))
    return replace(stereo, right=right)


def _whole(levels: Floats) -> Grey:
    grey: Grey = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
    return read_only(grey)
