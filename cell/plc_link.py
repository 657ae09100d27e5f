"""The PLC thread: exchange, step, pass on; every 50 ms, and at once with the answer to an order.

The order of things that must survive a power cut: an order is journaled before the exchange that tells
the PLC it was accepted, and before the cell thread gets it; a result is journaled (by the cell thread)
before it is published here.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from cell import handshake
from cell.channels import ABORTED_BY_PLC, LINK_LOST, Channels, Ticket
from cell.errors import JournalError
from cell.handshake import Memory, PlcEvent, Publication
from cell.journal import Journal
from cell.logs import logger
from cell.states import Event
from cell.types import PickOrder
from cell.workers import Beat, MailboxFull
from drivers.errors import DriverError
from drivers.interfaces import Plc
from drivers.timing import StopRequested, StopToken
from drivers.types import PlcInputs, PlcOutputs, ResultCode

log = logger("plc")

PERIOD_S: Final = 0.05
_SLOWEST_RETRY_S: Final = 1.0
_REMIND_S: Final = 30.0
_LAST_WORDS: Final = 4
"""Exchanges at the end: a result takes three (payload, number, valid), and a poll may have gone wrong."""


class PlcLink:
    """Owns the `Plc`; runs the pure handshake step on every exchange."""

    def __init__(
        self,
        plc: Plc,
        memory: Memory,
        channels: Channels,
        journal: Journal,
        stop: StopToken,
        cell_stop: StopToken,
        beat: Beat,
    ) -> None:
        self._plc = plc
        self._memory = memory
        self._channels = channels
        self._journal = journal
        self._stop = stop
        self._cell_stop = cell_stop
        self._running: StopToken | None = None
        self._beat = beat
        self._outputs = PlcOutputs()
        self._opened = False
        self._down_since: float | None = None
        self._said_at = 0.0
        self._failures = 0
        self._acknowledged = 0
        self._owing = False

    def run(self) -> None:
        """Until the token fires; then a last exchange with ready and busy off."""
        clock = self._stop.clock
        self._channels.inbox.put(Event.LINK_LOST)  # nobody has been heard yet
        self.greet()
        try:
            while True:
                began_at = clock.now()
                self._beat()
                self.turn()
                spent_s = clock.now() - began_at
                self._stop.wait(max(0.0, self._pause_s() - spent_s))
        except StopRequested:
            self._farewell()
        finally:
            self._plc.close()

    def greet(self) -> None:
        """The very first exchange already carries boot number and last accepted order, not zeros."""
        now = self._stop.clock.now()
        first = handshake.step(self._memory, None, self._channels.report.get(), None, now)
        self._memory, self._outputs = first.memory, first.outputs

    def _pause_s(self) -> float:
        """The period; none while the PLC waits for what is known already: the answer to its order.
        Longer and longer while nobody answers, so that a missing PLC costs nothing.

        Not before the loss is certain: until then an order may be running, and each poll may end it.
        """
        if self._owing:
            return 0.0
        if self._memory.link_ok:
            return PERIOD_S
        return min(_SLOWEST_RETRY_S, PERIOD_S * 2.0 ** min(self._failures, 8))

    def turn(self) -> None:
        """One exchange and one step of the handshake."""
        inputs = self._exchange()
        # after the exchange: a failed one takes its whole time limit, which counts as silence
        now = self._stop.clock.now()
        finished = self._channels.results.take(0.0)
        report = self._channels.report.get()
        step = handshake.step(self._memory, inputs, report, finished, now)
        for event in step.events:
            self._pass_on(event)
        if step.order is not None and not self._journaled(step.order):
            step = handshake.withdraw(self._memory, step, report, ResultCode.INTERNAL, now)
            self._tell(Event.JOURNAL_LOST)
        if step.order is not None:
            self._running = self._cell_stop.child()
            self._channels.inbox.put(Ticket(order=step.order, stop=self._running))
            log.info("order_accepted", request_id=step.order.request_id, command=step.order.command.name)
        # the parts of a result keep their distance: a PLC may take its time to copy what it was sent
        self._owing = inputs is not None and (step.order is not None or PlcEvent.BAD_ORDER in step.events)
        self._memory, self._outputs = step.memory, step.outputs
        self._note_acknowledge()

    def _journaled(self, order: PickOrder) -> bool:
        """Durable now. An order that is not must neither be accepted nor carried out."""
        try:
            self._journal.accept(order)
        except JournalError as error:
            log.error("order_not_journaled", request_id=order.request_id, detail=str(error))
            return False
        return True

    def _exchange(self) -> PlcInputs | None:
        try:
            if not self._opened:
                self._plc.open()
                self._opened = True
            inputs = self._plc.exchange(self._outputs)
        except DriverError as error:
            now = self._stop.clock.now()
            self._failures += 1
            if self._down_since is None:
                self._down_since = now
                self._said_at = now
                log.warning("plc_unreachable", detail=str(error), action="keeps trying")
            elif now - self._said_at >= _REMIND_S:
                self._said_at = now
                log.warning(
                    "plc_still_unreachable", detail=str(error), since_s=round(now - self._down_since, 1)
                )
            return None
        if self._down_since is not None:
            log.info("plc_reached", after_s=round(self._stop.clock.now() - self._down_since, 2))
        self._down_since = None
        self._failures = 0
        return inputs

    def _note_acknowledge(self) -> None:
        """The handshake says when: a number the PLC shows before the result was valid does not count."""
        taken = self._memory.published_seq
        if self._memory.publication is Publication.ACKNOWLEDGED and taken != self._acknowledged:
            self._acknowledged = taken
            try:
                self._journal.acknowledge(taken)
            except JournalError as error:
                # after a restart the PLC's own acknowledgement says the same
                log.warning("acknowledge_not_journaled", request_id=taken, detail=str(error))
            log.info("result_acknowledged", request_id=taken)

    def _pass_on(self, event: PlcEvent) -> None:
        log.info("plc_event", plc_event=event.name)
        match event:
            case PlcEvent.LINK_LOST:
                self._halt(LINK_LOST)
                self._tell(Event.LINK_LOST)
            case PlcEvent.LINK_UP:
                self._tell(Event.LINK_UP)
            case PlcEvent.ABORT:
                self._halt(ABORTED_BY_PLC)
                self._tell(Event.STOP)
            case PlcEvent.HOLD:
                self._tell(Event.HOLD)
            case PlcEvent.UNHOLD:
                self._tell(Event.UNHOLD)
            case PlcEvent.RESET:
                self._tell(Event.RESET)
            case PlcEvent.ENABLED | PlcEvent.DISABLED | PlcEvent.BAD_ORDER:
                pass

    def _halt(self, reason: str) -> None:
        """Reach into the order under way, or waiting; a running move halts the arm."""
        if self._running is not None:
            self._running.stop(reason)

    def _tell(self, event: Event) -> None:
        try:
            self._channels.inbox.put(event)
        except MailboxFull:
            log.warning("event_dropped", cell_event=event.name)

    def _farewell(self) -> None:
        """The cell thread has ended: publish its last result; ready is off, busy goes off with the last word.

        Not before: an accepted order without a result and without busy would break the contract.
        """
        if not self._opened:
            return
        inputs: PlcInputs | None = None
        for left in reversed(range(_LAST_WORDS)):
            now = self._stop.clock.now()
            finished = self._channels.results.take(0.0)
            step = handshake.step(self._memory, inputs, self._channels.report.get(), finished, now)
            self._memory = step.memory
            try:
                outputs = replace(
                    step.outputs, ready=False, moving=False, busy=step.outputs.busy and left > 0
                )
                inputs = self._plc.exchange(outputs)
            except DriverError as error:
                log.warning("last_exchange_failed", detail=str(error))
                return
