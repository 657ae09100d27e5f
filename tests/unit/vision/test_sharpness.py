"""Blur is told in pixels, by the edges themselves."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from scipy import special

from tests.fakes.station import DATA
from vision.sharpness import BLURRED_PX, blur_px
from vision.types import Grey

DRAWN = cv2.imread(str(DATA / "left.png"), cv2.IMREAD_GRAYSCALE)
assert DRAWN is not None
PICTURE: Grey = np.asarray(DRAWN, np.uint8)


def edge(sigma_px: float, contrast: float = 120.0, noise: float = 0.0) -> Grey:
    """A slanted edge through a known blur; drawn by the error function, not by a filter."""
    v, u = np.mgrid[0:200, 0:200].astype(np.float64)
    across = (u - 100.0) * math.cos(0.2) + (v - 100.0) * math.sin(0.2)
    step = special.erf(across / (sigma_px * math.sqrt(2.0)))
    rng = np.random.default_rng(1)
    grey = 60.0 + contrast * (1.0 + step) / 2 + rng.normal(0, noise, u.shape)
    return np.asarray(np.clip(grey, 0, 255), np.uint8)


@pytest.mark.parametrize("sigma_px", [0.8, 1.2, 2.0, 3.0, 4.0])
@pytest.mark.parametrize("contrast", [60.0, 150.0])
def test_the_blur_of_an_edge_is_found_whatever_its_contrast(sigma_px: float, contrast: float) -> None:
    assert blur_px(edge(sigma_px, contrast, noise=1.0)) == pytest.approx(sigma_px, rel=0.15, abs=0.15)


def test_blurring_a_scene_shows_and_a_strong_blur_is_over_the_limit() -> None:
    told = [blur_px(PICTURE)]
    for sigma in (1.0, 2.0, 3.0, 4.0):
        told.append(blur_px(np.asarray(cv2.GaussianBlur(PICTURE, (0, 0), sigma), np.uint8)))
    assert told == sorted(told)
    assert told[0] < 1.2
    assert told[1] < BLURRED_PX < told[4]


def test_noise_and_nothing_else_is_no_blur() -> None:
    rng = np.random.default_rng(2)
    noise = np.clip(rng.normal(90.0, 2.0, (200, 200)), 0, 255).astype(np.uint8)
    assert not blur_px(noise) > BLURRED_PX
    assert math.isnan(blur_px(np.full((200, 200), 90, np.uint8)))
