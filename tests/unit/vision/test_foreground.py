"""The adaptive mask on drawn sticks, under light that one number cannot serve."""

from __future__ import annotations

import numpy as np
import pytest

from tests.reference.sticks import lying, pair
from vision.foreground import stands_out
from vision.types import Grey, Mask

WIDTH_PX = 5.7


def picture(light: float = 160.0) -> Grey:
    return pair([lying(-0.03, 0, 60), lying(0.03, 0, 110)], light=light)[0]


def share_found(mask: Mask, truth: Mask) -> float:
    return float((mask & truth).sum() / (mask | truth).sum())


def test_it_is_what_a_good_fixed_threshold_gives_where_one_exists() -> None:
    grey = picture()

    found = stands_out(grey, WIDTH_PX)

    assert share_found(found.mask, grey > 110) > 0.9
    assert 100 < found.contrast_grey < 170


def test_a_strong_light_gradient_changes_nothing() -> None:
    grey = picture()
    gradient = np.linspace(0.3, 1.6, grey.shape[1])[None, :]
    bent = np.clip(grey * gradient, 0, 255).astype(np.uint8)

    found = stands_out(bent, WIDTH_PX)

    assert share_found(found.mask, grey > 110) > 0.85


def test_a_bright_block_of_more_than_twelve_widths_is_background() -> None:
    grey = picture()
    grey[300:460, 20:180] = 150

    found = stands_out(grey, WIDTH_PX)

    assert not found.mask[320:440, 40:160].any()
    assert share_found(found.mask[:290], grey[:290] > 110) > 0.8


def test_dim_sticks_are_found_and_noise_alone_is_not() -> None:
    dim = picture(light=40.0)
    empty = pair([])[0]

    assert share_found(stands_out(dim, WIDTH_PX).mask, picture() > 110) > 0.8
    assert stands_out(empty, WIDTH_PX).mask.sum() == 0


def test_a_black_picture_has_no_foreground_and_stays_as_it_was() -> None:
    black = np.zeros((50, 70), np.uint8)

    found = stands_out(black, WIDTH_PX)

    assert not found.mask.any()
    assert found.contrast_grey == 0.0
    assert not black.any()


def test_a_heap_without_a_gap_of_less_than_twelve_widths_is_foreground() -> None:
    grey = np.full((480, 640), 40, np.uint8)
    grey[200 : 200 + round(9 * WIDTH_PX), 100:400] = 170

    found = stands_out(grey, WIDTH_PX)

    assert found.mask[205 : 195 + round(9 * WIDTH_PX), 110:390].mean() > 0.95


def test_the_ground_holds_the_mask_and_what_is_in_the_shade_beside_it() -> None:
    grey = picture().astype(np.float64)
    dim = pair([lying(0.06, 0.02, 80)], light=45.0)[0]
    both = np.maximum(grey, dim).astype(np.uint8)
    bright, faint = grey > 110, (dim > 60) & (grey < 60)

    found = stands_out(both, WIDTH_PX)

    assert not (found.mask & ~found.ground).any()
    assert found.ground[bright].mean() > 0.99
    assert found.ground[faint].mean() > 0.75
    assert found.ground[~(bright | faint)].mean() < 0.03


def test_noise_is_told_from_the_picture() -> None:
    told = []
    for sigma in (3.0, 6.0, 12.0):
        grey = np.random.default_rng(1).normal(80, sigma, (480, 640)).clip(0, 255).astype(np.uint8)
        told.append(stands_out(grey, WIDTH_PX).noise_grey)

    # in proportion, to the steps of whole grey values; smoothing takes a little more than half of it
    assert told == pytest.approx([0.45 * 3.0, 0.45 * 6.0, 0.45 * 12.0], abs=1.0)
