"""Orders in the handshake, one test each, poll by poll: which are taken, which refused and with what code."""

from __future__ import annotations

from dataclasses import replace

import pytest

from cell.handshake import PlcEvent, begin
from cell.types import CellReport, PickOrder
from drivers.types import PlcCommand, ResultCode, ToolPose
from tests.unit.cell.dialogue import READY, Dialogue

# accepting


def test_an_order_is_taken_when_two_successive_polls_show_it(ready: Dialogue) -> None:
    ready.show(5)
    assert ready.poll().order is None
    assert ready.out.accepted_seq == 0
    assert ready.poll().order is not None
    assert (ready.out.accepted_seq, ready.out.ack_code) == (5, 0)
    assert ready.out.busy
    assert not ready.ready()


def test_an_order_carries_what_the_registers_say(ready: Dialogue) -> None:
    pose = ToolPose(x=1.0, y=2.0, z=3.0, rx=0.1, ry=0.2, rz=0.3)
    ready.show(
        9,
        cmd_code=1,
        recipe=4,
        source_id=2,
        destination_id=3,
        max_attempts=6,
        speed_percent=40,
        pose=pose,
        dry_run=True,
    )
    ready.polls(2)
    assert ready.orders == [
        PickOrder(
            request_id=9,
            command=PlcCommand.PICK,
            part_code=4,
            source_id=2,
            destination_id=3,
            max_attempts=6,
            speed_fraction=0.4,
            pose=pose,
            dry_run=True,
            received_at=ready.now,
        )
    ]


def test_zero_speed_and_attempts_mean_the_defaults(ready: Dialogue) -> None:
    ready.show(5, speed_percent=0, max_attempts=0)
    ready.polls(2)
    assert (ready.orders[0].speed_fraction, ready.orders[0].max_attempts) == (1.0, 1)


def test_a_matching_check_word_makes_one_poll_enough(ready: Dialogue) -> None:
    ready.show(5, crc_used=True, crc_ok=True)
    assert ready.poll().order is not None


def test_a_payload_that_still_changes_is_waited_for(ready: Dialogue) -> None:
    ready.show(5, speed_percent=10)
    ready.poll()
    ready.show(5, speed_percent=90)
    assert ready.poll().order is None
    got = ready.poll()
    assert got.order is not None
    assert got.order.speed_fraction == 0.9


def test_two_polls_with_a_lost_one_between_are_not_successive(ready: Dialogue) -> None:
    ready.show(5)
    ready.poll()
    ready.poll(lost=True)
    assert ready.poll().order is None
    assert ready.poll().order is not None


def test_an_order_is_given_once_however_long_the_plc_shows_it(busy: Dialogue) -> None:
    busy.polls(40)
    assert len(busy.orders) == 1


def test_sequence_zero_is_no_order(ready: Dialogue) -> None:
    ready.show(0)
    ready.polls(5)
    assert ready.orders == []
    assert ready.out.accepted_seq == 0


@pytest.mark.parametrize("command", [1, 2, 3, 4, 7, 8, 9, 255])
def test_supported_commands_are_taken(ready: Dialogue, command: int) -> None:
    ready.show(5, cmd_code=command)
    ready.polls(2)
    assert [o.command for o in ready.orders] == [command]


# refusing


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"cmd_code": 5}, ResultCode.UNKNOWN_COMMAND),
        ({"cmd_code": 6}, ResultCode.UNKNOWN_COMMAND),
        ({"cmd_code": 10, "max_attempts": 0}, ResultCode.BAD_PARAMETER),
        ({"cmd_code": 10, "max_attempts": 6}, ResultCode.BAD_PARAMETER),
        ({"cmd_code": 11, "max_attempts": 0}, ResultCode.BAD_PARAMETER),
        ({"cmd_code": 11, "max_attempts": 5}, ResultCode.BAD_PARAMETER),
        ({"cmd_code": 0}, ResultCode.UNKNOWN_COMMAND),
        ({"cmd_code": 77}, ResultCode.UNKNOWN_COMMAND),
        ({"speed_percent": 101}, ResultCode.BAD_PARAMETER),
        ({"max_attempts": 21}, ResultCode.BAD_PARAMETER),
        ({"map_version": 2}, ResultCode.MAP_VERSION),
        ({"crc_used": True, "crc_ok": False}, ResultCode.CRC),
        ({"enable": False}, ResultCode.NOT_ENABLED),
        ({"hold": True}, ResultCode.NOT_ENABLED),
        ({"abort": True}, ResultCode.ABORTED),
    ],
)
def test_a_bad_order_is_refused_with_its_code_and_moves_nothing(
    ready: Dialogue, changes: dict[str, object], code: ResultCode
) -> None:
    ready.show(5, **changes)
    ready.polls(2)
    assert ready.orders == []
    assert (ready.out.accepted_seq, ready.out.ack_code) == (5, code)
    assert not ready.out.busy
    assert ready.events.count(PlcEvent.BAD_ORDER) == 1


def test_a_wrong_check_word_is_waited_for_once_before_it_is_refused(ready: Dialogue) -> None:
    ready.show(5, crc_used=True, crc_ok=False)
    ready.poll()
    assert ready.out.accepted_seq == 0
    ready.show(5, crc_used=True, crc_ok=True)
    assert ready.poll().order is not None


@pytest.mark.parametrize(
    "report", [replace(READY, fault_code=413), CellReport(accepting=False), CellReport()]
)
def test_a_cell_that_cannot_refuses_with_30(ready: Dialogue, report: CellReport) -> None:
    ready.report = report
    ready.show(5)
    ready.polls(2)
    assert ready.orders == []
    assert ready.out.ack_code == ResultCode.ROBOT_NOT_READY


def test_a_refused_number_stays_refused_when_the_reason_is_gone(ready: Dialogue) -> None:
    ready.show(5, enable=False)
    ready.polls(2)
    ready.show(5, enable=True)
    ready.polls(10)
    ready.show(0)
    ready.polls(3)
    ready.show(5)
    ready.polls(3)
    assert ready.orders == []
    assert (ready.out.accepted_seq, ready.out.ack_code) == (5, ResultCode.NOT_ENABLED)
    ready.show(6)
    ready.polls(2)
    assert [o.request_id for o in ready.orders] == [6]


def test_another_order_while_one_is_in_flight_is_refused_as_busy(busy: Dialogue) -> None:
    busy.show(6)
    busy.polls(2)
    assert len(busy.orders) == 1
    assert (busy.out.accepted_seq, busy.out.ack_code) == (6, ResultCode.BUSY)
    assert busy.out.busy
    busy.show(5)
    busy.polls(2)
    assert (busy.out.accepted_seq, busy.out.ack_code) == (5, 0)


def test_an_order_in_flight_counts_before_the_cell_reports_itself_busy(busy: Dialogue) -> None:
    busy.report = READY
    busy.show(6)
    busy.polls(2)
    assert busy.out.ack_code == ResultCode.BUSY
    assert len(busy.orders) == 1


def test_an_order_before_the_last_result_is_acknowledged_is_refused_as_busy(busy: Dialogue) -> None:
    busy.finish(5)
    busy.show(6)
    busy.polls(2)
    assert busy.out.ack_code == ResultCode.BUSY
    assert busy.valid()


def test_a_number_behind_the_last_accepted_one_is_refused(busy: Dialogue) -> None:
    busy.finish(5)
    busy.show(4, result_ack_seq=5)
    busy.polls(2)
    assert busy.out.ack_code == ResultCode.BAD_SEQUENCE
    assert len(busy.orders) == 1


@pytest.mark.parametrize(("last", "following"), [(65535, 1), (65535, 32767), (40000, 7231), (7, 32774)])
def test_numbers_ahead_are_taken_across_the_wrap(last: int, following: int) -> None:
    d = Dialogue(begin(boot_id=1, accepted=last, finished=None))
    d.polls(2)
    d.show(following)
    d.polls(2)
    assert [o.request_id for o in d.orders] == [following]


@pytest.mark.parametrize(("last", "behind"), [(1, 65535), (32768, 1), (7, 32775), (65535, 32768)])
def test_numbers_behind_are_refused_across_the_wrap(last: int, behind: int) -> None:
    d = Dialogue(begin(boot_id=1, accepted=last, finished=None))
    d.polls(2)
    d.show(behind)
    d.polls(2)
    assert d.orders == []
    assert d.out.ack_code == ResultCode.BAD_SEQUENCE


def test_number_zero_shows_the_last_accepted_number_again(busy: Dialogue) -> None:
    busy.finish(5)
    busy.show(3, result_ack_seq=5)
    busy.polls(2)
    assert busy.out.accepted_seq == 3
    busy.show(0)
    busy.polls(2)
    assert (busy.out.accepted_seq, busy.out.ack_code) == (5, 0)
