"""The simulated cell's clock, eyes and lease, with a clock turned by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.sim.arm import MotionEnd, Refused
from drivers.sim.cell import load_world
from drivers.sim.controller import Controller
from drivers.sim.eyes import EXPOSURE_KEPT_S, CameraFault, Silent
from drivers.sim.layout import WorldLayout
from drivers.sim.optics import eyes
from drivers.sim.world import World
from drivers.types import Grip, SafetyMode, ToolPose
from tests.fakes.clock import FakeClock

WORLD = Path(__file__).parents[3] / "configs" / "demo" / "world.yaml"
ME, OTHER = 1, 2


@pytest.fixture(scope="module")
def layout() -> WorldLayout:
    """The demo's world behind lenses of a tenth of the size, so that pictures cost nothing."""
    full = load_world(WORLD)
    update = {
        side: eye.model_copy(
            update={
                "focal_px": tuple(0.1 * v for v in eye.focal_px),
                "centre_px": tuple(0.1 * v for v in eye.centre_px),
            }
        )
        for side, eye in (("left", full.cameras.left), ("right", full.cameras.right))
    }
    cameras = full.cameras.model_copy(update={**update, "width_px": 64, "height_px": 48})
    return full.model_copy(update={"cameras": cameras})


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock(100.0)


@pytest.fixture
def controller(layout: WorldLayout, clock: FakeClock) -> Controller:
    return Controller(World(layout, count=2), clock, 2.0, eyes(layout.cameras), 1)


def start(controller: Controller, speed_m_s: float = 0.05) -> ToolPose:
    """A slow line upwards."""
    here = controller.robot_state().tool
    target = replace(here, z=here.z + 0.08)
    controller.move_line(ME, target, speed_m_s, 1.0)
    return target


def test_simulated_time_runs_at_the_given_speed(controller: Controller, clock: FakeClock) -> None:
    before = controller.robot_state().controller_time_s
    clock.turn(0.2)
    assert controller.robot_state().controller_time_s - before == pytest.approx(0.4)


def test_after_a_long_sleep_of_the_process_time_goes_on_from_where_it_was(
    controller: Controller, clock: FakeClock
) -> None:
    before = controller.robot_state().controller_time_s
    clock.turn(600.0)
    assert controller.robot_state().controller_time_s - before <= 0.5


def test_a_motion_goes_on_while_its_client_asks_after_it(controller: Controller, clock: FakeClock) -> None:
    target = start(controller)
    for _ in range(20):
        clock.turn(0.1)
        motion, _ = controller.poll(ME)
    assert motion is MotionEnd.DONE
    assert controller.robot_state().tool.z == pytest.approx(target.z, abs=1e-4)
    assert controller.lease_halts == 0


def test_a_motion_nobody_asks_after_is_halted(controller: Controller, clock: FakeClock) -> None:
    target = start(controller)
    for _ in range(20):
        clock.turn(0.1)
        controller.advance()
    state = controller.robot_state()
    assert (state.moving, controller.lease_halts) == (False, 1)
    assert state.tool.z < target.z - 0.02


def test_somebody_elses_questions_do_not_keep_a_motion_alive(
    controller: Controller, clock: FakeClock
) -> None:
    start(controller)
    for _ in range(10):
        clock.turn(0.1)
        controller.poll(OTHER)
    assert controller.lease_halts == 1


def test_a_client_that_goes_halts_its_motion_and_frees_the_arm(
    controller: Controller, clock: FakeClock
) -> None:
    start(controller)
    with pytest.raises(Refused, match="another client"):
        controller.take_control(OTHER)
    clock.turn(0.05)
    controller.drop_control(ME)
    clock.turn(0.2)
    assert not controller.robot_state().moving
    controller.take_control(OTHER)


def test_a_frozen_controller_repeats_itself_and_does_not_react(
    controller: Controller, clock: FakeClock
) -> None:
    start(controller)
    clock.turn(0.1)
    controller.freeze_robot(True)
    told = controller.poll(ME)
    clock.turn(0.5)
    assert controller.poll(ME) == told
    assert told[0] is MotionEnd.RUNNING
    with pytest.raises(Refused, match="does not react"):
        controller.move_line(ME, controller.robot_state().tool, 0.1, 1.0)


def test_recovering_does_not_release_an_emergency_stop(controller: Controller) -> None:
    controller.stop_for_safety(SafetyMode.EMERGENCY_STOP)
    with pytest.raises(Refused, match="emergency"):
        controller.recover()
    assert not controller.robot_state().powered
    controller.stop_for_safety(SafetyMode.PROTECTIVE_STOP)
    controller.recover()
    assert controller.robot_state().safety is SafetyMode.NORMAL


def test_both_eyes_develop_the_same_instant_and_the_next_pair_a_new_one(
    controller: Controller, clock: FakeClock
) -> None:
    left = controller.eyes.grab("left", 99.0, 1.0)
    clock.turn(0.1)
    right = controller.eyes.grab("right", 99.0, 1.0)
    assert left.captured_at == right.captured_at == 100.0
    clock.turn(0.1)
    assert controller.eyes.grab("left", 99.0, 1.0).captured_at == pytest.approx(100.2)


@pytest.mark.parametrize(("newer_than", "wait_s"), [(100.05, 0.1), (99.0, EXPOSURE_KEPT_S + 0.1)])
def test_an_instant_too_early_or_too_long_ago_is_not_developed(
    controller: Controller, clock: FakeClock, newer_than: float, wait_s: float
) -> None:
    controller.eyes.grab("left", 99.0, 1.0)
    clock.turn(wait_s)
    assert controller.eyes.grab("right", newer_than, 1.0).captured_at == pytest.approx(100.0 + wait_s)


def test_a_picture_shows_the_moment_it_claims_and_not_the_moment_it_was_developed(
    controller: Controller, clock: FakeClock
) -> None:
    controller.eyes.set_fault("left", CameraFault.SLOW, 0.4)
    shot = controller.eyes.grab("left", 99.0, 1.0)
    assert shot.captured_at == 100.0
    assert clock.now() == pytest.approx(100.4)


def test_the_future_is_waited_for_as_long_as_allowed(controller: Controller, clock: FakeClock) -> None:
    assert controller.eyes.grab("left", 100.2, 1.0).captured_at > 100.2
    with pytest.raises(Silent):
        controller.eyes.grab("left", 105.0, 1.0)


def test_a_silent_eye_takes_its_time_and_says_nothing(controller: Controller, clock: FakeClock) -> None:
    controller.eyes.set_fault("right", CameraFault.SILENT)
    with pytest.raises(Silent):
        controller.eyes.grab("right", 99.0, 0.5)
    assert clock.now() == pytest.approx(100.5)


def test_a_frozen_eye_repeats_its_pixels(controller: Controller) -> None:
    first = controller.eyes.grab("left", 99.0, 1.0)
    controller.eyes.set_fault("left", CameraFault.FREEZE)
    assert np.array_equal(first.pixels, controller.eyes.grab("left", 99.0, 1.0).pixels)
    controller.eyes.set_fault("left", CameraFault.NONE)
    assert not np.array_equal(first.pixels, controller.eyes.grab("left", 99.0, 1.0).pixels)


def test_jaws_take_their_time(controller: Controller, clock: FakeClock) -> None:
    controller.begin_jaws(close=True)
    assert controller.grip() is Grip.UNKNOWN
    clock.turn(0.15)
    assert controller.grip() is Grip.UNKNOWN
    clock.turn(0.1)
    assert controller.grip() is Grip.CLOSED_EMPTY


@pytest.mark.parametrize("pin", [-1, 16])
def test_pins_that_are_not_there_are_refused(controller: Controller, pin: int) -> None:
    with pytest.raises(Refused, match="no pin"):
        controller.set_output(pin, True)
