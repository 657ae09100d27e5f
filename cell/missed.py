"""Where grips failed lately: another place, and before that another part, is tried first.

The same picture gives the same mistake, so a fresh look alone does not help.
"""

from __future__ import annotations

import math
from typing import Final

from drivers.types import ToolPose
from vision.types import Floats

NEAR_M: Final = 0.010
LOOKS: Final = 5


class MissedParts:
    """Remembers failed grasps for a few looks. Used by the cell thread only."""

    def __init__(self, looks: int = LOOKS, near_m: float = NEAR_M) -> None:
        self._looks = looks
        self._near_m = near_m
        self._missed: list[tuple[ToolPose, Floats, int]] = []

    def new_look(self) -> None:
        """A picture was taken: every memory is one look older, the oldest are dropped."""
        self._missed = [(pose, middle, left - 1) for pose, middle, left in self._missed if left > 1]

    def remember(self, grasp: ToolPose, middle_m: Floats) -> None:
        """A grip at this pose, on a part with its middle at (3,) m in the base frame, held nothing."""
        if self._looks:
            self._missed.append((grasp, middle_m, self._looks))

    def grip(self, grasp: ToolPose) -> bool:
        """True when a grip near this one failed lately."""
        return any(math.dist(grasp.six()[:3], pose.six()[:3]) < self._near_m for pose, _, _ in self._missed)

    def part(self, middle_m: Floats) -> bool:
        """True when a grip on a part with its middle near this one failed lately."""
        return any(math.dist(middle_m, middle) < self._near_m for _, middle, _ in self._missed)
