"""Whether a motion that was started has begun, goes on, has arrived: judged from the controller's own state.

The library's words are not enough: it answers True for stops it lost, "not running" for motions that still
run, and calls a link connected that is dead. Arrived means all of: the motion asked for is the one that
ended, the arm stands, its safety system and its program are as they were, and it is where it was sent.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from typing import Final

from drivers.errors import CommandRejected, DeviceTimeout, SafetyStop
from drivers.robot.ur_codes import Runtime, runtime_name
from drivers.robot.ur_stream import Snapshot

BEGIN_S: Final = 0.5
"""A motion that was accepted has begun within this time."""
SETTLE_S: Final = 0.3
"""A motion that ended has come to rest within this time."""
_IDS: Final = 128


class Progress(Enum):
    """How far a motion is."""

    UNDER_WAY = "under_way"
    ARRIVED = "arrived"


class Watch:
    """One motion, from its start to its end. ``before`` is the state right before it was asked for.

    ``missed`` says what is missing from a state to the target, None when nothing is.
    """

    def __init__(
        self, name: str, before: Snapshot, missed: Callable[[Snapshot], str | None], started_at: float
    ) -> None:
        self._name = name
        self._before_id = before.operation_id
        self._missed = missed
        self._started_at = started_at
        self._ended_at: float | None = None

    def look(self, now: Snapshot, at: float) -> Progress:
        """Judge one state.

        Raises
        ------
        SafetyStop
            The safety system stopped the arm.
        CommandRejected
            The program ended, or somebody else started a motion.
        DeviceTimeout
            It did not begin, or ended short of its target.
        """
        if not now.may_move:
            raise SafetyStop(self._name, now.safety)
        if now.runtime != Runtime.PLAYING:
            raise CommandRejected(
                self._name,
                f"the control program ended under way ({runtime_name(now.runtime)}): "
                "stopped at the panel, or by the controller",
            )
        if now.operation_id == self._before_id:
            if at - self._started_at > BEGIN_S:
                raise DeviceTimeout(self._name, f"the motion did not begin within {BEGIN_S:.1f} s")
            return Progress.UNDER_WAY
        if now.operation_id != (self._before_id + 1) % _IDS:
            raise CommandRejected(self._name, "a motion was started by somebody else")
        if now.operation_runs:
            self._ended_at = None
            return Progress.UNDER_WAY
        missing = self._missed(now)
        if missing is None and not now.moving:
            return Progress.ARRIVED
        self._ended_at = at if self._ended_at is None else self._ended_at
        if at - self._ended_at > SETTLE_S:
            raise DeviceTimeout(self._name, f"the motion ended early: {missing or 'the arm does not rest'}")
        return Progress.UNDER_WAY
