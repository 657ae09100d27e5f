"""Whatever the order of accepting, finishing, acknowledging and reopening: the journal never forgets."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from cell.journal import Journal
from cell.types import Outcome, PickResult
from drivers.types import ResultCode
from tests.fakes.station import order


class JournalMachine(RuleBasedStateMachine):
    """Compares the journal with a list of rows kept here: sequence, result, acknowledged."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(tempfile.mkdtemp(prefix="journal-"))
        self.journal = Journal(self.folder / "journal.sqlite")
        self.journal.open()
        self.rows: list[tuple[int, PickResult | None, bool]] = []
        self.next = 1

    @rule()
    def accept(self) -> None:
        self.journal.accept(order(request_id=self.next))
        self.rows.append((self.next, None, False))
        self.next = self.next % 5 + 1  # numbers come round quickly

    @precondition(lambda self: any(row[1] is None for row in self.rows))
    @rule(code=st.sampled_from(ResultCode), outcome=st.sampled_from(Outcome), data=st.data())
    def finish(self, code: ResultCode, outcome: Outcome, data: st.DataObject) -> None:
        open_rows = [i for i, row in enumerate(self.rows) if row[1] is None]
        chosen = data.draw(st.sampled_from(open_rows))
        seq = self.rows[chosen][0]
        newest = max(i for i in open_rows if self.rows[i][0] == seq)
        result = PickResult(request_id=seq, code=code, outcome=outcome)
        self.journal.finish(result)
        self.rows[newest] = (seq, result, self.rows[newest][2])

    @rule(seq=st.integers(1, 6))
    def finish_one_that_is_not_in_flight(self, seq: int) -> None:
        if any(row[0] == seq and row[1] is None for row in self.rows):
            return
        with pytest.raises(RuntimeError):
            self.journal.finish(PickResult(request_id=seq, code=ResultCode.OK, outcome=Outcome.NONE))

    @rule(seq=st.integers(1, 6))
    def acknowledge(self, seq: int) -> None:
        self.journal.acknowledge(seq)
        mine = [i for i, row in enumerate(self.rows) if row[0] == seq]
        if mine:
            self.rows[mine[-1]] = (seq, self.rows[mine[-1]][1], True)

    @rule()
    def reopen(self) -> None:
        self.journal.close()
        self.journal.open()

    @invariant()
    def agrees(self) -> None:
        assert self.journal.last() == (self.rows[-1] if self.rows else (0, None, False))
        assert self.journal.interrupted() == [seq for seq, result, _ in self.rows if result is None]
        picked = [r for _, r, _ in self.rows if r is not None]
        assert self.journal.total_picked() == sum(
            r.outcome is Outcome.PICKED and r.code is ResultCode.OK for r in picked
        )

    def teardown(self) -> None:
        self.journal.close()
        shutil.rmtree(self.folder)


JournalMachine.TestCase.settings = settings(max_examples=20, stateful_step_count=20, deadline=None)
TestJournal = JournalMachine.TestCase
