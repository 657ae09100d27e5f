"""The Robotiq driver over a real socket: what goes wrong, and what the gripper's own detection overlooks."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator

import pytest

from drivers.errors import CommandRejected, DeviceTimeout, DeviceUnavailable
from drivers.gripper.robotiq import FAULTS, RobotiqGripper
from drivers.settings import RobotiqGripperSettings
from drivers.timing import MonotonicClock, StopRequested, StopToken
from drivers.types import Grip
from tests.fakes.robotiq import RobotiqPeer, robotiq_peer

CLOCK = MonotonicClock()
SPEED = "8"
EMPTY_FROM = 225


@pytest.fixture(scope="module")
def running() -> Iterator[RobotiqPeer]:
    with robotiq_peer("--speed", SPEED) as peer:
        yield peer


@pytest.fixture
def peer(running: RobotiqPeer) -> Iterator[RobotiqPeer]:
    running.mend()
    yield running
    running.mend()


def settings(peer: RobotiqPeer, **changes: object) -> RobotiqGripperSettings:
    values = {
        "driver": "robotiq",
        "host": peer.host,
        "port": peer.port,
        "open_position": 150,
        "empty_from": EMPTY_FROM,
        "force": 10,
        "timeout_s": 0.3,
        "jaws_timeout_s": 1.0,
    }
    return RobotiqGripperSettings.model_validate({**values, **changes})


def driver(peer: RobotiqPeer, **changes: object) -> RobotiqGripper:
    return RobotiqGripper("gripper", settings(peer, **changes), CLOCK)


@pytest.fixture
def gripper(peer: RobotiqPeer, stop: StopToken) -> Iterator[RobotiqGripper]:
    made = driver(peer)
    made.open()
    made.release(stop=stop)
    yield made
    made.close()


# ------------------------------------------------------------------ what is held


@pytest.mark.parametrize("thin", [False, True], ids=["noticed", "overlooked by the gripper"])
def test_a_part_is_held_where_the_fingers_stop_short(
    peer: RobotiqPeer, gripper: RobotiqGripper, stop: StopToken, thin: bool
) -> None:
    peer.do("thin", on=thin)
    peer.do("part", at=218)
    assert gripper.grasp(stop=stop) is Grip.HOLDING
    assert gripper.grip() is Grip.HOLDING
    assert peer.do("status")["OBJ"] == ("3" if thin else "2")


def test_fingers_that_meet_each_other_hold_nothing_whatever_they_felt(
    peer: RobotiqPeer, gripper: RobotiqGripper, stop: StopToken
) -> None:
    peer.do("part", at=226)
    assert gripper.grasp(stop=stop) is Grip.CLOSED_EMPTY
    assert peer.do("status")["OBJ"] == "2"


def test_a_part_that_slips_is_noticed(peer: RobotiqPeer, gripper: RobotiqGripper, stop: StopToken) -> None:
    peer.do("part", at=218)
    assert gripper.grasp(stop=stop) is Grip.HOLDING
    peer.do("part", at=None)
    until = CLOCK.now() + 2.0
    while gripper.grip() is not Grip.CLOSED_EMPTY:
        assert CLOCK.now() < until
        stop.wait(0.01)


def test_gripping_twice_keeps_what_is_held(
    peer: RobotiqPeer, gripper: RobotiqGripper, stop: StopToken
) -> None:
    peer.do("part", at=218)
    assert gripper.grasp(stop=stop) is Grip.HOLDING
    assert gripper.grasp(stop=stop) is Grip.HOLDING
    gripper.release(stop=stop)
    gripper.release(stop=stop)
    assert gripper.grip() is Grip.OPEN


def test_a_part_held_before_a_restart_is_known_afterwards(
    peer: RobotiqPeer, gripper: RobotiqGripper, stop: StopToken
) -> None:
    peer.do("part", at=218)
    assert gripper.grasp(stop=stop) is Grip.HOLDING
    gripper.close()
    second = driver(peer)
    second.open()
    assert second.grip() is Grip.HOLDING
    second.close()


# ------------------------------------------------------------------ what goes wrong


@pytest.mark.parametrize("code", sorted(FAULTS))
def test_a_fault_is_told_with_its_number_and_what_to_do(
    peer: RobotiqPeer, gripper: RobotiqGripper, stop: StopToken, code: int
) -> None:
    peer.do("fault", code=code)
    with pytest.raises(CommandRejected, match=rf"fault {code}: .*teach pendant"):
        gripper.grip()
    before = peer.do("status")["orders"]
    with pytest.raises(CommandRejected, match=f"fault {code}"):
        gripper.grasp(stop=stop)
    assert peer.do("status")["orders"] == before  # nothing was moved


def test_a_fault_on_the_way_ends_the_grip(
    peer: RobotiqPeer, gripper: RobotiqGripper, stop: StopToken
) -> None:
    peer.do("stuck")  # so that the way does not end before
    timer = threading.Timer(0.1, lambda: peer.do("fault", code=14))
    timer.start()
    with pytest.raises(CommandRejected, match="overcurrent"):
        gripper.grasp(stop=stop)
    timer.join()


def test_fingers_that_do_not_leave_are_not_taken_for_a_grip(
    peer: RobotiqPeer, gripper: RobotiqGripper, stop: StopToken
) -> None:
    peer.do("stuck")
    began_at = CLOCK.now()
    with pytest.raises(DeviceTimeout, match="did not leave 150"):
        gripper.grasp(stop=stop)
    assert CLOCK.now() - began_at < 2.0


def test_fingers_that_cannot_open_are_told_with_where_they_stand(
    peer: RobotiqPeer, gripper: RobotiqGripper, stop: StopToken
) -> None:
    peer.do("part", at=218)
    assert gripper.grasp(stop=stop) is Grip.HOLDING
    peer.do("stuck")
    with pytest.raises(DeviceTimeout, match="did not leave 218"):
        gripper.release(stop=stop)


def test_without_power_at_the_flange_it_is_unavailable(
    peer: RobotiqPeer, gripper: RobotiqGripper, stop: StopToken
) -> None:
    peer.do("power", on=False)
    with pytest.raises(DeviceUnavailable, match="emergency stop"):
        gripper.grip()
    with pytest.raises(DeviceUnavailable, match="emergency stop"):
        gripper.grasp(stop=stop)
    peer.do("power", on=True)
    assert gripper.grip() is Grip.OPEN


def test_a_mute_peer_costs_one_time_out_and_its_late_answer_is_not_the_next_one(
    peer: RobotiqPeer, gripper: RobotiqGripper, stop: StopToken
) -> None:
    peer.do("mute")
    began_at = CLOCK.now()
    with pytest.raises(DeviceTimeout, match=r"GET STA within 0\.3 s"):
        gripper.grip()
    assert CLOCK.now() - began_at < 0.8
    peer.do("speak")
    assert gripper.grip() is Grip.OPEN


@pytest.mark.parametrize("how", ["rst", "fin"])
def test_a_cut_connection_is_told_once_and_made_anew(
    peer: RobotiqPeer, gripper: RobotiqGripper, stop: StopToken, how: str
) -> None:
    peer.do("cut", how=how)
    with pytest.raises(DeviceUnavailable, match="connection lost"):
        gripper.grip()
    assert gripper.grip() is Grip.OPEN


def test_a_peer_that_is_gone_is_unavailable_until_it_is_back(
    peer: RobotiqPeer, gripper: RobotiqGripper, stop: StopToken
) -> None:
    peer.do("refuse")
    peer.do("cut")
    for _ in range(2):
        with pytest.raises(DeviceUnavailable):
            gripper.grasp(stop=stop)
    peer.do("accept")
    assert gripper.grasp(stop=stop) is Grip.CLOSED_EMPTY


def test_a_token_fired_on_the_way_ends_the_wait(
    peer: RobotiqPeer, gripper: RobotiqGripper, stop: StopToken
) -> None:
    peer.do("stuck")
    timer = threading.Timer(0.1, lambda: stop.stop("changed our mind"))
    timer.start()
    began_at = CLOCK.now()
    with pytest.raises(StopRequested, match="changed our mind"):
        gripper.grasp(stop=stop)
    timer.join()
    assert CLOCK.now() - began_at < 0.5


def test_somebody_else_on_the_port_is_not_a_gripper(stop: StopToken) -> None:
    """An answer that makes no sense is quoted, and the connection given up."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def speak() -> None:
            connection, _ = server.accept()
            with connection:
                connection.recv(100)
                connection.sendall(b"220 ready for mail\n")

        thread = threading.Thread(target=speak)
        thread.start()
        port = server.getsockname()[1]
        other = RobotiqGripperSettings(
            driver="robotiq", host="127.0.0.1", port=port, open_position=0, empty_from=220, force=0
        )
        with pytest.raises(DeviceUnavailable, match="220 ready for mail"):
            RobotiqGripper("gripper", other, CLOCK).open()
        thread.join()


# ------------------------------------------------------------------ activation


@pytest.fixture
def asleep() -> Iterator[RobotiqPeer]:
    with robotiq_peer("--speed", SPEED, "--not-activated") as peer:
        yield peer


def test_a_gripper_that_is_not_activated_is_refused_and_does_not_move(asleep: RobotiqPeer) -> None:
    with pytest.raises(CommandRejected, match=r"not activated \(STA 0\).*pendant"):
        driver(asleep).open()
    assert asleep.do("status")["STA"] == "0"


def test_it_is_activated_where_the_settings_allow_its_motion(asleep: RobotiqPeer, stop: StopToken) -> None:
    gripper = driver(asleep, activate=True)
    gripper.open()
    assert asleep.do("status")["STA"] == "3"
    assert gripper.grip() is Grip.UNKNOWN  # fingers where nobody sent them
    gripper.release(stop=stop)
    assert gripper.grip() is Grip.OPEN
    gripper.close()


def test_it_is_not_activated_over_a_fault_that_a_person_has_to_see(asleep: RobotiqPeer) -> None:
    asleep.do("fault", code=13)
    with pytest.raises(CommandRejected, match="fault 13"):
        driver(asleep, activate=True).open()
    assert asleep.do("status")["STA"] == "0"
