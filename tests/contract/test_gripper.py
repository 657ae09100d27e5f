"""What every gripper promises (DESIGN section 5), over the simulated cell's socket and the double."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from drivers.errors import DeviceUnavailable
from drivers.interfaces import Gripper
from drivers.settings import SimGripperSettings, SimRobotSettings
from drivers.sim.devices import SimGripper, SimRobot
from drivers.sim.geometry import tool_pose
from drivers.timing import MonotonicClock, StopRequested, StopToken
from drivers.types import Grip, JointAngles, JointMotion, LineMotion, ToolPose
from tests.fakes.gripper import FakeGripper
from tests.fakes.simcell import SimCell, sim_cell

CLOCK = MonotonicClock()
TRAVEL = LineMotion(speed_m_s=0.6, accel_m_s2=1.5, timeout_s=10.0)
BOX = ToolPose(x=0.34, y=-0.38, z=0.14, rx=3.14159, ry=0.0, rz=0.0)
HOME = JointAngles(q_rad=(2.14, -1.92, 1.91, -1.56, -1.5708, 3.71))
QUICK = JointMotion(speed_rad_s=2.0, accel_rad_s2=4.0, timeout_s=10.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """One implementation, with nothing between its jaws."""

    good: Callable[[], Gripper]
    absent: Callable[[], Gripper]


@pytest.fixture(scope="module")
def cell() -> Iterator[SimCell]:
    with sim_cell("--sticks", "6", "--speed", "8") as running:
        yield running


def sim(port: int) -> SimGripper:
    return SimGripper("gripper", SimGripperSettings(driver="sim", port=port), CLOCK)


def scripted(open_error: Exception | None = None) -> FakeGripper:
    gripper = FakeGripper("gripper", [Grip.CLOSED_EMPTY] * 5)
    gripper.open_error = open_error
    return gripper


@pytest.fixture(params=["sim", "scripted"])
def kind(request: pytest.FixtureRequest, cell: SimCell) -> Kind:
    if request.param == "sim":
        return Kind(good=lambda: sim(cell.port), absent=lambda: sim(9))
    return Kind(good=scripted, absent=lambda: scripted(DeviceUnavailable("gripper", "not there")))


@pytest.fixture
def stop() -> StopToken:
    return StopToken(CLOCK)


@pytest.fixture
def gripper(kind: Kind) -> Iterator[Gripper]:
    made = kind.good()
    made.open()
    yield made
    made.close()


def test_a_gripper_that_was_not_opened_or_was_closed_is_unavailable(kind: Kind) -> None:
    made = kind.good()
    with pytest.raises(DeviceUnavailable):
        made.grip()
    made.close()
    made.open()
    made.close()
    made.close()
    with pytest.raises(DeviceUnavailable):
        made.grip()


def test_an_absent_gripper_fails_at_open(kind: Kind) -> None:
    with pytest.raises(DeviceUnavailable):
        kind.absent().open()


def test_closing_on_nothing_is_empty_and_releasing_opens(gripper: Gripper, stop: StopToken) -> None:
    gripper.release(stop=stop)
    assert gripper.grip() is Grip.OPEN
    assert gripper.grasp(stop=stop) is Grip.CLOSED_EMPTY
    assert gripper.grip() is Grip.CLOSED_EMPTY
    gripper.release(stop=stop)
    assert gripper.grip() is Grip.OPEN


def test_a_fired_token_ends_the_wait(gripper: Gripper, stop: StopToken) -> None:
    stop.stop("asked to end")
    with pytest.raises(StopRequested):
        gripper.grasp(stop=stop)


# ------------------------------------------------------------------ with the simulated arm and parts


@pytest.fixture
def hand(cell: SimCell, stop: StopToken) -> Iterator[tuple[SimRobot, SimGripper]]:
    robot, gripper = SimRobot("robot", SimRobotSettings(driver="sim", port=cell.port), CLOCK), sim(cell.port)
    robot.open()
    gripper.open()
    gripper.release(stop=stop)
    yield robot, gripper
    robot.move_joints(HOME, QUICK, stop)
    gripper.release(stop=stop)
    gripper.close()
    robot.close()


def grasp_pose(cell: SimCell, above_m: float = 0.0, aside_m: float = 0.0) -> ToolPose:
    """Over the middle of the stick dropped last: jaws across it, hand straight down."""
    sticks = cell.ask("truth").values["sticks"]
    assert isinstance(sticks, list)
    last = sticks[-1]
    assert isinstance(last, dict)
    ends = np.array(last["ends_m"], dtype=np.float64)
    along = ends[1] - ends[0]
    y = np.array([along[0], along[1], 0.0]) / np.hypot(along[0], along[1])
    if y[0] < 0.0:
        y = -y
    z = np.array([0.0, 0.0, -1.0])
    base_from_tool = np.eye(4)
    base_from_tool[:3, :3] = np.column_stack([np.cross(y, z), y, z])
    base_from_tool[:3, 3] = ends.mean(axis=0) + above_m * -z + aside_m * base_from_tool[:3, 0]
    return tool_pose(base_from_tool)


def go(cell: SimCell, hand: tuple[SimRobot, SimGripper], stop: StopToken, aside_m: float = 0.0) -> Grip:
    """Down to the last stick, close, and up again."""
    robot, gripper = hand
    over, at = grasp_pose(cell, 0.08, aside_m), grasp_pose(cell, 0.0, aside_m)
    robot.move_line(over, TRAVEL, stop)
    robot.move_line(at, TRAVEL, stop)
    grip = gripper.grasp(stop=stop)
    robot.move_line(over, TRAVEL, stop)
    return grip


def test_a_part_between_the_jaws_is_held_and_ends_in_the_box(
    cell: SimCell, hand: tuple[SimRobot, SimGripper], stop: StopToken
) -> None:
    before, boxed = cell.count("in_tray"), cell.count("in_box")
    assert go(cell, hand, stop) is Grip.HOLDING
    assert cell.count("in_tray") == before - 1
    hand[0].move_line(BOX, TRAVEL, stop)
    hand[1].release(stop=stop)
    assert cell.count("in_box") == boxed + 1
    assert cell.count("collisions") == 0


def test_a_part_outside_the_jaws_is_missed(
    cell: SimCell, hand: tuple[SimRobot, SimGripper], stop: StopToken
) -> None:
    before = cell.count("in_tray")
    assert go(cell, hand, stop, aside_m=0.0085) is Grip.CLOSED_EMPTY
    assert cell.count("in_tray") == before


def test_jaws_that_land_on_a_part_collide_and_get_nothing(
    cell: SimCell, hand: tuple[SimRobot, SimGripper], stop: StopToken
) -> None:
    before = cell.count("collisions")
    assert go(cell, hand, stop, aside_m=0.012) is Grip.CLOSED_EMPTY
    assert cell.count("collisions") == before + 1


def test_a_part_that_slips_is_noticed_and_lies_in_the_tray_again_or_on_the_table(
    cell: SimCell, hand: tuple[SimRobot, SimGripper], stop: StopToken
) -> None:
    before = cell.count("in_tray")
    dropped = cell.count("dropped")
    cell.fault("drop_next")
    gripper = hand[1]
    go(cell, hand, stop)
    until = CLOCK.now() + 3.0
    while gripper.grip() is Grip.HOLDING and CLOCK.now() < until:
        stop.wait(0.02)
    assert gripper.grip() is Grip.CLOSED_EMPTY
    assert cell.count("dropped") == dropped + 1
    assert cell.count("in_tray") == before


def test_a_grasp_told_to_miss_misses_once(
    cell: SimCell, hand: tuple[SimRobot, SimGripper], stop: StopToken
) -> None:
    cell.fault("miss_next")
    assert go(cell, hand, stop) is Grip.CLOSED_EMPTY
    hand[1].release(stop=stop)
    assert go(cell, hand, stop) is Grip.HOLDING
