"""Between the detector's transforms and the robot's six numbers nothing is lost or mirrored."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from cell import frames
from drivers.types import Frame, ToolPose
from vision import transforms


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.3, -1.0, 2.0), (np.pi, 0.0, 0.0), (0.0, 2.2, 2.2)])
def test_there_and_back_is_the_same_motion(turn: tuple[float, float, float]) -> None:
    before = transforms.make(turn, [0.1, -0.4, 0.25])
    after = frames.transform_of(frames.pose_of(before))
    np.testing.assert_allclose(after.rotation, before.rotation, atol=1e-12)
    np.testing.assert_allclose(after.translation, before.translation)


def test_six_numbers_are_metres_and_a_rotation_vector() -> None:
    quarter = frames.transform_of(ToolPose(x=1.0, y=2.0, z=3.0, rx=0.0, ry=0.0, rz=np.pi / 2))
    np.testing.assert_allclose(transforms.apply(quarter, [1.0, 0.0, 0.0]), [1.0, 3.0, 3.0], atol=1e-12)


@pytest.mark.parametrize("yaw", [-3.0, -0.7, 0.0, 1.2, np.pi])
def test_a_tool_that_looks_down_closes_along_its_yaw(yaw: float) -> None:
    pose = frames.tool_down(np.array([0.1, -0.4, 0.05]), yaw)
    base_from_tool = frames.transform_of(pose)
    np.testing.assert_allclose(base_from_tool.rotation @ [0, 0, 1], [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(base_from_tool.rotation @ [1, 0, 0], [np.cos(yaw), np.sin(yaw), 0], atol=1e-12)
    assert np.linalg.det(base_from_tool.rotation) == pytest.approx(1.0)
    assert (pose.x, pose.y, pose.z) == (0.1, -0.4, 0.05)


def test_raising_changes_the_height_alone() -> None:
    pose = ToolPose(x=0.1, y=0.2, z=0.3, rx=1.0, ry=2.0, rz=3.0)
    assert frames.raised(pose, 0.5) == ToolPose(x=0.1, y=0.2, z=0.5, rx=1.0, ry=2.0, rz=3.0)


def test_a_colour_frame_becomes_grey_as_the_eye_weighs_it() -> None:
    pixels = np.zeros((2, 3, 3), dtype=np.uint8)
    pixels[0, 0] = (255, 0, 0)  # blue
    pixels[0, 1] = (0, 255, 0)
    pixels[0, 2] = (0, 0, 255)
    grey = frames.grey_of(Frame(camera="c", pixels=pixels, captured_at=0.0, sequence=1))
    assert grey.shape == (2, 3)
    assert list(grey[0]) == [29, 150, 76]  # ITU-R BT.601
    assert np.array_equal(grey, cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY))


def test_a_grey_frame_is_taken_as_it_is() -> None:
    pixels = np.arange(6, dtype=np.uint8).reshape(2, 3)
    assert frames.grey_of(Frame(camera="c", pixels=pixels, captured_at=0.0, sequence=1)) is pixels
