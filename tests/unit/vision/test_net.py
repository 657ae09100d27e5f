"""How wide the foreground is at a place."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from vision.net import radii_px


def test_the_radius_is_the_distance_to_the_nearest_background_pixel() -> None:
    random = np.random.default_rng(7)
    for density in (0.5, 0.9, 0.99, 0.999):
        mask = random.random((50, 70)) < density
        mask[20, 30] = False
        v, u = np.nonzero(np.ones_like(mask))

        found = radii_px(mask, np.stack([u, v], axis=1).astype(float))

        assert found == pytest.approx(ndimage.distance_transform_edt(mask).ravel())


def test_the_border_of_the_picture_is_no_background() -> None:
    mask = np.zeros((30, 40), bool)
    mask[10:21] = True

    assert radii_px(mask, np.array([[0.0, 15.0], [39.0, 15.0], [20.0, 15.0]])) == pytest.approx([6.0] * 3)
    assert radii_px(np.ones((5, 9), bool), np.array([[0.0, 0.0]])).tolist() == [9.0]
