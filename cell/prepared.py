"""A look that was taken ahead, while the last part was on its way to its place.

It may be used by the next order for the same part while it is young, and while nothing has gone wrong since:
whatever may have changed the bin drops it, and the order looks anew.
"""

from __future__ import annotations

from dataclasses import dataclass

from cell.finding import Finding
from cell.sight import Sight
from cell.types import PickOrder


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ready:
    """A sight with the search that was begun in it, from pictures exposed after ``clear_at``."""

    sight: Sight
    finding: Finding
    clear_at: float


class Prepared:
    """At most one look ahead. Used by the cell thread."""

    def __init__(self) -> None:
        self._ready: Ready | None = None

    def begin(self, sight: Sight, finding: Finding, clear_at: float) -> None:
        """Search in this sight from now on."""
        self.drop()
        finding.start()
        self._ready = Ready(sight=sight, finding=finding, clear_at=clear_at)

    def take(self, order: PickOrder, max_age_s: float, now: float) -> Ready | None:
        """The look, for an order it suits; it is the caller's then. Any other is dropped."""
        ready = self._ready
        if ready is None:
            return None
        suits = ready.sight.order.part_code == order.part_code
        suits = suits and ready.sight.order.source_id == order.source_id
        if not suits or now - ready.clear_at > max_age_s:
            self.drop()
            return None
        self._ready = None
        return ready

    def drop(self) -> None:
        """Not to be used any more; the search ends at its next stage."""
        ready, self._ready = self._ready, None
        if ready is not None:
            ready.finding.abandon()
