"""What the cell thread and the PLC thread share: orders with their tokens, events, results, a report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from cell.states import Event
from cell.types import CellReport, PickOrder, PickResult
from cell.workers import Latest, Mailbox
from drivers.timing import StopToken

ABORTED_BY_PLC: Final = "abort by the PLC"
LINK_LOST: Final = "PLC link lost"
SERVICE_ENDS: Final = "service ends"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ticket:
    """An accepted order with the token that stops it, which its sender keeps."""

    order: PickOrder
    stop: StopToken


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Channels:
    """What the cell thread shares with the PLC thread.

    ``inbox`` orders and events in; ``results`` results out; ``report`` what it says of itself.
    """

    inbox: Mailbox[Ticket | Event]
    results: Mailbox[PickResult]
    report: Latest[CellReport]
