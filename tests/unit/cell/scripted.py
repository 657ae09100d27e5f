"""An order on a cell of doubles whose detector gives written scenes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cell.cycle import run_order
from cell.types import PickOrder, PickResult
from drivers.timing import StopToken
from drivers.types import (
    JointAngles,
    ToolPose,
)
from tests.fakes.station import Bench, stick
from vision.types import Refusal, Refused, Scene

FREE = stick((-0.04, -0.45, 0.022), (0.04, -0.45, 0.022))
SECOND = stick((-0.04, -0.38, 0.022), (0.04, -0.38, 0.022))
TOO_SHORT = Refused(reason=Refusal.LENGTH, value=0.03, limit=0.004, unit="m")
REFUSED = stick((-0.04, -0.52, 0.022), (0.0, -0.52, 0.022), refusals=(TOO_SHORT,))


@dataclass(slots=True)
class Eyes:
    """Stands in for the detector: gives the written scenes in order, the last one for ever."""

    scenes: list[Scene | Exception]
    looked: int = 0
    pictures: list[bytes] = field(default_factory=list)

    def __call__(
        self, left: np.ndarray[tuple[int, int], np.dtype[np.uint8]], *_: object, **__: object
    ) -> Scene:
        self.looked += 1
        self.pictures.append(left.tobytes())
        answer = self.scenes[min(self.looked, len(self.scenes)) - 1]
        if isinstance(answer, Exception):
            raise answer
        return answer


def ran(cell: Bench, wanted: PickOrder, stop: StopToken | None = None) -> PickResult:
    return run_order(cell.station, wanted, stop or StopToken(cell.clock))


def joints(cell: Bench) -> list[str]:
    """The named joint positions the arm was sent to."""
    names = {cell.station.workspace.watch_q_rad: "watch", cell.station.workspace.drop_q_rad: "drop"}
    return [names[t.q_rad] for t in cell.robot.targets if isinstance(t, JointAngles)]


def lines(cell: Bench) -> list[ToolPose]:
    return [t for t in cell.robot.targets if isinstance(t, ToolPose)]
