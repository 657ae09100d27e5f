"""What is kept of a cell's life: counters that never go back, the first reason of a stop, a whole file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cell import figures, standing
from cell.alarm_table import Condition
from cell.alarms import AlarmState
from cell.errors import ConfigError
from cell.faults import Fault, FaultCode
from cell.figures import Day, oee
from cell.journal import Journal
from cell.modes import Mode
from cell.operation import PlannedConfig
from cell.standing import Standing
from cell.states import State
from cell.types import Outcome, PickResult
from drivers.types import ResultCode
from tests.fakes.clock import FakeClock
from tests.fakes.station import order

NOON = 1_700_000_000.0


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock()


def made(folder: Path, clock: FakeClock, journal: Journal | None = None, **changes: object) -> Standing:
    count = (lambda row: (0, 0, row)) if journal is None else journal.counted_after
    planned = changes.get("planned")
    assert planned is None or isinstance(planned, PlannedConfig)
    kept = Standing(folder, clock, count, planned, wall=lambda: NOON + clock.now())
    kept.recall()
    return kept


def test_time_is_counted_by_mode_and_state(tmp_path: Path, clock: FakeClock) -> None:
    kept = made(tmp_path, clock)
    kept.entered(State.IDLE)
    clock.turn(10.0)
    kept.entered(State.EXECUTE)
    clock.turn(3.0)
    kept.mode(Mode.MAINTENANCE)
    clock.turn(2.0)
    kept.entered(State.IDLE)
    seconds = kept.figures.seconds
    assert seconds["PRODUCTION"]["IDLE"] == pytest.approx(10.0)
    assert seconds["PRODUCTION"]["EXECUTE"] == pytest.approx(3.0)
    assert seconds["MAINTENANCE"]["EXECUTE"] == pytest.approx(2.0)


def test_what_was_written_is_recalled_and_counted_on(tmp_path: Path, clock: FakeClock) -> None:
    kept = made(tmp_path, clock)
    kept.entered(State.IDLE)
    kept.mode(Mode.MANUAL)
    clock.turn(7.0)
    kept.stopped(Fault(code=FaultCode.CAMERA_LOST, detail="left"))
    kept.write()
    again = made(tmp_path, clock)
    assert again.figures == kept.figures
    again.entered(State.IDLE)
    clock.turn(1.0)
    again.write()
    assert again.figures.seconds["MANUAL"]["IDLE"] == pytest.approx(8.0)


def test_counters_are_the_journals_and_no_part_is_counted_twice(tmp_path: Path, clock: FakeClock) -> None:
    journal = Journal(tmp_path / "journal.sqlite")
    journal.open()

    def ends(seq: int, code: ResultCode, outcome: Outcome) -> None:
        journal.accept(order(request_id=seq))
        journal.finish(PickResult(request_id=seq, code=code, outcome=outcome))

    ends(1, ResultCode.OK, Outcome.PICKED)
    ends(2, ResultCode.GRIP_FAILED, Outcome.MISSED)
    ends(3, ResultCode.NO_PART_FOUND, Outcome.BIN_EMPTY)
    kept = made(tmp_path, clock, journal)
    assert (kept.figures.produced, kept.figures.failed) == (1, 1)
    kept.write()
    ends(4, ResultCode.OK, Outcome.PICKED)
    again = made(tmp_path, clock, journal)  # the process was killed after the order and before the file
    assert (again.figures.produced, again.figures.failed) == (2, 1)
    again.write()
    journal.close()
    (tmp_path / "journal.sqlite").unlink()
    for rest in tmp_path.glob("journal.sqlite-*"):
        rest.unlink()
    journal.open()
    ends(1, ResultCode.OK, Outcome.PICKED)
    third = made(tmp_path, clock, journal)  # a new journal: the counters go on
    assert (third.figures.produced, third.figures.failed) == (3, 1)
    journal.close()


def test_the_first_reason_of_a_stop_stays_until_the_cell_has_run_again(
    tmp_path: Path, clock: FakeClock
) -> None:
    kept = made(tmp_path, clock)
    kept.stopped(Fault(code=FaultCode.PROTECTIVE_STOP, detail="arm"))
    kept.stopped(Fault(code=FaultCode.CAMERA_LOST, detail="followed from it"))
    assert kept.figures.first_out is not None
    assert kept.figures.first_out.code == 411
    kept.entered(State.EXECUTE)
    assert kept.figures.first_out.code == 411
    kept.stopped(Fault(code=FaultCode.CAMERA_LOST, detail="another stop"))
    assert kept.figures.first_out is not None
    assert kept.figures.first_out.code == 201


def test_a_broken_file_is_kept_aside(tmp_path: Path, clock: FakeClock) -> None:
    (tmp_path / "state.json").write_text('{"figures": {"mode": "NONSENSE"}}')
    kept = made(tmp_path, clock)
    assert kept.figures.produced == 0
    assert (tmp_path / "state.broken").exists()


def test_a_file_that_cannot_be_written_stops_nothing(tmp_path: Path, clock: FakeClock) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    kept = made(blocked / "state", clock)
    kept.write()
    kept.tick()


def test_there_is_no_oee_without_planned_time(tmp_path: Path, clock: FakeClock) -> None:
    kept = made(tmp_path, clock)
    kept.entered(State.EXECUTE)
    clock.turn(5.0)
    assert kept.document()["oee"] is None
    assert kept.figures.days == ()


def test_oee_is_the_product_of_its_three_factors() -> None:
    """By hand: 1000 s planned, 100 s down, 450 s running, 40 tried at 9 s each, 36 good."""
    day = Day(date="2026-11-25", planned_s=1000.0, down_s=100.0, running_s=450.0, produced=36, failed=4)
    known = oee(day, 9.0)
    assert known is not None
    assert (known.availability, known.performance, known.quality) == (0.9, 0.8, 0.9)
    assert known.oee == pytest.approx(0.648)
    assert oee(Day(date="x", planned_s=10.0), 9.0) is None


def test_time_outside_the_plan_and_in_other_modes_is_not_planned(tmp_path: Path, clock: FakeClock) -> None:
    whole_day = PlannedConfig(begin="00:00", end="23:59", ideal_cycle_s=1.0)
    kept = made(tmp_path, clock, planned=whole_day)
    kept.entered(State.HELD)
    clock.turn(4.0)
    kept.mode(Mode.DRY_RUN)
    clock.turn(50.0)
    kept.write()
    assert [(day.planned_s, day.down_s) for day in kept.figures.days] == [(4.0, 4.0)]


def test_only_a_month_of_days_is_kept() -> None:
    known = figures.Figures(since="x")
    for number in range(40):
        known = figures.advance(
            known, State.IDLE, 1.0, f"2026-{number // 28 + 1:02}-{number % 28 + 1:02}", 1.0
        )
    assert len(known.days) == figures.DAYS_KEPT


# ------------------------------------------------------------------------------ alarms


def shown(kept: Standing) -> dict[int, str]:
    found = kept.document()["alarms"]
    assert isinstance(found, list)
    return {alarm["code"]: alarm["state"] for alarm in found}


def test_a_condition_that_flickers_is_no_alarm(tmp_path: Path, clock: FakeClock) -> None:
    kept = made(tmp_path, clock)
    for _ in range(20):
        kept.condition(FaultCode.PLC_SILENT, "not heard")
        clock.turn(0.5)
        kept.condition(FaultCode.PLC_SILENT, None)
        clock.turn(0.5)
    assert shown(kept) == {}
    kept.condition(FaultCode.PLC_SILENT, "not heard")
    clock.turn(3.5)
    kept.tick()
    assert shown(kept) == {602: "unacknowledged"}
    assert kept.seen() == standing.Seen(first=602, unacknowledged=1)


def test_a_shell_acknowledges_and_shelves(tmp_path: Path, clock: FakeClock) -> None:
    kept = made(tmp_path, clock)
    kept.condition(Condition.GRIPS_FAIL, "3 orders")
    kept.condition(FaultCode.CAMERA_LOST, "left")
    kept.tick()
    standing.ask(tmp_path, {"do": "acknowledge", "code": 511})
    standing.ask(tmp_path, {"do": "shelve", "code": 201, "for_s": 60.0})  # of high priority: refused
    standing.ask(tmp_path, {"do": "dance", "code": 511})
    (tmp_path / "alarm-requests" / "nonsense.json").write_text("[")
    clock.turn(1.1)
    kept.tick()
    assert shown(kept) == {201: AlarmState.UNACKNOWLEDGED.value, 511: AlarmState.ACKNOWLEDGED.value}
    assert list((tmp_path / "alarm-requests").glob("*.json")) == []
    standing.ask(tmp_path, {"do": "shelve", "code": 511, "for_s": 60.0})
    clock.turn(1.1)
    kept.tick()
    assert shown(kept)[511] == "shelved"
    assert kept.seen().first == 201


def test_devices_have_the_worst_of_what_is_active(tmp_path: Path, clock: FakeClock) -> None:
    kept = made(tmp_path, clock)
    kept.condition(Condition.GRIPS_FAIL, "3 orders")
    kept.mode(Mode.MANUAL)
    kept.condition(FaultCode.PROTECTIVE_STOP, "arm")
    kept.condition(FaultCode.ROBOT_LOST, "arm")
    kept.tick()
    devices = kept.document()["devices"]
    assert devices == {
        "cameras": "good",
        "arm": "failure",
        "gripper": "maintenance required",
        "PLC": "good",
        "controller": "good",
    }


def test_reading_without_a_file_says_what_is_missing(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="has the daemon run"):
        standing.read(tmp_path)


def test_the_file_is_whole_json(tmp_path: Path, clock: FakeClock) -> None:
    made(tmp_path, clock).write()
    assert json.loads((tmp_path / "state.json").read_text())["state"] == "STOPPED"
    assert not (tmp_path / "state.part").exists()
