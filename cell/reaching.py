"""Picks the arm cannot reach are refused while planning, with the number that stands against them.

The way is the one that is driven: from where the arm stands over the part, down to it, and up again the same
line. The jaws close alike after half a turn of the hand; where one turn is out of reach the other is tried.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from cell import frames
from cell.planning import PlanRefusal, PlanRefused, Reach
from cell.types import Pick
from drivers.interfaces import Kinematics
from drivers.types import JointAngles, NotReachable, ReachLimit, ToolPose
from vision import transforms
from vision.types import Transform

_REASONS: Final = {
    ReachLimit.BOX: PlanRefusal.WORKSPACE,
    ReachLimit.TOO_FAR: PlanRefusal.REACH,
    ReachLimit.TOO_NEAR: PlanRefusal.REACH,
    ReachLimit.JOINT: PlanRefusal.JOINT,
    ReachLimit.WRIST: PlanRefusal.SINGULARITY,
    ReachLimit.ELBOW: PlanRefusal.SINGULARITY,
    ReachLimit.SHOULDER: PlanRefusal.SINGULARITY,
    ReachLimit.SWING: PlanRefusal.POSTURE,
}
_HALF_TURN: Final = Transform(rotation=np.diag([-1.0, -1.0, 1.0]), translation=np.zeros(3))


def reach_of(kinematics: Kinematics, joints: JointAngles) -> Reach:
    """Judges picks by what is known of the arm, which stands at ``joints``."""

    def judge(pick: Pick) -> Pick | PlanRefused:
        against = kinematics.refused(joints, _way(pick))
        if against is None:
            return pick
        turned = replace(
            pick,
            approach=_turned(pick.approach),
            grasp=_turned(pick.grasp),
            retreat=_turned(pick.retreat),
        )
        if kinematics.refused(joints, _way(turned)) is None:
            return turned
        return _refusal(against)

    return judge


def anywhere(pick: Pick) -> Pick:
    """For plans without an arm: every pick is within reach."""
    return pick


def _way(pick: Pick) -> tuple[ToolPose, ...]:
    """Over the part, to where the descent begins, and down; up again is the same line the other way."""
    return (pick.retreat, pick.approach, pick.grasp)


def _turned(pose: ToolPose) -> ToolPose:
    """The same place with the hand turned by half a turn about itself."""
    return frames.pose_of(transforms.compose(frames.transform_of(pose), _HALF_TURN))


def _refusal(against: NotReachable) -> PlanRefused:
    return PlanRefused(
        reason=_REASONS[against.limit], value=against.value, limit=against.bound, unit=against.unit
    )
