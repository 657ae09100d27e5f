"""The arm during commissioning: slow, one motion at a time, each with a yes; Ctrl-C halts it."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Final

import numpy as np

from cell.errors import UsageError
from cell.frames import pose_of, transform_of
from drivers.interfaces import Robot, WatchedArm
from drivers.timing import Clock, StopToken
from drivers.types import JointAngles, JointMotion, LineMotion, RobotState
from vision import transforms
from vision.types import Transform

SLOW_M_S, SLOW_RAD_S = 0.06, 0.25
SETTLED_M, SETTLED_RAD = 5e-5, 2e-4
"""Two readings of a resting arm differ by less."""
SETTLE_READS: Final = 3
SETTLE_STEP_S: Final = 0.15
SETTLE_S: Final = 10.0
TIMEOUT_S: Final = 60.0
PATIENCE_S: Final = 15.0
"""For a pair of pictures: nobody waits for a pick here."""


class NotSettled(UsageError):
    """The arm did not come to rest."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LedArm:
    """An open arm that a person leads, with the token that ends the waiting for it."""

    robot: WatchedArm
    stop: StopToken

    def settled(self) -> RobotState:
        """Wait until the arm rests, and say where.

        Raises
        ------
        NotSettled
            It still moves after `SETTLE_S`.
        """
        until = self.stop.clock.now() + SETTLE_S
        still, before = 0, self.robot.state()
        while self.stop.clock.now() < until:
            self.stop.wait(SETTLE_STEP_S)
            now = self.robot.state()
            still = 0 if now.moving or apart(before, now) else still + 1
            before = now
            if still >= SETTLE_READS:
                return now
        raise NotSettled(f"the arm did not come to rest within {SETTLE_S:.0f} s")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SlowArm(LedArm):
    """An open arm with the token that halts it."""

    robot: Robot

    def line(self, base_from_tool: Transform, speed_m_s: float = SLOW_M_S) -> None:
        """Straight there, slowly."""
        motion = LineMotion(speed_m_s=speed_m_s, accel_m_s2=0.3, timeout_s=TIMEOUT_S)
        self.robot.move_line(pose_of(base_from_tool), motion, self.stop)

    def joints(self, target: JointAngles) -> None:
        """Through joint space, slowly."""
        motion = JointMotion(speed_rad_s=SLOW_RAD_S, accel_rad_s2=0.5, timeout_s=TIMEOUT_S)
        self.robot.move_joints(target, motion, self.stop)


def apart(one: RobotState, other: RobotState) -> bool:
    """Whether two readings of an arm are of two places."""
    a, b = transform_of(one.tool), transform_of(other.tool)
    return (
        float(np.linalg.norm(a.translation - b.translation)) > SETTLED_M
        or transforms.rotation_distance_rad(a.rotation, b.rotation) > SETTLED_RAD
    )


@contextmanager
def halted_by_ctrl_c(clock: Clock) -> Iterator[StopToken]:
    """A token that fires on Ctrl-C and SIGTERM, so that a motion is halted before the command ends."""
    token = StopToken(clock)

    def ask(number: int, _frame: FrameType | None) -> None:
        token.stop(f"asked to end ({signal.Signals(number).name})")

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield token
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
