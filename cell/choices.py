"""What a person may choose after failed grips: command 10 with its number. A reset edge means skip."""

from __future__ import annotations

from enum import IntEnum
from typing import Final

from cell.types import Outcome, PickOrder, PickResult
from drivers.types import ResultCode


class Choice(IntEnum):
    """Parameter of command 10 (word 8). `FREE_PLACES` is not about grips: the tray has been changed."""

    RETRY = 1
    SKIP = 2
    COUNT_AS_PICKED = 3
    STOP = 4
    FREE_PLACES = 5


_NO_PART: Final = (ResultCode.GRIP_FAILED, ResultCode.PART_LOST)


class Asking:
    """Counts orders in a row that brought nothing, and remembers what is asked about. Cell thread only."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self.in_a_row = 0
        self.order: PickOrder | None = None

    def ended(self, order: PickOrder, result: PickResult) -> bool:
        """An order has ended; True when a person is to choose now."""
        if result.outcome is Outcome.PICKED:
            self.in_a_row = 0
        elif result.outcome is Outcome.MISSED and result.code in _NO_PART:
            self.in_a_row += 1
            if self._limit and self.in_a_row >= self._limit:
                self.order = order
        return self.order is not None

    def answered(self) -> PickOrder | None:
        """The order that was asked about; nothing is asked any more."""
        order, self.order = self.order, None
        self.in_a_row = 0
        return order
