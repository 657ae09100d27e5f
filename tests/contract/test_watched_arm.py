"""What every arm promises that a person leads: it says where it is, and nothing is started on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest

from drivers.errors import CommandRejected, DeviceUnavailable
from drivers.factory import Factory
from drivers.interfaces import WatchedArm
from drivers.settings import SimRobotSettings
from drivers.sim.robot import SimRobot
from drivers.timing import MonotonicClock, StopToken
from drivers.types import JointAngles, JointMotion
from tests.fakes.simcell import sim_cell
from tests.fakes.ur_controller import free_host, ur_controller

CLOCK = MonotonicClock()
ELSEWHERE = JointAngles(q_rad=(1.9, -1.7, 1.8, -1.6, -1.5708, 3.71))
QUICK = JointMotion(speed_rad_s=2.0, accel_rad_s2=4.0, timeout_s=10.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    good: Callable[[], WatchedArm]
    absent: Callable[[], WatchedArm]


@pytest.fixture(scope="module", params=["sim", "ur"])
def kind(request: pytest.FixtureRequest) -> Iterator[Kind]:
    factory = Factory(CLOCK)
    if request.param == "ur":
        with ur_controller() as controller:
            there = controller.settings().model_copy(update={"tool_from": "installation"})
            nobody = there.model_copy(update={"host": free_host()})
            yield Kind(
                good=lambda: factory.watched_arm("robot", there),
                absent=lambda: factory.watched_arm("robot", nobody),
            )
        return
    with sim_cell("--sticks", "0", "--speed", "4") as cell:
        at = SimRobotSettings(driver="sim", port=cell.port)
        yield Kind(
            good=lambda: factory.watched_arm("robot", at),
            absent=lambda: factory.watched_arm("robot", SimRobotSettings(driver="sim", port=9)),
        )


def test_it_says_where_it_is_and_runs_no_program(kind: Kind) -> None:
    arm = kind.good()
    arm.open()
    try:
        state = arm.state()
        assert not state.moving
        assert abs(state.tool.z) < 2.0
        assert arm.name == "robot"
    finally:
        arm.close()
        arm.close()


def test_one_that_is_not_there_says_so_and_may_be_closed(kind: Kind) -> None:
    arm = kind.absent()
    arm.close()
    with pytest.raises(DeviceUnavailable, match="robot"):
        arm.open()
    with pytest.raises(DeviceUnavailable):
        arm.state()
    arm.close()


def test_on_a_ur_arm_no_program_is_started_and_its_tool_must_be_the_pendants() -> None:
    with ur_controller() as controller:
        settings = controller.settings()
        arm = Factory(CLOCK).watched_arm("robot", settings.model_copy(update={"tool_from": "installation"}))
        arm.open()
        try:
            assert not arm.state().program_running
        finally:
            arm.close()
        sets_its_own = Factory(CLOCK).watched_arm(
            "robot", settings.model_copy(update={"tool_from": "configuration"})
        )
        with pytest.raises(CommandRejected, match="set the tool on the pendant"):
            sets_its_own.open()


def test_somebody_else_may_move_it_meanwhile() -> None:
    with sim_cell("--sticks", "0", "--speed", "8") as cell:
        at = SimRobotSettings(driver="sim", port=cell.port)
        arm, hand = Factory(CLOCK).watched_arm("robot", at), SimRobot("hand", at, CLOCK)
        hand.open()
        arm.open()
        try:
            hand.move_joints(ELSEWHERE, QUICK, StopToken(CLOCK))
            assert arm.state().joints.q_rad == pytest.approx(ELSEWHERE.q_rad, abs=1e-3)
        finally:
            arm.close()
            hand.close()
