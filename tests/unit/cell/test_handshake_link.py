"""The link in the handshake, one test each: heartbeats, enable, abort, hold, reset, and what is reported."""

from __future__ import annotations

from dataclasses import replace

import pytest

from cell.handshake import PlcEvent, begin
from cell.types import CellReport
from drivers.types import ResultCode
from tests.unit.cell.dialogue import Dialogue


def test_the_link_is_up_when_the_plc_heartbeat_was_seen_counting() -> None:
    d = Dialogue()
    d.plc_alive = False
    d.polls(3)
    assert not d.linked()
    assert not d.ready()
    d.plc_alive = True
    d.poll()
    assert d.linked()
    assert d.events == [PlcEvent.LINK_UP, PlcEvent.ENABLED]


def test_a_standing_plc_heartbeat_is_a_lost_link_after_one_and_a_half_seconds(ready: Dialogue) -> None:
    ready.plc_alive = False
    ready.polls(30)
    assert ready.linked()
    ready.poll()
    assert not ready.linked()
    assert not ready.ready()
    assert ready.events == [PlcEvent.LINK_LOST, PlcEvent.DISABLED]


def test_a_plc_that_cannot_be_read_is_a_lost_link_after_half_a_second(ready: Dialogue) -> None:
    for _ in range(10):
        ready.poll(lost=True)
    assert ready.linked()
    ready.poll(lost=True)
    assert not ready.linked()
    assert ready.events == [PlcEvent.LINK_LOST, PlcEvent.DISABLED]
    assert ready.out.plc_link_age_s == pytest.approx(0.55)


def test_after_a_loss_enable_must_go_low_and_high_again(ready: Dialogue) -> None:
    ready.poll(lost=True, after_s=0.6)
    ready.polls(3)
    assert ready.linked()
    assert not ready.ready()
    ready.show(5)
    ready.polls(2)
    assert ready.out.ack_code == ResultCode.NOT_ENABLED
    ready.show(5, enable=False)
    ready.poll()
    ready.show(5, enable=True)
    ready.poll()
    assert ready.ready()
    ready.show(6)
    ready.polls(2)
    assert [o.request_id for o in ready.orders] == [6]


def test_after_a_loss_one_new_heartbeat_value_is_not_yet_a_link(ready: Dialogue) -> None:
    ready.poll(lost=True, after_s=0.6)
    ready.events.clear()
    ready.poll()
    assert not ready.linked()
    ready.poll()
    assert ready.linked()


def test_after_a_start_the_level_of_enable_is_enough() -> None:
    d = Dialogue()
    d.polls(2)
    assert d.ready()


def test_enable_low_stops_new_orders_but_not_the_result_of_the_old_one(busy: Dialogue) -> None:
    busy.show(5, enable=False)
    busy.poll()
    assert busy.events == [PlcEvent.DISABLED]
    busy.finish(5)
    assert busy.valid()


def test_abort_and_hold_come_as_edges(ready: Dialogue) -> None:
    for changes in ({"abort": True}, {"abort": False}, {"hold": True}, {"hold": False}):
        ready.show(0, **changes)
        ready.polls(3)
    assert ready.events == [PlcEvent.ABORT, PlcEvent.HOLD, PlcEvent.UNHOLD]


def test_abort_that_is_high_at_the_start_is_an_abort() -> None:
    d = Dialogue()
    d.show(0, abort=True)
    d.poll()
    assert PlcEvent.ABORT in d.events


@pytest.mark.parametrize("changes", [{"abort": True}, {"hold": True}, {"enable": False}])
def test_the_cell_is_not_ready_while_the_plc_stops_it(ready: Dialogue, changes: dict[str, object]) -> None:
    ready.show(0, **changes)
    ready.poll()
    assert not ready.ready()


def test_reset_counts_on_its_rising_edge_only(ready: Dialogue) -> None:
    ready.show(0, reset_fault=True)
    ready.polls(5)
    assert ready.events == [PlcEvent.RESET]
    ready.show(0, reset_fault=False)
    ready.polls(5)
    ready.show(0, reset_fault=True)
    ready.poll()
    assert ready.events == [PlcEvent.RESET, PlcEvent.RESET]


def test_reset_that_is_high_at_the_start_or_after_a_loss_is_no_edge(ready: Dialogue) -> None:
    d = Dialogue()
    d.show(0, reset_fault=True)
    d.polls(5)
    assert PlcEvent.RESET not in d.events
    ready.poll(lost=True, after_s=0.6)
    ready.show(0, reset_fault=True)
    ready.polls(5)
    assert PlcEvent.RESET not in ready.events


def test_of_a_foreign_map_version_enable_and_reset_are_not_believed_but_abort_is(ready: Dialogue) -> None:
    ready.show(0, map_version=2, reset_fault=True, abort=True)
    ready.poll()
    assert ready.events == [PlcEvent.ABORT, PlcEvent.DISABLED]


def test_the_cell_heartbeat_counts_every_quarter_second_and_only_when_called(ready: Dialogue) -> None:
    start = ready.out.heartbeat
    ready.polls(20)
    assert ready.out.heartbeat - start == 4
    ready.poll(after_s=30.0)
    assert ready.out.heartbeat - start == 5


def test_the_cell_heartbeat_wraps_at_16_bit() -> None:
    d = Dialogue(replace(begin(boot_id=1, accepted=0, finished=None), heartbeat=65535))
    d.poll(after_s=0.25)
    assert d.out.heartbeat == 0


def test_the_report_of_the_cell_reaches_the_plc(ready: Dialogue) -> None:
    ready.report = CellReport(
        state=9,
        moving=True,
        fault_code=411,
        fault_count=65537,
        emergency_stop=True,
        protective_stop=True,
        safeguard_stop=True,
        robot_link=True,
        remote_control=True,
        program_running=True,
        vision_ok=True,
        part_in_gripper=True,
        at_home=True,
        operator_needed=True,
        safety_mode=3,
        speed_percent=55,
        recipe=8,
        total_picks=123456,
    )
    out = ready.poll().outputs
    assert (out.state, out.fault_code, out.fault_count, out.safety_mode) == (9, 411, 1, 3)
    assert (out.actual_speed_percent, out.active_recipe, out.total_picks) == (55, 8, 123456)
    assert all(
        (
            out.moving,
            out.fault,
            out.emergency_stop,
            out.protective_stop,
            out.safeguard_stop,
            out.robot_link,
            out.remote_control,
            out.program_running,
            out.vision_ok,
            out.part_in_gripper,
            out.at_home,
            out.operator_needed,
        )
    )
    assert not out.ready
