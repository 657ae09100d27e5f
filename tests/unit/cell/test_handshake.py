"""Every rule of the handshake, one test each, poll by poll."""

from __future__ import annotations

from dataclasses import replace

import pytest

from cell.handshake import Memory, PlcEvent, Step, begin, step
from cell.types import CellReport, Outcome, PickOrder, PickResult
from drivers.types import PlcCommand, PlcInputs, PlcOutputs, ResultCode, ToolPose
from tests.fakes.plc import IDLE

POLL_S = 0.05
READY = CellReport(state=4, accepting=True)
WORKING = CellReport(state=6, busy=True)


def result(sequence: int, code: ResultCode = ResultCode.OK) -> PickResult:
    return PickResult(
        request_id=sequence,
        code=code,
        outcome=Outcome.PICKED,
        detail=3,
        quantity=1,
        part_type=7,
        confidence=0.5,
        pose=ToolPose(x=0.1, y=0.2, z=0.3, rx=0.0, ry=0.0, rz=0.0),
        took_s=2.5,
    )


class Dialogue:
    """A cell and a PLC that is looked at every 50 ms; the PLC's heartbeat counts at every poll."""

    def __init__(self, memory: Memory | None = None) -> None:
        self.memory = memory or begin(boot_id=77, accepted=0, finished=None)
        self.now = 100.0
        self.plc = replace(IDLE, heartbeat=10)
        self.report = READY
        self.plc_alive = True
        self.orders: list[PickOrder] = []
        self.events: list[PlcEvent] = []
        self.out: PlcOutputs = self.poll(lost=True).outputs

    def poll(
        self, *, lost: bool = False, finished: PickResult | None = None, after_s: float = POLL_S
    ) -> Step:
        self.now += after_s
        inputs: PlcInputs | None = None
        if not lost:
            beat = (self.plc.heartbeat + self.plc_alive) % 65536
            self.plc = replace(self.plc, heartbeat=beat, read_at=self.now)
            inputs = self.plc
        got = step(self.memory, inputs, self.report, finished, self.now)
        self.memory, self.out = got.memory, got.outputs
        self.events += got.events
        self.orders += [got.order] if got.order else []
        return got

    def polls(self, n: int) -> Step:
        for _ in range(n - 1):
            self.poll()
        return self.poll()

    def valid(self) -> bool:
        return self.out.result_valid

    def ready(self) -> bool:
        return self.out.ready

    def linked(self) -> bool:
        return self.out.plc_link_ok

    def show(self, sequence: int, **changes: object) -> None:
        self.plc = replace(self.plc, cmd_seq=sequence, **changes)  # type: ignore[arg-type]  # by name

    def finish(self, sequence: int, code: ResultCode = ResultCode.OK) -> None:
        """Publish completely: three polls until valid."""
        self.report = READY
        self.poll(finished=result(sequence, code))
        self.polls(2)


@pytest.fixture
def ready() -> Dialogue:
    """A cell in which link is up, enable is high and nothing is wanted."""
    d = Dialogue()
    d.polls(2)
    assert d.ready()
    d.events.clear()
    return d


@pytest.fixture
def busy(ready: Dialogue) -> Dialogue:
    """Order 5 is in flight."""
    ready.show(5)
    ready.polls(2)
    ready.report = WORKING
    assert [o.request_id for o in ready.orders] == [5]
    ready.events.clear()
    return ready


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


# results


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


# link and controls


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
