"""Writes a journal as fast as it can, in children that are there to be killed.

``python -m tests.system.journal_writer JOURNAL``: each line on standard input starts a child, whose number is
printed; the child goes on where the journal ends and prints what it would have told the PLC, after it was
durable: ``took N``, ``moved N`` and ``ended N``. When it has been killed, ``gone`` is printed.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import NoReturn

from cell.journal import Journal
from cell.recollection import recollect
from cell.types import Outcome, PickResult
from drivers.plc_map import next_sequence
from drivers.types import ResultCode
from tests.fakes.station import order


def say(text: str) -> None:
    os.write(1, f"{text}\n".encode())  # one write each: whole or not at all


def work(path: Path) -> NoReturn:
    """Order after order until somebody ends this process."""
    journal = Journal(path)
    journal.open()
    memory = recollect(journal, journal.boot())
    seq = memory.accepted
    while True:
        seq = next_sequence(seq)
        journal.accept(order(request_id=seq))
        say(f"took {seq}")
        say(f"moved {seq}")
        journal.finish(PickResult(request_id=seq, code=ResultCode.OK, outcome=Outcome.PICKED))
        say(f"ended {seq}")
        journal.acknowledge(seq)


def main(path: Path) -> None:
    for _ in sys.stdin:
        child = os.fork()
        if child == 0:
            work(path)
        say(f"child {child}")
        os.waitpid(child, 0)
        say("gone")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
