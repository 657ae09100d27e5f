"""The worker's loop over a scripted library: what it calls, when it kicks, when it stops the arm and ends."""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Iterator
from typing import NoReturn

import pytest

from drivers.robot import ur_worker
from drivers.robot.ur_link import Do, Lease, LinkError, Reply, Request, reply_of, request_of
from drivers.robot.ur_worker import DECELERATION_M_S2, WATCHDOG_HZ, Exit, Worker

TARGET = (0.1, 0.2, 0.3, 3.1, 0.0, 0.0)


class Library:
    """Records calls; ``answers`` are given instead of True, exceptions are raised."""

    def __init__(self) -> None:
        self.calls: list[tuple[object, ...]] = []
        self.kicks = 0
        self.answers: dict[str, bool | Exception] = {}

    def _called(self, *call: object) -> bool:
        self.calls.append(call)
        answer = self.answers.get(str(call[0]), True)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def moveL(self, pose: list[float], speed: float, acceleration: float, asynchronous: bool, /) -> bool:
        return self._called("moveL", tuple(pose), speed, acceleration, asynchronous)

    def moveJ(self, q: list[float], speed: float, acceleration: float, asynchronous: bool, /) -> bool:
        return self._called("moveJ", tuple(q), speed, acceleration, asynchronous)

    def stopL(self, a: float, asynchronous: bool, /) -> None:
        self._called("stopL", a, asynchronous)

    def stopJ(self, a: float, asynchronous: bool, /) -> None:
        self._called("stopJ", a, asynchronous)

    def setWatchdog(self, min_frequency: float, /) -> bool:
        return self._called("setWatchdog", min_frequency)

    def kickWatchdog(self) -> bool:
        self.kicks += 1
        answer = self.answers.get("kickWatchdog", True)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def isProgramRunning(self) -> bool:
        return self._called("isProgramRunning")

    def isSteady(self) -> bool:
        return self._called("isSteady")

    def getTCPOffset(self) -> list[float]:
        self._called("getTCPOffset")
        return [0.0, 0.0, 0.165, 0.0, 0.0, 0.0]

    def setTcp(self, tcp_offset: list[float], /) -> bool:
        return self._called("setTcp", tuple(tcp_offset))

    def setPayload(self, mass: float, cog: list[float], /) -> bool:
        return self._called("setPayload", mass, tuple(cog))

    def isPoseWithinSafetyLimits(self, pose: list[float], /) -> bool:
        return self._called("isPoseWithinSafetyLimits", tuple(pose))

    def stopScript(self) -> None:
        self._called("stopScript")


class Ended(BaseException):
    """Instead of the end of this process."""

    def __init__(self, code: Exit) -> None:
        super().__init__(code.name)
        self.code = code


class Rig:
    """A worker in a thread, and the driver's end of its socket."""

    def __init__(self) -> None:
        self.library = Library()
        self.ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.ours.settimeout(2.0)
        self.theirs = theirs
        memory = Lease.make()
        self.lease = Lease(memory)
        self.worker = Worker(self.library, theirs, Lease(memory))
        os.close(memory)
        self.code: Exit | None = None
        self.thread = threading.Thread(target=self._run)
        self.number = 0

    def armed(self) -> Library:
        assert self.ask(Do.ARM).ok
        assert self.library.calls == [("setWatchdog", WATCHDOG_HZ)]
        self.library.calls.clear()
        self.lease.renew(time.monotonic())
        return self.library

    def _run(self) -> None:
        try:
            self.worker.run()
        except Ended as end:
            self.code = end.code

    def ask(self, do: Do, *values: float) -> Reply:
        self.number += 1
        self.ours.send(Request(number=self.number, do=do, values=values).pack())
        reply = reply_of(self.ours.recv(4096))
        assert reply.number == self.number
        return reply

    def ended(self) -> Exit | None:
        self.thread.join(2.0)
        return self.code


@pytest.fixture
def rig(monkeypatch: pytest.MonkeyPatch) -> Iterator[Rig]:
    def leave(code: Exit) -> NoReturn:
        raise Ended(code)

    def quiet(_: float) -> None:
        """No timer of the kernel in the test's process."""

    monkeypatch.setattr(ur_worker, "leave", leave)
    monkeypatch.setattr(ur_worker, "guard", quiet)
    made = Rig()
    made.thread.start()
    yield made
    made.ours.close()
    made.thread.join(2.0)
    made.theirs.close()


def test_motions_are_started_asynchronously_and_nothing_else(rig: Rig) -> None:
    rig.armed()
    assert rig.ask(Do.MOVE_LINE, *TARGET, 0.25, 1.2).ok
    assert rig.ask(Do.MOVE_JOINTS, *TARGET, 1.0, 1.4).ok
    assert rig.library.calls == [("moveL", TARGET, 0.25, 1.2, True), ("moveJ", TARGET, 1.0, 1.4, True)]


def test_nothing_moves_before_the_watchdog_is_armed(rig: Rig) -> None:
    rig.library.answers = {"setWatchdog": False}
    assert not rig.ask(Do.ARM).ok
    for do in (Do.MOVE_LINE, Do.MOVE_JOINTS):
        assert not rig.ask(do, *TARGET, 0.25, 1.2).ok
    assert rig.library.calls == [("setWatchdog", WATCHDOG_HZ)]


def test_a_false_and_an_exception_are_both_a_no(rig: Rig) -> None:
    rig.library.answers = {"setTcp": False, "setPayload": RuntimeError("did not succeed!")}
    assert not rig.ask(Do.SET_TOOL, *TARGET).ok
    told = rig.ask(Do.SET_PAYLOAD, 0.9, 0.0, 0.0, 0.05)
    assert (told.ok, told.detail) == (False, "RuntimeError: did not succeed!")


def test_limits_are_not_believed_of_a_program_that_does_not_run(rig: Rig) -> None:
    assert rig.ask(Do.WITHIN_LIMITS, *TARGET).values == (1.0,)
    rig.library.answers = {"isProgramRunning": False}
    assert not rig.ask(Do.WITHIN_LIMITS, *TARGET).ok


def test_at_rest_the_watchdog_is_kicked_without_a_lease(rig: Rig) -> None:
    kicked = rig.library.kicks
    until = time.monotonic() + 2.0
    while rig.library.kicks < kicked + 3 and time.monotonic() < until:
        rig.ask(Do.PING)
    assert rig.library.kicks >= kicked + 3
    assert rig.code is None


def test_a_motion_nobody_looks_after_is_stopped_and_the_worker_ends(rig: Rig) -> None:
    rig.armed()
    rig.ask(Do.MOVE_LINE, *TARGET, 0.25, 1.2)
    assert rig.ended() is Exit.LEASE_OVER
    assert rig.library.calls[-1] == ("stopL", DECELERATION_M_S2, True)


def test_a_driver_that_is_gone_costs_the_motion(rig: Rig) -> None:
    rig.armed()
    rig.ask(Do.MOVE_JOINTS, *TARGET, 0.25, 1.2)
    rig.ours.close()
    assert rig.ended() is Exit.DRIVER_GONE
    assert rig.library.calls[-1][0] == "stopJ"


def test_a_driver_that_is_gone_while_the_arm_rests_stops_nothing(rig: Rig) -> None:
    rig.armed()
    rig.ask(Do.MOVE_LINE, *TARGET, 0.25, 1.2)
    rig.ask(Do.RESTS)
    rig.ours.close()
    assert rig.ended() is Exit.DRIVER_GONE
    assert rig.library.calls[-1][0] == "moveL"


def test_a_program_that_was_stopped_is_never_kicked_again(rig: Rig) -> None:
    rig.library.answers = {"kickWatchdog": False}
    until = time.monotonic() + 2.0
    kicked = rig.library.kicks
    while rig.library.kicks == kicked and time.monotonic() < until:
        rig.ask(Do.PING)
    rig.library.answers = {}
    stopped_at = rig.library.kicks
    for _ in range(50):
        rig.ask(Do.PING)
    assert rig.library.kicks == stopped_at


def test_a_library_that_cannot_kick_ends_the_worker(rig: Rig) -> None:
    rig.library.answers = {"kickWatchdog": RuntimeError("no connection")}
    assert rig.ended() is Exit.LIBRARY


def test_asked_to_end_it_stops_the_program(rig: Rig) -> None:
    rig.ours.send(Request(number=1, do=Do.END).pack())
    assert rig.ended() is Exit.ASKED
    assert rig.library.calls[-1] == ("stopScript",)


def test_what_it_does_not_know_ends_it(rig: Rig) -> None:
    rig.ours.send(b'[1, "dance", []]')
    assert rig.ended() is Exit.PROTOCOL


@pytest.mark.parametrize("data", [b"", b"{}", b'[1, "ping"]', b'["1", "ping", []]', b'[1, "ping", ["x"]]'])
def test_requests_that_are_none_are_refused(data: bytes) -> None:
    with pytest.raises(LinkError):
        request_of(data)


@pytest.mark.parametrize("data", [b"[1, 2, 3, 4]", b'[1, true, "", [NaN]]', b'[true, true, "", []]'])
def test_replies_that_are_none_are_refused(data: bytes) -> None:
    with pytest.raises(LinkError):
        reply_of(data)


def test_a_number_that_is_none_never_gets_on_the_wire() -> None:
    with pytest.raises(ValueError, match="JSON"):
        Request(number=1, do=Do.MOVE_LINE, values=(float("nan"),)).pack()
