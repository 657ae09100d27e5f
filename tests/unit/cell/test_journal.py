"""The journal keeps its word across reopening, a killed process and a foreign file."""

from __future__ import annotations

import os
import select
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from cell.errors import ConfigError
from cell.faults import Fault, FaultCode
from cell.journal import SCHEMA_VERSION, Journal, result_of
from cell.states import State
from cell.types import Outcome, PickResult
from drivers.types import ResultCode, ToolPose
from tests.fakes.station import order

REPOSITORY = Path(__file__).parents[3]
POSE = ToolPose(x=0.1, y=-0.4, z=0.02, rx=3.1, ry=0.0, rz=-0.5)


def result(seq: int, code: ResultCode = ResultCode.OK, outcome: Outcome = Outcome.PICKED) -> PickResult:
    return PickResult(
        request_id=seq,
        code=code,
        outcome=outcome,
        detail=1,
        quantity=1,
        part_type=2,
        confidence=0.75,
        pose=POSE,
        took_s=3.25,
        seen=4,
        refused={"LENGTH": 2},
        durations_s={"look": 0.1},
    )


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    made = Journal(tmp_path / "state" / "journal.sqlite")
    made.open()
    yield made
    made.close()


def reopened(journal: Journal) -> Journal:
    journal.close()
    journal.open()
    return journal


def test_a_new_journal_knows_nothing(journal: Journal) -> None:
    assert journal.last() == (0, None, False)
    assert journal.interrupted() == []
    assert journal.total_picked() == 0
    assert journal.fault_count() == 0


def test_an_accepted_order_is_there_after_reopening(journal: Journal) -> None:
    journal.accept(order(request_id=41))
    assert reopened(journal).last() == (41, None, False)
    assert journal.interrupted() == [41]


def test_a_result_comes_back_as_it_was(journal: Journal) -> None:
    journal.accept(order(request_id=41))
    journal.finish(result(41))
    assert reopened(journal).last() == (41, result(41), False)
    assert journal.interrupted() == []


def test_a_result_without_pose_comes_back_without(journal: Journal) -> None:
    journal.accept(order(request_id=1))
    plain = PickResult(request_id=1, code=ResultCode.PLC_LINK_LOST, outcome=Outcome.ABORTED)
    journal.finish(plain)
    kept = journal.last()[1]
    assert kept == plain
    assert kept is not None
    assert kept.code is ResultCode.PLC_LINK_LOST
    assert kept.outcome is Outcome.ABORTED


def test_an_acknowledge_is_kept(journal: Journal) -> None:
    journal.accept(order(request_id=41))
    journal.finish(result(41))
    journal.acknowledge(41)
    assert reopened(journal).last() == (41, result(41), True)


def test_an_acknowledge_belongs_to_the_newest_order_of_its_number(journal: Journal) -> None:
    for _ in range(2):  # the numbers came round
        journal.accept(order(request_id=5))
        journal.finish(result(5))
    journal.acknowledge(5)
    assert journal.last() == (5, result(5), True)


def test_an_acknowledge_of_an_unknown_order_changes_nothing(journal: Journal) -> None:
    journal.accept(order(request_id=41))
    journal.finish(result(41))
    journal.acknowledge(40)
    assert journal.last() == (41, result(41), False)


def test_orders_cut_short_are_listed_oldest_first(journal: Journal) -> None:
    for seq in (65535, 1, 2):
        journal.accept(order(request_id=seq))
    journal.finish(result(1))
    assert reopened(journal).interrupted() == [65535, 2]


def test_a_result_of_an_order_that_is_not_in_flight_raises(journal: Journal) -> None:
    journal.accept(order(request_id=41))
    with pytest.raises(RuntimeError, match="result for sequence 42, which is not in flight"):
        journal.finish(result(42))
    journal.finish(result(41))
    with pytest.raises(RuntimeError, match="41, which is not in flight"):
        journal.finish(result(41, ResultCode.GRIP_FAILED, Outcome.MISSED))
    assert journal.last() == (41, result(41), False)


def test_a_refused_write_leaves_the_journal_usable(journal: Journal) -> None:
    with pytest.raises(RuntimeError):
        journal.finish(result(42))
    journal.accept(order(request_id=43))
    assert journal.last()[0] == 43


def test_only_parts_that_were_picked_count(journal: Journal) -> None:
    endings = [
        (ResultCode.OK, Outcome.PICKED),
        (ResultCode.OK, Outcome.NONE),
        (ResultCode.GRIP_FAILED, Outcome.MISSED),
        (ResultCode.NO_PART_FOUND, Outcome.BIN_EMPTY),
        (ResultCode.OK, Outcome.PICKED),
    ]
    for seq, (code, outcome) in enumerate(endings, start=1):
        journal.accept(order(request_id=seq))
        journal.finish(result(seq, code, outcome))
    assert reopened(journal).total_picked() == 2


def test_faults_and_states_are_kept_with_their_words(journal: Journal, tmp_path: Path) -> None:
    journal.boot()
    journal.fault(Fault(code=FaultCode.CAMERA_LOST, detail="camera.left: unplugged"))
    journal.state(State.ABORTED, "HALTED")
    assert reopened(journal).fault_count() == 1
    with sqlite3.connect(tmp_path / "state" / "journal.sqlite") as reader:
        faults = reader.execute("SELECT boot, code, name, detail FROM faults").fetchall()
        states = reader.execute("SELECT boot, state, event FROM states").fetchall()
    reader.close()
    assert faults == [(1, 201, "CAMERA_LOST", "camera.left: unplugged")]
    assert states == [(1, "ABORTED", "HALTED")]


def test_every_start_has_the_next_number(journal: Journal) -> None:
    assert [journal.boot(), reopened(journal).boot(), reopened(journal).boot()] == [1, 2, 3]


def test_the_number_of_a_start_fits_its_register_and_is_never_zero(journal: Journal, tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "state" / "journal.sqlite") as writer:
        writer.execute("INSERT INTO boots (id, at) VALUES (65534, 0)")
    writer.close()
    assert [journal.boot(), journal.boot(), journal.boot()] == [65535, 1, 2]


def test_every_commit_waits_for_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # a power cut cannot be had in a test; that SQLite was told to survive one can be asked
    opened: list[sqlite3.Connection] = []
    connect = sqlite3.connect

    def kept(path: Path, **options: object) -> sqlite3.Connection:
        opened.append(connect(path, **options))  # type: ignore[call-overload]  # as the journal gave them
        return opened[-1]

    monkeypatch.setattr(sqlite3, "connect", kept)
    journal = Journal(tmp_path / "journal.sqlite")
    journal.open()
    full = 2
    assert opened[0].execute("PRAGMA synchronous").fetchone() == (full,)
    assert opened[0].execute("PRAGMA journal_mode").fetchone() == ("wal",)
    journal.close()


def test_two_connections_see_each_others_rows(journal: Journal, tmp_path: Path) -> None:
    other = Journal(tmp_path / "state" / "journal.sqlite")
    other.open()
    try:
        journal.accept(order(request_id=9))  # the PLC thread
        other.finish(result(9))  # the cell thread
        assert journal.last() == (9, result(9), False)
    finally:
        other.close()


def test_opening_twice_and_closing_twice_is_nothing(journal: Journal) -> None:
    journal.open()
    journal.accept(order(request_id=3))
    journal.close()
    journal.close()
    with pytest.raises(RuntimeError, match="journal used before open"):
        journal.last()


def test_a_journal_of_another_version_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    with sqlite3.connect(path) as writer:
        writer.execute("PRAGMA user_version=7")
    writer.close()
    with pytest.raises(ConfigError, match=f"journal of version 7, this program writes {SCHEMA_VERSION}"):
        Journal(path).open()


def test_a_file_that_is_no_journal_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    path.write_text("dear diary, today nothing was picked, and yesterday neither" * 40)
    with pytest.raises(ConfigError, match=r"journal\.sqlite: the journal cannot be written: file is not a"):
        Journal(path).open()
    assert path.read_text().startswith("dear diary")


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "state").write_text("a file where the folder should be")
    with pytest.raises(ConfigError, match=r"state/journal\.sqlite: the journal cannot be written"):
        Journal(tmp_path / "state" / "journal.sqlite").open()


def test_a_folder_in_place_of_the_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "journal.sqlite").mkdir()
    with pytest.raises(ConfigError, match=r"journal\.sqlite: the journal cannot be written: unable to open"):
        Journal(tmp_path / "journal.sqlite").open()


def test_a_result_of_an_unknown_code_is_no_result() -> None:
    with pytest.raises(ValueError, match="200 is not a valid ResultCode"):
        result_of('{"request_id": 1, "code": 200, "outcome": 1, "pose": null}')


KILLED = """
import sys
from dataclasses import replace
from pathlib import Path
from cell.journal import Journal
from cell.types import Outcome, PickResult
from drivers.types import ResultCode
from tests.fakes.station import order

journal = Journal(Path(sys.argv[1]))
journal.open()
journal.boot()
for seq in range(1, 60000):
    journal.accept(order(request_id=seq))
    print(f"accepted {seq}", flush=True)
    journal.finish(PickResult(request_id=seq, code=ResultCode.OK, outcome=Outcome.PICKED))
    print(f"finished {seq}", flush=True)
"""


@pytest.mark.parametrize("after", [5, 12, 20])
def test_what_was_said_before_a_kill_is_there_after_it(tmp_path: Path, after: int) -> None:
    path = tmp_path / "journal.sqlite"
    child = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(path)], stdout=subprocess.PIPE, cwd=REPOSITORY, text=True
    )
    assert child.stdout is not None
    try:
        said = [_line(child.stdout.fileno(), child) for _ in range(after)]
    finally:
        os.kill(child.pid, signal.SIGKILL)
        rest = child.communicate(timeout=10)[0]
    said += rest.split("\n")[:-1]
    accepted = [int(line.split()[1]) for line in said if line.startswith("accepted")]
    finished = [int(line.split()[1]) for line in said if line.startswith("finished")]

    journal = Journal(path)
    journal.open()
    try:
        assert journal.boot() == 2
        last, kept, acknowledged = journal.last()
        interrupted = journal.interrupted()
        # what was told is durable; one more step may have been done and not told
        assert last in (accepted[-1], accepted[-1] + 1)
        assert journal.total_picked() in (len(finished), len(finished) + 1)
        assert interrupted in ([], [last])
        assert (kept is None) == (interrupted == [last])
        assert not acknowledged
        assert not set(interrupted) & set(finished)
    finally:
        journal.close()


def _line(descriptor: int, child: subprocess.Popen[str]) -> str:
    """One line of the child, read byte by byte so that nothing is buffered away."""
    read = bytearray()
    while not read.endswith(b"\n"):
        ready, _, _ = select.select([descriptor], [], [], 30.0)
        byte = os.read(descriptor, 1) if ready else b""
        assert byte, f"the child ended early: {child.poll()}"
        read += byte
    return read.decode().strip()
