"""A PLC program that orders picks, as a PLC programmer would write it: one scan after the other, a step
chain for the order, on-delay timers, and an image of the registers on either side.

Pure: `PlcProgram.scan` gets the time and leaves in ``command`` what the registers are to show. Every write
of the cell goes through `PlcProgram.cell_wrote`, so nothing between two scans is missed.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum
from typing import TypeAlias

from drivers.plc_map import next_sequence
from drivers.sim.plc_rules import ContractCheck
from drivers.types import QUIET, PlcInputs, PlcOutputs, ResultCode

BIN_EMPTY_DETAIL = 2
BEAT_S = 0.1
ENABLE_LOW_S = 0.5
ANSWER_WITHIN_S = 2.0
DROP_WITHIN_S = 2.0
AFTER_REFUSAL_S = 0.5
MOST_REFUSALS = 10
MOST_FRUITLESS = 10

Value: TypeAlias = int | float | str


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """What the program is to do. ``orders`` None: until the cell reports an empty bin, or brings nothing
    `MOST_FRUITLESS` times in a row."""

    orders: int | None
    command: int = 3
    part: int = 1
    source_id: int = 1
    destination_id: int = 1
    max_attempts: int = 3
    speed_percent: int = 0
    use_crc: bool = False
    pause_s: float = 0.0
    deadline_s: float = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """One thing that happened, as it is printed."""

    name: str
    at: float
    values: tuple[tuple[str, Value], ...] = ()


@dataclass(slots=True, kw_only=True)
class OrderRecord:
    """One order from its writing to its end; instants are None until they come."""

    seq: int
    ordered_at: float
    ack_code: int | None = None
    code: int | None = None
    detail: int | None = None
    quantity: int | None = None
    confidence: float | None = None
    cycle_time_s: float | None = None
    closed_at: float | None = None
    boot_id: int | None = None


class Chain(Enum):
    """The step chain of an order."""

    WAIT_READY = "wait for ready"
    WRITE_SEQUENCE = "payload is written, the sequence number follows"
    WAIT_ANSWER = "wait for the answer"
    WAIT_RESULT = "wait for the result"
    WAIT_DROP = "wait for the result to be dropped"
    PAUSE = "pause"
    ENDED = "ended"


@dataclass(slots=True)
class _Timer:
    """On-delay: `passed` since it was started."""

    since: float | None = None

    def start(self, now: float) -> None:
        self.since = now

    def passed(self, now: float, preset_s: float) -> bool:
        return self.since is not None and now - self.since >= preset_s


@dataclass(slots=True)
class PlcProgram:
    """The program and its data block.

    ``command`` is the output image (what the command registers show), ``rules.status`` the input image.
    ``violations`` are the handshake errors found; ``ended`` says why the program is over, None before.
    """

    task: Task
    command: PlcInputs = field(init=False)
    rules: ContractCheck = field(default_factory=ContractCheck)
    orders: list[OrderRecord] = field(default_factory=list)
    violations: list[str] = field(default_factory=list)
    ended: str | None = None
    _chain: Chain = Chain.WAIT_READY
    _events: list[Event] = field(default_factory=list)
    _beat: _Timer = field(default_factory=_Timer)
    _enable_low: _Timer = field(default_factory=_Timer)
    _step: _Timer = field(default_factory=_Timer)
    _order: _Timer = field(default_factory=_Timer)
    _alive: bool = False
    _boot_id: int | None = None
    _refusals: int = 0
    _fruitless: int = 0

    def __post_init__(self) -> None:
        t = self.task
        self.command = replace(
            QUIET,
            cmd_code=t.command,
            recipe=t.part,
            source_id=t.source_id,
            destination_id=t.destination_id,
            max_attempts=t.max_attempts,
            speed_percent=t.speed_percent,
            crc_used=t.use_crc,
        )

    @property
    def clean(self) -> bool:
        """Every handshake closed and no rule broken."""
        return not self.violations and all(order.closed_at is not None for order in self.orders)

    def events(self) -> list[Event]:
        """What has happened since the last call."""
        events, self._events = self._events, []
        return events

    def cell_wrote(self, status: PlcOutputs, now: float) -> None:
        """The cell has written its status block."""
        for text in self.rules.wrote(status, now):
            self._violate(text, now)
        if self._boot_id is not None and status.boot_id != self._boot_id:
            self._tell("cell_restarted", now, ("boot_id", status.boot_id))
        self._boot_id = status.boot_id

    def scan(self, now: float) -> None:
        """One PLC cycle."""
        if self._beat.since is None or self._beat.passed(now, BEAT_S):
            self._beat.start(now)
            self.command = replace(self.command, heartbeat=(self.command.heartbeat + 1) & 0xFFFF)
        self._watch_cell(now)
        if self._chain is not Chain.ENDED:
            self._run_chain(self.rules.status, now)

    def _watch_cell(self, now: float) -> None:
        """Enable is dropped while the cell does not answer or does not hear us, and raised again after."""
        alive = self.rules.alive(now)
        if alive != self._alive:
            self._alive = alive
            self._tell("cell_back" if alive else "cell_lost", now)
        if not (alive and self.rules.status.plc_link_ok):
            if self.command.enable or self._enable_low.since is None:
                self._enable_low.start(now)
            self.command = replace(self.command, enable=False)
        elif self.ended is None and not self.command.enable and self._enable_low.passed(now, ENABLE_LOW_S):
            self.command = replace(self.command, enable=True)

    def _run_chain(self, status: PlcOutputs, now: float) -> None:
        match self._chain:
            case Chain.WAIT_READY:
                self._wait_ready(status, now)
            case Chain.WRITE_SEQUENCE:
                self._write_sequence(status, now)
            case Chain.WAIT_ANSWER:
                self._wait_answer(status, now)
            case Chain.WAIT_RESULT:
                self._wait_result(status, now)
            case Chain.WAIT_DROP:
                self._wait_drop(status, now)
            case Chain.PAUSE:
                pause_s = self.task.pause_s if self._refusals == 0 else AFTER_REFUSAL_S
                if self._step.passed(now, pause_s):
                    self._go(Chain.WAIT_READY, now)
            case Chain.ENDED:
                return

    def _wait_ready(self, status: PlcOutputs, now: float) -> None:
        if self._step.since is None:
            self._step.start(now)
        if self._alive and status.result_valid and status.result_seq != self.command.result_ack_seq:
            # left from before this program started, nobody else will take it
            self._acknowledge(status.result_seq)
            self._tell("leftover", now, ("seq", status.result_seq), ("code", status.result_code))
        elif self._alive and self.command.enable and status.ready and not status.result_valid:
            t = self.task
            self.command = replace(
                self.command,
                cmd_code=t.command,
                recipe=t.part,
                source_id=t.source_id,
                destination_id=t.destination_id,
                max_attempts=t.max_attempts,
                speed_percent=t.speed_percent,
            )
            self._go(Chain.WRITE_SEQUENCE, now)
        elif self._step.passed(now, self.task.deadline_s):
            self._give_up(f"the cell was not ready within {self.task.deadline_s:g} s", now)

    def _write_sequence(self, status: PlcOutputs, now: float) -> None:
        sequence = next_sequence(self.orders[-1].seq if self.orders else status.accepted_seq)
        self.command = replace(self.command, cmd_seq=sequence)
        self.rules.ordered(sequence)
        self.orders.append(OrderRecord(seq=sequence, ordered_at=now))
        self._order.start(now)
        self._tell("ordered", now, ("seq", sequence), ("command", self.task.command))
        self._go(Chain.WAIT_ANSWER, now)

    def _wait_answer(self, status: PlcOutputs, now: float) -> None:
        order = self.orders[-1]
        if status.accepted_seq == order.seq:
            order.ack_code, order.boot_id = status.ack_code, status.boot_id
            if status.ack_code == 0:
                self._tell("accepted", now, ("seq", order.seq))
                self._go(Chain.WAIT_RESULT, now)
                return
            order.code, order.detail = status.ack_code, 0
            order.closed_at = now
            self._tell("refused", now, ("seq", order.seq), ("code", status.ack_code))
            self._refusals += 1
            self._close(now, ends=False)
            if self._refusals >= MOST_REFUSALS:
                self._give_up(f"{MOST_REFUSALS} orders refused in a row", now)
        elif not self._alive:
            self._step.start(now)
            self._check_deadline(now)
        elif self._step.passed(now, ANSWER_WITHIN_S):
            self._give_up(f"order {order.seq} was not answered within {ANSWER_WITHIN_S:g} s", now)

    def _wait_result(self, status: PlcOutputs, now: float) -> None:
        order = self.orders[-1]
        if status.result_valid and status.result_seq == order.seq:
            order.code, order.detail = status.result_code, status.result_detail
            order.quantity, order.confidence = status.quantity, status.confidence
            order.cycle_time_s = status.cycle_time_s
            self._tell("result", now, ("seq", order.seq), ("code", order.code), ("detail", order.detail))
            self._acknowledge(order.seq)
            self._refusals = 0
            self._go(Chain.WAIT_DROP, now)
        else:
            self._check_deadline(now)

    def _wait_drop(self, status: PlcOutputs, now: float) -> None:
        order = self.orders[-1]
        if not status.result_valid:
            order.closed_at = now
            self._tell("closed", now, ("seq", order.seq), ("took_s", round(now - order.ordered_at, 3)))
            self._close(now, ends=True)
        elif not self._alive:
            self._step.start(now)
            self._check_deadline(now)
        elif self._step.passed(now, DROP_WITHIN_S):
            self._give_up(
                f"result of {order.seq} still valid {DROP_WITHIN_S:g} s after it was acknowledged", now
            )

    def _close(self, now: float, *, ends: bool) -> None:
        order = self.orders[-1]
        self.rules.closed()
        empty = order.code == ResultCode.NO_PART_FOUND and order.detail == BIN_EMPTY_DETAIL
        if ends:
            self._fruitless = 0 if order.quantity else self._fruitless + 1
        if self.task.orders is None and ends and empty:
            self._end("the bin is empty", now)
        elif self.task.orders is None and self._fruitless >= MOST_FRUITLESS:
            self._end(f"{MOST_FRUITLESS} orders in a row brought nothing", now)
        elif self.task.orders is not None and len(self.orders) >= self.task.orders:
            self._end("all orders done", now)
        else:
            self._go(Chain.PAUSE, now)

    def _acknowledge(self, sequence: int) -> None:
        self.command = replace(self.command, result_ack_seq=sequence)
        self.rules.acknowledged(sequence)

    def _check_deadline(self, now: float) -> None:
        if self._order.passed(now, self.task.deadline_s):
            text = f"order {self.orders[-1].seq} was not finished within {self.task.deadline_s:g} s"
            self._give_up(text, now)

    def _give_up(self, text: str, now: float) -> None:
        self._violate(text, now)
        self._end("gave up", now)

    def stop(self, reason: str, now: float) -> None:
        """Somebody ends the program from outside."""
        if self._chain is not Chain.ENDED:
            self._end(reason, now)

    def _end(self, reason: str, now: float) -> None:
        self.ended = reason
        self.command = replace(self.command, enable=False)
        self._tell("ended", now, ("reason", reason), ("orders", len(self.orders)))
        self._go(Chain.ENDED, now)

    def _go(self, chain: Chain, now: float) -> None:
        self._chain = chain
        self._step.start(now)

    def _violate(self, text: str, now: float) -> None:
        self.violations.append(text)
        self._tell("violation", now, ("text", text))

    def _tell(self, name: str, now: float, *values: tuple[str, Value]) -> None:
        self._events.append(Event(name=name, at=now, values=values))
