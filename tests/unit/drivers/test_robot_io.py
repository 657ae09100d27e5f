"""A gripper on outputs of the arm: nothing is believed that its input does not confirm."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from drivers.errors import DeviceTimeout, DeviceUnavailable, StaleData
from drivers.gripper.robot_io import RobotIoGripper, checks
from drivers.settings import RobotIoGripperSettings
from drivers.timing import StopRequested, StopToken
from drivers.types import Grip, Pins
from tests.fakes.clock import FakeClock
from tests.fakes.robot import FakeRobot

CLOSE, OPEN, HELD, IS_OPEN = 4, 5, 2, 3


class Rig:
    """A gripper on a scripted arm and a clock turned by hand."""

    def __init__(self, **changes: object) -> None:
        self.clock = FakeClock()
        self.robot = FakeRobot("robot", self.clock)
        self.robot.open()
        values = {
            "driver": "robot_io",
            "close_output": CLOSE,
            "holding_input": HELD,
            "closing_s": 0.4,
            "opening_s": 0.3,
            **changes,
        }
        settings = RobotIoGripperSettings.model_validate(values)
        self.gripper = RobotIoGripper("gripper", settings, self.robot, self.clock)
        self.stop = StopToken(self.clock)

    def opened(self) -> Rig:
        self.gripper.open()
        return self

    def input(self, pin: int, on: bool, after_s: float = 0.0) -> None:
        """What the sensor says, now or at a moment of the next wait."""
        self.clock.at(self.clock.now() + after_s, lambda: self.robot.inputs.update({pin: on}))

    @property
    def switched(self) -> list[str]:
        return [call.what for call in self.robot.calls if call.what.startswith("set_output")]


def test_a_part_that_comes_between_the_jaws_is_held() -> None:
    rig = Rig().opened()
    rig.gripper.release(stop=rig.stop)
    rig.input(HELD, True, after_s=0.15)
    began_at = rig.clock.now()
    assert rig.gripper.grasp(stop=rig.stop) is Grip.HOLDING
    assert 0.2 <= rig.clock.now() - began_at < 0.25  # settled, and not waited for longer
    assert rig.gripper.grip() is Grip.HOLDING
    assert rig.switched == [f"set_output {CLOSE} False", f"set_output {CLOSE} True"]


def test_nothing_by_the_time_the_jaws_are_closed_is_an_empty_grip() -> None:
    rig = Rig().opened()
    rig.gripper.release(stop=rig.stop)
    assert rig.gripper.grasp(stop=rig.stop) is Grip.CLOSED_EMPTY
    assert rig.gripper.grip() is Grip.CLOSED_EMPTY


def test_a_sensor_that_flickers_while_the_jaws_close_is_no_grip() -> None:
    rig = Rig().opened()
    rig.gripper.release(stop=rig.stop)
    for start in (0.1, 0.2, 0.3):
        rig.input(HELD, True, after_s=start)
        rig.input(HELD, False, after_s=start + 0.03)
    assert rig.gripper.grasp(stop=rig.stop) is Grip.CLOSED_EMPTY


def test_a_part_that_comes_at_the_last_moment_gets_its_time_to_settle() -> None:
    rig = Rig().opened()
    rig.gripper.release(stop=rig.stop)
    rig.input(HELD, True, after_s=0.38)
    assert rig.gripper.grasp(stop=rig.stop) is Grip.HOLDING


def test_a_sensor_that_means_held_when_it_is_off() -> None:
    rig = Rig(holding_level=False)
    rig.robot.inputs[HELD] = True
    rig.opened()
    rig.gripper.release(stop=rig.stop)
    assert rig.gripper.grip() is Grip.OPEN
    rig.input(HELD, False, after_s=0.1)
    assert rig.gripper.grasp(stop=rig.stop) is Grip.HOLDING


def test_a_sensor_that_says_held_with_open_jaws_is_never_a_good_grip() -> None:
    rig = Rig().opened()
    rig.gripper.release(stop=rig.stop)
    rig.robot.inputs[HELD] = True
    assert rig.gripper.grip() is Grip.UNKNOWN
    with pytest.raises(StaleData, match=r"input 2 says that a part is held before closing"):
        rig.gripper.grasp(stop=rig.stop)
    assert rig.switched == [f"set_output {CLOSE} False"]


def test_a_part_that_sticks_to_a_finger_is_told_after_opening() -> None:
    rig = Rig().opened()
    rig.robot.inputs[HELD] = True
    with pytest.raises(StaleData, match="after opening"):
        rig.gripper.release(stop=rig.stop)
    assert rig.gripper.grip() is Grip.HOLDING  # until somebody has looked


def test_a_part_that_falls_a_moment_after_opening_is_released() -> None:
    rig = Rig().opened()
    rig.robot.inputs[HELD] = True
    rig.input(HELD, False, after_s=0.45)
    rig.gripper.release(stop=rig.stop)
    assert rig.gripper.grip() is Grip.OPEN


def test_after_a_start_only_the_input_is_known() -> None:
    rig = Rig().opened()
    assert rig.gripper.grip() is Grip.UNKNOWN
    rig.robot.inputs[HELD] = True
    assert rig.gripper.grip() is Grip.HOLDING


def test_a_release_cut_short_leaves_it_unknown_where_the_jaws_are() -> None:
    rig = Rig().opened()
    rig.clock.at(rig.clock.now() + 0.1, lambda: rig.stop.stop("asked to end"))
    with pytest.raises(StopRequested):
        rig.gripper.release(stop=rig.stop)
    assert rig.gripper.grip() is Grip.UNKNOWN


def test_both_coils_of_a_valve_are_never_on_together() -> None:
    rig = Rig(open_output=OPEN).opened()
    for act in (rig.gripper.release, rig.gripper.grasp, rig.gripper.release):
        act(stop=rig.stop)
    on = {CLOSE: False, OPEN: False}
    for call in rig.switched:
        _, pin, value = call.split()
        on[int(pin)] = value == "True"
        assert not all(on.values())
    assert on == {CLOSE: False, OPEN: True}


def test_jaws_that_do_not_say_open_are_late() -> None:
    rig = Rig(open_input=IS_OPEN).opened()
    with pytest.raises(DeviceTimeout, match=r"input 3 did not say open within 0\.3 s"):
        rig.gripper.release(stop=rig.stop)
    rig.input(IS_OPEN, True, after_s=0.1)
    rig.gripper.release(stop=rig.stop)
    assert rig.gripper.grip() is Grip.OPEN


def test_an_arm_that_is_not_there_is_noticed_when_the_gripper_is_opened() -> None:
    rig = Rig()
    rig.robot.close()
    with pytest.raises(DeviceUnavailable, match="robot"):
        rig.gripper.open()


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"open_output": CLOSE}, "open_output and close_output are both 4"),
        ({"open_input": HELD}, "open_input and holding_input are both 2"),
        ({"settle_s": 0.5}, r"settle_s 0\.5 is not below closing_s 0\.4"),
        ({"close_output": 18}, "less than or equal to 17"),
    ],
)
def test_wiring_that_cannot_work_is_refused(changes: dict[str, object], why: str) -> None:
    with pytest.raises(ValidationError, match=why):
        Rig(**changes)


@pytest.mark.parametrize(
    ("outputs", "inputs", "wrong"),
    [
        (0, 1 << IS_OPEN, None),
        (1 << CLOSE, 1 << HELD, None),
        (1 << CLOSE, 0, None),
        (0, 1 << HELD | 1 << IS_OPEN, "confirm input"),
        (0, 0, "open input"),
        (1 << CLOSE, 1 << IS_OPEN, "open input"),
        (1 << CLOSE | 1 << OPEN, 0, "valve"),
    ],
)
def test_a_look_at_the_pins_tells_what_contradicts_itself(
    outputs: int, inputs: int, wrong: str | None
) -> None:
    settings = RobotIoGripperSettings(
        driver="robot_io",
        close_output=CLOSE,
        open_output=OPEN,
        holding_input=HELD,
        open_input=IS_OPEN,
        closing_s=0.4,
        opening_s=0.3,
    )
    lines = checks(settings, Pins(inputs=inputs, outputs=outputs))
    assert [line.what for line in lines if not line.ok] == ([] if wrong is None else [wrong])
    assert all(line.do for line in lines if not line.ok)
