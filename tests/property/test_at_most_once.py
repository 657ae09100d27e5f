"""At most once, with the real journal on disk, the real PLC thread's turns, and words on the wire.

A PLC that writes in any order and repeats, skips and goes back; reads and writes torn between two words; lost
requests and lost answers; a disk that is full for a while; a process that dies at each point between reading
an order and publishing its result, and comes back with what is on disk. The observer is not the cell: an arm
that notes what it was made to do, and a PLC that notes what it was told.
"""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule

from cell.errors import JournalError
from cell.journal import Journal
from cell.loop import Channels, Ticket
from cell.plc_link import PERIOD_S, PlcLink
from cell.recollection import recollect
from cell.states import Event
from cell.types import CellReport, Outcome, PickOrder, PickResult
from cell.workers import Beat, Latest, Mailbox
from drivers.errors import DeviceTimeout
from drivers.plc_codec import decode_command, decode_status, encode_command, encode_status
from drivers.plc_map import COMMAND_WORDS, STATUS_WORDS
from drivers.timing import StopToken
from drivers.types import PlcInputs, PlcOutputs, ResultCode
from tests.fakes.clock import FakeClock
from tests.fakes.plc import IDLE

SEQUENCES = st.integers(1, 9)
POINTS = ("accept.before", "accept.after", "send.before", "send.after", "finish.before", "finish.after")
READY = CellReport(state=4, accepting=True)


class PowerCut(Exception):
    """The process is gone."""


class Fuse:
    """Cuts the power where it was told to."""

    def __init__(self) -> None:
        self.at = ""

    def passes(self, point: str) -> None:
        if self.at == point:
            self.at = ""
            raise PowerCut


class Disk(Journal):
    """The journal on a disk that can be full, in a process that can die."""

    def __init__(self, path: Path, fuse: Fuse) -> None:
        super().__init__(path)
        self.full = False
        self._fuse = fuse

    def accept(self, order: PickOrder) -> None:
        self._fuse.passes("accept.before")
        if self.full:
            raise JournalError(Path("journal.sqlite"), "database or disk is full")
        super().accept(order)
        self._fuse.passes("accept.after")

    def finish(self, result: PickResult) -> None:
        self._fuse.passes("finish.before")
        if self.full:
            raise JournalError(Path("journal.sqlite"), "database or disk is full")
        super().finish(result)
        self._fuse.passes("finish.after")


class WirePlc:
    """The PLC's registers as words, and a line that tears and loses."""

    name = "plc"

    def __init__(self, clock: FakeClock, fuse: Fuse) -> None:
        self._clock = clock
        self._fuse = fuse
        self.command = replace(IDLE, enable=False)
        self.before = encode_command(self.command)
        self.shown = encode_status(PlcOutputs())
        self.lost = ""
        self.reached = False
        self.tear_read = COMMAND_WORDS
        self.tear_write = STATUS_WORDS
        self.told: dict[int, set[int]] = {}
        self.refused: set[int] = set()
        self.meant: dict[int, set[tuple[int, int]]] = {}

    def open(self) -> None: ...

    def close(self) -> None: ...

    def write(self, **fields: object) -> None:
        """The PLC's program writes; a torn read shows some words of the time before."""
        self.before = encode_command(self.command)
        self.command = replace(self.command, **fields)  # type: ignore[arg-type]  # names of its fields
        wanted = (self.command.cmd_code, max(1, self.command.max_attempts))
        self.meant.setdefault(self.command.cmd_seq, set()).add(wanted)

    def exchange(self, outputs: PlcOutputs) -> PlcInputs:
        self._fuse.passes("send.before")
        self.reached = self.lost != "request"  # else it still shows what was written before
        if self.lost == "request":
            raise DeviceTimeout("plc", "no answer")
        words = encode_status(outputs)
        whole = [*words[: self.tear_write], *self.shown[self.tear_write :]]
        self._look(whole)
        self.shown = words
        self._look(words)
        self._fuse.passes("send.after")
        if self.lost == "answer":
            raise DeviceTimeout("plc", "no answer")
        now = encode_command(self.command)
        return decode_command([*now[: self.tear_read], *self.before[self.tear_read :]], self._clock.now())

    def _look(self, words: list[int]) -> None:
        """What the PLC's program sees in one scan."""
        status = decode_status(words)
        if status.result_valid:
            self.told.setdefault(status.result_seq, set()).add(status.result_code)
        if status.ack_code:
            self.refused.add(status.accepted_seq)

    @property
    def status(self) -> PlcOutputs:
        return decode_status(self.shown)


class Cell(RuleBasedStateMachine):
    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(tempfile.mkdtemp(prefix="at-most-once-"))
        self.clock = FakeClock()
        self.fuse = Fuse()
        self.plc = WirePlc(self.clock, self.fuse)
        self.moved: list[int] = []
        self.ended: dict[int, ResultCode] = {}
        self.working_on = 0
        self.unwritten: PickResult | None = None
        self.accepting = True
        self.start()

    # the process

    def start(self) -> None:
        self.fuse.at = ""
        self.journal = Disk(self.folder / "journal.sqlite", self.fuse)
        self.journal.open()
        boot = self.journal.boot()
        self.inbox: Mailbox[Ticket | Event] = Mailbox(64)
        self.results: Mailbox[PickResult] = Mailbox(8)
        self.report = Latest(READY, self.clock)
        stop = StopToken(self.clock)
        self.link = PlcLink(
            self.plc,
            recollect(self.journal, boot),
            Channels(inbox=self.inbox, results=self.results, report=self.report),
            self.journal,
            stop,
            StopToken(self.clock),
            Beat("plc", 3.0, self.clock),
        )
        self.link.greet()
        self.working_on, self.unwritten = 0, None

    def die(self) -> None:
        """As by a power cut: what is not on disk is gone."""
        self.journal.close()
        self.start()

    def turn(self) -> None:
        self.clock.turn(PERIOD_S)
        self.plc.command = replace(self.plc.command, heartbeat=(self.plc.command.heartbeat + 1) % 65536)
        try:
            self.link.turn()
        except PowerCut:
            self.die()
            return
        status = self.plc.status  # written before this turn's order was seen
        if status.ready and self.plc.reached:
            assert self.working_on == 0
            assert not status.busy
        while (item := self.inbox.take(0.0)) is not None:
            if isinstance(item, Ticket):
                assert self.working_on == 0, "an order while one is under way"
                assert item.order.request_id not in self.moved, "executed twice"
                done = (int(item.order.command), item.order.max_attempts)
                assert done in self.plc.meant[item.order.request_id], "an order nobody has written"
                self.moved.append(item.order.request_id)
                self.working_on = item.order.request_id

    def finish(self, code: ResultCode) -> None:
        """The arm has come to rest; the result is tried until it is on disk, as the cell thread does."""
        result = self.unwritten or PickResult(request_id=self.working_on, code=code, outcome=Outcome.NONE)
        try:
            self.journal.finish(result)
        except JournalError:
            self.unwritten = result
            return
        except PowerCut:
            last, kept, _ = self.journal.last()
            if kept is not None and last == result.request_id:
                self.ended[last] = kept.code  # it was on disk before the power went
            self.die()
            return
        self.ended[result.request_id] = result.code
        self.results.put(result)
        self.working_on, self.unwritten = 0, None

    # the PLC

    @rule(sequence=SEQUENCES, command=st.sampled_from([1, 3, 7, 255]))
    def orders_in_one_go(self, sequence: int, command: int) -> None:
        self.plc.write(cmd_seq=sequence, cmd_code=command)

    @rule(crc=st.booleans(), attempts=st.integers(0, 4))
    def orders_the_next(self, crc: bool, attempts: int) -> None:
        """What a PLC should do: without it the machine rarely comes past its first order."""
        self.plc.write(enable=False)
        self.turns(2)
        self.plc.write(enable=True, cmd_code=3, max_attempts=attempts, crc_used=crc)
        self.turns(2)
        self.plc.write(cmd_seq=self.plc.status.accepted_seq % 9 + 1)
        self.turns(2)

    @rule(sequence=SEQUENCES)
    def orders_any_number_with_everything_else_in_order(self, sequence: int) -> None:
        """Whatever was open is closed; only the number may be wrong."""
        self.plc.write(abort=False, result_ack_seq=0)
        self.the_cell_is_ready_or_not(True)
        self.journal.full = False
        self.orders_the_next(False, 1)
        for number in (0, sequence):
            if self.working_on:
                self.finish(ResultCode.OK)
            self.turns(5)
            if self.plc.status.result_valid:
                self.takes_the_result()
            self.turns(2)
            self.plc.write(cmd_seq=number)
            self.turns(3)

    @rule(read=st.integers(3, 9))
    def orders_while_the_read_is_torn(self, read: int) -> None:
        """The number of the new order with the payload of the old one, in one poll."""
        self.orders_any_number_with_everything_else_in_order(0)
        last = self.plc.command.cmd_code
        self.plc.write(
            cmd_seq=self.plc.status.accepted_seq % 9 + 1, cmd_code=1 if last == 3 else 3, max_attempts=last
        )
        self.a_torn_turn(read, STATUS_WORDS)
        self.turns(2)

    @rule(sequence=SEQUENCES)
    def writes_any_number(self, sequence: int) -> None:
        self.plc.write(cmd_seq=sequence)

    @rule()
    def writes_no_number(self) -> None:
        self.plc.write(cmd_seq=0)

    @rule(enable=st.booleans(), abort=st.sampled_from([False, False, True]))
    def writes_controls(self, enable: bool, abort: bool) -> None:
        self.plc.write(enable=enable, abort=abort)

    @precondition(lambda self: self.plc.status.result_valid)
    @rule()
    def takes_the_result(self) -> None:
        self.plc.write(result_ack_seq=self.plc.status.result_seq)

    @rule()
    def restarts(self) -> None:
        """Its registers are empty again; it goes on from the number the cell shows."""
        self.plc.command = replace(IDLE, enable=False)
        self.plc.before = encode_command(self.plc.command)

    # line, disk and power

    @rule(n=st.integers(1, 5))
    def turns(self, n: int) -> None:
        for _ in range(n):
            self.turn()

    @rule(read=st.integers(0, COMMAND_WORDS), write=st.integers(0, STATUS_WORDS))
    def a_torn_turn(self, read: int, write: int) -> None:
        self.plc.tear_read, self.plc.tear_write = read, write
        self.turn()
        self.plc.tear_read, self.plc.tear_write = COMMAND_WORDS, STATUS_WORDS
        self.plc.before = encode_command(self.plc.command)

    @rule(lost=st.sampled_from(["request", "answer"]), n=st.sampled_from([1, 2, 12, 40]))
    def loses(self, lost: str, n: int) -> None:
        self.plc.lost = lost
        self.turns(n)
        self.plc.lost = ""

    @rule(point=st.sampled_from(POINTS))
    def the_power_will_fail(self, point: str) -> None:
        self.fuse.at = point

    @rule()
    def the_power_fails(self) -> None:
        self.die()

    @rule(full=st.booleans())
    def the_disk(self, full: bool) -> None:
        self.journal.full = full

    # the arm

    @precondition(lambda self: self.working_on)
    @rule(code=st.sampled_from([ResultCode.OK, ResultCode.GRIP_FAILED, ResultCode.ABORTED]))
    def ends_its_order(self, code: ResultCode) -> None:
        self.finish(code)

    @rule(accepting=st.booleans())
    def the_cell_is_ready_or_not(self, accepting: bool) -> None:
        self.accepting = accepting
        self.report.put(replace(READY, accepting=accepting))

    def teardown(self) -> None:
        """Everything is well again: whatever was accepted has come to its one result."""
        self.fuse.at = ""
        self.journal.full = False
        self.plc.write(enable=False, abort=False, hold=False, cmd_seq=0)
        for _ in range(30):
            if self.working_on:
                self.finish(ResultCode.OK)
            self.turn()
            if self.plc.status.result_valid:
                self.plc.write(result_ack_seq=self.plc.status.result_seq)
        told = self.plc.told
        assert len(self.moved) == len(set(self.moved)), "executed twice"
        assert set(self.moved) <= set(told), "a result was lost"
        for seq, codes in told.items():
            assert len(codes) == 1, f"{seq} was told {codes}"
            expected = self.ended.get(seq, ResultCode.INTERRUPTED_BY_RESTART)
            assert codes == {int(expected)}, f"{seq} ended as {expected}, told {codes}"
        self.journal.close()
        shutil.rmtree(self.folder)


Cell.TestCase.settings = settings(
    max_examples=40,
    stateful_step_count=30,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)
TestCell = Cell.TestCase
