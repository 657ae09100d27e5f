"""The worker process as the driver sees it: a deadline on every request, a kill for whatever misses it."""

from __future__ import annotations

import os
import select
import signal
import socket
import subprocess
import sys
import threading
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Final

import structlog

from drivers.errors import CommandRejected, DeviceTimeout, DeviceUnavailable
from drivers.robot.ur_link import MESSAGE_LIMIT, Do, Lease, LinkError, Reply, Request, reply_of
from drivers.robot.ur_worker import Exit, flags_of
from drivers.timing import Clock

START_S: Final = 9.0
"""The library gives its program 5 s to start, and the worker 2 s more to see it run."""
END_S: Final = 1.0
CONTROL_HZ: Final = 500.0
_SLICE_S: Final = 0.04
_LINES: Final = 20
_FILE_LIMIT: Final = 64 * 1024
_ROOT: Final = Path(__file__).resolve().parents[2]

_ENDS: Final = {
    Exit.ASKED: "it was asked to",
    Exit.NOT_STARTED: "the control program did not start",
    Exit.DRIVER_GONE: "it heard nothing from the driver any more",
    Exit.LEASE_OVER: "nobody looked after the motion for too long; it stopped the arm",
    Exit.LIBRARY: "the library could not kick the watchdog",
    Exit.PROTOCOL: "it was asked something it does not know",
}

log = structlog.get_logger()


class WorkerProcess:
    """One process from spawn to end. Asked from one thread; `kill` may come from any."""

    def __init__(self, name: str, clock: Clock) -> None:
        self._name = name
        self._clock = clock
        self._process: subprocess.Popen[bytes] | None = None
        self._socket: socket.socket | None = None
        self._lease: Lease | None = None
        self._said: int | None = None
        self._said_bytes = 0
        self._number = 0
        self._why: str | None = None
        self._never = threading.Event()

    # ------------------------------------------------------------------ start and end

    def start(self, host: str, upper_registers: bool) -> None:
        """Spawn it and wait until the control program runs.

        Raises
        ------
        DeviceTimeout
            Not ready within `START_S`: killed.
        CommandRejected
            The library or the controller refused.
        DeviceUnavailable
            It ended.
        """
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        memory = Lease.make()
        said = os.memfd_create(f"{self._name}-worker", os.MFD_CLOEXEC)
        self._socket, self._said = ours, said
        try:
            self._lease = Lease(memory)
            self._process = subprocess.Popen(
                [
                    *(sys.executable, "-P", "-m", "drivers.robot.ur_worker"),
                    *(host, str(CONTROL_HZ), str(flags_of(upper_registers))),
                    *(str(theirs.fileno()), str(memory)),
                ],
                stdin=subprocess.DEVNULL,
                stdout=said,
                stderr=said,
                pass_fds=(theirs.fileno(), memory),
                # a session of its own: the terminal's Ctrl-C is the driver's to act on
                start_new_session=True,
                env={**os.environ, "PYTHONPATH": str(_ROOT)},
            )
        except OSError as error:
            self.close()
            raise DeviceUnavailable(self._name, f"worker process cannot be started: {error}") from error
        finally:
            theirs.close()
            os.close(memory)
        with ExitStack() as undo:
            undo.callback(self.close)
            ready = self._wait(0, START_S)
            if not ready.ok:
                raise CommandRejected(self._name, f"control program not started: {ready.detail}")
            undo.pop_all()

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self._process is not None and self._process.poll() is None

    @property
    def pid(self) -> int | None:
        """Its process id, None before `start`."""
        return None if self._process is None else self._process.pid

    def why_ended(self) -> str:
        """Why it does not run, for a person."""
        if self._process is None:
            return "worker process not started"
        code = self._process.poll()
        if self._why is not None:
            return f"worker process killed: {self._why}"
        if code is None:
            return "worker process runs"
        if code < 0:
            return f"worker process ended by {signal.Signals(-code).name}"
        known = _ENDS.get(Exit(code)) if code in set(Exit) else None
        return f"worker process ended: {known or f'exit code {code}'}"

    @property
    def killed(self) -> bool:
        """Whether it had to be killed."""
        return self._process is not None and self._process.poll() == -signal.SIGKILL

    def ended_for_lease(self) -> bool:
        """Whether it ended because nobody looked after a motion."""
        return self._process is not None and self._process.poll() == Exit.LEASE_OVER

    def kill(self, why: str) -> None:
        """SIGKILL; the controller's watchdog then stops the arm. From any thread; may come twice."""
        process = self._process
        if process is not None and process.poll() is None:
            self._why = self._why or why
            process.kill()

    def end(self) -> None:
        """Ask it to stop the program and end; kill it when it does not."""
        if self.alive and self._socket is not None:
            with suppress(OSError):
                self._send(Request(number=self._number + 1, do=Do.END))
            assert self._process is not None
            try:
                self._process.wait(END_S)
            except subprocess.TimeoutExpired:
                self.kill("it did not end when asked")
        self.close()

    def close(self) -> None:
        """Kill what still runs, leave no zombie, log what it said last; may come twice."""
        self.kill("not needed any more")
        if self._process is not None:
            self._process.wait()
        self.listen()
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        if self._lease is not None:
            self._lease.close()
            self._lease = None
        if self._said is not None:
            os.close(self._said)
            self._said = None

    # ------------------------------------------------------------------ requests

    def look_after(self) -> None:
        """Renew the lease: the motion under way is wanted."""
        if self._lease is not None:
            self._lease.renew(self._clock.now())

    def ask(self, do: Do, values: tuple[float, ...] = (), *, within_s: float) -> Reply:
        """One request and its answer.

        Raises
        ------
        DeviceTimeout
            None in time: killed. Or it had ended because the driver was held up.
        DeviceUnavailable
            It ended.
        """
        if self._socket is None:
            raise DeviceUnavailable(self._name, self.why_ended())
        self._number += 1
        request = Request(number=self._number, do=do, values=values)
        try:
            self._send(request)
        except OSError as error:
            raise self.gone() from error
        return self._wait(request.number, within_s)

    def _send(self, request: Request) -> None:
        assert self._socket is not None
        self._socket.send(request.pack(), socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)

    def _wait(self, number: int, within_s: float) -> Reply:
        assert self._socket is not None
        until = self._clock.now() + within_s
        while True:
            left_s = until - self._clock.now()
            if left_s <= 0.0:
                self.kill(f"no answer within {within_s:.2f} s")
                self.listen()
                raise DeviceTimeout(
                    self._name, f"worker process gave no answer within {within_s:.2f} s; killed"
                )
            self.look_after()  # the library may take its time over a motion; the deadline bounds it
            self._clock.wait(self._never, 0.0)  # the wait counts as progress of whoever waits
            if not select.select([self._socket], [], [], min(left_s, _SLICE_S))[0]:
                continue
            try:
                data = self._socket.recv(MESSAGE_LIMIT)
                reply = reply_of(data) if data else None
            except (OSError, LinkError) as error:
                self.kill(f"its answer is none: {error}")
                reply = None
            if reply is None:
                raise self.gone()
            if reply.number == number:
                self.listen()
                return reply

    def gone(self) -> DeviceUnavailable | DeviceTimeout:
        """What to raise when it does not run any more."""
        if self._process is not None:
            try:
                self._process.wait(END_S)
            except subprocess.TimeoutExpired:
                self.kill("it hung up and did not end")
                self._process.wait()
        self.listen()
        if self.ended_for_lease():
            return DeviceTimeout(self._name, f"held up: {self.why_ended()}")
        return DeviceUnavailable(self._name, self.why_ended())

    # ------------------------------------------------------------------ what it says

    def listen(self) -> None:
        """Log what the library wrote since the last time; bounded, and never in the way of who writes."""
        if self._said is None:
            return
        size = os.fstat(self._said).st_size
        if size <= self._said_bytes:
            return
        text = os.pread(self._said, _FILE_LIMIT, self._said_bytes).decode("utf-8", "replace")
        self._said_bytes = size
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        for line in lines[:_LINES]:
            log.info("robot_library_said", device=self._name, text=line[:500])
        if len(lines) > _LINES:
            log.info(
                "robot_library_said", device=self._name, text=f"... and {len(lines) - _LINES} lines more"
            )
