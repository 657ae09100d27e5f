"""What can be wrong with a controller before the arm may move: each is told with what to do, and opening the
arm is refused in time with the fault code that belongs to it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import pytest

from cell.faults import FaultCode, fault_of
from drivers.errors import CommandRejected, DriverError
from drivers.robot.ur import UrRobot
from drivers.robot.ur_preflight import checks
from drivers.timing import MonotonicClock, StopToken
from drivers.types import Check, JointAngles, JointMotion
from tests.fakes.ur_controller import START_Q, Json, UrController, free_host, ur_controller

CLOCK = MonotonicClock()
QUICK = JointMotion(speed_rad_s=2.0, accel_rad_s2=4.0, timeout_s=10.0)
ALL: list[Json] = [29999, 30001, 30002, 30003, 30004]


@pytest.fixture(scope="module")
def running() -> Iterator[UrController]:
    with ur_controller("--payload", "0.9") as controller:
        yield controller


@pytest.fixture
def controller(running: UrController) -> Iterator[UrController]:
    yield running
    running.do("release")
    running.mend()
    running.do("payload", kg=0.9)


@dataclass(frozen=True, slots=True, kw_only=True)
class Wrong:
    """One thing that is wrong: which line tells it in which words, and the fault it becomes."""

    what: str
    do: Callable[[UrController], None]
    found: str
    advice: str
    code: FaultCode
    settings: dict[str, object] = field(default_factory=dict)


def _do(doing: str, /, **values: Json) -> Callable[[UrController], None]:
    return lambda controller: controller.do(doing, **values)


def _nothing(_: UrController) -> None:
    """It is the settings that are wrong."""


C = FaultCode
WRONG = {
    "local control": Wrong(
        what="control",
        do=_do("remote", on=False),
        found="local",
        advice="remote control at its panel",
        code=C.NOT_IN_REMOTE,
    ),
    "a fieldbus holds the registers": Wrong(
        what="registers",
        do=_do("registers", taken="lower"),
        found="0-23 are held by a fieldbus: PROFINET, or EtherNet/IP",
        advice="robot.registers: upper",
        code=C.MOVE_REJECTED,
    ),
    "the upper ones as well": Wrong(
        what="registers",
        do=_do("registers", taken="upper"),
        found="24-47 are held",
        advice="Installation > Fieldbus",
        code=C.MOVE_REJECTED,
        settings={"registers": "upper"},
    ),
    "PolyScope too old": Wrong(
        what="PolyScope",
        do=_do("version", polyscope="5.4.0"),
        found="5.4.0",
        advice="5.6 or later",
        code=C.MOVE_REJECTED,
    ),
    "upper registers of a PolyScope that breaks them": Wrong(
        what="PolyScope",
        do=_do("version", polyscope="5.23.0"),
        found="5.23.0 with robot.registers: upper",
        advice="set robot.registers: lower",
        code=C.MOVE_REJECTED,
        settings={"registers": "upper"},
    ),
    "speed slider": Wrong(
        what="speed slider",
        do=_do("speed_slider", fraction=0.03),
        found="3 %",
        advice="raise it at the panel",
        code=C.MOVE_REJECTED,
    ),
    "another tool on the pendant": Wrong(
        what="tool",
        do=_nothing,
        found="0.1650",
        advice="Installation > TCP",
        code=C.MOVE_REJECTED,
        settings={"tool_from": "installation", "tcp_m_rad": (0.0, 0.0, 0.2, 0.0, 0.0, 0.0)},
    ),
    "another payload on the pendant": Wrong(
        what="payload",
        do=_do("payload", kg=2.0),
        found="2.00 kg",
        advice="Installation > Payload",
        code=C.MOVE_REJECTED,
        settings={"tool_from": "installation", "payload_cog_m": (0.0, 0.0, 0.0)},
    ),
    "another arm": Wrong(
        what="arm",
        do=_nothing,
        found="UR5",
        advice="robot.model",
        code=C.MOVE_REJECTED,
        settings={"model": "UR10e"},
    ),
    "dashboard answers late": Wrong(
        what="controller",
        do=_do("delay", what="dashboard", s=3.5),
        found="does not answer",
        advice="robot.host",
        code=C.ROBOT_SLOW,
    ),
    "nothing answers": Wrong(
        what="controller",
        do=_do("freeze", what="all"),
        found="does not answer",
        advice="robot.host",
        code=C.ROBOT_SLOW,
    ),
    "RTDE mute": Wrong(
        what="RTDE",
        do=_do("freeze", what="rtde"),
        found="no answer to VERSION",
        advice="30004",
        code=C.ROBOT_SLOW,
    ),
    "RTDE port closed": Wrong(
        what="RTDE", do=_do("refuse", ports=[30004]), found="refused", advice="30004", code=C.ROBOT_LOST
    ),
    "script port closed": Wrong(
        what="programs",
        do=_do("refuse", ports=[30003]),
        found="30003 does not answer",
        advice="Services",
        code=C.ROBOT_LOST,
    ),
    "switched off": Wrong(
        what="controller",
        do=_nothing,
        found="no dashboard",
        advice="its power",
        code=C.ROBOT_LOST,
        settings={"host": free_host()},
    ),
}


def _line(lines: tuple[Check, ...], what: str) -> Check:
    (line,) = (one for one in lines if one.what == what)
    return line


def test_a_controller_that_is_as_it_should_be_has_no_wrong_line(controller: UrController) -> None:
    before = controller.status()["counts"]
    lines = checks(controller.settings(tool_from="installation", payload_cog_m=(0.0, 0.0, 0.0)), CLOCK)
    assert [line for line in lines if not line.ok] == []
    assert {line.what for line in lines} >= {
        *("controller", "PolyScope", "arm", "control", "safety", "power", "program", "RTDE"),
        *("registers", "outputs", "programs", "speed slider", "tool", "payload"),
    }
    after = controller.status()["counts"]
    assert isinstance(before, dict)
    assert isinstance(after, dict)
    assert after.get("uploads") == before.get("uploads")  # looking starts no program
    assert controller.status()["owned_inputs"] == 0  # and holds nothing


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_told_with_what_to_do_and_the_arm_is_not_opened(
    name: str, controller: UrController
) -> None:
    wrong = WRONG[name]
    settings = controller.settings(**wrong.settings)
    wrong.do(controller)
    line = _line(checks(settings, CLOCK), wrong.what)
    assert not line.ok
    assert wrong.found in line.found
    assert wrong.advice in line.do

    robot = UrRobot("robot", settings, CLOCK)
    began_at = time.monotonic()
    with pytest.raises(DriverError) as caught:
        robot.open()
    assert time.monotonic() - began_at < 3.0
    assert fault_of(caught.value).code is wrong.code
    assert robot.worker_pid is None
    assert controller.status()["moves_started"] == 0


def test_registers_in_the_other_half_work_where_a_fieldbus_holds_the_lower_ones(
    controller: UrController,
) -> None:
    controller.do("registers", taken="lower")
    robot = UrRobot("robot", controller.settings(registers="upper"), CLOCK)
    robot.open()
    robot.close()


def test_a_control_program_that_does_not_start_is_refused_in_time(controller: UrController) -> None:
    controller.do("script", how="ignore")
    robot = UrRobot("robot", controller.settings(), CLOCK)
    began_at = time.monotonic()
    with pytest.raises(CommandRejected, match="program"):
        robot.open()
    assert time.monotonic() - began_at < 10.0
    assert robot.worker_pid is None


def test_a_control_program_that_dies_soon_after_its_start_moves_nothing(controller: UrController) -> None:
    controller.do("script", how="die")
    robot = UrRobot("robot", controller.settings(), CLOCK)
    robot.open()  # it runs, for now
    try:
        ends_at = time.monotonic() + 2.0
        while robot.state().program_running:
            assert time.monotonic() < ends_at
            time.sleep(0.02)
        with pytest.raises(CommandRejected, match="control program does not run"):
            robot.move_joints(JointAngles(q_rad=START_Q), QUICK, StopToken(CLOCK))
    finally:
        robot.close()
    assert controller.status()["moves_started"] == 0


def test_a_program_that_somebody_else_runs_is_left_alone(controller: UrController) -> None:
    first = UrRobot("robot", controller.settings(), CLOCK)
    first.open()
    try:
        second = UrRobot("robot", controller.settings(), CLOCK)
        with pytest.raises(CommandRejected, match="program"):
            second.open()
        with pytest.raises(CommandRejected, match="runs on the controller"):
            second.recover()
        assert first.state().program_running
    finally:
        first.close()


def test_an_arm_without_power_is_opened_after_a_reset_only(controller: UrController) -> None:
    controller.do("power_off")
    robot = UrRobot("robot", controller.settings(), CLOCK)
    with pytest.raises(CommandRejected, match="POWER_OFF"):
        robot.open()
    robot.recover()
    robot.open()
    try:
        began_at = time.monotonic()
        target = JointAngles(q_rad=(START_Q[0] - 1.0, *START_Q[1:]))
        robot.move_joints(target, QUICK, StopToken(CLOCK))
        slow_s = time.monotonic() - began_at
        began_at = time.monotonic()
        robot.move_joints(JointAngles(q_rad=START_Q), QUICK, StopToken(CLOCK))
        # the first motion after it is slow
        assert slow_s > 1.5 * (time.monotonic() - began_at)
    finally:
        robot.close()
