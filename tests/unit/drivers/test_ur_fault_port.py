"""The fault port's requests without its socket, and the page that lists them."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.sim.ur_codes import RobotMode, Runtime, Safety
from drivers.sim.ur_core import Core, Setup
from drivers.sim.ur_faults import Faults
from drivers.sim.ur_ports import Ports
from drivers.sim.ur_session import Owners

PAGE = Path(__file__).parents[3] / "docs" / "explanation" / "simulated-controller.md"


class Machine:
    """What the fault port may stop."""

    standing = False
    world = "none"


@pytest.fixture
def core() -> Core:
    return Core(Setup())


@pytest.fixture
def owners() -> Owners:
    return Owners()


@pytest.fixture
def machine() -> Machine:
    return Machine()


@pytest.fixture
def faults(core: Core, owners: Owners, machine: Machine) -> Iterator[Faults]:
    ports = Ports("127.0.0.1", seed=0)
    yield Faults(core, ports, owners, machine)
    ports.close()


def do(faults: Faults, doing: str, **values: object) -> None:
    assert faults.answer(json.dumps({"do": doing, **values}).encode()) == {"ok": True}


def test_the_page_lists_every_fault_and_no_other(faults: Faults) -> None:
    table = PAGE.read_text(encoding="utf-8").split("## The fault port")[1].split("\n## ")[0]
    rows = [line.split("|")[1] for line in table.splitlines() if line.startswith("| `")]
    listed = {name for row in rows for name in re.findall(r"`(\w+)`", row)} - {"do"}
    assert listed == set(faults.doings)


def test_the_status_is_json_and_says_where_everything_stands(faults: Faults, core: Core) -> None:
    core.step()
    status = json.loads(json.dumps(faults.answer(b'{"do": "status"}')))
    assert status["q"] == list(core.arm.q)
    assert (status["safety"], status["runtime"], status["robot_mode"]) == ("NORMAL", "STOPPED", "RUNNING")
    assert (status["moving"], status["world"], status["time_s"]) == (False, "none", 0.002)


def test_states_change_at_once(faults: Faults, core: Core, machine: Machine, owners: Owners) -> None:
    do(faults, "remote", on=False)
    do(faults, "version", polyscope="5.9.1")
    do(faults, "script", how="die")
    do(faults, "slow", factor=0.25)
    do(faults, "speed_slider", fraction=0.5)
    do(faults, "payload", kg=2.5)
    do(faults, "inputs", bits=6)
    do(faults, "freeze", what="clock")
    do(faults, "registers", taken="upper")
    do(faults, "hide", names=["payload"])
    assert (core.remote, core.version, core.script_fault) == (False, (5, 9, 1), "die")
    assert (core.arm.slow, core.arm.slider, core.payload_kg, core.io.inputs) == (0.25, 0.5, 2.5, 6)
    assert machine.standing
    assert not owners.free_for("input_int_register_24", 1)
    assert owners.free_for("input_int_register_23", 1)
    assert owners.hidden == {"payload"}


@pytest.mark.parametrize(
    ("doing", "safety"),
    [
        ("protective_stop", Safety.PROTECTIVE_STOP),
        ("safeguard", Safety.SAFEGUARD_STOP),
        ("emergency_stop", Safety.ROBOT_EMERGENCY_STOP),
        ("violation", Safety.VIOLATION),
        ("reduced", Safety.REDUCED),
    ],
)
def test_safety_states(faults: Faults, core: Core, doing: str, safety: Safety) -> None:
    do(faults, doing)
    assert core.safety is safety


def test_a_program_is_killed_and_the_power_switched_off(faults: Faults, core: Core) -> None:
    core.upload("def small():\n\tsleep(10)\nend")
    while core.runtime is not Runtime.PLAYING:
        core.step()
    do(faults, "kill_program")
    core.step()
    assert core.counts["stops"] == 1
    do(faults, "power_off")
    assert core.mode is RobotMode.POWER_OFF


def test_what_is_armed_waits(faults: Faults, core: Core) -> None:
    do(faults, "protective_stop", at={"after_s": 0.1})
    for _ in range(49):
        core.step()
    assert core.counts["protective_stop"] == 0
    core.step()
    core.step()
    assert core.counts["protective_stop"] == 1
    do(faults, "remote", on=False, at={"moving_s": 0.1})
    for _ in range(500):
        core.step()
    assert core.remote  # nothing moved
