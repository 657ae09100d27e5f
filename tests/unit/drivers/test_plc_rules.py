"""What the simulated PLC calls a broken rule, and what it must not call one."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivers.sim.plc_rules import ContractCheck
from drivers.types import PlcOutputs

IDLE = PlcOutputs(heartbeat=1, ready=True, plc_link_ok=True, accepted_seq=4, boot_id=9)
TAKEN = replace(IDLE, ready=False, busy=True, accepted_seq=5)
FINISHED = replace(TAKEN, busy=False, result_valid=True, result_seq=5, result_code=1, quantity=1)
DROPPED = replace(FINISHED, result_valid=False, ready=True)


class Plc:
    """A checker to which order 5 has been announced; every write comes 50 ms later and beats."""

    def __init__(self, *, ordered: bool = True) -> None:
        self.check = ContractCheck()
        self.check.connected()
        self.now = 0.0
        assert self.write(IDLE) == []
        if ordered:
            self.check.ordered(5)

    def write(self, status: PlcOutputs, after_s: float = 0.05) -> list[str]:
        self.now += after_s
        self.check.status = replace(self.check.status, heartbeat=status.heartbeat - 1)
        return self.check.wrote(status, self.now)


def test_a_proper_handshake_breaks_no_rule() -> None:
    plc = Plc()
    assert plc.write(TAKEN) == []
    assert plc.write(FINISHED) == []
    plc.check.acknowledged(5)
    assert plc.write(DROPPED) == []
    plc.check.closed()
    assert plc.write(DROPPED) == []


def test_a_refusal_breaks_no_rule() -> None:
    assert Plc().write(replace(IDLE, accepted_seq=5, ack_code=53)) == []


def test_a_result_left_from_before_the_program_started_breaks_no_rule() -> None:
    plc = Plc(ordered=False)
    assert plc.write(replace(FINISHED, accepted_seq=4, result_seq=4)) == []


@pytest.mark.parametrize(
    ("writes", "text"),
    [
        ((FINISHED,), None),  # answer and result may come in one write
        ((replace(FINISHED, accepted_seq=4),), "result of 5 before it was accepted"),
        ((TAKEN, replace(FINISHED, result_seq=4)), "result of 4 while 5 was ordered"),
        ((TAKEN, replace(FINISHED, result_code=0)), "result of 5 is valid without a code"),
        ((TAKEN, FINISHED, replace(FINISHED, quantity=2)), "result of 5 changed while it was valid"),
        ((TAKEN, FINISHED, DROPPED), "result of 5 taken back before it was acknowledged"),
        ((TAKEN, replace(TAKEN, busy=False)), "order 5 was accepted, but the cell is not busy"),
        ((replace(IDLE, accepted_seq=7),), "answered 7, which was never ordered"),
        ((replace(TAKEN, ready=True),), "ready together with busy"),
        ((replace(IDLE, fault=True),), "ready together with fault"),
        ((replace(IDLE, map_version=0),), "map version 0 instead of 1"),
    ],
)
def test_each_rule(writes: tuple[PlcOutputs, ...], text: str | None) -> None:
    plc = Plc()
    broken = [sentence for status in writes for sentence in plc.write(status)]
    if text is None:
        assert broken == []
    else:
        assert any(text in sentence for sentence in broken)


def test_a_second_result_of_a_closed_order_is_one_too_many() -> None:
    plc = Plc()
    for status in (TAKEN, FINISHED):
        plc.write(status)
    plc.check.acknowledged(5)
    plc.write(DROPPED)
    plc.check.closed()
    assert plc.write(FINISHED) == ["a second result of 5"]


def test_a_cell_may_come_back_to_what_the_plc_remembers_of_before_its_restart() -> None:
    plc = Plc()
    plc.check.remembered([3, 4])
    plc.write(TAKEN)
    assert plc.write(replace(IDLE, boot_id=10, accepted_seq=4)) == []
    assert plc.write(replace(IDLE, boot_id=10, accepted_seq=2)) == ["answered 2, which was never ordered"]


def test_a_restarted_cell_may_show_a_result_once_more_that_was_taken_meanwhile() -> None:
    plc = Plc()
    for status in (TAKEN, FINISHED):
        plc.write(status)
    plc.check.acknowledged(5)
    plc.write(replace(DROPPED, boot_id=10))
    plc.check.closed()
    assert plc.write(replace(FINISHED, boot_id=10)) == []
    plc.write(replace(DROPPED, boot_id=10))
    assert plc.write(replace(FINISHED, boot_id=10)) == ["a second result of 5"]


def test_a_heartbeat_that_stood_counts_only_on_one_line_of_one_start() -> None:
    plc = Plc(ordered=False)
    assert "stood for 1.60 s" in plc.write(IDLE, after_s=1.6)[0]
    plc.check.connected()
    assert plc.write(IDLE, after_s=1.6) == []
    assert plc.write(replace(IDLE, boot_id=10), after_s=1.6) == []
    assert plc.check.restarts == 1


def test_an_order_that_outlives_the_cell_need_not_look_busy_to_its_successor() -> None:
    plc = Plc()
    plc.write(TAKEN)
    assert plc.write(replace(IDLE, boot_id=10, ready=False, accepted_seq=5)) == []


def test_the_cell_is_alive_while_its_heartbeat_counts() -> None:
    plc = Plc(ordered=False)
    assert plc.check.alive(plc.now + 1.5)
    assert not plc.check.alive(plc.now + 1.6)
    assert not ContractCheck().alive(0.0)
