"""What a start knows of the time before it: orders that were cut short get their result now."""

from __future__ import annotations

from cell import handshake
from cell.handshake import Memory
from cell.journal import Journal
from cell.logs import logger
from cell.types import Outcome, PickResult
from drivers.types import ResultCode

log = logger("daemon")


def recollect(journal: Journal, boot: int) -> Memory:
    """The handshake's memory from the journal; what was accepted and never finished ends as interrupted.

    Raises
    ------
    JournalError
        The journal cannot be written, so nothing may be promised.
    """
    for seq in journal.interrupted():
        log.warning("order_interrupted_by_restart", request_id=seq)
        journal.finish(
            PickResult(
                request_id=seq,
                code=ResultCode.INTERRUPTED_BY_RESTART,
                outcome=Outcome.ABORTED,
                detail=int(Outcome.ABORTED),
            )
        )
    accepted, finished, acknowledged = journal.last()
    return handshake.begin(boot, accepted, None if acknowledged else finished)
