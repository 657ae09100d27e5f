"""What a pile of straight parts shows and who lies on whom, from where they lie."""

from __future__ import annotations

import numpy as np
import pytest

from bench.outlines import truth_of
from vision.types import CameraModel, Floats, Plane, StereoModel, Transform, read_only

DIAMETER_M = 0.004
CAMERA = CameraModel(
    matrix=read_only(np.array([[500.0, 0.0, 160.0], [0.0, 500.0, 120.0], [0.0, 0.0, 1.0]])),
    distortion=read_only(np.zeros(5)),
    width_px=320,
    height_px=240,
)
STEREO = StereoModel(
    left=CAMERA,
    right=CAMERA,
    right_from_left=Transform(rotation=np.eye(3), translation=np.array([-0.02, 0.0, 0.0])),
)
# a table 0.4 m away, square to the cameras; heights are towards them
TABLE = Plane(normal=read_only(np.array([0.0, 0.0, -1.0])), offset_m=0.4)


def lying(x: float, y: float, degrees: float, height_m: float = 0.5 * DIAMETER_M) -> Floats:
    """The axis of a part of 60 mm with its middle at (x, y) m."""
    half = 0.03 * np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees)), 0.0])
    middle = np.array([x, y, 0.4 - height_m])
    return np.stack([middle - half, middle + half])


def test_a_part_alone_is_free_and_shows_wholly() -> None:
    truth, left, _ = truth_of(np.stack([lying(0.02, 0.0, 30.0)]), DIAMETER_M, STEREO, TABLE)

    (only,) = truth.parts
    assert only.visible == 1.0
    assert only.free
    assert only.asked
    # 60 by 4 mm at 0.397 m and 500 px: 76 by 5 pixels
    assert np.count_nonzero(left) == pytest.approx(76 * 5, rel=0.1)


def test_the_upper_of_two_crossing_parts_is_told_and_hides_the_lower() -> None:
    lower, upper = lying(0.02, 0.0, 0.0), lying(0.02, 0.0, 90.0, 1.5 * DIAMETER_M)

    truth, _, _ = truth_of(np.stack([lower, upper]), DIAMETER_M, STEREO, TABLE)

    (crossing,) = truth.crossings
    assert (crossing.above, crossing.below) == (1, 0)
    assert crossing.at == pytest.approx(0.5, abs=0.02)
    assert not truth.parts[0].pickable
    assert not truth.parts[0].free
    assert truth.parts[1].free
    assert 0.9 < truth.parts[0].visible < 0.96
    assert truth.parts[1].visible == 1.0


def test_a_part_over_an_end_leaves_the_middle_pickable() -> None:
    lower, upper = lying(0.02, 0.0, 0.0), lying(0.045, 0.0, 90.0, 1.5 * DIAMETER_M)

    truth, _, _ = truth_of(np.stack([lower, upper]), DIAMETER_M, STEREO, TABLE)

    assert truth.parts[0].pickable
    assert not truth.parts[0].free


def test_parts_side_by_side_lie_on_nobody() -> None:
    beside = np.stack([lying(0.02, 0.0, 0.0), lying(0.02, DIAMETER_M, 0.0)])

    truth, _, _ = truth_of(beside, DIAMETER_M, STEREO, TABLE)

    assert truth.crossings == ()
    assert all(one.free for one in truth.parts)


def test_a_part_in_the_groove_of_two_lies_on_both() -> None:
    rise = 0.5 * DIAMETER_M + np.sqrt(0.75) * DIAMETER_M
    three = np.stack(
        [lying(0.02, 0.0, 0.0), lying(0.02, DIAMETER_M, 0.0), lying(0.02, 0.5 * DIAMETER_M, 0.0, rise)]
    )

    truth, _, _ = truth_of(three, DIAMETER_M, STEREO, TABLE)

    assert {(c.above, c.below) for c in truth.crossings} == {(2, 0), (2, 1)}
    assert [one.free for one in truth.parts] == [False, False, True]


def test_a_part_beyond_the_picture_is_not_asked_for() -> None:
    truth, _, _ = truth_of(np.stack([lying(0.12, 0.0, 0.0)]), DIAMETER_M, STEREO, TABLE)

    assert not truth.parts[0].in_frame
    assert not truth.parts[0].asked
