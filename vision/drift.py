"""Has the calibration moved? Told from what production sees anyway: no target, no extra pictures.

Two numbers per look. The rows of the two pictures must agree at every end of a part, whatever lies there:
their offset shows cameras that turned against each other. A common error of scale (a baseline that is longer
than told) hides from that, but not from the measured length of parts whose length is known. Each is smoothed
(exponentially weighted moving average, Roberts 1959, here with the weight of an average over the first looks)
and compared with where it stood after commissioning. Nothing is ever corrected by this.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

SETTLED_LOOKS: Final = 8
"""Before so many looks a trend has no say, and where it stands then is what later ones are compared with."""
LEAST_ENDS: Final = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Trend:
    """One smoothed number. ``value`` the average now, ``reference`` where it stood when it had settled (NaN
    before), ``looks`` how many went in."""

    value: float = 0.0
    reference: float = float("nan")
    looks: int = 0

    @property
    def settled(self) -> bool:
        """Whether it has a say."""
        return self.looks >= SETTLED_LOOKS


@dataclass(frozen=True, slots=True, kw_only=True)
class Drift:
    """Both trends: ``rows_px`` and ``length`` (measured over true, 1 where all is well)."""

    rows_px: Trend = Trend()
    length: Trend = Trend()


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """How far the trends may go."""

    rows_px: float
    length: float
    memory_looks: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Drifted:
    """One alarm: ``what`` went to ``value`` from ``reference``, beyond ``limit``."""

    what: str
    value: float
    reference: float
    limit: float
    unit: str


def take(trend: Trend, value: float, memory_looks: float) -> Trend:
    """One more look."""
    looks = trend.looks + 1
    weight = max(1.0 / looks, 1.0 / memory_looks)
    moved = trend.value + weight * (value - trend.value)
    reference = moved if looks == SETTLED_LOOKS else trend.reference
    return replace(trend, value=moved, reference=reference, looks=looks)


def observe(
    drift: Drift,
    row_offset_px: float | None,
    lengths_m: Sequence[float],
    true_length_m: float,
    limits: Limits,
) -> Drift:
    """What one look says. ``row_offset_px`` None where too few ends were seen."""
    rows, length = drift.rows_px, drift.length
    if row_offset_px is not None and np.isfinite(row_offset_px):
        rows = take(rows, row_offset_px, limits.memory_looks)
    measured = np.array([value for value in lengths_m if np.isfinite(value)])
    if len(measured):
        length = take(length, float(np.median(measured)) / true_length_m, limits.memory_looks)
    return Drift(rows_px=rows, length=length)


def alarms(drift: Drift, limits: Limits) -> tuple[Drifted, ...]:
    """Trends beyond their limits. Rows are compared with their own beginning and with nothing at all,
    because a rig that was off from the first day has not drifted but is as wrong; lengths with the true
    length."""
    found = []
    rows, length = drift.rows_px, drift.length
    if rows.settled:
        for reference in (rows.reference, 0.0):
            if abs(rows.value - reference) > limits.rows_px:
                found.append(
                    Drifted(
                        what="rows of the two pictures",
                        value=rows.value,
                        reference=reference,
                        limit=limits.rows_px,
                        unit="px",
                    )
                )
                break
    if length.settled and abs(length.value - 1.0) > limits.length:
        found.append(
            Drifted(
                what="measured over true length of parts",
                value=length.value,
                reference=1.0,
                limit=limits.length,
                unit="",
            )
        )
    return tuple(found)
