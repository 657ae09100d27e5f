"""What is known of the simulated arm without asking it: nothing, its shape stands in the world's file."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.types import JointAngles, NotReachable, ToolPose


class AskTheArm:
    """Satisfies `drivers.interfaces.Kinematics`: whether it reaches a place is the arm's to say."""

    def refused(self, start: JointAngles, way: Sequence[ToolPose]) -> NotReachable | None:  # noqa: ARG002
        """Nothing is known against any way."""
        return None
