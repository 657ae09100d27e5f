"""Whether the places of a configuration suit its arm: what can be said before the arm is asked.

The watch position must be away from limits and singularities, because every pick starts there. The corners of
the workspace are tried as picks would be: over, down, and the hand turned either way.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np

from cell import frames
from cell.config import CellConfig
from drivers.interfaces import Kinematics
from drivers.types import Check, JointAngles, NotReachable, ToolPose


def checks(config: CellConfig, kinematics: Kinematics) -> tuple[Check, ...]:
    """Watch position, drop position, corners of the workspace."""
    return (*_postures(config, kinematics), _corners(config, kinematics))


def why(against: NotReachable) -> str:
    """A refusal with its number, for a person."""
    joint = "" if against.joint is None else f" (joint {against.joint + 1})"
    if against.unit == "m":
        return f"{against.limit.value}{joint}: {against.value:.3f} m, limit {against.bound:.3f} m"
    return (
        f"{against.limit.value}{joint}: {math.degrees(against.value):.1f} deg, "
        f"limit {math.degrees(against.bound):.1f} deg"
    )


def _postures(config: CellConfig, kinematics: Kinematics) -> Iterator[Check]:
    for key in ("watch_q_rad", "drop_q_rad"):
        joints = JointAngles(q_rad=getattr(config.workspace, key))
        against = kinematics.refused(joints, ())
        yield Check(
            what=f"workspace.{key}",
            ok=against is None,
            found="inside its box, away from limits and singularities" if against is None else why(against),
            do="" if against is None else f"move the arm to a better posture and copy its joints to {key}",
        )


def _corners(config: CellConfig, kinematics: Kinematics) -> Check:
    """The eight corners of the workspace as picks, by the better of four turns of the hand."""
    space = config.workspace
    start = JointAngles(q_rad=space.watch_q_rad)
    refused: list[tuple[ToolPose, NotReachable]] = []
    tried = 0
    for x, y, z in itertools.product(*zip(space.box_min_m, space.box_max_m, strict=True)):
        tried += 1
        first: tuple[ToolPose, NotReachable] | None = None
        for yaw in (0.0, math.pi / 2, math.pi, -math.pi / 2):
            at = frames.tool_down(np.array([x, y, z]), yaw)
            against = kinematics.refused(start, (frames.raised(at, max(space.travel_z_m, z)), at))
            if against is None:
                break
            first = first or (at, against)
        else:
            assert first is not None
            refused.append(first)
    if not refused:
        return Check(what="workspace", ok=True, found=f"all {tried} corners are within reach")
    at, against = refused[0]
    return Check(
        what="workspace",
        ok=False,
        found=f"{len(refused)} of {tried} corners are out of reach; "
        f"[{at.x:.3f}, {at.y:.3f}, {at.z:.3f}]: {why(against)}",
        do="parts there will be refused: move the bin or the arm, choose another watch_q_rad, or change the "
        "box of the workspace or of the tool",
    )
