"""The simulated UR controller stepped by hand when it is stopped: safety, power, and the watchdog."""

from __future__ import annotations

import pytest

from drivers.sim.ur_codes import RobotMode, Runtime, Safety
from drivers.sim.ur_core import UNLOCK_AFTER_S, Armed, Core, Setup
from tests.unit.drivers.ur_client import AWAY, HOME, SCRIPT, Client

# ------------------------------------------------------------------ watchdog


@pytest.mark.parametrize("scale", [1.0, 4.0])
def test_the_watchdog_stops_an_unfed_program_and_the_arm(scale: float) -> None:
    core = Core(Setup(start_q=HOME, time_scale=scale))
    client = Client(core).upload()
    client.done(35, (10.0,))
    client.done(1, (*AWAY, 1.0, 2.0), asynchronous=True)
    fed_s = core.time_s
    client.until(lambda: core.runtime is not Runtime.PLAYING)
    assert core.time_s - fed_s == pytest.approx(0.1 * scale, abs=0.01)  # real time, whatever the scale
    client.until(lambda: core.runtime is Runtime.STOPPED)
    assert core.arm.motion is None
    assert core.counts["watchdog"] == 1


def test_a_fed_watchdog_lets_the_program_run(client: Client, core: Core) -> None:
    client.done(35, (10.0,))
    client.done(1, (*AWAY, 0.5, 2.0), asynchronous=True)
    while client.status[1]:
        client.seconds(0.05)
        core.input_written(0)
    assert core.runtime is Runtime.PLAYING
    assert core.arm.q == AWAY


def test_the_watchdog_looks_at_its_own_register_and_ends_with_the_program(core: Core) -> None:
    client = Client(core, 24).upload()
    client.done(35, (10.0,))
    for _ in range(20):
        client.seconds(0.02)
        core.input_written(0)  # not the register that is watched
    assert core.counts["watchdog"] == 1
    client.upload()
    client.seconds(1.0)
    assert core.counts["watchdog"] == 1
    assert core.runtime is Runtime.PLAYING


# ------------------------------------------------------------------ safety and power


def test_a_protective_stop_pauses_waits_5_s_and_goes_on_only_when_played(client: Client, core: Core) -> None:
    client.done(1, (*AWAY, 1.0, 2.0), asynchronous=True)
    client.seconds(0.3)
    core.protective_stop("test")
    client.until(lambda: core.runtime is Runtime.PAUSED, within_s=0.2)
    rests_at = core.arm.q
    assert core.safety is Safety.PROTECTIVE_STOP
    client.seconds(UNLOCK_AFTER_S - 0.3)
    assert not core.unlock()
    client.seconds(0.4)
    assert core.unlock()
    client.seconds(1.0)
    assert core.arm.q == rests_at  # unlocking alone moves nothing
    assert core.runtime is Runtime.PAUSED
    assert core.play()
    client.until(lambda: core.arm.motion is None)
    assert core.arm.q == AWAY  # the old motion went on
    assert core.arm.moves_started == 1


def test_after_a_protective_stop_a_new_program_forgets_the_old_motion(client: Client, core: Core) -> None:
    client.done(1, (*AWAY, 1.0, 2.0), asynchronous=True)
    client.seconds(0.3)
    core.protective_stop("test")
    client.seconds(UNLOCK_AFTER_S + 0.1)
    assert core.unlock()
    rests_at = core.arm.q
    client.upload()
    client.seconds(1.0)
    assert core.arm.q == rests_at
    client.done(1, (*HOME, 1.0, 2.0))
    assert core.arm.q == HOME


def test_a_program_sent_during_a_protective_stop_does_not_run(client: Client, core: Core) -> None:
    core.protective_stop("test")
    client.seconds(0.5)
    core.upload(SCRIPT.format(0, ""))
    client.seconds(0.5)
    assert core.runtime is Runtime.STOPPED
    assert core.unlock() is False


def test_a_safeguard_stop_waits_for_play_unless_told_to_resume(client: Client, core: Core) -> None:
    client.done(1, (*AWAY, 0.2, 2.0), asynchronous=True)
    for resume in (False, True):
        client.seconds(0.3)
        core.safeguard_stop()
        client.until(lambda: core.runtime is Runtime.PAUSED, within_s=0.2)
        rests_at = core.arm.q
        assert core.release(resume)
        client.seconds(0.5)
        assert (core.arm.q != rests_at) is resume
        if not resume:
            assert core.play()
    client.until(lambda: core.arm.motion is None)
    assert core.arm.q == AWAY


def test_reduced_mode_is_told_and_stops_nothing(client: Client, core: Core) -> None:
    told = []
    core.reduce()
    told.append(core.safety)
    client.done(1, (*AWAY, 1.0, 2.0))
    assert core.arm.q == AWAY
    assert core.release()
    core.protective_stop("test")
    core.reduce()  # does not hide a stop
    told.append(core.safety)
    assert told == [Safety.REDUCED, Safety.PROTECTIVE_STOP]


def test_an_emergency_stop_ends_the_program_and_the_power(client: Client, core: Core) -> None:
    client.done(1, (*AWAY, 1.0, 2.0), asynchronous=True)
    client.seconds(0.3)
    core.emergency_stop()
    client.until(lambda: core.runtime is Runtime.STOPPED, within_s=0.2)
    rests_at = core.arm.q
    assert (core.safety, core.mode) == (Safety.ROBOT_EMERGENCY_STOP, RobotMode.POWER_OFF)
    core.power_on()  # not while the button is pressed
    client.seconds(2.0)
    assert core.mode is RobotMode.POWER_OFF
    assert core.release()
    core.upload(SCRIPT.format(0, ""))
    client.seconds(0.5)
    assert core.runtime is Runtime.STOPPED  # no power, no program
    core.power_on()
    client.until(lambda: core.mode is RobotMode.IDLE)
    core.brake_release()
    client.until(lambda: core.mode is RobotMode.RUNNING)
    assert core.arm.q == rests_at
    client.upload()
    client.done(1, (*HOME, 1.0, 2.0))


def test_what_cannot_be_reached_is_a_protective_stop_underway(client: Client, core: Core) -> None:
    x, y, z, *turn = core.arm.pose
    client.order(3, (x - 0.9, y, z, *turn, 0.5, 2.0))
    client.until(lambda: core.safety is Safety.PROTECTIVE_STOP)
    assert core.arm.distance_m > 0.05
    assert not any(core.arm.qd)


def test_something_armed_happens_at_its_instant_of_the_motion(client: Client, core: Core) -> None:
    happened: list[float] = []
    core.armed.append(Armed(lambda: happened.append(core.time_s), moving_s=0.2))
    client.seconds(1.0)
    assert happened == []  # nothing moves
    client.done(1, (*AWAY, 1.0, 2.0), asynchronous=True)
    began_s = core.time_s
    client.seconds(1.0)
    assert len(happened) == 1
    assert happened[0] - began_s == pytest.approx(0.2, abs=0.01)
