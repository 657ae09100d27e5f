"""SIGTERM: the arm halts, the PLC gets its result, ready and busy go off, and all of it in five seconds."""

from __future__ import annotations

import signal
from pathlib import Path

from drivers.types import ResultCode
from tests.fakes.simcell import SimCell
from tests.system.handplc import HandPlc
from tests.system.processes import daemon, orders, until, write_config

STOPPED = 2


def test_asked_to_end_in_the_middle_of_a_pick(tmp_path: Path, cell: SimCell, plc: HandPlc) -> None:
    config = write_config(tmp_path, cell.port, plc.port)
    with daemon(config) as running:
        running.started()
        plc.enable()
        plc.change(speed_percent=15)
        sequence = plc.order()
        running.wait_for("stage_begun", stage="fetch")
        until(lambda: cell.ask("status").flag("arm_moving"), 2.0, "the arm moves")
        running.signal(signal.SIGTERM)
        assert running.process.wait(5.0) == 0

        assert not cell.ask("status").flag("arm_moving")
        last = plc.status
        assert (last.result_seq, last.result_code, last.result_valid) == (sequence, ResultCode.ABORTED, True)
        assert (last.ready, last.busy, last.moving, last.state) == (False, False, False, STOPPED)
        assert [(row.seq, row.code) for row in orders(tmp_path)] == [(sequence, ResultCode.ABORTED)]
        assert plc.violations == []
        running.wait_for("daemon_ended", 1.0, failed=False)

    # the next start brings the same result again, because the PLC has not taken it yet, and no 42
    with daemon(config) as running:
        assert plc.result(sequence, 30.0).result_code == ResultCode.ABORTED
        assert plc.violations == []


def test_asked_to_end_at_a_terminal_while_nothing_goes_on(
    tmp_path: Path, cell: SimCell, plc: HandPlc
) -> None:
    config = write_config(tmp_path, cell.port, plc.port)
    with daemon(config) as running:
        running.started()
        plc.enable()
        running.signal(signal.SIGINT)
        assert running.process.wait(2.0) == 0
        assert (plc.status.ready, plc.status.busy) == (False, False)
        assert plc.violations == []


def test_asked_to_end_before_it_is_ready(tmp_path: Path, cell: SimCell, plc: HandPlc) -> None:
    """The service manager may change its mind while the detector still warms up."""
    config = write_config(tmp_path, cell.port, plc.port)
    with daemon(config) as running:
        running.wait_for("daemon_started")
        # nothing is open yet: the signal may simply end it, which a service manager takes for a clean end
        assert running.terminate()[0] in (0, -signal.SIGTERM)
