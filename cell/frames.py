"""The two vocabularies meet: the detector's `Transform`, the robot's `ToolPose`, frames to grey pictures."""

from __future__ import annotations

import cv2
import numpy as np

from drivers.types import Frame, ToolPose
from vision import transforms
from vision.types import Floats, Grey, Transform


def pose_of(base_from_tool: Transform) -> ToolPose:
    """The robot's six numbers of a transform: metres and a rotation vector."""
    x, y, z = (float(v) for v in base_from_tool.translation)
    rx, ry, rz = (float(v) for v in transforms.vector_from_matrix(base_from_tool.rotation))
    return ToolPose(x=x, y=y, z=z, rx=rx, ry=ry, rz=rz)


def transform_of(pose: ToolPose) -> Transform:
    """``base_from_tool`` of the robot's six numbers."""
    rotation = transforms.matrix_from_vector(np.array([pose.rx, pose.ry, pose.rz]))
    return transforms.make(rotation, np.array([pose.x, pose.y, pose.z]))


def tool_down(point_m: Floats, closing_yaw_rad: float) -> ToolPose:
    """A tool that looks straight down.

    Parameters
    ----------
    point_m
        (3,) m in the base frame: where the tool centre point is to be.
    closing_yaw_rad
        Direction in which the jaws close (the tool's x axis), about the base's z axis.
    """
    return tool_at(point_m, looking_down(closing_yaw_rad))


def looking_down(closing_yaw_rad: float) -> Floats:
    """(3, 3) rotation ``base_from_tool`` of a tool that looks straight down."""
    c, s = np.cos(closing_yaw_rad), np.sin(closing_yaw_rad)
    # columns: x along the closing direction, z down, y = z cross x
    return np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])


def tool_at(point_m: Floats, rotation: Floats) -> ToolPose:
    """The tool centre point at (3,) m, turned as ``base_from_tool``'s (3, 3) rotation says."""
    return pose_of(transforms.make(rotation, point_m))


def backed_out(point_m: Floats, rotation: Floats, z_m: float) -> ToolPose:
    """The tool drawn back along its own z axis until its point is at this height."""
    back = -rotation[:, 2]
    point = point_m + back * ((z_m - point_m[2]) / back[2])
    return tool_at(np.array([point[0], point[1], z_m]), rotation)


def raised(pose: ToolPose, z_m: float) -> ToolPose:
    """The same pose at another height in the base frame."""
    return ToolPose(x=pose.x, y=pose.y, z=z_m, rx=pose.rx, ry=pose.ry, rz=pose.rz)


def grey_of(frame: Frame) -> Grey:
    """(H, W) uint8 of a frame, whatever its channels."""
    pixels = frame.pixels
    if pixels.ndim == 2:
        return pixels
    return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
