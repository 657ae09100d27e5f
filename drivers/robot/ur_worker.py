"""The process that alone loads ur-rtde. It starts asynchronous motions, stops them, and kicks the watchdog.

Why a process: the library's constructors hold the interpreter's lock and may hang, on a cut link it ends in a
segmentation fault, its destructors may abort, and none of its calls has a time limit (design, section 7). So
the driver kills this process whenever an answer is late, and this process trusts nobody either:

* a timer of the kernel ends it when a call of the library hangs and nobody is left to kill it;
* while a motion is under way it kicks the controller's watchdog only as long as the driver looks after the
  motion (`Lease`); otherwise it stops the arm and ends, and the controller's watchdog stops the program;
* when the driver is gone, it stops the arm and ends.

It never returns from the library's destructors: `os._exit` is the only way out.
"""

from __future__ import annotations

import faulthandler
import os
import select
import signal
import socket
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from enum import IntEnum
from typing import Final, NoReturn, Protocol, cast

from drivers.robot.ur_link import MESSAGE_LIMIT, Do, Lease, LinkError, Reply, Request, request_of

KICK_S: Final = 0.02
WATCHDOG_HZ: Final = 10.0
LATE_S: Final = 0.06
"""A kick this late is worth a line: at 0.1 s the controller stops the program."""
STEADY_S: Final = 2.0
"""How long the program may take to run, once the library says it has been sent."""
_START_GUARD_S: Final = 15.0
_GUARD_S: Final = 6.0
_REAL_TIME: Final = 1
_NICE: Final = -10


class Exit(IntEnum):
    """Why the worker ended, as its exit code."""

    ASKED = 0
    NOT_STARTED = 3
    DRIVER_GONE = 4
    LEASE_OVER = 5
    LIBRARY = 6
    PROTOCOL = 7


class Control(Protocol):
    """What is used of ``rtde_control.RTDEControlInterface``; it has no types of its own."""

    def moveL(self, pose: list[float], speed: float, acceleration: float, asynchronous: bool, /) -> bool: ...
    def moveJ(self, q: list[float], speed: float, acceleration: float, asynchronous: bool, /) -> bool: ...
    def stopL(self, a: float, asynchronous: bool, /) -> None: ...
    def stopJ(self, a: float, asynchronous: bool, /) -> None: ...
    def setWatchdog(self, min_frequency: float, /) -> bool: ...
    def kickWatchdog(self) -> bool: ...
    def isProgramRunning(self) -> bool: ...
    def isSteady(self) -> bool: ...
    def getTCPOffset(self) -> list[float]: ...
    def setTcp(self, tcp_offset: list[float], /) -> bool: ...
    def setPayload(self, mass: float, cog: list[float], /) -> bool: ...
    def isPoseWithinSafetyLimits(self, pose: list[float], /) -> bool: ...
    def stopScript(self) -> None: ...


class _Library(Protocol):
    """The module."""

    def RTDEControlInterface(self, hostname: str, frequency: float, flags: int, /) -> Control: ...


FLAG_UPLOAD_SCRIPT: Final = 1
FLAG_UPPER_RANGE_REGISTERS: Final = 8
FLAG_NO_EXT_FT: Final = 0x40


def flags_of(upper_registers: bool) -> int:
    """The library's flags: its own program, no force-torque input (a variable less that others may hold)."""
    return FLAG_UPLOAD_SCRIPT | FLAG_NO_EXT_FT | (FLAG_UPPER_RANGE_REGISTERS if upper_registers else 0)


class Worker:
    """One library object, one driver, one loop."""

    def __init__(self, control: Control, driver: socket.socket, lease: Lease) -> None:
        self._control = control
        self._driver = driver
        self._lease = lease
        self._line = True
        self._moves = False
        self._runs = True
        self._armed = False
        self._kicked_at = float("-inf")
        self._busy, self._busy_s = "nothing", 0.0

    def run(self) -> NoReturn:
        """Until asked to end, the driver is gone, or the library fails."""
        while True:
            guard(_GUARD_S)
            wait_s = max(0.0, self._kicked_at + KICK_S - time.monotonic())
            if select.select([self._driver], [], [], wait_s)[0]:
                self._hear()
            self._look_after()

    def _hear(self) -> None:
        try:
            data = self._driver.recv(MESSAGE_LIMIT)
        except OSError:
            data = b""
        if not data:
            self._leave(Exit.DRIVER_GONE, "the driver is gone")
        try:
            request = request_of(data)
        except LinkError as error:
            self._leave(Exit.PROTOCOL, str(error))
        if request.do is Do.END:
            self._moves = False
            with suppress(RuntimeError):
                self._control.stopScript()
            leave(Exit.ASKED)
        began_at = time.monotonic()
        self._busy = request.do.value
        try:
            reply = self._carry_out(request)
        except (RuntimeError, ValueError, TypeError) as error:
            reply = Reply(number=request.number, ok=False, detail=f"{type(error).__name__}: {error}")
        self._busy_s = time.monotonic() - began_at
        answer(self._driver, reply)

    def _carry_out(self, request: Request) -> Reply:
        """One call of the library; every return value is looked at."""
        values = list(request.values)
        ok = True
        told: tuple[float, ...] = ()
        if request.do in (Do.MOVE_LINE, Do.MOVE_JOINTS) and not self._armed:
            return Reply(number=request.number, ok=False, detail="nothing moves before the watchdog is armed")
        match request.do:
            case Do.ARM:
                # last of all: what comes before it moves nothing, and each command takes its time
                ok = self._armed = self._control.setWatchdog(WATCHDOG_HZ)
            case Do.MOVE_LINE:
                self._line = self._moves = True
                ok = self._control.moveL(values[:6], values[6], values[7], True)
            case Do.MOVE_JOINTS:
                self._line, self._moves = False, True
                ok = self._control.moveJ(values[:6], values[6], values[7], True)
            case Do.STOP_LINE:
                self._control.stopL(values[0], True)
            case Do.STOP_JOINTS:
                self._control.stopJ(values[0], True)
            case Do.RESTS:
                self._moves = False
            case Do.PING:
                self._control.isSteady()
                ok = self._control.isProgramRunning()
            case Do.TOOL:
                offset = self._control.getTCPOffset()
                ok, told = len(offset) == 6, tuple(float(v) for v in offset)
            case Do.SET_TOOL:
                ok = self._control.setTcp(values[:6])
            case Do.SET_PAYLOAD:
                ok = self._control.setPayload(values[0], values[1:4])
            case Do.WITHIN_LIMITS:
                # False also means that the program does not run: ask before and after
                ran = self._control.isProgramRunning()
                within = self._control.isPoseWithinSafetyLimits(values[:6])
                ok, told = ran and self._control.isProgramRunning(), (float(within),)
            case Do.END:
                raise AssertionError("handled before")
        return Reply(number=request.number, ok=ok, detail="" if ok else "the library says no", values=told)

    def _look_after(self) -> None:
        """Kick the watchdog; not for a motion that nobody looks after."""
        now = time.monotonic()
        late_s = now - self._kicked_at
        if LATE_S < late_s < float("inf"):
            say(f"watchdog kicked {late_s:.3f} s after the last time; {self._busy} took {self._busy_s:.3f} s")
        if self._moves and not self._lease.fresh(now):
            self._leave(Exit.LEASE_OVER, "nobody looks after the motion")
        if now - self._kicked_at < KICK_S:
            return
        self._kicked_at = now
        if not self._runs:
            return
        try:
            # False: the program was stopped or paused. It is never kicked again, so that it cannot go on
            self._runs = self._control.kickWatchdog()
        except RuntimeError as error:
            self._leave(Exit.LIBRARY, f"watchdog not kicked: {error}")

    def _leave(self, code: Exit, why: str) -> NoReturn:
        """Stop what moves, then end: from here on the controller's watchdog is not kicked."""
        if self._moves:
            with suppress(RuntimeError, ValueError):
                if self._line:
                    self._control.stopL(DECELERATION_M_S2, True)
                else:
                    self._control.stopJ(DECELERATION_RAD_S2, True)
        say(why)
        leave(code)


DECELERATION_M_S2: Final = 4.0
DECELERATION_RAD_S2: Final = 8.0
"""With which the worker stops the arm when it acts alone."""


def before_others() -> None:
    """Run before what is not urgent, as far as this process may: a watchdog kicked late stops the arm."""
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(_REAL_TIME))
    except OSError:
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, 0, _NICE)


def guard(seconds: float) -> None:
    """The kernel ends this process unless `guard` is called again in time, whoever holds the interpreter."""
    signal.setitimer(signal.ITIMER_REAL, seconds)


def say(text: str) -> None:
    """A line for the log, past the library's own buffers."""
    with suppress(OSError):
        os.write(2, f"worker: {text}\n".encode())


def answer(driver: socket.socket, reply: Reply) -> None:
    """To the driver; that it is gone is noticed by the next look at the socket."""
    with suppress(OSError):
        driver.send(reply.pack())


def leave(code: Exit) -> NoReturn:
    """End without the library's destructors, which hang or abort."""
    os._exit(code)


def connect(host: str, frequency: float, flags: int) -> Control:
    """The library's object, its program running.

    Raises
    ------
    RuntimeError, ValueError, ImportError
        What the library throws, or that its program does not run though it says so.
    """
    import rtde_control

    library = cast(_Library, rtde_control)
    control = library.RTDEControlInterface(host, frequency, flags)
    until = time.monotonic() + STEADY_S
    # the constructor's word that the program runs is not enough: it may have ended since
    while not control.isProgramRunning():
        if time.monotonic() > until:
            raise RuntimeError("the control program was sent but does not run")
        # no token reaches this process before it is ready; its driver ends it if that takes too long
        time.sleep(0.01)
    return control


def main(arguments: Sequence[str]) -> NoReturn:
    """``ur_worker HOST FREQUENCY FLAGS SOCKET LEASE``; the last two are file descriptors."""
    host, frequency, flags, driver_file, lease_file = arguments
    faulthandler.enable()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # the driver ends this process, after the arm stands
    before_others()
    driver = socket.socket(fileno=int(driver_file))
    guard(_START_GUARD_S)
    try:
        control = connect(host, float(frequency), int(flags))
    except (RuntimeError, ValueError, ImportError) as error:
        answer(driver, Reply(number=0, ok=False, detail=str(error)))
        leave(Exit.NOT_STARTED)
    answer(driver, Reply(number=0, ok=True))
    Worker(control, driver, Lease(int(lease_file))).run()


if __name__ == "__main__":
    main(sys.argv[1:])
