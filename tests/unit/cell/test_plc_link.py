"""The PLC thread: what is durable before it is said, and what a lost link does to an order."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from cell import handshake
from cell.errors import JournalError
from cell.journal import Journal
from cell.loop import SERVICE_ENDS, Channels, Ticket
from cell.plc_link import PERIOD_S, PlcLink
from cell.states import Event
from cell.types import PickOrder
from cell.workers import Beat, Mailbox, MailboxFull
from drivers.errors import CommandRejected, DeviceTimeout, DeviceUnavailable, DriverError
from drivers.types import PlcInputs, PlcOutputs, ResultCode
from tests.fakes.plc import IDLE
from tests.fakes.station import order
from tests.unit.cell.plc_side import Side, done


@pytest.fixture
def side(journal: Journal) -> Side:
    return Side(journal)


# ------------------------------------------------------------------------------ orders and results


def test_the_device_is_opened_before_it_is_asked(side: Side) -> None:
    side.turns(2)
    assert side.plc.calls == ["open", "exchange", "exchange"]


def test_an_order_is_journaled_before_the_plc_is_told_it_was_accepted(side: Side) -> None:
    side.up()
    side.wants(1)
    known_when_sent: list[int] = []
    exchange = side.plc.exchange

    def watched(outputs: PlcOutputs) -> PlcInputs:
        if outputs.accepted_seq == 1:
            known_when_sent.append(side.journal.last()[0])
        return exchange(outputs)

    side.plc.exchange = watched  # type: ignore[method-assign]  # a look over its shoulder
    side.turns(4)
    assert known_when_sent
    assert set(known_when_sent) == {1}


def test_an_order_is_journaled_before_the_cell_thread_gets_it(side: Side) -> None:
    known: list[int] = []

    class Watched(Mailbox[Ticket | Event]):
        def put(self, item: Ticket | Event) -> None:
            if isinstance(item, Ticket):
                known.append(side.journal.last()[0])
            super().put(item)

    watched = Side(side.journal)
    watched.inbox = Watched(64)
    watched.link = PlcLink(
        watched.plc,
        handshake.begin(5, 0, None),
        Channels(inbox=watched.inbox, results=watched.results, report=watched.report),
        watched.journal,
        watched.stop,
        watched.cell_stop,
        Beat("plc", 3.0, watched.clock),
    )
    watched.up()
    watched.wants(1)
    watched.turns(3)
    assert known == [1]


def test_an_order_that_cannot_be_journaled_is_refused_and_reaches_nobody(side: Side) -> None:
    side.up()
    side.wants(1)

    def full(order: PickOrder) -> None:
        raise JournalError(Path("journal.sqlite"), "database or disk is full")

    side.journal.accept = full  # type: ignore[method-assign]  # a disk that is full
    side.turns(4)
    taken = side.taken()
    assert not any(isinstance(item, Ticket) for item in taken)
    assert taken.count(Event.JOURNAL_LOST) == 1
    answers = {(o.accepted_seq, o.ack_code) for o in side.plc.sent if o.accepted_seq}
    assert answers == {(1, ResultCode.INTERNAL)}
    assert not side.plc.sent[-1].busy


def test_a_number_refused_for_a_full_disk_stays_refused_and_the_next_one_is_taken(side: Side) -> None:
    accept = side.journal.accept
    side.up()
    side.wants(1)

    def full(order: PickOrder) -> None:
        raise JournalError(Path("journal.sqlite"), "database or disk is full")

    side.journal.accept = full  # type: ignore[method-assign]  # a disk that is full
    side.turns(4)
    side.journal.accept = accept  # type: ignore[method-assign]  # somebody made room
    side.turns(4)
    assert side.journal.last() == (0, None, False)
    side.wants(2)
    side.turns(4)
    assert side.journal.last() == (2, None, False)


def test_an_order_shown_for_a_long_time_is_handed_over_once(side: Side) -> None:
    side.up()
    side.wants(1)
    side.turns(20)
    tickets = [item for item in side.taken() if isinstance(item, Ticket)]
    assert [ticket.order.request_id for ticket in tickets] == [1]


def test_a_result_is_published_and_its_acknowledge_journaled(side: Side) -> None:
    side.up()
    side.wants(1)
    side.turns(3)
    side.journal.finish(done(1))
    side.results.put(done(1))
    side.turns(5)
    assert (side.last.result_valid, side.last.result_seq, side.last.result_code) == (True, 1, ResultCode.OK)
    assert side.journal.last() == (1, done(1), False)
    side.wants(1, result_ack_seq=1)
    side.turns(3)
    assert not side.last.result_valid
    assert side.journal.last() == (1, done(1), True)


def test_the_first_words_to_the_plc_already_know_the_last_order(journal: Journal) -> None:
    side = Side(journal, accepted=41)
    side.stop.stop(SERVICE_ENDS)
    side.link.run()
    first = side.plc.sent[0]
    assert (first.boot_id, first.accepted_seq) == (5, 41)


def test_a_result_the_plc_never_took_is_published_again_after_a_restart(journal: Journal) -> None:
    journal.accept(order(request_id=41))
    journal.finish(done(41))
    side = Side(journal, accepted=41, finished=done(41))
    side.plc.then(replace(IDLE, cmd_seq=41, heartbeat=1), replace(IDLE, cmd_seq=41, heartbeat=2))
    side.turns(8)
    assert (side.last.result_valid, side.last.result_seq) == (True, 41)
    assert not any(isinstance(item, Ticket) for item in side.taken())


# ------------------------------------------------------------------------------ events


def test_levels_of_the_plc_become_events_of_the_cell(side: Side) -> None:
    side.up()
    side.plc.then(
        replace(IDLE, hold=True, heartbeat=10),
        replace(IDLE, hold=False, heartbeat=11),
        replace(IDLE, reset_fault=True, heartbeat=12),
        replace(IDLE, reset_fault=True, heartbeat=13),
        replace(IDLE, abort=True, heartbeat=14),
    )
    side.turns(5)
    assert side.taken() == [Event.HOLD, Event.UNHOLD, Event.RESET, Event.STOP]


def test_an_abort_stops_the_order_under_way_at_once(side: Side) -> None:
    side.up()
    side.wants(1)
    side.turns(3)
    (ticket,) = [item for item in side.taken() if isinstance(item, Ticket)]
    side.wants(1, abort=True)
    side.turns(1)
    assert ticket.stop.stopped
    assert ticket.stop.reason == "abort by the PLC"
    assert not side.cell_stop.stopped


def test_events_that_find_no_room_do_not_end_the_thread(side: Side) -> None:
    side.up()
    for _ in range(64):
        side.inbox.put(Event.RESET)
    with pytest.raises(MailboxFull):
        side.inbox.put(Event.RESET)
    side.plc.then(replace(IDLE, hold=True, heartbeat=10))
    side.turns(2)
    assert Event.HOLD not in side.taken()


# ------------------------------------------------------------------------------ a lost link


@pytest.mark.parametrize(
    "error", [DeviceTimeout("plc", "x"), DeviceUnavailable("plc", "x"), CommandRejected("plc", "x")]
)
def test_any_failure_of_the_plc_is_tried_again(side: Side, error: DriverError) -> None:
    side.up()
    side.plc.then(error, error)
    side.turns(4)
    assert side.last.plc_link_ok


@pytest.mark.parametrize("limit_s", [0.0, 0.05, 0.3])
def test_a_cut_link_stops_the_order_within_its_time(side: Side, limit_s: float) -> None:
    side.up()
    side.wants(1)
    side.turns(3)
    (ticket,) = [item for item in side.taken() if isinstance(item, Ticket)]
    cut_at = side.clock.now() - PERIOD_S  # when the PLC was last read
    side.plc.cut, side.plc.limit_s = True, limit_s
    side.clock.at(cut_at + 5.0, lambda: side.stop.stop(SERVICE_ENDS))
    fired: list[float] = []
    stop = ticket.stop.stop

    def note(reason: str) -> None:
        fired.append(side.clock.now())
        stop(reason)

    ticket.stop.stop = note  # type: ignore[method-assign]  # to know when
    side.link.run()
    assert ticket.stop.reason == "PLC link lost"
    assert fired[0] - cut_at <= 0.5 + max(limit_s, PERIOD_S) + PERIOD_S


def test_a_plc_whose_heartbeat_stands_is_lost_though_it_answers(side: Side) -> None:
    side.up()
    side.wants(1)
    side.turns(3)
    (ticket,) = [item for item in side.taken() if isinstance(item, Ticket)]
    side.plc.then(*[replace(IDLE, cmd_seq=1, heartbeat=7)] * 40)
    side.turns(28)
    assert not ticket.stop.stopped
    side.turns(6)
    assert ticket.stop.reason == "PLC link lost"
    assert Event.LINK_LOST in side.taken()
    assert not side.last.ready


def test_a_missing_plc_is_asked_less_and_less_often(side: Side) -> None:
    side.plc.cut = True
    side.clock.at(side.clock.now() + 10.0, lambda: side.stop.stop(SERVICE_ENDS))
    side.link.run()
    assert 10 <= side.plc.calls.count("exchange") <= 20
    waits = side.clock.waits
    assert max(waits) == 1.0


def test_a_plc_that_comes_back_is_asked_at_full_rate_again(side: Side) -> None:
    side.plc.cut = True
    back_at = side.clock.now() + 5.0
    side.clock.at(back_at, lambda: setattr(side.plc, "cut", False))
    side.clock.at(back_at + 3.0, lambda: side.stop.stop(SERVICE_ENDS))
    side.link.run()
    assert side.clock.waits[-5:] == pytest.approx([PERIOD_S] * 5)


def test_the_answer_to_an_order_goes_out_at_once_and_everything_else_in_its_period(side: Side) -> None:
    side.up()
    side.wants(7)
    clock, told = side.clock, []
    exchange = side.plc.exchange

    def noted(outputs: PlcOutputs) -> PlcInputs:
        told.append((clock.now(), outputs))
        return exchange(outputs)

    side.plc.exchange = noted  # type: ignore[method-assign]
    clock.at(clock.now() + 0.52, lambda: side.results.put(done(7)))
    ends_at = clock.now() + 1.0
    clock.at(ends_at, lambda: side.stop.stop(SERVICE_ENDS))

    side.link.run()

    later = list(pairwise(one for one in told if one[0] < ends_at))
    gaps = [at - before for (before, _), (at, _) in later]
    quick = [out for gap, (_, (_, out)) in zip(gaps, later, strict=True) if gap == 0.0]
    assert [(s.accepted_seq, s.ack_code, s.busy, s.result_code) for s in quick] == [(7, 0, True, 0)]
    assert [gap for gap in gaps if gap > 0.0] == pytest.approx([PERIOD_S] * (len(gaps) - 1))
    assert later[-1][1][1].result_valid


# ------------------------------------------------------------------------------ the end


def test_the_end_takes_ready_and_busy_away_and_hangs_up(side: Side) -> None:
    side.up()
    side.clock.at(side.clock.now() + 1.0, lambda: side.stop.stop(SERVICE_ENDS))
    side.link.run()
    assert (side.last.ready, side.last.busy, side.last.moving) == (False, False, False)
    assert side.plc.calls[-1] == "close"


def test_the_last_result_is_still_published_at_the_end(side: Side) -> None:
    side.up()
    side.wants(1)
    side.turns(3)
    side.journal.finish(done(1, ResultCode.ABORTED))
    side.results.put(done(1, ResultCode.ABORTED))
    side.stop.stop(SERVICE_ENDS)
    side.link.run()
    assert (side.last.result_valid, side.last.result_seq) == (True, 1)
    assert side.last.result_code == ResultCode.ABORTED
    assert (side.last.ready, side.last.busy) == (False, False)


def test_an_end_without_a_plc_is_an_end_all_the_same(side: Side) -> None:
    side.plc.cut = True
    side.stop.stop(SERVICE_ENDS)
    side.link.run()
    assert side.plc.calls[-1] == "close"
