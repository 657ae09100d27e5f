"""An observer that times the detector's stages: the detector itself knows no clock."""

from __future__ import annotations

from drivers.timing import Clock


class StageTimes:
    """Call it with each stage's product; ``durations_s`` holds the seconds since the product before."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._last_at = clock.now()
        self.durations_s: dict[str, float] = {}

    def __call__(self, stage: str, product: object) -> None:  # noqa: ARG002 - an observer's signature
        now = self._clock.now()
        self.durations_s[stage] = self.durations_s.get(stage, 0.0) + now - self._last_at
        self._last_at = now
