"""Results in the handshake, one test each: published, acknowledged, and what a restart leaves of them."""

from __future__ import annotations

import pytest

from cell.handshake import begin
from cell.types import PickResult
from drivers.types import ResultCode
from tests.unit.cell.dialogue import READY, WORKING, Dialogue, result


def test_a_result_goes_out_as_payload_then_number_then_valid(busy: Dialogue) -> None:
    busy.poll(finished=result(5))
    assert (busy.out.result_code, busy.out.result_seq, busy.valid()) == (1, 0, False)
    busy.poll()
    assert (busy.out.result_code, busy.out.result_seq, busy.valid()) == (1, 5, False)
    assert (busy.out.busy, busy.ready()) == (True, False)
    busy.report = READY
    busy.poll()
    assert (busy.out.result_code, busy.out.result_seq, busy.valid()) == (1, 5, True)
    assert (busy.out.busy, busy.ready()) == (False, False)


def test_a_stage_of_a_result_that_was_not_sent_is_sent_again(busy: Dialogue) -> None:
    busy.poll(finished=result(5))
    busy.poll(lost=True)
    busy.poll(lost=True)
    assert busy.out.result_seq == 0
    busy.poll()
    assert (busy.out.result_seq, busy.valid()) == (5, False)
    busy.poll(lost=True)
    assert not busy.valid()


def test_a_result_says_all_the_cell_knows(busy: Dialogue) -> None:
    busy.finish(5)
    assert (busy.out.result_detail, busy.out.quantity, busy.out.part_type) == (3, 1, 7)
    assert (busy.out.confidence, busy.out.cycle_time_s) == (0.5, 2.5)
    assert busy.out.pose.six() == (0.1, 0.2, 0.3, 0.0, 0.0, 0.0)


def test_a_result_stays_valid_until_it_is_acknowledged(busy: Dialogue) -> None:
    busy.finish(5)
    busy.show(5, result_ack_seq=4)
    busy.polls(50)
    assert busy.valid()
    busy.show(5, result_ack_seq=5)
    busy.poll()
    assert not busy.valid()
    assert busy.out.result_seq == 5
    assert busy.ready()


def test_an_acknowledgement_that_was_there_before_the_result_does_not_swallow_it(busy: Dialogue) -> None:
    busy.show(5, result_ack_seq=5)
    busy.finish(5)
    assert busy.valid()
    busy.poll()
    assert not busy.valid()


def test_an_acknowledged_order_shown_again_is_published_again_and_not_executed(busy: Dialogue) -> None:
    busy.finish(5)
    busy.show(5, result_ack_seq=5)
    busy.poll()
    busy.show(0, result_ack_seq=0)
    busy.polls(3)
    assert not busy.valid()
    busy.show(5)
    busy.polls(4)
    assert (busy.out.result_seq, busy.out.result_code, busy.valid()) == (5, 1, True)
    assert len(busy.orders) == 1


def test_an_old_result_is_not_published_while_its_successor_is_in_flight(busy: Dialogue) -> None:
    busy.finish(5)
    busy.show(5, result_ack_seq=5)
    busy.poll()
    busy.show(6)
    busy.polls(2)
    busy.report = WORKING
    for sequence in (0, 6):
        busy.show(sequence, result_ack_seq=0)
        busy.polls(4)
    assert not busy.valid()
    assert [o.request_id for o in busy.orders] == [5, 6]


def test_a_plc_that_clears_its_acknowledgement_is_not_told_twice(busy: Dialogue) -> None:
    busy.finish(5)
    busy.show(5, result_ack_seq=5)
    busy.poll()
    busy.show(5, result_ack_seq=0)
    busy.polls(10)
    assert not busy.valid()


@pytest.mark.parametrize("sequence", [4, 6])
def test_a_result_of_another_order_is_an_error_of_the_caller(busy: Dialogue, sequence: int) -> None:
    with pytest.raises(ValueError, match=f"result of order {sequence}, but 5 is in flight"):
        busy.poll(finished=result(sequence))


def test_a_second_result_of_the_same_order_is_an_error_of_the_caller(busy: Dialogue) -> None:
    busy.finish(5)
    with pytest.raises(ValueError, match="but 0 is in flight"):
        busy.poll(finished=result(5))


# restart


def test_an_order_from_before_the_start_that_the_journal_does_not_know_is_stale() -> None:
    d = Dialogue(begin(boot_id=2, accepted=4, finished=None))
    d.show(5)
    d.polls(10)
    assert d.orders == []
    assert (d.out.accepted_seq, d.out.ack_code) == (5, ResultCode.INTERRUPTED_BY_RESTART)
    d.show(6)
    d.polls(2)
    assert [o.request_id for o in d.orders] == [6]


def test_an_interrupted_order_ends_with_42_after_the_start() -> None:
    interrupted = result(5, ResultCode.INTERRUPTED_BY_RESTART)
    d = Dialogue(begin(boot_id=2, accepted=5, finished=interrupted))
    assert (d.out.accepted_seq, d.valid(), d.out.boot_id) == (5, False, 2)
    d.show(5, result_ack_seq=4)
    d.polls(3)
    assert (d.out.result_seq, d.out.result_code, d.valid()) == (5, 42, True)
    assert (d.out.accepted_seq, d.out.ack_code) == (5, 0)
    d.show(5, result_ack_seq=5)
    d.poll()
    assert d.ready()
    assert d.orders == []


def test_a_result_acknowledged_before_the_start_is_not_published_again() -> None:
    d = Dialogue(begin(boot_id=2, accepted=5, finished=result(5)))
    d.show(5, result_ack_seq=5)
    for _ in range(5):
        d.poll()
        assert not d.valid()
    assert d.ready()


@pytest.mark.parametrize(
    ("boot_id", "accepted", "finished"),
    [(-1, 0, None), (65536, 0, None), (1, -1, None), (1, 65536, None), (1, 5, result(4))],
)
def test_a_journal_that_contradicts_itself_is_refused(
    boot_id: int, accepted: int, finished: PickResult | None
) -> None:
    with pytest.raises(ValueError):
        begin(boot_id=boot_id, accepted=accepted, finished=finished)
