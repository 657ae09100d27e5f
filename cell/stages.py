"""Seconds by stage of one order."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from cell.station import Stage, Station


@dataclass(slots=True)
class Times:
    """Seconds by stage of one order; a stage that comes twice adds up."""

    spent_s: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, station: Station, stage: Stage) -> Iterator[None]:
        """Time a stage and tell the station that it began."""
        station.progress(stage)
        began_at = station.clock.now()
        try:
            yield
        finally:
            self.add(stage.value, station.clock.now() - began_at)

    def add(self, name: str, seconds: float) -> None:
        """Count time for a stage."""
        self.spent_s[name] = round(self.spent_s.get(name, 0.0) + seconds, 4)
