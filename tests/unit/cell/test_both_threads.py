"""Cell loop and PLC link on one hand-turned clock: an order all the way, and what a lost link does to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import pytest

from cell import handshake
from cell.journal import Journal
from cell.loop import SERVICE_ENDS, CellLoop, Channels
from cell.plc_link import PERIOD_S, PlcLink
from cell.types import CellReport
from cell.workers import Beat, Latest
from drivers.errors import DeviceUnavailable
from drivers.types import ResultCode
from tests.fakes.inbox import ClockedMailbox
from tests.fakes.plc import IDLE
from tests.fakes.station import Bench, bench, scene
from tests.unit.cell.plc_side import Side
from tests.unit.cell.scripted import FREE, Eyes


@dataclass(slots=True)
class Whole:
    """Cell loop and PLC link on one hand-turned clock: the link takes a turn whenever 50 ms have passed."""

    cell: Bench
    side: Side
    loop: CellLoop

    @staticmethod
    def made(journal: Journal) -> Whole:
        cell = bench(pictures=8)
        side = Side(journal, clock=cell.clock)
        side.inbox = ClockedMailbox(64, cell.clock)
        side.report = Latest(CellReport(), cell.clock)
        channels = Channels(inbox=side.inbox, results=side.results, report=side.report)
        side.link = PlcLink(
            side.plc,
            handshake.begin(1, 0, None),
            channels,
            journal,
            side.stop,
            side.cell_stop,
            Beat("plc", 3.0, cell.clock),
        )
        loop = CellLoop(
            cell.station, cell.devices, channels, journal, side.cell_stop, Beat("cell", 6.0, cell.clock)
        )
        return Whole(cell=cell, side=side, loop=loop)

    def run(self, until_s: float) -> None:
        clock, began = self.cell.clock, self.cell.clock.now()
        for n in range(int(until_s / PERIOD_S)):
            clock.at(began + n * PERIOD_S, self.side.link.turn)
        clock.at(began + until_s, lambda: self.side.cell_stop.stop(SERVICE_ENDS))
        self.loop.run()

    def at(self, when_s: float, action: Callable[[], None]) -> None:
        self.cell.clock.at(self.cell.clock.now() + when_s, action)

    def enable(self) -> None:
        self.side.plc.then(replace(IDLE, enable=False, heartbeat=1), replace(IDLE, enable=False, heartbeat=2))
        self.side.plc.then(replace(IDLE, heartbeat=3))


@pytest.fixture
def whole(journal: Journal, see: Callable[..., Eyes]) -> Whole:
    see(scene(FREE))
    made = Whole.made(journal)
    made.enable()
    return made


def test_an_order_goes_from_the_plc_through_the_arm_and_back(whole: Whole, journal: Journal) -> None:
    whole.at(0.5, lambda: whole.side.wants(1))
    whole.run(3.0)
    seen = [(o.busy, o.result_valid, o.result_seq) for o in whole.side.plc.sent]
    assert (True, False, 0) in seen
    assert whole.side.last.result_valid
    assert (whole.side.last.result_code, whole.side.last.result_seq) == (ResultCode.OK, 1)
    assert whole.side.last.total_picks == 1
    last, result, _ = journal.last()
    assert last == 1
    assert result is not None


def test_a_cut_link_halts_the_arm_in_its_motion_and_the_result_is_41(whole: Whole, journal: Journal) -> None:
    whole.cell.robot.move_s = 4.0
    whole.at(0.5, lambda: whole.side.wants(1))
    whole.at(1.0, lambda: setattr(whole.side.plc, "cut", True))
    whole.run(4.0)
    calls = [call.what for call in whole.cell.robot.calls]
    assert calls == ["move_joints", "halt", "halt"]  # the last one at the end of the service
    result = journal.last()[1]
    assert result is not None
    assert result.code is ResultCode.PLC_LINK_LOST


def test_an_order_accepted_but_not_begun_when_the_link_dies_never_moves(
    whole: Whole, journal: Journal
) -> None:
    # the cell thread is held up in its health check while the order comes in and the link goes
    state = whole.cell.robot.state
    slow: list[bool] = []

    def held_up() -> object:
        if not slow and whole.cell.clock.now() > 1000.6:
            slow.append(True)
            whole.cell.clock.turn(2.0)
        return state()

    whole.cell.robot.state = held_up  # type: ignore[method-assign, assignment]  # an arm that answers late
    whole.at(0.7, lambda: whole.side.wants(1))
    whole.at(1.0, lambda: setattr(whole.side.plc, "cut", True))
    whole.run(5.0)
    assert slow
    last, result, _ = journal.last()
    assert last == 1
    assert result is not None
    assert result.code is ResultCode.PLC_LINK_LOST
    assert whole.cell.robot.targets == []


def test_after_a_lost_link_enable_must_cycle_before_the_next_order(whole: Whole, journal: Journal) -> None:
    whole.at(0.5, lambda: setattr(whole.side.plc, "cut", True))
    whole.at(1.5, lambda: setattr(whole.side.plc, "cut", False))
    whole.at(2.5, lambda: whole.side.wants(1))
    whole.run(4.0)
    assert whole.side.last.ack_code == ResultCode.NOT_ENABLED
    assert journal.last()[0] == 0
    assert whole.cell.robot.targets == []


def test_a_fault_is_reset_by_the_plc_and_the_next_order_runs(whole: Whole, journal: Journal) -> None:
    whole.cell.gripper.grasps = [DeviceUnavailable("gripper", "no answer")]
    whole.at(0.5, lambda: whole.side.wants(1))
    whole.at(2.0, lambda: whole.side.wants(1, result_ack_seq=1))
    whole.at(2.5, lambda: whole.side.wants(1, result_ack_seq=1, reset_fault=True))
    whole.at(3.5, lambda: whole.side.wants(2, result_ack_seq=1))
    whole.run(6.0)
    faults = {outputs.fault_code for outputs in whole.side.plc.sent}
    assert 501 in faults
    assert (whole.side.last.fault_code, whole.side.last.result_seq) == (0, 2)
    assert whole.side.last.result_code == ResultCode.OK
    assert journal.last()[0] == 2
