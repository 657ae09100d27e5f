"""Where grips failed lately: such parts are tried last, because the same picture gives the same mistake."""

from __future__ import annotations

import math
from typing import Final

from drivers.types import ToolPose

_NEAR_M: Final = 0.010
_LOOKS: Final = 5


class MissedParts:
    """Remembers failed grasps for a few looks. Used by the cell thread only."""

    def __init__(self) -> None:
        self._missed: list[tuple[ToolPose, int]] = []

    def new_look(self) -> None:
        """A picture was taken: every memory is one look older, the oldest are dropped."""
        self._missed = [(pose, left - 1) for pose, left in self._missed if left > 1]

    def remember(self, grasp: ToolPose) -> None:
        """A grip at this pose held nothing."""
        self._missed.append((grasp, _LOOKS))

    def holds(self, grasp: ToolPose) -> bool:
        """True when a grip within a centimetre failed lately."""
        return any(math.dist(grasp.six()[:3], pose.six()[:3]) < _NEAR_M for pose, _ in self._missed)
