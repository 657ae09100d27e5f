"""Directed edges on drawn bars: where they are to a tenth of a pixel, and which way they look."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.special import erf

from tests.reference.sticks import rig
from vision.canvas import canvas, points_through_grid
from vision.edges import STRENGTH, UX, UY, Edges, X, Y, edges
from vision.types import CameraModel, Floats, Grey, StereoModel, Transform


def straight_rig() -> StereoModel:
    """Two parallel cameras without distortion: a canvas pixel is a raw pixel, moved by whole numbers."""
    camera = CameraModel(
        matrix=np.array([[500.0, 0.0, 80.0], [0.0, 500.0, 60.0], [0.0, 0.0, 1.0]]),
        distortion=np.zeros(5),
        width_px=160,
        height_px=120,
    )
    motion = Transform(rotation=np.eye(3), translation=np.array([-0.07, 0.0, 0.0]))
    return StereoModel(left=camera, right=camera, right_from_left=motion)


ON = canvas(straight_rig())
DARK, BRIGHT, BLUR_PX = 40.0, 200.0, 0.9


def soft(distance: Floats) -> Floats:
    """How much of a pixel is inside, by its signed distance to an edge."""
    return np.asarray(0.5 * (1.0 + erf(distance / (BLUR_PX * np.sqrt(2.0)))), np.float64)


def bars(offsets_px: list[float], angle_rad: float, width_px: float = 6.0, between: float = DARK) -> Grey:
    """Long bright bars through the middle (80, 60), shifted along their normal."""
    v, u = np.mgrid[0:120, 0:160].astype(np.float64)
    across = -(u - 80.0) * np.sin(angle_rad) + (v - 60.0) * np.cos(angle_rad)
    lit = np.zeros(u.shape)
    for offset in offsets_px:
        half = 0.5 * width_px
        lit = lit + soft(across - offset + half) * soft(offset + half - across)
    grey = DARK + (BRIGHT - DARK) * np.clip(lit, 0, 1)
    if len(offsets_px) == 2 and between != DARK:
        seam = np.abs(across - 0.5 * sum(offsets_px)) < 0.8
        grey = np.where(seam, between, grey)
        grey = np.asarray(cv2.GaussianBlur(grey, (0, 0), 0.6), np.float64)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def found(grey: Grey, row_shift_px: float = 0.0, side: int = 0) -> Edges:
    mask = grey > 80
    return edges(grey, mask, mask, BRIGHT - DARK, ON, side, row_shift_px)


def offsets(of: Edges, angle_rad: float) -> tuple[Floats, Floats]:
    """Distance of each edge in the middle of the picture from the line (80, 60), and of its direction."""
    middle = points_through_grid(ON.from_raw[0], np.array([[80.0, 60.0]]))[0]
    away = of.table[:, [X, Y]].astype(np.float64) - middle
    near = np.hypot(away[:, 0], away[:, 1]) < 40
    normal = np.array([-np.sin(angle_rad), np.cos(angle_rad)])
    return away[near] @ normal, of.table[near][:, [UX, UY]].astype(np.float64) @ normal


@pytest.mark.parametrize("angle_deg", [0.0, 12.0, 30.0, 45.0, 77.0, 90.0, 140.0])
@pytest.mark.parametrize("offset", [0.0, 0.3, 0.75])
def test_both_flanks_are_where_grey_changes_most_and_look_at_each_other(
    angle_deg: float, offset: float
) -> None:
    angle = np.radians(angle_deg)

    at, way = offsets(found(bars([offset], angle, 7.0)), angle)

    low, high = at < offset, at > offset
    assert np.median(at[low]) == pytest.approx(offset - 3.5, abs=0.12)
    assert np.median(at[high]) == pytest.approx(offset + 3.5, abs=0.12)
    assert np.abs(np.abs(at - offset) - 3.5).max() < 0.25
    assert (way[low] > 0.97).all()
    assert (way[high] < -0.97).all()


def test_bars_that_touch_give_two_flanks_at_their_seam_that_look_apart() -> None:
    grey = bars([-3.5, 3.5], 0.4, 6.0, between=110.0)

    at, way = offsets(found(grey), 0.4)

    seam = np.abs(at) < 2.5
    outer = np.abs(at) > 5.0
    assert (way[seam & (at > 0)] > 0.9).all()
    assert (way[seam & (at < 0)] < -0.9).all()
    assert min((seam & (at > 0)).sum(), (seam & (at < 0)).sum()) > 40
    assert outer.sum() > 100


def test_the_map_names_the_edge_at_its_pixel_and_the_stronger_of_two() -> None:
    of = found(bars([0.0], 0.3))

    for number in range(0, len(of.table), 7):
        x, y = of.table[number, :2].astype(np.float64)
        named = of.at[int(y + 0.5), int(x + 0.5)]
        assert named >= 0
        assert of.table[named, STRENGTH] >= of.table[number, STRENGTH]
    assert set(np.unique(of.at)) - {-1} <= set(range(len(of.table)))


def test_a_row_shift_moves_edges_map_and_ground_alike() -> None:
    grey = bars([0.0], 0.3)

    still, moved = found(grey, 0.0, 1), found(grey, 2.0, 1)

    assert moved.table[:, X] == pytest.approx(still.table[:, X])
    assert moved.table[:, Y] == pytest.approx(still.table[:, Y] + 2.0)
    assert np.array_equal(moved.ground[4:], still.ground[2:-2])


def test_faint_and_full_edges_are_told_apart_and_noise_is_none() -> None:
    strong = found(bars([0.0], 0.3))
    grey = bars([0.0], 0.3).astype(np.float64)
    faint_grey = np.rint(DARK + 0.1 * (grey - DARK)).astype(np.uint8)
    mask = grey > 80
    faint = edges(faint_grey, mask, mask, BRIGHT - DARK, ON, 0)
    noise = np.random.default_rng(1).normal(60, 0.7, (120, 160)).round().astype(np.uint8)
    nothing = edges(noise, np.ones(noise.shape, np.bool_), mask, BRIGHT - DARK, ON, 0)

    assert np.median(strong.table[:, STRENGTH]) == pytest.approx(1.0)
    assert 0.05 < np.median(faint.table[:, STRENGTH]) < 0.6
    assert len(nothing.table) == 0


def test_an_empty_mask_has_no_edges_and_the_canvas_stays_its_size() -> None:
    on = canvas(rig())
    none = np.zeros((480, 640), np.bool_)
    nothing = edges(np.zeros((480, 640), np.uint8), none, none, 0.0, on, 0)

    assert nothing.table.shape == (0, 5)
    assert nothing.at.shape == nothing.ground.shape == (on.height_px, on.width_px)
    assert (nothing.at == -1).all()
