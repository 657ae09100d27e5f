"""The simulated cell dies or freezes: a fault the PLC can read, a daemon that stays alive for the service
manager, and a reset edge that brings it back without moving anything."""

from __future__ import annotations

import signal
from pathlib import Path

from drivers.types import ResultCode
from tests.fakes.ports import free_port
from tests.fakes.simcell import SimCell, sim_cell
from tests.system.handplc import HandPlc, hand_plc
from tests.system.processes import SPEED, daemon, freeze, notify_socket, until, write_config

IDLE, ABORTED = 4, 9
ROBOT_LOST, ROBOT_SLOW, CAMERA_SLOW = 401, 402, 202


def test_a_cell_that_dies_in_a_pick_and_comes_back_needs_a_reset(tmp_path: Path) -> None:
    port = free_port()
    sim = ("--port", str(port), "--speed", SPEED, "--seed", "7", "--sticks", "2")
    with hand_plc() as plc, notify_socket(tmp_path / "notify") as manager:
        config = write_config(tmp_path, port, plc.port)
        with daemon(config, notify=manager.path) as running:
            # nobody there at the start: a fault, not an end
            plc.wait(lambda s: s.state == ABORTED, "ABORTED", 30.0)
            assert plc.status.fault_code // 100 in (2, 4, 5)
            assert (plc.status.ready, plc.status.operator_needed) == (False, True)

            with sim_cell(*sim) as cell:
                plc.reset()
                plc.enable()
                assert plc.status.state == IDLE
                assert plc.status.fault_code == 0
                assert cell.count("motions") == 0
                plc.change(speed_percent=15)
                sequence = plc.order()
                running.wait_for("stage_begun", stage="fetch")
                until(lambda: cell.ask("status").flag("arm_moving"), 2.0, "the arm moves")
                cell.process.kill()
                cell.process.wait(5.0)

            plc.wait(lambda s: s.state == ABORTED and s.fault_code != 0, "ABORTED")
            assert plc.status.fault_code == ROBOT_LOST
            assert plc.result(sequence).result_code == ResultCode.ROBOT_LINK_LOST

            # a reset while it is still away is answered with a fault again
            count = plc.status.fault_count
            plc.reset()
            plc.wait(lambda s: s.fault_count > count and s.state == ABORTED, "the next fault")

            with sim_cell(*sim) as cell:
                # it is back, but nobody has said so: nothing happens by itself
                manager.listen(0.7)
                assert (plc.status.state, cell.count("motions")) == (ABORTED, 0)
                plc.reset()
                plc.enable()
                assert cell.count("motions") == 0
                plc.change(speed_percent=0)
                assert plc.run().result_code == ResultCode.OK
                assert cell.count("in_box") == 1
            assert running.process.poll() is None
            assert plc.violations == []


def test_a_cell_that_freezes_is_a_time_out_and_the_daemon_stays_fed(
    tmp_path: Path, cell: SimCell, plc: HandPlc
) -> None:
    """Waiting for a device and giving up in time is progress: the watchdog goes on being fed."""
    with notify_socket(tmp_path / "notify") as manager:
        config = write_config(tmp_path, cell.port, plc.port)
        with daemon(config, notify=manager.path) as running:
            running.started()
            plc.enable()
            manager.drain()

            cell.fault("camera_silent", eye="left")
            assert plc.run().result_code == ResultCode.VISION_TIMEOUT
            plc.wait(lambda s: s.fault_code == CAMERA_SLOW, "the camera's fault")
            cell.fault("camera_ok")
            plc.reset()
            plc.wait(lambda s: s.ready, "ready")

            freeze(cell.process)
            try:
                plc.wait(lambda s: s.state == ABORTED, "ABORTED", 5.0)
                assert plc.status.fault_code in (ROBOT_SLOW, 501)
                manager.drain()
                told = manager.listen(2.0)
                assert told.count("WATCHDOG=1") >= 3  # twice a second, as before
                assert running.events("worker_stalled") == []
            finally:
                cell.process.send_signal(signal.SIGCONT)
            plc.reset()
            plc.wait(lambda s: s.ready, "ready")
            assert plc.violations == []
