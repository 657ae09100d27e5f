"""The daemon with the UR driver over RTDE, and the worst in the middle of a pick: the daemon is killed, the
arm stops for its own safety. The PLC learns of it, and nothing moves that nobody ordered."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from drivers.types import PlcCommand, ResultCode
from tests.fakes.simcell import sim_cell
from tests.fakes.ur_controller import TCP, UrController, ur_controller
from tests.system.handplc import HandPlc
from tests.system.processes import DEMO, daemon, orders, until

STANDS_S = 0.3
SLOW_PERCENT = 15
"""Slow enough that a motion takes longer than it takes the test to act on it."""
START_S = 60.0


@pytest.fixture
def wired() -> Iterator[tuple[UrController, int]]:
    """A controller whose arm is the simulated cell's, and the cell's port."""
    with (
        sim_cell("--seed", "7", "--sticks", "12") as cell,
        ur_controller("--payload", "0.9", "--world-port", str(cell.port)) as controller,
    ):
        yield controller, cell.port


def _config(folder: Path, host: str, sim_port: int, plc_port: int) -> Path:
    data = yaml.safe_load(DEMO.read_text(encoding="utf-8"))
    arm = yaml.safe_load((DEMO.parent / "ur.yaml").read_text(encoding="utf-8"))
    assert tuple(arm["robot"]["tcp_m_rad"]) == TCP
    data["robot"], data["gripper"] = arm["robot"] | {"host": host}, arm["gripper"]
    data["allow_mixed"] = True
    data["cameras"]["left"]["port"] = data["cameras"]["right"]["port"] = sim_port
    data["cameras"]["look_timeout_s"] = 20.0
    data["plc"]["port"] = plc_port
    data["files"] = {"calibration": str(DEMO.parent / "calibration.json"), "journal": "journal.sqlite"}
    path = folder / "cell.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return path


def _under_way(plc: HandPlc, controller: UrController) -> int:
    """Order a slow pick and wait until the arm is well into a motion of it; the order's sequence number."""
    plc.change(speed_percent=SLOW_PERCENT)
    sequence = plc.order()
    until(lambda: controller.number("moving_s") > 0.4, START_S, "the arm moves")
    return sequence


def test_killed_in_the_middle_of_a_move_the_arm_stands_at_once_and_nothing_moves_after(
    tmp_path: Path, plc: HandPlc, wired: tuple[UrController, int]
) -> None:
    controller, sim_port = wired
    config = _config(tmp_path, controller.host, sim_port, plc.port)
    with daemon(config) as first:
        first.started()
        plc.enable()
        sequence = _under_way(plc, controller)
        first.signal(signal.SIGKILL)
        began_at = time.monotonic()
        until(lambda: not controller.moving, 2.0, "the arm stands")
        assert time.monotonic() - began_at < STANDS_S
    until(lambda: controller.status()["runtime"] == "STOPPED", 2.0, "its watchdog stops the program")
    started, distance_m = controller.number("moves_started"), controller.number("distance_m")

    with daemon(config) as second:
        second.started()
        assert plc.result(sequence, START_S).result_code == ResultCode.INTERRUPTED_BY_RESTART
        plc.enable()
        assert (controller.number("moves_started"), controller.number("distance_m")) == (started, distance_m)
        plc.change(speed_percent=100)
        assert plc.run(PlcCommand.HOME).result_code == ResultCode.OK
        assert controller.number("moves_started") > started
        assert second.terminate()[0] == 0
    assert [row.seq for row in orders(tmp_path)].count(sequence) == 1
    assert plc.violations == []


def test_a_protective_stop_in_a_pick_is_told_and_waits_for_a_reset(
    tmp_path: Path, plc: HandPlc, wired: tuple[UrController, int]
) -> None:
    controller, sim_port = wired
    config = _config(tmp_path, controller.host, sim_port, plc.port)
    with daemon(config) as running:
        running.started()
        plc.enable()
        sequence = _under_way(plc, controller)
        controller.do("protective_stop")
        got = plc.result(sequence, START_S)
        assert got.result_code == ResultCode.PROTECTIVE_STOP
        told = plc.wait(lambda s: s.fault, "a fault")
        assert (told.fault_code, told.protective_stop, told.robot_link) == (411, True, True)
        assert controller.status()["program"] == "rtde_control"
        assert controller.status()["runtime"] == "STOPPED"  # nothing is left that play could go on with
        started, distance_m = controller.number("moves_started"), controller.number("distance_m")

        plc.reset()
        plc.wait(lambda s: s.ready and not s.fault, "ready after the reset", START_S)
        assert (controller.number("moves_started"), controller.number("distance_m")) == (started, distance_m)
        plc.change(speed_percent=100)
        assert plc.run(PlcCommand.HOME).result_code == ResultCode.OK
        assert running.terminate()[0] == 0
    assert plc.violations == []
