"""A controller outside drives the simulated cell's arm: what follows, who is refused, what the jaws do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.sim.arm import Refused, find_joints
from drivers.sim.cell import load_world
from drivers.sim.controller import Controller, Drive, Driven
from drivers.sim.geometry import Floats
from drivers.sim.layout import CameraLayout, WorldLayout
from drivers.sim.optics import eyes
from drivers.sim.piles import Stick
from drivers.sim.protocol import Json, Message, ProtocolError, decode, encode
from drivers.sim.service import answer
from drivers.sim.ur_kinematics import six
from drivers.sim.world import World
from drivers.types import Grip, JointAngles, SafetyMode, Six
from tests.fakes.clock import FakeClock

WORLD = Path(__file__).parents[3] / "configs" / "demo" / "world.yaml"
UR, OTHER = 7, 8


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock(100.0)


@pytest.fixture(scope="module")
def layout() -> WorldLayout:
    """The demo's world behind lenses of a tenth of the size: nobody looks here."""
    full = load_world(WORLD)

    def small(eye: CameraLayout) -> CameraLayout:
        (fx, fy), (cx, cy) = eye.focal_px, eye.centre_px
        lens = {"focal_px": (0.1 * fx, 0.1 * fy), "centre_px": (0.1 * cx, 0.1 * cy)}
        return eye.model_copy(update=lens)

    sides = {"left": small(full.cameras.left), "right": small(full.cameras.right)}
    cameras = full.cameras.model_copy(update={**sides, "width_px": 64, "height_px": 48})
    return full.model_copy(update={"cameras": cameras})


@pytest.fixture
def world(layout: WorldLayout) -> World:
    return World(layout, count=1)


@pytest.fixture
def controller(world: World, clock: FakeClock) -> Controller:
    return Controller(world, clock, 1.0, eyes(world.layout.cameras), 1)


class Driver:
    """The controller outside."""

    def __init__(self, controller: Controller, clock: FakeClock, world: World) -> None:
        self._controller, self._clock, self._world = controller, clock, world
        self.q: Six = world.arm.joints()
        self.outputs = 0
        self.safety = SafetyMode.NORMAL

    def say(self, moving: bool = False) -> Driven:
        """One message, 4 ms after the one before."""
        self._clock.turn(0.004)
        drive = Drive(q_rad=self.q, moving=moving, safety=self.safety, outputs=self.outputs)
        return self._controller.drive(UR, drive)

    def go(self, base_from_tool: Floats, steps: int = 40) -> list[Driven]:
        """Turn all joints evenly to there."""
        goal = find_joints(base_from_tool, np.array(self.q), self._world.arm.flange_from_tool)
        assert goal is not None
        start, said = np.array(self.q), []
        for i in range(1, steps + 1):
            self.q = six([float(v) for v in start + (goal - start) * (i / steps)])
            said.append(self.say(moving=True))
        said.append(self.say())
        return said

    def stand(self, seconds: float) -> Driven:
        """At rest for so long."""
        for _ in range(round(seconds / 0.004)):
            said = self.say()
        return said


@pytest.fixture
def driver(controller: Controller, clock: FakeClock, world: World) -> Driver:
    return Driver(controller, clock, world)


def over(stick: Stick, up_m: float) -> Floats:
    """base_from_tool with the hand straight down, y along the stick."""
    y = np.array([stick.axis[0], stick.axis[1], 0.0])
    y /= np.linalg.norm(y)
    z = np.array([0.0, 0.0, -1.0])
    matrix = np.eye(4)
    matrix[:3, :3] = np.column_stack([np.cross(y, z), y, z])
    matrix[:3, 3] = stick.centre - up_m * z
    return matrix


def test_the_arm_is_where_its_driver_has_it(controller: Controller, driver: Driver) -> None:
    driver.q = (2.0, *driver.q[1:])
    driver.say(moving=True)
    state = controller.robot_state()
    assert state.joints.q_rad == driver.q
    assert state.moving
    driver.say()
    assert not controller.robot_state().moving


def test_while_it_is_driven_nobody_else_moves_it(controller: Controller, driver: Driver) -> None:
    driver.say()
    with pytest.raises(Refused, match="another client"):
        controller.move_joints(OTHER, JointAngles(q_rad=(0.0,) * 6), 1.0, 1.0)
    controller.halt()
    assert controller.robot_state().joints.q_rad == pytest.approx(driver.q)


def test_nobody_drives_an_arm_another_client_has(controller: Controller, driver: Driver) -> None:
    controller.take_control(OTHER)
    with pytest.raises(Refused, match="another client"):
        driver.say()


def test_a_driver_that_leaves_leaves_a_free_and_standing_arm(controller: Controller, driver: Driver) -> None:
    driver.say(moving=True)
    controller.drop_control(UR)
    assert not controller.robot_state().moving
    controller.take_control(OTHER)


def test_a_silent_driver_is_no_lease_gone(controller: Controller, driver: Driver, clock: FakeClock) -> None:
    driver.say(moving=True)
    for _ in range(10):
        clock.turn(0.2)
        controller.advance()
    assert controller.lease_halts == 0


def test_output_0_closes_the_jaws_and_input_0_tells_of_a_part(
    controller: Controller, driver: Driver, world: World
) -> None:
    (stick,) = world.lying
    driver.go(over(stick, 0.08))
    assert {each.inputs for each in driver.go(over(stick, 0.0))} == {0}
    driver.outputs = 1
    assert driver.stand(world.layout.gripper.grasp_s + 0.05).inputs == 1
    assert controller.grip() is Grip.HOLDING
    driver.go(over(stick, 0.1))
    assert world.snapshot().held is not None
    assert world.counts["collisions"] == 0
    driver.outputs = 0
    assert driver.stand(world.layout.gripper.release_s + 0.05).inputs == 0
    assert world.counts["fell_back"] == 1


def test_only_a_change_of_the_output_moves_the_jaws(
    controller: Controller, driver: Driver, world: World
) -> None:
    driver.say()
    controller.begin_jaws(close=True)  # somebody else's gripper, on a wire of its own
    driver.stand(1.0)
    assert controller.grip() is Grip.CLOSED_EMPTY
    assert world.counts["grasps"] == 1


def test_inputs_wired_from_outside_come_through(controller: Controller, driver: Driver) -> None:
    controller.set_input(5, True)
    assert driver.say().inputs == 1 << 5


def test_a_crash_asks_once_for_a_protective_stop_and_lets_the_arm_out_again(
    driver: Driver, world: World
) -> None:
    (stick,) = world.lying
    deep = over(stick, -0.03)
    driver.go(over(stick, 0.08))
    asked = [each.asked for each in driver.go(deep)]
    assert asked.count(SafetyMode.PROTECTIVE_STOP) == 1
    assert {SafetyMode.PROTECTIVE_STOP, None} == set(asked)
    again = [each.asked for each in driver.go(over(stick, 0.1))]
    assert set(again) == {None}
    assert SafetyMode.PROTECTIVE_STOP in {each.asked for each in driver.go(deep)}


def test_a_stop_of_the_cell_is_asked_of_the_driver_once(controller: Controller, driver: Driver) -> None:
    driver.say()
    controller.stop_for_safety(SafetyMode.EMERGENCY_STOP)
    assert [driver.say().asked for _ in range(3)] == [SafetyMode.EMERGENCY_STOP, None, None]
    driver.safety = SafetyMode.EMERGENCY_STOP
    driver.say()
    assert controller.robot_state().safety is SafetyMode.EMERGENCY_STOP


def test_over_the_wire_a_drive_is_checked(controller: Controller, driver: Driver) -> None:
    q: list[Json] = list(driver.q)
    drive: dict[str, Json] = {"op": "drive", "q_rad": q, "moving": False, "safety": "normal", "outputs": 0}
    said = answer(controller, UR, Message(values=drive))
    assert said.values == {"ok": True, "inputs": 0, "asked": ""}
    wrong: dict[str, Json] = {"q_rad": [0.0], "safety": "fine", "outputs": 0.5, "moving": 1}
    for key, value in wrong.items():
        with pytest.raises(ProtocolError):
            answer(controller, UR, Message(values={**drive, key: value}))


def test_messages_come_out_of_pieces_whole() -> None:
    first, second = Message(values={"a": 1}, payload=b"xyz"), Message(values={"b": [2.5]})
    stream, found = b"", []
    for byte in encode(first) + encode(second):
        message, stream = decode(stream + bytes([byte]))
        if message is not None:
            found.append((message.values, message.payload))
    assert found == [({"a": 1}, b"xyz"), ({"b": [2.5]}, b"")]
    assert stream == b""
    with pytest.raises(ProtocolError, match="too long"):
        decode(b"\xff" * 8)
