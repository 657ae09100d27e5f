"""No PLC and no line can make the handshake execute a sequence twice, or two at a time.

First a PLC that writes anything in any order, with lost polls, standing heartbeats and a cell that dies at
the worst moments and comes back with what its journal holds. Then the shipped PLC program in a closed loop
with the handshake over a line that loses polls: it must come through with every handshake closed.
"""

from __future__ import annotations

from dataclasses import replace

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule

from cell.handshake import Memory, begin, step
from cell.types import CellReport, Outcome, PickOrder, PickResult
from drivers.plc_codec import decode_command, decode_status, encode_command, encode_status
from drivers.sim.plc_program import PlcProgram, Task
from drivers.types import PlcInputs, PlcOutputs, ResultCode
from tests.fakes.plc import IDLE

# few numbers, so that they meet again; the large ones sit around half the ring and the wrap
SEQUENCES = st.sampled_from([0, 1, 2, 3, 4, 5, 32766, 32767, 32768, 65534, 65535])
RING = 65535


class AnyPlc(RuleBasedStateMachine):
    """The journal is a model: what the caller of `step` writes down, and when."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 10.0
        self.plc = IDLE
        self.boots = 0
        self.journal_accepted = 0
        self.journal_result: PickResult | None = None
        self.travelled = 0
        self.executed_at: dict[int, int] = {}
        self.working_on = 0
        self.waiting_result: PickResult | None = None
        self.memory = begin(boot_id=0, accepted=0, finished=None)
        self.out = PlcOutputs()
        self.before = PlcOutputs()
        self.delivered: dict[int, ResultCode] = {}
        self.report = CellReport()
        self.polled: PlcInputs | None = None
        self.shown_at_start: int | None = None
        self.armed = True

    @initialize(enable=st.booleans())
    def plc_starts(self, enable: bool) -> None:
        self.plc = replace(self.plc, enable=enable)
        self.poll(lost=True)

    # the PLC does what it likes

    @rule(sequence=SEQUENCES)
    def write_sequence(self, sequence: int) -> None:
        self.plc = replace(self.plc, cmd_seq=sequence)

    @rule(
        command=st.sampled_from([1, 3, 4, 7, 8, 9, 255, 0, 5, 99]),
        speed=st.sampled_from([0, 50, 100, 101]),
        attempts=st.sampled_from([0, 1, 20, 21]),
        version=st.sampled_from([1, 1, 1, 2]),
    )
    def write_payload(self, command: int, speed: int, attempts: int, version: int) -> None:
        self.plc = replace(
            self.plc, cmd_code=command, speed_percent=speed, max_attempts=attempts, map_version=version
        )

    @rule(used=st.booleans(), ok=st.booleans())
    def write_check_word(self, used: bool, ok: bool) -> None:
        self.plc = replace(self.plc, crc_used=used, crc_ok=ok or not used)

    @rule(enable=st.booleans(), abort=st.booleans(), hold=st.booleans(), reset=st.booleans())
    def write_controls(self, enable: bool, abort: bool, hold: bool, reset: bool) -> None:
        self.plc = replace(self.plc, enable=enable, abort=abort, hold=hold, reset_fault=reset)

    @rule(sequence=SEQUENCES)
    def acknowledge_anything(self, sequence: int) -> None:
        self.plc = replace(self.plc, result_ack_seq=sequence)

    @rule()
    def acknowledge_what_is_shown(self) -> None:
        self.plc = replace(self.plc, result_ack_seq=self.out.result_seq)

    def ask_properly(self, sequence: int, acknowledged: int) -> None:
        """All that an order needs, except that the numbers may be wrong."""
        self.plc = replace(IDLE, heartbeat=self.plc.heartbeat, cmd_seq=sequence, result_ack_seq=acknowledged)
        self.report = CellReport(state=4, accepting=True)
        self.good_polls(times=3)

    @rule(sequence=SEQUENCES, forgets=st.booleans(), pauses=st.booleans())
    def ask_for_any_number(self, sequence: int, forgets: bool, pauses: bool) -> None:
        acknowledged = 0 if forgets else self.memory.accepted
        if pauses:
            self.ask_properly(0, acknowledged)
        self.ask_properly(sequence, acknowledged)

    @rule(ahead=st.sampled_from([1, 1, 1, 2, 32767]), finishes=st.booleans(), acknowledges=st.booleans())
    def a_whole_order(self, ahead: int, finishes: bool, acknowledges: bool) -> None:
        """Without this the machine would rarely come past its first order."""
        self.plc = replace(self.plc, enable=False)
        self.good_polls(times=3)
        self.ask_properly((self.memory.accepted + ahead - 1) % RING + 1, self.memory.accepted)
        if finishes and self.working_on:
            self.cell_finishes(code=ResultCode.OK)
            self.good_polls(times=4)
        if acknowledges:
            self.acknowledge_what_is_shown()
            self.good_polls(times=1)

    # the line and the time

    @rule(
        lost=st.booleans(),
        beats=st.booleans(),
        after_s=st.sampled_from([0.05, 0.05, 0.05, 0.4, 0.6, 1.6]),
        times=st.integers(1, 4),
    )
    def polls(self, lost: bool, beats: bool, after_s: float, times: int) -> None:
        for _ in range(times):
            self.now += after_s
            if beats:
                self.plc = replace(self.plc, heartbeat=(self.plc.heartbeat + 1) % 65536)
            self.poll(lost=lost)

    @rule(times=st.integers(2, 6))
    def good_polls(self, times: int) -> None:
        self.polls(lost=False, beats=True, after_s=0.05, times=times)

    # the cell

    @rule(accepting=st.booleans(), busy=st.booleans(), fault=st.sampled_from([0, 0, 0, 413]))
    def cell_reports(self, accepting: bool, busy: bool, fault: int) -> None:
        self.report = CellReport(accepting=accepting, busy=busy, fault_code=fault)

    @precondition(lambda self: self.working_on)
    @rule(code=st.sampled_from([ResultCode.OK, ResultCode.NO_PART_FOUND, ResultCode.ABORTED]))
    def cell_finishes(self, code: ResultCode) -> None:
        self.waiting_result = PickResult(request_id=self.working_on, code=code, outcome=Outcome.NONE)
        self.journal_result = self.waiting_result
        self.working_on = 0

    @rule(torn=st.booleans())
    def cell_dies_and_comes_back(self, torn: bool) -> None:
        """``torn``: it polls once more, and dies between `step` and the journal."""
        if torn:
            self.now += 0.05
            self.poll(lost=False, journals=False)
        self.boots += 1
        self.working_on = 0
        self.waiting_result = None
        result = self.journal_result
        if self.journal_accepted and (result is None or result.request_id != self.journal_accepted):
            result = PickResult(
                request_id=self.journal_accepted,
                code=ResultCode.INTERRUPTED_BY_RESTART,
                outcome=Outcome.NONE,
            )
            self.journal_result = result
        self.memory = begin(boot_id=self.boots % 65536, accepted=self.journal_accepted, finished=result)
        self.before = self.out = PlcOutputs()
        self.polled, self.shown_at_start, self.armed = None, None, True
        self.poll(lost=True)

    def poll(self, *, lost: bool, journals: bool = True) -> None:
        inputs: PlcInputs | None = None if lost else replace(self.plc, read_at=self.now)
        finished, self.waiting_result = self.waiting_result, None
        got = step(self.memory, inputs, self.report, finished, self.now)
        self.memory = got.memory
        if not journals:
            return  # neither the order nor the outputs got any further
        self.before, self.out = self.out, got.outputs
        polled, self.polled = self.polled, inputs
        if self.before.plc_link_ok and not self.out.plc_link_ok:
            self.armed = False
        if inputs is not None and inputs.map_version == 1:
            self.armed = self.armed or not inputs.enable
            if self.shown_at_start is None:
                self.shown_at_start = inputs.cmd_seq
            elif inputs.cmd_seq != self.shown_at_start:
                self.shown_at_start = 0
        if got.order is not None:
            self.check_order(got.order, inputs, polled)
        self.a_valid_result_is_the_one_of_the_last_accepted_order()
        self.a_result_becomes_valid_only_after_its_words_were_out()
        self.ready_means_that_nothing_is_owed()
        self.an_answer_of_zero_means_that_the_order_was_journaled()

    def check_order(self, order: PickOrder, inputs: PlcInputs | None, polled: PlcInputs | None) -> None:
        assert inputs is not None
        assert inputs.crc_used or (polled is not None and polled.cmd_seq == order.request_id), "seen once"
        assert order.request_id != self.shown_at_start, "an order from before the start"
        assert inputs.enable
        assert self.armed
        assert not inputs.abort
        assert not inputs.hold
        assert inputs.crc_ok
        assert inputs.map_version == 1
        assert self.report.accepting
        assert not self.report.fault_code
        assert self.working_on == 0, "an order while one is in flight"
        assert self.out.accepted_seq == order.request_id
        assert self.out.busy
        assert 0 < order.speed_fraction <= 1.0
        assert 1 <= order.max_attempts <= 20
        # numbers go forward, by half the ring at most, and come again only after a whole one
        gone = (order.request_id - self.journal_accepted) % RING or RING
        assert gone <= RING // 2 or self.journal_accepted == 0, "a number behind the last one"
        self.travelled += gone
        last = self.executed_at.get(order.request_id)
        assert last is None or self.travelled - last >= RING, "a sequence was executed twice"
        self.executed_at[order.request_id] = self.travelled
        self.journal_accepted = order.request_id
        self.journal_result = None
        self.working_on = order.request_id

    # what must hold after every poll

    def a_valid_result_is_the_one_of_the_last_accepted_order(self) -> None:
        if self.out.result_valid:
            assert self.journal_result is not None
            assert self.out.result_seq == self.journal_result.request_id == self.journal_accepted
            assert self.out.result_code == self.journal_result.code

    def a_result_becomes_valid_only_after_its_words_were_out(self) -> None:
        if self.out.result_valid and not self.before.result_valid:
            before = (self.before.result_seq, self.before.result_code)
            assert before == (self.out.result_seq, self.out.result_code)

    def ready_means_that_nothing_is_owed(self) -> None:
        if self.out.ready:
            assert not self.out.busy
            assert not self.out.result_valid
            assert not self.out.fault
            assert self.out.plc_link_ok
            assert self.working_on == 0
            assert self.armed
            assert not self.memory.abort
            assert not self.memory.hold

    def an_answer_of_zero_means_that_the_order_was_journaled(self) -> None:
        if self.out.ack_code == 0 and self.out.accepted_seq:
            assert self.out.accepted_seq == self.journal_accepted


AnyPlc.TestCase.settings = settings(
    max_examples=150,
    stateful_step_count=50,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)
TestAnyPlc = AnyPlc.TestCase


# the shipped PLC program in a closed loop


class ClosedLoop:
    """Program and handshake joined by the words on the wire, in one hand-turned time."""

    def __init__(self, task: Task, work_polls: int) -> None:
        self.program = PlcProgram(task)
        self.now = 0.0
        self.boots = 1
        self.accepted = 0
        self.result: PickResult | None = None
        self.work_polls = work_polls
        self.left = 0
        self.executed: list[int] = []
        self.memory: Memory = begin(boot_id=1, accepted=0, finished=None)
        self.out = self._step(None, None)
        self.program.rules.connected()

    def _step(self, inputs: PlcInputs | None, finished: PickResult | None) -> PlcOutputs:
        working = bool(self.memory.in_flight) and finished is None
        report = CellReport(accepting=not working, busy=working)
        got = step(self.memory, inputs, report, finished, self.now)
        self.memory = got.memory
        if got.order is not None:
            self.accepted, self.result = got.order.request_id, None
            self.executed.append(got.order.request_id)
            self.left = self.work_polls
        return got.outputs

    def restart(self) -> None:
        """The process dies and is back at once, with what the journal holds."""
        self.boots += 1
        if self.accepted and self.result is None:
            self.result = PickResult(
                request_id=self.accepted, code=ResultCode.INTERRUPTED_BY_RESTART, outcome=Outcome.ABORTED
            )
        self.memory = begin(boot_id=self.boots, accepted=self.accepted, finished=self.result)
        self.out = self._step(None, None)
        self.program.rules.connected()

    def poll(self, lost: str) -> None:
        """50 ms: five PLC scans, then an exchange. ``lost``: "", "write" (all of it), or "read" only."""
        for _ in range(5):
            self.now += 0.01
            self.program.scan(self.now)
        inputs = None
        if lost:
            self.program.rules.connected()  # after an error the driver connects anew
        if lost != "write":
            self.program.cell_wrote(decode_status(encode_status(self.out)), self.now)
        if not lost:
            inputs = decode_command(encode_command(self.program.command), self.now)
        finished = None
        if self.memory.in_flight:
            self.left -= 1
            if self.left == 0:
                finished = PickResult(
                    request_id=self.memory.in_flight, code=ResultCode.OK, outcome=Outcome.PICKED, quantity=1
                )
                self.result = finished
        self.out = self._step(inputs, finished)


@settings(max_examples=60, deadline=None)
@given(
    losses=st.lists(st.sampled_from(["", "", "", "write", "read"]), max_size=120),
    restarts=st.sets(st.integers(0, 200), max_size=3),
    work_polls=st.integers(1, 12),
    use_crc=st.booleans(),
)
def test_the_plc_program_and_the_handshake_close_every_order_over_a_bad_line(
    losses: list[str], restarts: set[int], work_polls: int, use_crc: bool
) -> None:
    loop = ClosedLoop(Task(orders=4, use_crc=use_crc), work_polls)
    for i in range(4000):
        if i in restarts:
            loop.restart()
        loop.poll(losses[i] if i < len(losses) else "")
        if loop.program.ended:
            break
    assert loop.program.violations == []
    assert loop.program.ended == "all orders done"
    assert loop.program.clean
    assert len(loop.executed) == len(set(loop.executed))
    done = [order.seq for order in loop.program.orders if order.code == ResultCode.OK]
    assert set(done) <= set(loop.executed)
