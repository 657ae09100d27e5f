"""What one look without motion has to go on."""

from __future__ import annotations

from dataclasses import dataclass

from cell.calibration import Calibration
from cell.config import CellConfig, PartConfig
from drivers.types import Pixels
from vision.types import Plane, Transform, Tuning


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sight:
    """What a look needs, wherever it came from. ``left``, ``right`` (H, W[, 3]) uint8; names for people;
    ``among`` other products that may lie there."""

    left: Pixels
    right: Pixels
    left_name: str
    right_name: str
    known: Calibration
    part: PartConfig
    tuning: Tuning
    table: Plane | None
    config: CellConfig | None
    base_from_camera: Transform | None
    among: tuple[PartConfig, ...] = ()

    @property
    def parts(self) -> tuple[PartConfig, ...]:
        """The part that is asked for, then what else may lie there."""
        return (self.part, *self.among)
