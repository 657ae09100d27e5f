"""Where a camera is, told by a board that is seen from several poses of an arm: records and closed forms.

Two mountings, one equation. ``mount_from_camera`` is ``base_from_camera`` of a camera that stands beside the
arm and ``tool_from_camera`` of one on it; ``held_from_board`` is ``tool_from_board`` in the first case (the
arm holds the board) and ``base_from_board`` in the second. With ``held_from_mount`` the arm's pose turned
round as the mounting asks, every look says

    camera_from_board = inverse(mount_from_camera) mount_from_held held_from_board

The closed forms are OpenCV's; they are compared, and the best one starts the fit of `vision.handeye_fit`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import cv2
import numpy as np

from vision import transforms
from vision.types import Floats, Transform

Mount: TypeAlias = Literal["fixed", "tool"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sighting:
    """One pose of the arm with what the cameras saw of the board.

    ``board_left_m`` (N, 3) corners in the board's frame and ``left_px`` (N, 2) where the left picture has
    them (raw pixels); the same for the right one, (0, 3) and (0, 2) where there is none.
    """

    name: str
    base_from_tool: Transform
    board_left_m: Floats
    left_px: Floats
    board_right_m: Floats
    right_px: Floats

    @property
    def corners(self) -> int:
        """How many corners both pictures show together."""
        return len(self.left_px) + len(self.right_px)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HandEye:
    """The two unknowns of the equation above."""

    mount_from_camera: Transform
    held_from_board: Transform


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClosedForm:
    """What one closed form made of the poses; ``found`` None where it gave up or gave nonsense."""

    name: str
    found: HandEye | None


HAND_EYE: Final = {
    "Tsai": cv2.CALIB_HAND_EYE_TSAI,
    "Park": cv2.CALIB_HAND_EYE_PARK,
    "Horaud": cv2.CALIB_HAND_EYE_HORAUD,
    "Andreff": cv2.CALIB_HAND_EYE_ANDREFF,
    "Daniilidis": cv2.CALIB_HAND_EYE_DANIILIDIS,
}
ROBOT_WORLD: Final = {
    "Shah": cv2.CALIB_ROBOT_WORLD_HAND_EYE_SHAH,
    "Li": cv2.CALIB_ROBOT_WORLD_HAND_EYE_LI,
}
LEAST_POSES: Final = 3


def mount_from_held(sighting: Sighting, mount: Mount) -> Transform:
    """The arm's pose as the equation has it."""
    return sighting.base_from_tool if mount == "fixed" else transforms.invert(sighting.base_from_tool)


def closed_forms(
    mount_from_helds: Sequence[Transform], camera_from_boards: Sequence[Transform]
) -> tuple[ClosedForm, ...]:
    """All of OpenCV's, each with what it found.

    `cv2.calibrateHandEye` may return no motion at all without an error (opencv/opencv#27625), and takes its
    method by name only (#24871): both are met here.
    """
    if len(mount_from_helds) < LEAST_POSES:
        return tuple(ClosedForm(name=name, found=None) for name in (*HAND_EYE, *ROBOT_WORLD))
    arms = [transforms.invert(each) for each in mount_from_helds]
    forms = []
    for name, method in HAND_EYE.items():
        try:
            rotation, shift = cv2.calibrateHandEye(
                R_gripper2base=[a.rotation for a in arms],
                t_gripper2base=[a.translation.reshape(3, 1) for a in arms],
                R_target2cam=[b.rotation for b in camera_from_boards],
                t_target2cam=[b.translation.reshape(3, 1) for b in camera_from_boards],
                method=method,
            )
        except cv2.error:
            forms.append(ClosedForm(name=name, found=None))
            continue
        camera = _transform(np.asarray(rotation), np.asarray(shift))
        if camera is None:
            forms.append(ClosedForm(name=name, found=None))
            continue
        boards = [
            transforms.compose(transforms.invert(held), camera, board)
            for held, board in zip(mount_from_helds, camera_from_boards, strict=True)
        ]
        found = HandEye(mount_from_camera=camera, held_from_board=transforms.average(boards))
        forms.append(ClosedForm(name=name, found=found))
    for name, method in ROBOT_WORLD.items():
        try:
            base, shift_base, eye, shift_eye = cv2.calibrateRobotWorldHandEye(
                R_world2cam=[b.rotation for b in camera_from_boards],
                t_world2cam=[b.translation.reshape(3, 1) for b in camera_from_boards],
                R_base2gripper=[m.rotation for m in mount_from_helds],
                t_base2gripper=[m.translation.reshape(3, 1) for m in mount_from_helds],
                method=method,
            )
        except cv2.error:
            forms.append(ClosedForm(name=name, found=None))
            continue
        board = _transform(np.asarray(base), np.asarray(shift_base))
        back = _transform(np.asarray(eye), np.asarray(shift_eye))
        forms.append(
            ClosedForm(
                name=name,
                found=None
                if board is None or back is None
                else HandEye(
                    mount_from_camera=transforms.invert(back), held_from_board=transforms.invert(board)
                ),
            )
        )
    return tuple(forms)


def _transform(rotation: Floats, shift: Floats) -> Transform | None:
    """None for what is no motion, or none at all (what a failed closed form returns)."""
    if not (np.isfinite(rotation).all() and np.isfinite(shift).all()):
        return None
    if np.array_equal(rotation, np.eye(3)) and not np.any(shift):
        return None
    try:
        return transforms.make(transforms.nearest_rotation(rotation), shift.reshape(3))
    except (ValueError, np.linalg.LinAlgError):
        return None


def camera_from_board(found: HandEye, held: Transform) -> Transform:
    """What the equation says of one look."""
    return transforms.compose(transforms.invert(found.mount_from_camera), held, found.held_from_board)
