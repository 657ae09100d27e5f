"""kill -9 of the daemon at chosen instants: no order is executed twice, nothing moves by itself, and the PLC
learns exactly which order was cut short."""

from __future__ import annotations

import signal
from contextlib import ExitStack
from pathlib import Path

import pytest

from drivers.types import PlcCommand, PlcOutputs, ResultCode
from tests.fakes.simcell import SimCell, sim_cell
from tests.system.handplc import HandPlc
from tests.system.processes import SPEED, Daemon, daemon, orders, until, write_config

INTERRUPTED = ResultCode.INTERRUPTED_BY_RESTART
SLOW_PERCENT = 15
"""Slow enough that a motion takes longer than it takes the test to act on it."""


def _rest(cell: SimCell) -> int:
    """Wait until the arm stands without anybody asking it to; how many motions were started so far."""
    until(lambda: not cell.ask("status").flag("arm_moving"), 3.0, "the arm stands")
    return cell.count("motions")


def _restart(config: Path, plc: HandPlc, cell: SimCell, cut_short: int) -> Daemon:
    """Start anew; the PLC gets 42 for the order that was cut short, and nothing has moved."""
    before = _rest(cell)
    restarted = Daemon(config)
    with ExitStack() as undo:
        undo.callback(restarted.end)
        # the PLC works on: its heartbeat counts, its registers still show the old order
        got = plc.result(cut_short, 30.0)
        assert got.result_code == INTERRUPTED
        plc.enable()
        assert cell.count("motions") == before
        assert [row.seq for row in orders(config.parent)].count(cut_short) == 1
        assert plc.violations == []
        undo.pop_all()
    return restarted


@pytest.mark.parametrize("told", [False, True], ids=["before the PLC is told", "as the PLC is told"])
def test_killed_at_the_instant_of_acceptance(tmp_path: Path, plc: HandPlc, cell: SimCell, told: bool) -> None:
    config = write_config(tmp_path, cell.port, plc.port)
    with daemon(config) as first:
        first.started()
        plc.enable()

        def kill_it(status: PlcOutputs) -> bool:
            """Runs in the server, while the daemon waits for the answer to this very write."""
            if status.accepted_seq != 1:
                return True
            first.signal(signal.SIGKILL)
            return told

        plc.program.before_write = kill_it
        sequence = plc.order()
        until(lambda: first.process.poll() is not None, 10.0, "killed")
        plc.program.before_write = lambda status: True
    assert plc.status.accepted_seq == (1 if told else 0)
    assert [(row.seq, row.finished) for row in orders(tmp_path)] == [(1, False)]

    second = _restart(config, plc, cell, sequence)
    try:
        assert plc.run(PlcCommand.PING).result_code == ResultCode.OK
        assert [(row.seq, row.code) for row in orders(tmp_path)] == [(1, INTERRUPTED), (2, ResultCode.OK)]
    finally:
        second.end()


def test_an_order_written_while_the_daemon_was_dead_is_refused_and_not_executed(
    tmp_path: Path, plc: HandPlc, cell: SimCell
) -> None:
    config = write_config(tmp_path, cell.port, plc.port)
    with daemon(config) as first:
        first.started()
        plc.enable()
        first.signal(signal.SIGSTOP)
        sequence = plc.order()
        first.kill()
    before = _rest(cell)
    with daemon(config) as second:
        second.started()
        got = plc.wait(lambda s: s.accepted_seq == sequence, "an answer")
        assert got.ack_code == INTERRUPTED
        assert (cell.count("motions"), orders(tmp_path)) == (before, [])
        plc.enable()
        assert plc.run(PlcCommand.HOME).result_code == ResultCode.OK
        assert cell.count("motions") == before + 1


def test_killed_in_the_middle_of_a_pick_the_job_still_comes_to_its_end(tmp_path: Path, plc: HandPlc) -> None:
    sticks = 3
    with sim_cell("--speed", SPEED, "--seed", "7", "--sticks", str(sticks)) as cell:
        config = write_config(tmp_path, cell.port, plc.port)
        with daemon(config) as first:
            first.started()
            plc.enable()
            plc.change(speed_percent=SLOW_PERCENT)
            sequence = plc.order()
            first.wait_for("stage_begun", stage="fetch")
            until(lambda: cell.ask("status").flag("arm_moving"), 2.0, "the arm moves")
            first.kill()
        begun = _rest(cell)
        assert begun >= 1

        plc.change(speed_percent=0)
        second = _restart(config, plc, cell, sequence)
        try:
            codes = plc.empty(3 * sticks)
            assert codes.count(ResultCode.OK) == sticks
            assert (cell.count("in_box"), cell.count("in_tray")) == (sticks, 0)
            rows = orders(tmp_path)
            assert [row.seq for row in rows] == list(range(1, len(rows) + 1))
            assert [row.seq for row in rows if row.code == INTERRUPTED] == [sequence]
            assert plc.violations == []
            assert second.terminate()[0] == 0
        finally:
            second.end()


def test_killed_with_a_part_in_the_gripper(tmp_path: Path, plc: HandPlc, cell: SimCell) -> None:
    config = write_config(tmp_path, cell.port, plc.port)
    in_box = cell.count("in_box")
    with daemon(config) as first:
        first.started()
        plc.enable()
        sequence = plc.order()
        first.wait_for("grip_closed", grip="holding")
        first.kill()
    _rest(cell)
    assert cell.ask("status").flag("holding")

    second = _restart(config, plc, cell, sequence)
    try:
        assert plc.status.part_in_gripper  # the PLC can see what it has to deal with
        assert plc.run().result_code == ResultCode.OK
        second.wait_for("part_found_in_gripper", 1.0)
        # the part in the hand was put into the box first; it belonged to the order that was cut short
        assert (cell.count("in_box"), cell.count("lost")) == (in_box + 2, 0)
        assert plc.status.total_picks == 1
    finally:
        second.end()


def test_a_daemon_that_is_frozen_loses_the_arm_to_its_lease(
    tmp_path: Path, plc: HandPlc, cell: SimCell
) -> None:
    """Frozen, not dead: its connections stay open, so only the lease can stop the arm."""
    config = write_config(tmp_path, cell.port, plc.port)
    with daemon(config) as running:
        running.started()
        plc.enable()
        halts = cell.count("lease_halts")
        plc.change(speed_percent=SLOW_PERCENT)
        plc.order()
        running.wait_for("stage_begun", stage="fetch")
        until(lambda: cell.ask("status").flag("arm_moving"), 2.0, "the arm moves")
        running.signal(signal.SIGSTOP)
        before = _rest(cell)
        assert cell.count("lease_halts") == halts + 1

        running.signal(signal.SIGCONT)
        # it finds its motion ended early, or the PLC's link too old, and goes on with nothing
        result = plc.wait(lambda s: s.result_valid, "a result").result_code
        assert result in (ResultCode.MOTION_TIMEOUT, ResultCode.PLC_LINK_LOST)
        running.wait_for("pick_finished", outcome="ABORTED")
        assert cell.count("motions") == before
