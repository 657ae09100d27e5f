"""The UR arm alone, over RTDE with the unmodified library: what only it can be asked."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import pytest

from drivers.errors import (
    CommandRejected,
    SafetyStop,
)
from drivers.robot.ur import UrRobot
from drivers.timing import StopToken
from drivers.types import JointAngles
from tests.contract.arms import CLOCK, CRAWL, ELSEWHERE, FAR, HOME, LINE, QUICK, ur
from tests.fakes.ur_controller import UrController


@pytest.fixture
def wired(controller: UrController) -> Iterator[UrRobot]:
    made = ur(controller)
    made.open()
    made.move_joints(HOME, QUICK, StopToken(CLOCK))
    yield made
    made.close()


def test_what_nobody_should_ask_for_never_gets_to_the_library(
    wired: UrRobot, controller: UrController, stop: StopToken
) -> None:
    here = wired.state().tool
    commands = controller.status()["commands"]
    for target in (replace(here, z=math.nan), FAR, replace(here, z=-0.5)):
        with pytest.raises(CommandRejected):
            wired.move_line(target, LINE, stop)
    with pytest.raises(CommandRejected):
        wired.move_joints(JointAngles(q_rad=HOME.q_rad[:3]), QUICK, stop)  # type: ignore[arg-type]  # too few
    with pytest.raises(CommandRejected):
        wired.move_line(here, replace(LINE, speed_m_s=math.inf), stop)
    assert controller.status()["commands"] == commands


def test_an_output_follows_on_the_controller_and_a_pin_that_is_not_there_is_rejected(
    wired: UrRobot, controller: UrController
) -> None:
    for pin in (0, 9, 17):  # one of each group
        wired.set_output(pin, False)
        others = controller.status()["outputs"]
        wired.set_output(pin, True)
        assert controller.status()["outputs"] == others | 1 << pin
        wired.set_output(pin, False)
        assert controller.status()["outputs"] == others
    for pin in (-1, 18):
        with pytest.raises(CommandRejected, match="no digital output"):
            wired.set_output(pin, True)


def test_inputs_are_read_by_their_number(wired: UrRobot, controller: UrController, stop: StopToken) -> None:
    controller.do("inputs", bits=1 << 16 | 1 << 3)
    stop.wait(0.05)
    assert [pin for pin in range(18) if wired.read_input(pin)] == [3, 16]
    controller.do("inputs", bits=0)


def test_software_does_not_clear_an_emergency_stop_of_the_wire(
    wired: UrRobot, controller: UrController, stop: StopToken
) -> None:
    controller.do("emergency_stop")
    try:
        stop.wait(0.05)
        with pytest.raises(CommandRejected, match="release the emergency stop"):
            wired.recover()
        with pytest.raises(SafetyStop):
            wired.move_joints(ELSEWHERE, QUICK, stop)
    finally:
        controller.do("release")
    wired.recover()  # a person let go of the button: power and brakes are software's
    wired.move_joints(HOME, QUICK, stop)


def test_after_a_safety_stop_on_the_way_the_old_motion_is_never_taken_up_again(
    wired: UrRobot, controller: UrController, stop: StopToken
) -> None:
    here = wired.state().tool
    controller.do("protective_stop", at={"moving_s": 0.2})
    with pytest.raises(SafetyStop):
        wired.move_line(replace(here, z=here.z - 0.1), CRAWL, stop)
    stopped_at = controller.status()["tcp"]
    wired.recover()
    stop.wait(0.3)
    assert controller.status()["tcp"] == pytest.approx(stopped_at, abs=1e-5)
    assert wired.state().tool.six() == pytest.approx(stopped_at, abs=1e-5)
    assert controller.status()["counts"].get("play", 0) == 0
    wired.move_joints(HOME, QUICK, stop)
