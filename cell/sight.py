"""What one look has to go on, as a record."""

from __future__ import annotations

from dataclasses import dataclass

from cell.config import PartConfig
from cell.mounting import View
from cell.stopwatch import StageTimes
from cell.types import PickOrder
from drivers.types import FramePair, Pixels
from vision.types import Grey, Transform


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sight:
    """What one look has to go on: the pair and its pictures, and where the tool was when they were taken."""

    order: PickOrder
    part: PartConfig
    among: tuple[PartConfig, ...]
    pair: FramePair
    left: Grey
    right: Grey
    colour: Pixels | None
    tool: Transform
    view: View
    watch: StageTimes
