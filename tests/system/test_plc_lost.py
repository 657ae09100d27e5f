"""The PLC's link: absent at the start, lost in a pick, back again. The daemon stays, says so once, and costs
next to nothing while it waits."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

from drivers.types import ResultCode
from tests.fakes.ports import free_port
from tests.fakes.simcell import SimCell
from tests.system.handplc import HandPlc, hand_plc
from tests.system.processes import ROOT, daemon, freeze, orders, until, write_config

SUSPENDED = "SUSPENDED"


def test_a_plc_that_comes_later_is_found_and_one_that_goes_stops_the_arm(
    tmp_path: Path, cell: SimCell
) -> None:
    port = free_port()
    in_box = cell.count("in_box")
    config = write_config(tmp_path, cell.port, port)
    with daemon(config) as running:
        # nobody there: it waits in SUSPENDED, said so once, and hardly uses the processor
        running.wait_for("state_changed", 30.0, after=SUSPENDED)
        until(lambda: bool(running.events("plc_unreachable")), 3.0, "said that nobody is there")
        assert running.cpu_fraction(2.0) < 0.20
        assert len(running.events("plc_unreachable")) == 1
        assert running.process.poll() is None

        with hand_plc(port) as plc:
            running.wait_for("plc_reached", 5.0)
            plc.enable()
            plc.change(speed_percent=15)
            sequence = plc.order()
            running.wait_for("stage_begun", stage="fetch")
            until(lambda: cell.ask("status").flag("arm_moving"), 2.0, "the arm moves")
            violations = plc.violations
        assert violations == []

        # gone in the middle of a motion
        running.wait_for("plc_event", 3.0, plc_event="LINK_LOST")
        running.wait_for("pick_finished", 3.0, code=int(ResultCode.PLC_LINK_LOST))
        assert not cell.ask("status").flag("arm_moving")
        before = cell.count("motions")
        assert [(row.seq, row.code) for row in orders(tmp_path)] == [(sequence, ResultCode.PLC_LINK_LOST)]
        assert len(running.events("plc_unreachable")) == 2

        with hand_plc(port) as plc:
            # a PLC that has lost its memory: it shows no order, and takes the result all the same
            got = plc.result(sequence, 10.0)
            assert got.result_code == ResultCode.PLC_LINK_LOST
            assert plc.status.fault_code == 0  # the link heals by itself: no reset is asked for
            assert cell.count("motions") == before
            plc.sequence = sequence
            plc.enable()
            assert plc.run().result_code == ResultCode.OK
            assert cell.count("in_box") == in_box + 1
            assert plc.violations == []


def test_a_plc_whose_program_stands_counts_as_lost(tmp_path: Path, cell: SimCell, plc: HandPlc) -> None:
    """Its server still answers; its heartbeat does not count any more."""
    config = write_config(tmp_path, cell.port, plc.port)
    with daemon(config) as running:
        running.started()
        plc.enable()
        plc.change(speed_percent=5)
        sequence = plc.order()
        running.wait_for("stage_begun", stage="fetch")
        with plc.standing():
            running.wait_for("plc_event", 4.0, plc_event="LINK_LOST")
            running.wait_for("pick_finished", 3.0, code=int(ResultCode.PLC_LINK_LOST))
            plc.wait(lambda s: not s.plc_link_ok, "told that it is not heard")
        assert plc.result(sequence).result_code == ResultCode.PLC_LINK_LOST
        # back, but not ready before enable has been low
        assert not plc.wait(lambda s: s.plc_link_ok, "link up").ready
        plc.enable()
        assert plc.violations == []


def test_a_plc_that_freezes_in_a_pick_gets_41_when_it_thaws_and_goes_on_ordering(
    tmp_path: Path, cell: SimCell
) -> None:
    """Nothing is closed and nothing answers, as behind a pulled cable; the PLC is a process of its own."""
    command = [sys.executable, "-m", "drivers.sim.plc", "--orders", "2", "--speed-percent", "20"]
    with subprocess.Popen(
        [*command, "--out", str(tmp_path / "plc.json")], cwd=ROOT, stdout=subprocess.PIPE, text=True
    ) as plc:
        try:
            assert plc.stdout is not None
            port = int(json.loads(plc.stdout.readline())["port"])
            with daemon(write_config(tmp_path, cell.port, port)) as running:
                running.wait_for("stage_begun", 30.0, stage="fetch")
                until(lambda: cell.ask("status").flag("arm_moving"), 2.0, "the arm moves")
                freeze(plc)
                running.wait_for("plc_event", 3.0, plc_event="LINK_LOST")
                running.wait_for("pick_finished", 3.0, code=int(ResultCode.PLC_LINK_LOST))
                assert not cell.ask("status").flag("arm_moving")
                plc.send_signal(signal.SIGCONT)
                plc.communicate(timeout=30.0)
                assert plc.returncode == 0  # no rule of the handshake was broken
        finally:
            plc.kill()
    summary = json.loads((tmp_path / "plc.json").read_text())
    assert [order["code"] for order in summary["orders"]] == [ResultCode.PLC_LINK_LOST, ResultCode.OK]
    assert [row.code for row in orders(tmp_path)] == [ResultCode.PLC_LINK_LOST, ResultCode.OK]
