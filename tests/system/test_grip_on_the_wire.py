"""A part in the hand or not, from the sensor to the PLC: arm over RTDE, grippers on its outputs and on
Robotiq's socket, and a simulated cell in which the part really is held, missed or lost."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml

from drivers.types import ResultCode
from tests.fakes.robotiq import robotiq_peer
from tests.fakes.simcell import SimCell, sim_cell
from tests.fakes.ur_controller import ur_controller
from tests.system.handplc import HandPlc, hand_plc
from tests.system.processes import DEMO, START_S, Daemon, Json, daemon


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """A whole cell at work."""

    world: SimCell
    plc: HandPlc
    running: Daemon


def _written(folder: Path, world_port: int, plc_port: int, host: str, gripper: dict[str, Json]) -> Path:
    data = yaml.safe_load(DEMO.read_text(encoding="utf-8"))
    arm = yaml.safe_load((DEMO.parent / "ur.yaml").read_text(encoding="utf-8"))
    for eye in ("left", "right"):
        data["cameras"][eye]["port"] = world_port
    data["robot"] = {**arm["robot"], "host": host}
    data["gripper"] = gripper or arm["gripper"]
    data["plc"]["port"] = plc_port
    data["allow_mixed"] = True
    data["files"] = {"calibration": str(DEMO.parent / "calibration.json"), "journal": "journal.sqlite"}
    path = folder / "cell.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return path


@pytest.fixture(params=["robot_io", "robotiq"], scope="module")
def cell(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with ExitStack() as stack:
        world = stack.enter_context(sim_cell("--sticks", "6", "--seed", "7"))
        controller = stack.enter_context(ur_controller("--payload", "0.9", "--world-port", str(world.port)))
        gripper: dict[str, Json] = {}
        if request.param == "robotiq":
            peer = stack.enter_context(robotiq_peer("--world-port", str(world.port)))
            gripper = {
                "driver": "robotiq",
                "host": peer.host,
                "port": peer.port,
                "open_position": 150,
                "empty_from": 225,
                "force": 10,
            }
        plc = stack.enter_context(hand_plc())
        path = _written(tmp_path_factory.mktemp("cell"), world.port, plc.port, controller.host, gripper)
        running = stack.enter_context(daemon(path))
        running.wait_for("state_changed", START_S, after="IDLE")
        plc.enable()
        yield Cell(world=world, plc=plc, running=running)
        assert plc.violations == []
        assert running.terminate()[0] == 0


BUSY = {401, 402, 403, 421}
"""Faults of a machine that is too busy for real time: reset, and ordered again."""


def _picked(cell: Cell, attempts: int) -> ResultCode:
    """The result of one order, the machine permitting."""
    for _ in range(6):
        for _ in range(6):
            if cell.plc.status.ready:
                break
            cell.plc.reset()
            with suppress(AssertionError):
                cell.plc.wait(lambda s: s.ready, "ready", 12.0)
        got = cell.plc.result(cell.plc.order(attempts=attempts), within_s=90.0)
        if cell.plc.status.fault_code not in BUSY:
            return ResultCode(got.result_code)
    raise AssertionError("the machine is too busy for a pick")


def _in_box(cell: Cell) -> int:
    return cell.world.count("in_box")


def _told(cell: Cell, event: str) -> list[Json]:
    return [line["grip"] for line in cell.running.events(event)]


def test_a_part_is_held_on_both_looks_and_lies_in_the_box(cell: Cell) -> None:
    before = _in_box(cell)
    assert _picked(cell, attempts=1) is ResultCode.OK
    assert _in_box(cell) == before + 1
    assert _told(cell, "grip_closed")[-1] == "holding"
    assert _told(cell, "grip_after_retreat")[-1] == "holding"


@pytest.mark.parametrize(
    ("upset", "code", "closed"),
    [
        ("miss_next", ResultCode.GRIP_FAILED, "closed_empty"),
        ("drop_next", ResultCode.PART_LOST, "holding"),
    ],
)
def test_a_part_that_is_not_there_is_not_reported_as_picked(
    cell: Cell, upset: str, code: ResultCode, closed: str
) -> None:
    before = _in_box(cell)
    cell.world.fault(upset)
    assert _picked(cell, attempts=1) is code
    assert _told(cell, "grip_closed")[-1] == closed
    assert _in_box(cell) == before
    assert cell.plc.status.part_in_gripper is False
    # nothing is broken by it: the next order picks
    assert _picked(cell, attempts=3) is ResultCode.OK
    assert _in_box(cell) == before + 1
