"""Configuration of what is verified and watched: touch test and drift."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field, PositiveFloat

from drivers.settings import Settings


class DriftConfig(Settings):
    """When production says that the calibration has moved. Limits of the smoothed values (EWMA)."""

    row_limit_px: PositiveFloat = Field(
        default=0.5, description="rows of the two pictures, smoothed, may differ by this from commissioning"
    )
    length_limit: PositiveFloat = Field(
        default=0.01, description="measured over true length of parts, smoothed, may be off 1 by this share"
    )
    memory_looks: PositiveFloat = Field(
        default=20.0, description="looks after which an old one counts a third: weight 1/memory each"
    )


class CommissioningConfig(Settings):
    """Relative paths are relative to the folder of the journal, which is writable and kept."""

    touch_tolerance_m: PositiveFloat = Field(default=0.001, description="largest error of a touched point")
    touch_history: Path = Field(
        default=Path("touch-history.jsonl"), description="every touch test, a line each"
    )
    drift: DriftConfig = DriftConfig()
    drift_file: Path = Field(default=Path("drift.json"), description="the trend, kept from run to run")
