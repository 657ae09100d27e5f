"""The cell's side of the handshake without a cell: a PLC program is led through it, and nothing can move.

The step is the daemon's own (`cell.handshake`), so is the driver; only the work is missing: an order "takes"
a moment and ends well.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

from cell import handshake
from cell.commission.plc_transcript import Transcript
from cell.handshake import Publication
from cell.types import CellReport, Outcome, PickOrder, PickResult
from drivers.errors import DriverError
from drivers.interfaces import Plc
from drivers.plc_map import MAP_VERSION, next_sequence
from drivers.timing import Clock, StopToken
from drivers.types import PlcInputs, PlcOutputs, ResultCode

PERIOD_S: Final = 0.02
WORK_S: Final = 0.5
BEATS_S: Final = 3.0
SILENCE_S: Final = 2.5
SLOWEST_BEAT_S: Final = 0.5
_FARTHEST_M: Final = 10.0
_MOST_RAD: Final = 6.3

HEALTHY: Final = CellReport(
    state=4,
    accepting=True,
    robot_link=True,
    remote_control=True,
    program_running=True,
    vision_ok=True,
    at_home=True,
    safety_mode=1,
)
"""A cell that could work at once."""
UNWILLING: Final = replace(HEALTHY, accepting=False)
"""One that takes no orders for the moment."""


class CellSide:
    """One exchange and one handshake step per `poll`; keeps what was seen."""

    def __init__(self, plc: Plc, boot_id: int, clock: Clock, transcript: Transcript) -> None:
        self._plc = plc
        self._transcript = transcript
        self._stop = StopToken(clock)
        self.clock = clock
        self.memory = handshake.begin(boot_id, 0, None)
        self.report = UNWILLING
        self.inputs: PlcInputs | None = None
        self.error = ""
        self.orders: list[PickOrder] = []
        self.refusals = 0
        self.seen: set[str] = set()
        self.beating = True
        self.seems_ready = False
        self._finished: PickResult | None = None
        self._outputs = PlcOutputs()
        self._turn(None)

    def poll(self) -> None:
        """One exchange, one step."""
        began_at = self.clock.now()
        inputs: PlcInputs | None = None
        try:
            inputs = self._plc.exchange(self._outputs)
            self._transcript.took("one exchange", self.clock.now() - began_at)
        except DriverError as error:
            self.error = error.detail
        self._turn(inputs)
        self._stop.wait(max(0.0, PERIOD_S - (self.clock.now() - began_at)))

    def _turn(self, inputs: PlcInputs | None) -> None:
        before = self._outputs.heartbeat
        finished, self._finished = self._finished, None
        got = handshake.step(self.memory, inputs, self.report, finished, self.clock.now())
        self.memory, self._outputs = got.memory, got.outputs
        if not self.beating:
            self._outputs = replace(self._outputs, heartbeat=before)
        if self.seems_ready:  # the race a PLC may lose: ready is high, and then the answer is no
            self._outputs = replace(self._outputs, ready=not (self.memory.outstanding or self._outputs.busy))
        if inputs is not None:
            self.inputs = inputs
            self.seen |= {name for name in ("abort", "hold", "reset_fault") if getattr(inputs, name)}
        if got.order is not None:
            self.orders.append(got.order)
        self.refusals += sum(event is handshake.PlcEvent.BAD_ORDER for event in got.events)
        self.report = replace(
            self.report, state=6 if self.memory.in_flight else 4, busy=bool(self.memory.in_flight)
        )

    def until(self, condition: Callable[[], bool], within_s: float) -> float | None:
        """Poll until so; how long it took, None when the time was over."""
        began_at = self.clock.now()
        while not condition():
            if self.clock.now() - began_at > within_s:
                return None
            self.poll()
        return self.clock.now() - began_at

    def finish(self, code: ResultCode = ResultCode.OK) -> None:
        """The order in flight has ended."""
        self._finished = PickResult(
            request_id=self.memory.in_flight, code=code, outcome=Outcome.NONE, quantity=0, took_s=WORK_S
        )

    def restart(self, boot_id: int) -> None:
        """As if the daemon had died in the order and come back."""
        cut_short = PickResult(
            request_id=self.memory.accepted,
            code=ResultCode.INTERRUPTED_BY_RESTART,
            outcome=Outcome.ABORTED,
            detail=int(Outcome.ABORTED),
        )
        self.memory = handshake.begin(boot_id, self.memory.accepted, cut_short)
        self.report = UNWILLING
        self._turn(None)

    def leave(self) -> None:
        """Last words: not ready any more."""
        self.report = CellReport()
        for _ in range(2):
            self._turn(None)
            self.poll()


def play_cell(plc: Plc, clock: Clock, transcript: Transcript, orders: int, wait_s: float, bits: bool) -> None:
    """Lead the PLC through the handshake; every step ends in the transcript."""
    boot_id = int(clock.now() * 1000) & 0x7FFF
    side = CellSide(plc, boot_id, clock, transcript)
    try:
        if not (_connection(plc, side, transcript, wait_s) and _version(side, transcript)):
            return
        _heartbeat(side, transcript)
        _word_order(side, transcript)
        if not _enable(side, transcript, wait_s):
            return
        if not _orders(side, transcript, orders, wait_s):
            return
        _refusal(side, transcript, wait_s)
        _restart(side, transcript, boot_id + 1, wait_s)
        _own_heartbeat(side, transcript, wait_s)
        _control_bits(side, transcript, wait_s if bits else None)
    finally:
        side.leave()
        plc.close()


def _connection(plc: Plc, side: CellSide, transcript: Transcript, wait_s: float) -> bool:
    began_at = side.clock.now()
    opened = False
    while not opened and side.clock.now() - began_at <= wait_s:
        try:
            plc.open()
            opened = True
        except DriverError as error:
            side.error = error.detail
            StopToken(side.clock).wait(0.2)
    took_s = side.until(lambda: side.inputs is not None, wait_s) if opened else None
    return transcript.step(
        "connection",
        took_s is not None,
        "command block read, status block sent" if took_s is not None else side.error,
        "check address, port, cable, and that the PLC's Modbus blocks run and have the words of the map",
    )


def _version(side: CellSide, transcript: Transcript) -> bool:
    assert side.inputs is not None
    found = side.inputs.map_version
    do = "the PLC writes 1 into word 0 of the command block"
    if found == MAP_VERSION << 8:
        do = "the two bytes of every word are swapped: correct this in the PLC's copy of the blocks"
    return transcript.step("map version", found == MAP_VERSION, f"word 0 is {found}", do)


def _heartbeat(side: CellSide, transcript: Transcript) -> None:
    """How often it counts, and its longest pause."""
    last, since, longest_s, beats = side.memory.plc_heartbeat, side.clock.now(), 0.0, 0
    ends_at = since + BEATS_S
    while side.clock.now() < ends_at:
        side.poll()
        now = side.clock.now()
        longest_s = max(longest_s, now - since)
        if side.inputs is not None and side.inputs.heartbeat != last:
            beats, last, since = beats + 1, side.inputs.heartbeat, now
    transcript.step(
        "the PLC's heartbeat",
        beats > 1 and longest_s <= SLOWEST_BEAT_S + 0.1,
        f"counted {beats} times in {BEATS_S:g} s, stood for {longest_s:.2f} s at most",
        "add 1 to word 1 of the command block at least every 0.5 s, in a task that always runs",
    )


def _word_order(side: CellSide, transcript: Transcript) -> None:
    """Whether what the PLC writes as target is a place in this world."""
    transcript.note(
        "test registers",
        "compare in the PLC: word 0 is 4660, words 2-3 are 305419896, words 4-5 are -123456",
        "1450709556 instead: use the other plc.word_order. They are at 200 (client role: where plc.test_base "
        "says)",
    )
    assert side.inputs is not None
    six = side.inputs.pose.six()
    if not any(six):
        transcript.note("word order of the target", "the PLC writes none; 0 has no word order")
        return
    plausible = max(map(abs, six[:3])) < _FARTHEST_M and max(map(abs, six[3:])) < _MOST_RAD
    transcript.step(
        "word order of the target",
        plausible,
        ", ".join(f"{v:g}" for v in six) + " (m, rad)",
        "no such place: use the other plc.word_order, or correct the scale (1 count is 1 micrometre)",
    )


def _enable(side: CellSide, transcript: Transcript, wait_s: float, what: str = "enable") -> bool:
    took_s = side.until(lambda: side.memory.enabled, wait_s)
    return transcript.step(
        what,
        took_s is not None,
        "control bit 0 is high" if took_s is not None else f"control bit 0 not high within {wait_s:g} s",
        "set control bit 0 when the cell may work; after a lost link it has to go low and high",
    )


def _ordered(side: CellSide, wait_s: float) -> PickOrder | None:
    """The next order; None when none came."""
    known = len(side.orders)
    took_s = side.until(lambda: len(side.orders) > known, wait_s)
    return None if took_s is None else side.orders[-1]


def _orders(side: CellSide, transcript: Transcript, orders: int, wait_s: float) -> bool:
    """Whole handshakes: accepted, result, acknowledged, the next number."""
    last = 0
    side.report = HEALTHY
    for number in range(1, orders + 1):
        asked_at = side.clock.now()
        order = _ordered(side, wait_s)
        if order is None:
            transcript.step(
                f"order {number}",
                False,
                f"no order within {wait_s:g} s"
                + (f"; {side.refusals} refused with {side.memory.refusal.name}" if side.refusals else ""),
                "have the PLC order something: payload first, then the next cmd_seq, while ready is high",
            )
            return number > 1
        if number > 1:
            transcript.took("result dropped to the next order", side.clock.now() - asked_at)
            transcript.step(
                f"order {number}: its number",
                order.request_id == next_sequence(last),
                f"{last} was followed by {order.request_id}",
                "count cmd_seq up by one for each order; 65535 is followed by 1",
            )
        last = order.request_id
        ends_at = side.clock.now() + WORK_S
        side.until(lambda ends_at=ends_at: side.clock.now() >= ends_at, 2 * WORK_S)  # type: ignore[misc]
        same = side.inputs is not None and side.inputs.cmd_seq == last
        part = f"part {order.part_code}, {order.max_attempts} attempt(s)"
        if not transcript.step(
            f"order {number}: accepted",
            same,
            f"sequence {last}, {order.command.name}, {part}; then {'waits' if same else 'goes on at once'}",
            "leave cmd_seq as it is until the result has been taken",
        ):
            return False
        if not _acknowledged(side, transcript, f"order {number}: result", wait_s, side.finish):
            return False
    return True


def _acknowledged(
    side: CellSide, transcript: Transcript, what: str, wait_s: float, publish: Callable[[], None]
) -> bool:
    """Publish a result and wait for the PLC to take it."""
    publish()
    valid_s = side.until(lambda: side.memory.publication is Publication.VALID, wait_s)
    took_s = side.until(lambda: side.memory.publication is Publication.ACKNOWLEDGED, wait_s)
    if valid_s is not None and took_s is not None:
        transcript.took("result valid to acknowledged", took_s)
    found = (
        f"not acknowledged within {wait_s:g} s" if took_s is None else f"acknowledged {took_s:.3f} s later"
    )
    return transcript.step(
        what,
        took_s is not None,
        f"result_seq {side.memory.accepted}, {found}",
        "while result_valid is high and result_seq is your number: copy the result, write result_ack_seq",
    )


def _refusal(side: CellSide, transcript: Transcript, wait_s: float) -> None:
    """A cell that could not take an order after all: the PLC goes on with another number."""
    known = side.refusals
    side.report = UNWILLING
    side.seems_ready = True
    took_s = side.until(lambda: side.refusals > known, wait_s)
    side.seems_ready = False
    side.report = HEALTHY
    if took_s is None:
        transcript.note("a refused order", f"no further order within {wait_s:g} s")
        return
    refused = side.memory.refused_seq
    order = _ordered(side, wait_s)
    transcript.step(
        "a refused order",
        order is not None and order.request_id != refused,
        f"{refused} refused with 30, "
        + (f"then {order.request_id}" if order is not None else f"then nothing within {wait_s:g} s"),
        "when ack_code is not 0 nothing happens: order again with the next number",
    )
    if order is not None:
        _acknowledged(side, transcript, "the order after it", wait_s, side.finish)


def _restart(side: CellSide, transcript: Transcript, boot_id: int, wait_s: float) -> None:
    """The daemon dies in an order: the number the PLC shows is not executed again, its result is 42."""
    order = _ordered(side, wait_s)
    if order is None:
        transcript.note("restart in an order", f"no further order within {wait_s:g} s")
        return
    known = len(side.orders)
    side.report = UNWILLING  # after this one
    good = _acknowledged(
        side, transcript, "restart in an order", wait_s, lambda: side.restart(boot_id & 0xFFFF)
    )
    if good:
        transcript.step(
            "the same number again",
            all(later.request_id != order.request_id for later in side.orders[known:]),
            f"{order.request_id} was not executed twice, its result was 42",
        )


def _own_heartbeat(side: CellSide, transcript: Transcript, wait_s: float) -> None:
    """Our heartbeat stands: a PLC that looks at it takes enable away."""
    if side.until(lambda: side.memory.enabled, wait_s) is None:
        transcript.note("the cell's heartbeat", "not tried: enable did not come back")
        return
    side.beating = False
    noticed_s = side.until(lambda: side.inputs is not None and not side.inputs.enable, SILENCE_S)
    side.beating = True
    if noticed_s is None:
        transcript.note(
            "the cell's heartbeat",
            f"stood for {SILENCE_S:g} s and the PLC left enable high",
            "watch word 1 of the status block: when it stands for 1.5 s, the cell's bits are old news",
        )
        return
    transcript.step("the cell's heartbeat", True, f"stood; the PLC took enable away {noticed_s:.2f} s later")
    _enable(side, transcript, wait_s, "enable again")


def _control_bits(side: CellSide, transcript: Transcript, wait_s: float | None) -> None:
    """Hold, abort and reset, switched by a person where somebody waits for it."""
    for name, bit in (("hold", 2), ("abort", 1), ("reset_fault", 3)):
        if wait_s is not None and name not in side.seen:
            transcript.head(f"  now switch {name} (control bit {bit}) on and off")
            side.until(lambda name=name: name in side.seen, wait_s)  # type: ignore[misc]
            side.until(
                lambda name=name: side.inputs is not None and not getattr(side.inputs, name),  # type: ignore[misc]
                wait_s,
            )
        if name in side.seen:
            transcript.step(f"bit {name}", True, f"control bit {bit} was seen high")
        elif wait_s is not None:
            transcript.step(
                f"bit {name}",
                False,
                f"control bit {bit} was not seen high within {wait_s:g} s",
                "check which bit of word 2 the PLC writes; bit 0 is the lowest",
            )
        else:
            transcript.note(f"bit {name}", "not seen", "run again with --bits and switch it by hand")
