"""Perturbations do what they say, to copies."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from bench import perturb
from bench.rigs import WEBCAM, known
from bench.scenes import Pile
from vision.types import Grey


@pytest.fixture
def picture() -> Grey:
    grey = np.full((120, 160), 100, np.uint8)
    grey[40:80, 60:100] = 180
    grey.setflags(write=False)
    return grey


def test_noise_is_as_strong_as_asked(picture: Grey) -> None:
    noisy = perturb.noisy(picture, 8.0, np.random.default_rng(1))
    assert np.std(noisy.astype(float) - picture) == pytest.approx(8.0, rel=0.05)


def test_blur_spreads_an_edge_and_keeps_the_light(picture: Grey) -> None:
    edge = perturb.blurred(picture, 1.5).astype(float)[60]
    assert edge.sum() == pytest.approx(picture[60].astype(float).sum(), rel=0.005)
    steps = np.diff(edge)[50:70]
    at = np.arange(len(steps))
    middle = (steps * at).sum() / steps.sum()
    assert np.sqrt((steps * (at - middle) ** 2).sum() / steps.sum()) == pytest.approx(1.5, rel=0.1)
    assert perturb.blurred(picture, 0.0) is picture


def test_levels_gain_and_gradient_change_brightness_as_told(picture: Grey) -> None:
    assert perturb.brighter(picture, -40.0)[0, 0] == 60
    assert perturb.gained(picture, 1.5)[60, 80] == 255
    assert perturb.gained(picture, 0.5)[0, 0] == 50
    sloped = perturb.gradient(picture, 0.4, 0.0)
    assert (sloped[0, 0], sloped[0, -1]) == (60, 140)
    assert np.array_equal(sloped[0], sloped[-1])


def test_texture_and_highlights_add_light_of_the_strength_asked_for(picture: Grey) -> None:
    rng = np.random.default_rng(3)
    assert np.std(perturb.textured(picture, 6.0, rng).astype(float) - picture) == pytest.approx(6.0, rel=0.05)
    spotted = perturb.highlights(picture, 1, 60.0, 6.0, rng).astype(int) - picture
    assert 50 <= spotted.max() <= 60
    assert 0.0 < (spotted > 5).mean() < 0.1


def test_both_pictures_change_and_the_pile_that_was_given_does_not(picture: Grey) -> None:
    pile = Pile(left=picture, right=picture, ends=np.zeros((0, 2, 3)))
    changed = perturb.both(pile, lambda grey: perturb.brighter(grey, 10.0))
    assert (changed.left[0, 0], changed.right[0, 0], pile.left[0, 0]) == (110, 110, 100)


def test_moved_rows_move_what_the_right_camera_is_believed_to_see() -> None:
    stereo = known(WEBCAM).stereo
    moved = perturb.rows_moved(stereo, 2.0)
    point = np.array([[0.01, 0.02, 0.4]])
    before, after = (
        cv2.projectPoints(point, np.zeros(3), np.zeros(3), s.right.matrix, s.right.distortion)[0].ravel()
        for s in (stereo, moved)
    )
    assert after - before == pytest.approx([0.0, 2.0])
    assert moved.left is stereo.left
