"""SIGKILL at 200 random instants while the journal is written; torn tails; a disk that is full.

What a killed process wrote stays in the machine's memory, so a kill alone shows that no instant is a bad one;
that a tail which never came to the disk does no harm is shown on copies whose tail is cut off.
"""

from __future__ import annotations

import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from cell import journal as journals
from cell.errors import JournalError
from cell.journal import Journal
from cell.recollection import recollect
from cell.types import Outcome, PickResult
from drivers.types import ResultCode
from tests.fakes.simcell import SimCell
from tests.fakes.station import order
from tests.system.handplc import HandPlc
from tests.system.processes import ROOT, daemon, orders, write_config

CUTS = 200
LONGEST_S = 0.03


class Writer:
    """The process that starts children, and what they said."""

    def __init__(self, path: Path) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tests.system.journal_writer", str(path)],
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def cut(self, after_s: float) -> list[tuple[str, int]]:
        """One child, killed this long after its first word; all it said."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write("go\n")
        self.process.stdin.flush()
        said: list[tuple[str, int]] = []
        child = int(self.process.stdout.readline().split()[1])
        said.append(self._line())
        ends_at = time.monotonic() + after_s
        while time.monotonic() < ends_at:
            pass  # an instant that is not one of the scheduler's
        with suppress(ProcessLookupError):  # on a busy machine it may have come to its end meanwhile
            os.kill(child, signal.SIGKILL)
        while (line := self._line()) != ("gone", 0):
            said.append(line)
        return said

    def _line(self) -> tuple[str, int]:
        assert self.process.stdout is not None
        word, _, number = self.process.stdout.readline().strip().partition(" ")
        return word, int(number or 0)

    def end(self) -> None:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        with suppress(BrokenPipeError):
            self.process.stdin.close()
        self.process.wait(5.0)
        self.process.stdout.close()


def test_killed_at_200_random_instants_the_journal_opens_and_nothing_is_done_twice(tmp_path: Path) -> None:
    seed = random.SystemRandom().randrange(10**6)
    sys.stdout.write(f"seed {seed}\n")
    rng = random.Random(seed)
    path = tmp_path / "journal.sqlite"
    writer = Writer(path)
    moved: list[int] = []
    cut_short = 0
    try:
        for _ in range(CUTS):
            said = writer.cut(rng.uniform(0.0, LONGEST_S))
            took = [n for word, n in said if word == "took"]
            moved += [n for word, n in said if word == "moved"]
            ended = [n for word, n in said if word == "ended"]
            journal = Journal(path)
            journal.open()
            open_orders = journal.interrupted()
            last, result, _ = journal.last()
            assert len(open_orders) <= 1, "two orders at once"
            assert not set(open_orders) & set(ended), f"seed {seed}: a result that was told is not on disk"
            # what was told is on disk; one more may be, which nobody has been told of
            assert last - max(took) in (0, 1), f"seed {seed}: told of {max(took)}, on disk is {last}"
            memory = recollect(journal, 1)
            assert memory.accepted == last
            if result is None:
                cut_short += 1
                assert memory.result is not None
                assert memory.result.code is ResultCode.INTERRUPTED_BY_RESTART
            assert journal.interrupted() == []
            journal.close()
    finally:
        writer.end()
    assert len(moved) == len(set(moved)), f"seed {seed}: an order was carried out twice"
    assert len(moved) > CUTS
    assert cut_short > CUTS // 20, "hardly any cut fell into an order"
    sys.stdout.write(f"{CUTS} cuts, {len(moved)} orders, {cut_short} cut short\n")


def test_a_tail_that_never_came_to_the_disk_is_left_out_whole(tmp_path: Path) -> None:
    """The write-ahead log cut off anywhere, or with garbage at its end: what remains is a beginning of the
    history, and no half order."""
    source = tmp_path / "whole"
    journal = Journal(source / "journal.sqlite")
    journal.open()
    journal.boot()
    for seq in range(1, 7):
        journal.accept(order(request_id=seq))
        if seq < 6:
            journal.finish(PickResult(request_id=seq, code=ResultCode.OK, outcome=Outcome.PICKED))
    log = (source / "journal.sqlite-wal").read_bytes()
    assert len(log) > 10_000
    rng = random.Random(5)
    seen = set()
    for number in range(60):
        cut = rng.randrange(len(log))
        copy = tmp_path / f"copy-{number}"
        copy.mkdir()
        shutil.copy(source / "journal.sqlite", copy / "journal.sqlite")
        tail = rng.randbytes(min(4096, len(log) - cut)) if number % 2 else b""
        (copy / "journal.sqlite-wal").write_bytes(log[:cut] + tail)
        again = Journal(copy / "journal.sqlite")
        again.open()
        last, result, _ = again.last()
        assert again.interrupted() == ([last] if last and result is None else [])
        seen.add((last, result is None))
        again.accept(order(request_id=last + 1))
        assert again.last()[0] == last + 1
        again.close()
    journal.close()
    assert len(seen) > 4, "the cuts all fell at the same place"


def test_an_order_is_refused_while_there_is_no_room_for_its_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal = Journal(tmp_path / "journal.sqlite")
    journal.open()
    monkeypatch.setattr(journals, "ROOM_BYTES", 1 << 60)
    with pytest.raises(JournalError, match=r"KiB are free.*make room"):
        journal.accept(order(request_id=1))
    assert journal.last() == (0, None, False)
    monkeypatch.undo()
    journal.accept(order(request_id=1))
    journal.close()


def test_a_file_that_may_not_grow_takes_no_order_and_keeps_what_it_has(tmp_path: Path) -> None:
    """The kernel refuses every write, as on a full disk, in the middle of a transaction."""
    journal = Journal(tmp_path / "journal.sqlite")
    journal.open()
    journal.accept(order(request_id=1))
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, hard))
    try:
        with pytest.raises(JournalError, match=r"journal\.sqlite: the journal cannot be written"):
            journal.finish(PickResult(request_id=1, code=ResultCode.OK, outcome=Outcome.PICKED))
        with pytest.raises(JournalError):
            journal.accept(order(request_id=2))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert journal.last() == (1, None, False)
    journal.finish(PickResult(request_id=1, code=ResultCode.OK, outcome=Outcome.PICKED))
    journal.accept(order(request_id=2))
    assert journal.last() == (2, None, False)
    journal.close()


def test_a_full_disk_refuses_the_order_with_a_named_fault_and_nothing_moves(
    tmp_path: Path, plc: HandPlc, cell: SimCell
) -> None:
    with daemon(write_config(tmp_path, cell.port, plc.port)) as running:
        running.started()
        plc.enable()
        before = cell.count("motions")
        limits = resource.prlimit(running.pid, resource.RLIMIT_FSIZE)
        resource.prlimit(running.pid, resource.RLIMIT_FSIZE, (0, limits[1]))
        try:
            sequence = plc.order()
            got = plc.wait(lambda s: s.accepted_seq == sequence and s.ack_code != 0, "a refusal")
            assert got.ack_code == ResultCode.INTERNAL
            status = plc.wait(lambda s: s.fault, "the fault")
            assert status.fault_code == 701
            assert not status.ready
        finally:
            resource.prlimit(running.pid, resource.RLIMIT_FSIZE, limits)
        assert cell.count("motions") == before
        assert orders(tmp_path) == []
        plc.program.rules.closed()
        plc.reset()
        plc.wait(lambda s: s.ready, "ready again")
        assert plc.run().result_code in (ResultCode.OK, ResultCode.GRIP_FAILED)
        assert [row.seq for row in orders(tmp_path)] == [2]
        assert plc.violations == []
        assert running.terminate()[0] == 0
