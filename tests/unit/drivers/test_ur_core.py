"""The simulated UR controller stepped by hand: register protocol and programs. No sockets."""

from __future__ import annotations

import pytest

from drivers.sim.ur_codes import Runtime
from drivers.sim.ur_core import Core, Setup
from tests.unit.drivers.ur_client import AWAY, HOME, SCRIPT, Client

# ------------------------------------------------------------------ register protocol


@pytest.mark.parametrize("offset", [0, 24])
def test_a_blocking_move_is_done_when_the_arm_is_there(core: Core, offset: int) -> None:
    client = Client(core, offset).upload()
    took_s = client.done(1, (*AWAY, 1.0, 2.0))
    assert core.arm.q == AWAY
    assert took_s == pytest.approx(0.5 / 1.0 + 1.0 / 2.0, abs=0.012)
    assert core.output_ints[24 - offset] == 0  # the other range is left alone


def test_a_command_is_carried_out_once_however_long_it_stands_in_the_register(
    client: Client, core: Core
) -> None:
    client.order(1, (*AWAY, 1.0, 2.0))
    client.seconds(3.0)
    assert (core.arm.moves_started, core.arm.moves_finished) == (1, 1)


def test_an_asynchronous_move_is_done_at_once_and_told_by_the_status_word(client: Client, core: Core) -> None:
    before = client.status
    assert client.done(1, (*AWAY, 1.0, 2.0), asynchronous=True) < 0.01
    assert client.status == (before[0] + 1, True, 0)
    client.until(lambda: not client.status[1])
    assert core.arm.q == AWAY
    assert client.status[0] == before[0] + 1


def test_a_new_asynchronous_move_replaces_the_old_one_from_rest(client: Client, core: Core) -> None:
    client.done(1, (*AWAY, 1.0, 2.0), asynchronous=True)
    client.seconds(0.4)
    client.done(1, (*HOME, 1.0, 2.0), asynchronous=True)
    fastest = 0.0
    while client.status[1]:
        core.step()
        fastest = max(fastest, abs(core.arm.qd[0]))
    assert core.arm.q == HOME
    assert fastest <= 1.0 + 1e-6
    assert (core.arm.moves_started, core.arm.moves_finished) == (2, 1)


def test_a_stop_ends_an_asynchronous_move_on_its_way(client: Client, core: Core) -> None:
    client.done(1, (*AWAY, 1.0, 2.0), asynchronous=True)
    client.seconds(0.4)
    took_s = client.done(34, (4.0,))
    assert took_s == pytest.approx(0.8 / 4.0, abs=0.02)
    assert 0.0 < core.arm.q[0] < 0.5
    assert not client.status[1]
    client.seconds(1.0)
    assert core.arm.moves_finished == 0


def test_an_asynchronous_stop_is_an_operation_of_its_own(client: Client, core: Core) -> None:
    client.done(1, (*AWAY, 1.0, 2.0), asynchronous=True)
    client.seconds(0.4)
    number = client.status[0]
    assert client.done(33, (0.5,), asynchronous=True) < 0.01
    assert client.status[:2] == (number + 1, True)
    client.until(lambda: not client.status[1])
    assert core.arm.motion is None


def test_a_line_goes_to_the_pose_and_a_path_tells_how_far_it_is(core: Core) -> None:
    path = "signal_async_progress(0)\nmovej([0.2,-1.5708,1.5708,-1.5708,-1.5708,0],a=2,v=1,r=0)\n"
    path += "signal_async_progress(1)\nmovej([0.4,-1.5708,1.5708,-1.5708,-1.5708,0],a=2,v=1,r=0)"
    client = Client(core, 0, path).upload()
    client.done(45, asynchronous=True)
    client.until(lambda: client.status[2] == 1)
    assert core.arm.q[0] == pytest.approx(0.2, abs=1e-4)
    client.until(lambda: not client.status[1])
    assert core.arm.q[0] == 0.4
    x, y, z, *turn = core.arm.pose
    client.done(3, (x, y, z + 0.1, *turn, 0.25, 1.2))
    assert core.arm.pose[2] == pytest.approx(z + 0.1, abs=1e-9)


def test_questions_are_answered_in_the_output_registers(client: Client, core: Core) -> None:
    pose = core.arm.pose
    client.done(29, (0.0, 0.0, 0.1, 0.0, 0.0, 0.0))
    client.done(40)
    assert client.doubles(6) == [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]
    client.done(44, (*AWAY, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert client.doubles(6) == pytest.approx(core.arm.tool_of(AWAY, (0.0,) * 6))
    client.done(29, (0.0,) * 6)
    client.done(46, pose)
    assert client.doubles(6) == pytest.approx(HOME, abs=1e-9)
    client.done(60, pose)
    assert core.output_ints[1] == 1
    client.done(60, (3.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert core.output_ints[1] == 0
    client.done(37, (0.0, 0.0, 3.5, 0.0, 0.0, 0.0))
    assert core.output_ints[1] == 0
    client.seconds(0.2)
    client.done(47)
    assert core.output_ints[1] == 1


def test_no_inverse_kinematics_kills_the_program(client: Client, core: Core) -> None:
    client.order(46, (3.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    client.until(lambda: core.runtime is Runtime.STOPPED)
    assert "unable to find" in core.events[-1]


def test_a_command_nobody_simulates_kills_the_program_and_says_so(client: Client, core: Core) -> None:
    client.order(6)
    client.until(lambda: core.runtime is Runtime.STOPPED)
    assert "command 6 " in core.events[-1]


def test_the_stop_command_ends_the_program(client: Client, core: Core) -> None:
    client.order(255)
    client.until(lambda: core.runtime is Runtime.STOPPED)
    assert core.counts["stops"] == 1


def test_payload_and_tcp_are_set_and_too_much_payload_is_refused(client: Client, core: Core) -> None:
    client.done(17, (0.9, 0.0, 0.0, 0.05))
    assert (core.payload_kg, core.payload_cog) == (0.9, (0.0, 0.0, 0.05))
    client.done(17, (1.2, 0.0, 0.0, 0.0))
    assert (core.payload_kg, core.payload_cog) == (1.2, (0.0, 0.0, 0.05))
    client.order(17, (99.0, 0.0, 0.0, 0.0))
    client.until(lambda: core.runtime is Runtime.STOPPED)


# ------------------------------------------------------------------ programs


def test_pausing_keeps_the_program_and_stopping_does_not(client: Client, core: Core) -> None:
    client.done(1, (*AWAY, 1.0, 2.0), asynchronous=True)
    client.seconds(0.3)
    assert core.pause()
    client.until(lambda: core.runtime is Runtime.PAUSED)
    assert core.play()
    client.seconds(0.1)
    core.stop_program("test")
    client.until(lambda: core.runtime is Runtime.STOPPED, within_s=0.2)
    assert not core.play()
    assert core.arm.motion is None
    assert core.arm.moves_finished == 0


def test_in_local_mode_and_when_told_so_uploads_are_ignored(core: Core) -> None:
    client = Client(core)
    core.remote = False
    core.upload(SCRIPT.format(0, ""))
    client.seconds(1.0)
    core.remote, core.script_fault = True, "ignore"
    core.upload(SCRIPT.format(0, ""))
    client.seconds(1.0)
    assert (core.runtime, core.counts["uploads"]) == (Runtime.STOPPED, 2)


def test_a_script_told_to_die_runs_for_a_moment(core: Core) -> None:
    core.script_fault = "die"
    client = Client(core).upload()
    assert client.until(lambda: core.runtime is Runtime.STOPPED) == pytest.approx(0.2, abs=0.05)


def test_a_small_program_moves_writes_and_ends(core: Core) -> None:
    core.upload(
        "def small():\n\twrite_output_integer_register(0, 1)\n\tset_standard_digital_out(2, True)\n"
        "\tmovej([0.1,-1.5708,1.5708,-1.5708,-1.5708,0], a=2, v=1)\n"
        "\twrite_output_integer_register(0, 2)\nend"
    )
    client = Client(core)
    client.until(lambda: core.runtime is Runtime.PLAYING)
    client.until(lambda: core.runtime is Runtime.STOPPED)
    assert core.arm.q[0] == 0.1
    assert (core.output_ints[0], core.io.outputs) == (2, 4)


def test_a_secondary_program_switches_an_output_beside_the_running_one(client: Client, core: Core) -> None:
    core.upload("sec lamp():\n set_tool_digital_out(0, True)\nend")
    core.upload("sec go():\n movej([0,0,0,0,0,0])\nend")
    client.seconds(0.2)
    assert core.io.outputs == 1 << 16
    assert core.runtime is Runtime.PLAYING
    assert core.arm.moves_started == 0


def test_the_same_orders_give_the_same_controller() -> None:
    def story() -> tuple[object, ...]:
        core = Core(Setup(start_q=HOME))
        client = Client(core).upload()
        client.done(1, (*AWAY, 1.0, 2.0), asynchronous=True)
        client.seconds(0.3)
        core.protective_stop("test")
        client.seconds(6.0)
        core.unlock()
        core.play()
        client.seconds(3.0)
        return core.steps, core.arm.q, core.arm.distance_m, tuple(core.events), tuple(core.output_ints)

    assert story() == story()
