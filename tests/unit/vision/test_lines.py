"""Sub-pixel flanks, lines and ends on bands whose place is known exactly."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import erf

from vision.graph import trace
from vision.lines import Picture, end_fall, fit_line, flanks, straight_pieces
from vision.types import Floats


def step(distance: Floats, blur_px: float = 0.8) -> Floats:
    return np.asarray(0.5 * (1.0 + erf(distance / (blur_px * np.sqrt(2.0)))), np.float64)


def band(origin: tuple[float, float], angle_rad: float, width_px: float, length_px: float = 1e3) -> Picture:
    """A soft bright band through a point, (60, 80)."""
    v, u = np.mgrid[0:60, 0:80].astype(np.float64)
    along = (u - origin[0]) * np.cos(angle_rad) + (v - origin[1]) * np.sin(angle_rad)
    across = -(u - origin[0]) * np.sin(angle_rad) + (v - origin[1]) * np.cos(angle_rad)
    lit = step(across + 0.5 * width_px) * step(0.5 * width_px - across)
    return np.asarray(30 + 150 * lit * step(0.5 * length_px - np.abs(along)), np.float32)


@settings(max_examples=60, deadline=None)
@given(
    u=st.floats(36, 44),
    v=st.floats(26, 34),
    angle=st.floats(0, np.pi),
    width=st.floats(4.0, 9.0),
    off=st.floats(-0.8, 0.8),
)
def test_flanks_are_found_to_a_twentieth_of_a_pixel(
    u: float, v: float, angle: float, width: float, off: float
) -> None:
    grey = band((u, v), angle, width)
    normal = np.array([[-np.sin(angle), np.cos(angle)]])

    seen = flanks(grey, np.array([[u, v]]) + off * normal, normal, 0.5 * width, 1.5)

    assert 0.5 * (seen.low_px[0] + seen.high_px[0]) == pytest.approx(-off, abs=0.05)
    assert seen.high_px[0] - seen.low_px[0] == pytest.approx(width, abs=0.12)
    assert min(seen.low_slope[0], seen.high_slope[0]) > 30


def test_where_there_is_no_flank_its_slope_is_nothing() -> None:
    seen = flanks(
        np.full((60, 80), 90, np.float32), np.array([[40.0, 30.0]]), np.array([[0.0, 1.0]]), 3.0, 1.5
    )

    assert seen.low_slope[0] == 0.0
    assert seen.high_slope[0] == 0.0


@settings(max_examples=60, deadline=None)
@given(angle=st.floats(0, np.pi), seed=st.integers(0, 9999))
def test_a_third_of_wild_points_does_not_move_a_line(angle: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    along = np.array([np.cos(angle), np.sin(angle)])
    normal = np.array([-along[1], along[0]])
    points = np.array([100.0, 50.0]) + np.linspace(-40, 40, 80)[:, None] * along
    points = points + random.normal(0, 0.1, 80)[:, None] * normal
    wild = random.permutation(80)[:24]
    points[wild] += random.uniform(2.0, 5.0, 24)[:, None] * normal

    line = fit_line(points, np.ones(80))

    assert line is not None
    assert abs(float((np.array([100.0, 50.0]) - line.origin) @ line.normal)) < 0.1
    assert abs(float(line.direction @ normal)) < 0.005
    assert line.scale_px < 0.3


def test_too_few_points_or_one_spot_is_no_line() -> None:
    assert fit_line(np.zeros((2, 2)), np.ones(2)) is None
    assert fit_line(np.ones((9, 2)), np.ones(9)) is None


def test_the_end_of_a_band_is_found_on_all_five_lanes() -> None:
    grey = band((40.0, 30.0), 0.3, 6.0, length_px=40.6)
    along = np.array([np.cos(0.3), np.sin(0.3)])

    lanes = end_fall(grey, np.array([40.0, 30.0]) + 19.0 * along, along, 3.0, 4.0)

    assert lanes[:, 0] == pytest.approx(1.3, abs=0.1)
    assert (lanes[:, 1] > 30).all()


def test_a_bent_path_is_cut_at_its_corner_and_trimmed_at_junctions_only() -> None:
    mask = np.zeros((40, 40), bool)
    mask[5, 5:30] = True
    mask[5:30, 29] = True
    bent = straight_pieces(trace(mask), 1.5, 3.0, 4.0)
    mask[5:30, 5] = True
    mask[20, 5:20] = True
    branched = straight_pieces(trace(mask), 1.5, 3.0, 4.0)

    assert sorted(np.linalg.norm(bent.end - bent.start, axis=1).round()) == [21, 21]
    ends = np.concatenate([branched.start, branched.end]).tolist()
    assert [19.0, 20.0] in ends
    assert [8.0, 20.0] in ends
