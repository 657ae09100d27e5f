"""The linear solve on strands whose tips are computed, not measured."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.reference.sticks import TABLE, Stick, lying, rig
from vision.reconstruct_lines import (
    Solved,
    from_space,
    in_space,
    level_of_depths,
    level_of_table,
    solve,
)
from vision.stereo import project, rectification, rectify_points
from vision.strands import Strands, Tip
from vision.types import Floats

LENGTH_M = 0.1
RECT = rectification(rig())
LEVEL = level_of_table(RECT, TABLE, (-0.005, 0.06))


def strand(ends: Floats, hidden: tuple[bool, bool] = (False, False)) -> Strands:
    way = ends[1] - ends[0]
    kind = [Tip.HIDDEN if h else Tip.FREE for h in hidden]
    return Strands(
        tips=ends[None],
        kind=np.array([kind], np.int64),
        tip_sigma_px=np.array([[30.0 if h else 0.4 for h in hidden]]),
        reach_px=np.array([[50.0 if h else 0.0 for h in hidden]]),
        sure=np.ones((1, 2), np.bool_),
        cautious_tips=ends[None],
        cautious_reach_px=np.zeros((1, 2)),
        direction=(way / np.linalg.norm(way))[None],
        line_sigma_px=np.full((1, 2), 0.1),
        width_px=np.array([5.7]),
        seen=np.ones(1),
    )


def both(stick: Stick) -> tuple[Floats, Floats]:
    left, right = project(np.stack([stick.start, stick.end]), rig())
    return rectify_points(left, RECT, "left"), rectify_points(right, RECT, "right")


def solved(left: Strands, right: Strands, flipped: int = 0) -> Solved:
    return solve(left, right, np.zeros((1, 2), np.int64), np.array([flipped]), LEVEL, RECT, LENGTH_M, 0.0)


@settings(max_examples=100, deadline=None)
@given(
    x=st.floats(-0.06, 0.06),
    y=st.floats(-0.06, 0.06),
    height=st.floats(0.0, 0.03),
    angle=st.floats(0, 180),
    tilt=st.floats(-15, 15),
)
def test_seen_tips_give_the_stick_back(x: float, y: float, height: float, angle: float, tilt: float) -> None:
    stick = lying(x, y, angle, height_m=height + 0.02, tilt_deg=tilt)
    left, right = both(stick)

    found = solved(strand(left), strand(right))

    assert found.ends_m[0] == pytest.approx(np.stack([stick.start, stick.end]), abs=2e-3)
    assert found.residual_px[0] < 0.5


def test_strands_that_run_against_each_other_are_turned() -> None:
    stick = lying(0.01, 0.02, 50)
    left, right = both(stick)

    found = solved(strand(left), strand(right[::-1]), flipped=1)

    assert found.ends_m[0] == pytest.approx(np.stack([stick.start, stick.end]), abs=1e-3)


def test_a_tip_hidden_in_one_picture_is_taken_from_the_other() -> None:
    stick = lying(0.01, 0.02, 50)
    left, right = both(stick)
    short = right.copy()
    short[1] = right[0] + 0.7 * (right[1] - right[0])

    found = solved(strand(left), strand(short, (False, True)))

    assert found.ends_m[0, 1] == pytest.approx(stick.end, abs=1e-3)
    assert found.end_sigma_px[0, 1] < 1


def test_a_stick_along_the_baseline_with_a_hidden_tip_is_believed_to_lie_flat() -> None:
    stick = lying(0.0, 0.0, 0.0)
    left, right = both(stick)
    short_l, short_r = left.copy(), right.copy()
    short_l[1] = left[0] + 0.8 * (left[1] - left[0])
    short_r[1] = right[0] + 0.6 * (right[1] - right[0])

    found = solved(strand(short_l, (False, True)), strand(short_r, (False, True)))

    rise = found.ends_m[0, 1, 2] - found.ends_m[0, 0, 2]
    assert abs(rise) < 0.012


def test_strands_of_two_sticks_disagree() -> None:
    left, _ = both(lying(0.0, 0.0, 70))
    _, right = both(lying(0.01, 0.02, 70))

    assert solved(strand(left), strand(right)).chi2[0] > 100


def test_a_table_level_is_the_disparity_of_its_middle_height() -> None:
    point = np.array([[0.03, -0.02, 0.4 - 0.0275]])

    pixel = from_space(point, RECT)

    assert LEVEL.disparity_px(pixel[:, :2])[0] == pytest.approx(pixel[0, 2], abs=1e-6)
    top = from_space(np.array([[0.0, 0.0, 0.34]]), RECT)
    assert top[0, 2] - LEVEL.disparity_px(top[:, :2])[0] == pytest.approx(LEVEL.half_px, rel=0.2)


def test_a_depth_range_is_a_flat_level() -> None:
    level = level_of_depths(RECT, (0.35, 0.45))

    low, high = (RECT.focal_px * RECT.baseline_m / depth for depth in (0.45, 0.35))
    assert level.offset - level.half_px == pytest.approx(low)
    assert level.offset + level.half_px == pytest.approx(high)


@settings(max_examples=50, deadline=None)
@given(x=st.floats(-0.2, 0.2), y=st.floats(-0.2, 0.2), z=st.floats(0.2, 0.9))
def test_pixels_and_space_are_inverse(x: float, y: float, z: float) -> None:
    point = np.array([[x, y, z]])

    assert in_space(from_space(point, RECT), RECT) == pytest.approx(point, abs=1e-9)
