"""What geometry promises: by hand, and how it grows."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vision.forecast import Pair, depth_sigma_m, disparity_sigma_px, forecast

WEBCAMS = Pair(focal_px=600.0, baseline_m=0.08, width_px=640, height_px=480)


def test_one_pixel_of_disparity_at_400_mm_is_a_third_of_a_centimetre() -> None:
    assert forecast(WEBCAMS, 0.4, 0.004).depth_per_px_m == pytest.approx(0.4**2 / 48.0)
    assert forecast(WEBCAMS, 0.4, 0.004).part_px == pytest.approx(6.0)
    assert forecast(WEBCAMS, 0.4, 0.004).view_m == pytest.approx((640 * 0.4 / 600 - 0.08, 0.32))


def test_twice_as_far_is_four_times_as_bad_and_twice_the_baseline_half() -> None:
    wide = Pair(focal_px=600.0, baseline_m=0.16, width_px=640, height_px=480)

    assert depth_sigma_m(WEBCAMS, 0.8, 0.1) == pytest.approx(4 * depth_sigma_m(WEBCAMS, 0.4, 0.1))
    assert depth_sigma_m(wide, 0.4, 0.1) == pytest.approx(depth_sigma_m(WEBCAMS, 0.4, 0.1) / 2)


def test_parts_along_the_baseline_are_told_worst() -> None:
    assert disparity_sigma_px(math.radians(45)) == pytest.approx(
        math.sqrt(2) * disparity_sigma_px(math.pi / 2)
    )
    assert disparity_sigma_px(0.0) == disparity_sigma_px(math.radians(15))


def test_depth_moves_points_aside_at_the_edge_only() -> None:
    told = forecast(WEBCAMS, 0.4, 0.004)

    assert told.lateral_m[1, 1] < 0.2 * told.lateral_m[0, 0]
    corner = math.hypot(told.x_m[0, 0], told.y_m[0, 0]) / 0.4 * told.depth_m[0, 0]
    assert told.lateral_m[0, 0] == pytest.approx(np.hypot(corner, told.lateral_m[1, 1]))


def test_cameras_that_see_nothing_in_common_are_refused() -> None:
    with pytest.raises(ValueError, match="nothing in common"):
        forecast(WEBCAMS, 0.05, 0.004)
