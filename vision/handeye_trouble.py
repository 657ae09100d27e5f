"""What can be wrong with a hand-eye session, each with its name, and the tests that need no solution: motion,
pairs, mirrored boards, sizes.

A small residual shows none of it: a wrong pitch, a mirrored board or two swapped cameras fit well, or badly
for a reason nobody would guess.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Final, Literal

import numpy as np

from vision import transforms
from vision.handeye import HandEye, Sighting
from vision.handeye_fit import Fit, Noise, board_pose, fit
from vision.types import StereoModel, Transform

LEAST_POSES: Final = 6
ADVISED_POSES: Final = 15
LEAST_TURN_RAD: Final = np.deg2rad(20.0)
"""The largest turn between two poses must reach this: below, errors of the arm and of corners are all there
is."""
LEAST_SECOND_RAD: Final = np.deg2rad(5.0)
"""So much the poses must turn about a second axis: with one alone the place along it stays unknown."""
WRONG_RMS_PX: Final = 2.0
"""No session whose poses belong together leaves this much."""
SCALE_LEAST, SCALE_SIGMAS = 0.003, 5.0
"""Three in a thousand: below that a board is printed as well as a rule reads it."""
PAIRS_TRIED: Final = 7
PAIR_PX: Final = 1.5
"""Left and right picture of one board agree within this unless cameras, calibration or pairs are mixed up."""
_STILL: Final = Noise(arm_m=0.0, arm_rad=0.0)


class Trouble(Enum):
    """What can be wrong with a session. Values are what a person reads first."""

    TOO_FEW = "too few poses"
    WEAK_MOTION = "the poses turn too little"
    ONE_AXIS = "the poses turn about one axis only"
    WRONG_POSE = "a pose does not belong to the others"
    WRONG_PITCH = "the board is not as large as told"
    WRONG_RIG = "the cameras' baseline is not as long as calibrated"
    MIRRORED = "the board is seen mirrored"
    SWAPPED = "left and right camera are swapped"
    NOT_A_PAIR = "the two pictures of a pose do not show one board"
    INVERTED = "the poses are of the base seen from the tool"
    OTHER_MOUNT = "the camera is mounted the other way than told"
    NO_FIT = "the poses and the pictures do not belong together"


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One trouble: ``value`` against ``limit`` in ``unit``, and which poses (places in the session)."""

    trouble: Trouble
    value: float
    limit: float
    unit: Literal["m", "rad", "px", "1"]
    poses: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """How far the poses spread: the largest turn between two, what is turned about a second axis (root mean
    square over all pairs), and the largest distance between two tools."""

    largest_rad: float
    second_rad: float
    reach_m: float


def motion_of(poses: Sequence[Transform]) -> Motion:
    """The spread of the arm's poses."""
    turns, reach = [], 0.0
    for i, one in enumerate(poses):
        for other in poses[i + 1 :]:
            turns.append(transforms.vector_from_matrix(one.rotation.T @ other.rotation))
            reach = max(reach, float(np.linalg.norm(one.translation - other.translation)))
    if not turns:
        return Motion(largest_rad=0.0, second_rad=0.0, reach_m=0.0)
    vectors = np.array(turns)
    spread = np.linalg.svd(vectors, compute_uv=False) / np.sqrt(len(vectors))
    second = float(spread[1]) if len(spread) > 1 else 0.0
    return Motion(largest_rad=float(np.linalg.norm(vectors, axis=1).max()), second_rad=second, reach_m=reach)


def weak(motion: Motion, count: int) -> tuple[Finding, ...]:
    """What stands against solving at all; asked before any solving."""
    found = []
    if count < LEAST_POSES:
        found.append(Finding(trouble=Trouble.TOO_FEW, value=count, limit=LEAST_POSES, unit="1"))
    if motion.largest_rad < LEAST_TURN_RAD:
        found.append(
            Finding(
                trouble=Trouble.WEAK_MOTION, value=motion.largest_rad, limit=float(LEAST_TURN_RAD), unit="rad"
            )
        )
    elif motion.second_rad < LEAST_SECOND_RAD:
        found.append(
            Finding(
                trouble=Trouble.ONE_AXIS, value=motion.second_rad, limit=float(LEAST_SECOND_RAD), unit="rad"
            )
        )
    return tuple(found)


def no_fit(rms_px: float) -> Finding:
    """Nothing explains the session."""
    return Finding(trouble=Trouble.NO_FIT, value=rms_px, limit=WRONG_RMS_PX, unit="px")


def scales(scaled: Fit) -> list[Finding]:
    """Sizes that the arm contradicts."""
    found = []
    for trouble, scale, sigma in (
        (Trouble.WRONG_PITCH, scaled.board_scale, scaled.board_scale_sigma),
        (Trouble.WRONG_RIG, scaled.rig_scale, scaled.rig_scale_sigma),
    ):
        if not np.isfinite(sigma):
            continue
        limit = max(SCALE_LEAST, SCALE_SIGMAS * sigma)
        if abs(scale - 1.0) > limit:
            found.append(Finding(trouble=trouble, value=scale, limit=limit, unit="1"))
    return found


def mirrored(boards: Sequence[Transform]) -> Finding | None:
    """A board has its back to the camera only when its corners are numbered mirrored: paper shows nothing
    from behind. Its z axis points into it, away from the camera."""
    away = np.array([board.rotation[2, 2] for board in boards])
    share = float(np.mean(away < 0))
    if share <= 0.5:
        return None
    return Finding(trouble=Trouble.MIRRORED, value=share, limit=0.5, unit="1")


def pairs(sightings: Sequence[Sighting], stereo: StereoModel) -> Finding | None:
    """Whether the two pictures of each pose show one board as this pair of cameras would."""
    both = [s for s in sightings if len(s.left_px) >= 6 and len(s.right_px) >= 6]
    both = both[:: max(1, len(both) // PAIRS_TRIED)]
    if not both:
        return None
    told = float(np.median([_pair_px(s, stereo) for s in both]))
    if told <= PAIR_PX:
        return None
    swapped = float(np.median([_pair_px(_swap(s), stereo) for s in both]))
    named = Trouble.SWAPPED if swapped < 0.25 * told else Trouble.NOT_A_PAIR
    return Finding(trouble=named, value=told, limit=PAIR_PX, unit="px")


def _pair_px(sighting: Sighting, stereo: StereoModel) -> float:
    """What the best pose of the board leaves in both pictures, with the board's size free: its pitch is no
    business of this test."""
    pose = board_pose(sighting, stereo)
    if pose is None:
        return float("inf")
    still = HandEye(mount_from_camera=transforms.identity(), held_from_board=pose)
    alone = replace(sighting, base_from_tool=transforms.identity())
    free = fit([alone], stereo, "fixed", still, _STILL, robust=False, scales=1)
    return float(free.pose_px[0])


def _swap(sighting: Sighting) -> Sighting:
    return replace(
        sighting,
        board_left_m=sighting.board_right_m,
        left_px=sighting.right_px,
        board_right_m=sighting.board_left_m,
        right_px=sighting.left_px,
    )
