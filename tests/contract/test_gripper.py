"""What every gripper promises (DESIGN section 5): the simulated cell's, one wired to its arm, one that speaks
Robotiq's protocol, and the double."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import pytest

from drivers.errors import DeviceUnavailable
from drivers.gripper.robot_io import RobotIoGripper
from drivers.gripper.robotiq import RobotiqGripper
from drivers.interfaces import DigitalIo, Gripper
from drivers.settings import (
    RobotIoGripperSettings,
    RobotiqGripperSettings,
    SimGripperSettings,
    SimRobotSettings,
)
from drivers.sim.devices import SimGripper
from drivers.sim.geometry import Floats, tool_pose
from drivers.sim.robot import SimRobot
from drivers.timing import MonotonicClock, StopRequested, StopToken
from drivers.types import Grip, JointAngles, JointMotion, LineMotion, ToolPose
from tests.fakes.gripper import FakeGripper
from tests.fakes.robotiq import RobotiqPeer, robotiq_peer
from tests.fakes.simcell import SimCell, sim_cell

CLOCK = MonotonicClock()
TRAVEL = LineMotion(speed_m_s=0.6, accel_m_s2=1.5, timeout_s=10.0)
BOX = ToolPose(x=0.34, y=-0.38, z=0.14, rx=3.14159, ry=0.0, rz=0.0)
HOME = JointAngles(q_rad=(2.14, -1.92, 1.91, -1.56, -1.5708, 3.71))
QUICK = JointMotion(speed_rad_s=2.0, accel_rad_s2=4.0, timeout_s=10.0)


SPEED = "8"


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """One implementation, with nothing between its jaws."""

    good: Callable[[], Gripper]
    absent: Callable[[], Gripper]


@pytest.fixture(scope="module")
def cell() -> Iterator[SimCell]:
    with sim_cell("--sticks", "3", "--speed", SPEED) as running:
        yield running


@pytest.fixture(scope="module")
def peer(cell: SimCell) -> Iterator[RobotiqPeer]:
    with robotiq_peer("--speed", SPEED, "--world-port", str(cell.port)) as running:
        yield running


@pytest.fixture
def arm(cell: SimCell) -> Iterator[SimRobot]:
    """The simulated arm, to which a gripper may be wired."""
    robot = SimRobot("robot", SimRobotSettings(driver="sim", port=cell.port), CLOCK)
    robot.open()
    yield robot
    robot.close()


def sim(port: int) -> SimGripper:
    return SimGripper("gripper", SimGripperSettings(driver="sim", port=port), CLOCK)


def wired(io: DigitalIo) -> RobotIoGripper:
    settings = RobotIoGripperSettings(
        driver="robot_io", close_output=0, holding_input=0, closing_s=0.2, opening_s=0.1
    )
    return RobotIoGripper("gripper", settings, io, CLOCK)


def robotiq(port: int) -> RobotiqGripper:
    settings = RobotiqGripperSettings(
        driver="robotiq", host="127.0.0.1", port=port, open_position=150, empty_from=225, force=10
    )
    return RobotiqGripper("gripper", settings, CLOCK)


def scripted(open_error: Exception | None = None) -> FakeGripper:
    gripper = FakeGripper("gripper", [Grip.CLOSED_EMPTY] * 5)
    gripper.open_error = open_error
    return gripper


@pytest.fixture(params=["sim", "robot_io", "robotiq", "scripted"])
def kind(request: pytest.FixtureRequest, cell: SimCell) -> Kind:
    match request.param:
        case "sim":
            return Kind(good=lambda: sim(cell.port), absent=lambda: sim(9))
        case "robot_io":
            robot: SimRobot = request.getfixturevalue("arm")
            away = SimRobot("robot", SimRobotSettings(driver="sim", port=cell.port), CLOCK)
            return Kind(good=lambda: wired(robot), absent=lambda: wired(away))
        case "robotiq":
            port = request.getfixturevalue("peer").port
            return Kind(good=lambda: robotiq(port), absent=lambda: robotiq(9))
    return Kind(good=scripted, absent=lambda: scripted(DeviceUnavailable("gripper", "not there")))


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


Hand: TypeAlias = tuple[SimRobot, Gripper]


@pytest.fixture(params=["sim", "robot_io", "robotiq"])
def hand(request: pytest.FixtureRequest, cell: SimCell, arm: SimRobot, stop: StopToken) -> Iterator[Hand]:
    gripper: Gripper
    match request.param:
        case "sim":
            gripper = sim(cell.port)
        case "robot_io":
            gripper = wired(arm)
        case _:
            gripper = robotiq(request.getfixturevalue("peer").port)
    gripper.open()
    gripper.release(stop=stop)
    cell.ask("add_sticks", count=max(0, 3 - cell.count("in_tray")))
    yield arm, gripper
    arm.move_joints(HOME, QUICK, stop)
    gripper.release(stop=stop)
    gripper.close()


def freest(cell: SimCell) -> Floats:
    """(2, 3) ends of the stick with the most room around its middle: nothing else is met on the way to it."""
    sticks = cell.ask("truth").values["sticks"]
    assert isinstance(sticks, list)
    ends = np.array([stick["ends_m"] for stick in sticks if isinstance(stick, dict)], dtype=np.float64)
    share = np.linspace(0.0, 1.0, 41)[:, None]

    def room(number: int) -> float:
        others = np.delete(ends, number, axis=0)
        points = others[:, :1] + share * (others[:, 1:] - others[:, :1])
        middle = ends[number].mean(axis=0)
        return float(np.linalg.norm((points - middle)[..., :2], axis=-1).min(initial=1.0))

    return np.asarray(ends[max(range(len(ends)), key=room)])


def grasp_pose(ends: Floats, above_m: float = 0.0, aside_m: float = 0.0) -> ToolPose:
    """Over the middle of a stick: jaws across it, hand straight down."""
    along = ends[1] - ends[0]
    y = np.array([along[0], along[1], 0.0]) / np.hypot(along[0], along[1])
    if y[0] < 0.0:
        y = -y
    z = np.array([0.0, 0.0, -1.0])
    base_from_tool = np.eye(4)
    base_from_tool[:3, :3] = np.column_stack([np.cross(y, z), y, z])
    base_from_tool[:3, 3] = ends.mean(axis=0) + above_m * -z + aside_m * base_from_tool[:3, 0]
    return tool_pose(base_from_tool)


def go(cell: SimCell, hand: Hand, stop: StopToken, aside_m: float = 0.0) -> Grip:
    """Down to a stick, close, and up again."""
    robot, gripper = hand
    ends = freest(cell)
    over, at = grasp_pose(ends, 0.08, aside_m), grasp_pose(ends, 0.0, aside_m)
    robot.move_line(over, TRAVEL, stop)
    robot.move_line(at, TRAVEL, stop)
    grip = gripper.grasp(stop=stop)
    robot.move_line(over, TRAVEL, stop)
    return grip


def test_a_part_between_the_jaws_is_held_and_ends_in_the_box(
    cell: SimCell, hand: Hand, stop: StopToken
) -> None:
    before, boxed = cell.count("in_tray"), cell.count("in_box")
    assert go(cell, hand, stop) is Grip.HOLDING
    assert cell.count("in_tray") == before - 1
    hand[0].move_line(BOX, TRAVEL, stop)
    hand[1].release(stop=stop)
    assert cell.count("in_box") == boxed + 1
    assert cell.count("collisions") == 0


def test_a_part_outside_the_jaws_is_missed(cell: SimCell, hand: Hand, stop: StopToken) -> None:
    before = cell.count("in_tray")
    assert go(cell, hand, stop, aside_m=0.0085) is Grip.CLOSED_EMPTY
    assert cell.count("in_tray") == before


def test_jaws_that_land_on_a_part_collide_and_get_nothing(cell: SimCell, hand: Hand, stop: StopToken) -> None:
    before = cell.count("collisions")
    assert go(cell, hand, stop, aside_m=0.012) is Grip.CLOSED_EMPTY
    assert cell.count("collisions") == before + 1


def test_a_part_that_slips_is_noticed_and_lies_in_the_tray_again_or_on_the_table(
    cell: SimCell, hand: Hand, stop: StopToken
) -> None:
    before = cell.count("in_tray")
    dropped = cell.count("dropped")
    cell.fault("drop_next")
    gripper = hand[1]
    assert go(cell, hand, stop) is Grip.HOLDING
    until = CLOCK.now() + 3.0
    while gripper.grip() is Grip.HOLDING and CLOCK.now() < until:
        stop.wait(0.02)
    assert gripper.grip() is Grip.CLOSED_EMPTY
    assert cell.count("dropped") == dropped + 1
    assert cell.count("in_tray") == before


def test_a_grasp_told_to_miss_misses_once(cell: SimCell, hand: Hand, stop: StopToken) -> None:
    cell.fault("miss_next")
    assert go(cell, hand, stop) is Grip.CLOSED_EMPTY
    hand[1].release(stop=stop)
    assert go(cell, hand, stop) is Grip.HOLDING
