"""Camera and gripper of the simulated cell, clients of its process (`drivers.sim.cell`); their link to it.

The arm is in `robot`.
Every call is bounded: a request that is not answered in time closes the connection, so that a late answer is
never taken for the next one; the next call connects anew.
"""

from __future__ import annotations

import socket
from contextlib import ExitStack
from typing import NoReturn

import numpy as np

from drivers.camera_settings import SimCameraSettings
from drivers.errors import (
    CommandRejected,
    DeviceTimeout,
    DeviceUnavailable,
)
from drivers.settings import SimGripperSettings
from drivers.sim.protocol import Json, Message, ProtocolError, receive, send
from drivers.timing import Clock, StopToken
from drivers.types import (
    Frame,
    Grip,
)

CONNECT_S = 1.0
REQUEST_S = 1.0
POLL_S = 0.02
GRACE_S = 0.25
"""For the eye's own "not in time" to arrive, or a picture that was exposed just in time."""
JAWS_S = 5.0
"""How long the jaws may take to open or close."""


class Link:
    """One connection to the simulated cell, made when needed and given up at the first doubt."""

    def __init__(self, name: str, host: str, port: int, clock: Clock, greeting: str | None = None) -> None:
        self._name = name
        self._address = (host, port)
        self._clock = clock
        self._greeting = greeting
        self._socket: socket.socket | None = None
        self._opened = False

    @property
    def connected(self) -> bool:
        """Whether there is a connection, as far as is known."""
        return self._socket is not None

    @property
    def opened(self) -> bool:
        """Whether calls are taken."""
        return self._opened

    def open(self) -> None:
        """Connect, or raise `DeviceUnavailable` (`CommandRejected` if the greeting is refused)."""
        self._opened = True
        with ExitStack() as undo:
            undo.callback(self.close)
            self._connect()
            undo.pop_all()

    def close(self) -> None:
        """Give the connection up; calls are refused until the next `open`."""
        self._opened = False
        self._drop()

    def _drop(self) -> None:
        connection, self._socket = self._socket, None
        if connection is not None:
            connection.close()

    def _connect(self) -> socket.socket:
        if self._socket is not None:
            return self._socket
        if not self._opened:
            raise DeviceUnavailable(self._name, "not open")
        try:
            self._socket = socket.create_connection(self._address, timeout=CONNECT_S)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError as error:
            self._drop()
            host, port = self._address
            raise DeviceUnavailable(self._name, f"no simulated cell at {host}:{port}: {error}") from error
        if self._greeting is not None:
            self.ask(self._greeting)
        if self._socket is None:
            raise DeviceUnavailable(self._name, "lost while connecting")
        return self._socket

    def ask(
        self, operation: str, values: dict[str, Json] | None = None, wait_s: float = REQUEST_S
    ) -> Message:
        """One request and its answer within ``wait_s``.

        Raises
        ------
        DeviceUnavailable
            The process cannot be reached, or was lost.
        DeviceTimeout
            It did not answer in time, or answered that it cannot in time.
        CommandRejected
            It said no.
        """
        connection = self._connect()
        until = self._clock.now() + wait_s
        try:
            connection.settimeout(max(0.01, wait_s))
            send(connection, Message(values={"op": operation, **(values or {})}))
            answer = receive(connection, lambda: until - self._clock.now())
        except TimeoutError as error:
            self._drop()
            raise DeviceTimeout(self._name, f"no answer to {operation} within {wait_s:.2f} s") from error
        except (OSError, ProtocolError) as error:
            self._drop()
            raise DeviceUnavailable(self._name, f"connection lost: {error}") from error
        if answer is None:
            self._drop()
            raise DeviceUnavailable(self._name, "the simulated cell closed the connection")
        try:
            if answer.flag("ok"):
                return answer
            kind, detail = answer.text("kind"), answer.text("detail")
        except ProtocolError as error:
            self.doubt(error)
        if kind == "timeout":
            raise DeviceTimeout(self._name, detail)
        raise CommandRejected(self._name, detail)

    def doubt(self, error: Exception) -> NoReturn:
        """An answer that makes no sense: give the connection up."""
        self._drop()
        raise DeviceUnavailable(self._name, f"answer not understood: {error}") from error


class SimCamera:
    """One eye of the simulated cell."""

    def __init__(self, name: str, settings: SimCameraSettings, clock: Clock) -> None:
        self._name = name
        self._settings = settings
        self._link = Link(name, settings.host, settings.port, clock)

    @property
    def name(self) -> str:
        """How logs and faults call it."""
        return self._name

    def open(self) -> None:
        """Connect."""
        self._link.open()

    def close(self) -> None:
        """Disconnect."""
        self._link.close()

    def check(self) -> None:
        """`DeviceUnavailable` when it is not open; that the process is gone, the next picture tells."""
        if not self._link.opened:
            raise DeviceUnavailable(self._name, "not open")

    def grab(self, *, newer_than: float, timeout_s: float) -> Frame:
        """A frame exposed after ``newer_than`` (monotonic seconds), or `DeviceTimeout`.

        `CommandRejected` when the simulated cell's pictures have another size than the settings.
        """
        request: dict[str, Json] = {
            "eye": self._settings.eye,
            "newer_than": newer_than,
            "timeout_s": timeout_s,
        }
        answer = self._link.ask("grab", request, timeout_s + GRACE_S)
        try:
            width, height = answer.whole("width"), answer.whole("height")
            captured_at, sequence = answer.number("captured_at"), answer.whole("sequence")
            if len(answer.payload) != width * height * 3:
                raise ProtocolError("picture and size differ")
        except ProtocolError as error:
            self._link.doubt(error)
        if (width, height) != (self._settings.width_px, self._settings.height_px):
            raise CommandRejected(
                self._name,
                f"pictures are {width}x{height}, the settings say "
                f"{self._settings.width_px}x{self._settings.height_px}",
            )
        if captured_at <= newer_than:
            raise DeviceTimeout(self._name, "only an old picture came")
        pixels = np.frombuffer(answer.payload, dtype=np.uint8).reshape(height, width, 3)
        return Frame(camera=self._name, pixels=pixels, captured_at=captured_at, sequence=sequence)


class SimGripper:
    """The two jaws of the simulated cell."""

    def __init__(self, name: str, settings: SimGripperSettings, clock: Clock) -> None:
        self._name = name
        self._clock = clock
        self._link = Link(name, settings.host, settings.port, clock)

    @property
    def name(self) -> str:
        """How logs and faults call it."""
        return self._name

    def open(self) -> None:
        """Connect."""
        self._link.open()

    def close(self) -> None:
        """Disconnect; the jaws stay as they are."""
        self._link.close()

    def release(self, *, stop: StopToken) -> None:
        """Open the jaws and wait until they are open."""
        self._jaws(False, stop)

    def grasp(self, *, stop: StopToken) -> Grip:
        """Close the jaws and say what they got."""
        return self._jaws(True, stop)

    def _jaws(self, close: bool, stop: StopToken) -> Grip:
        stop.check()
        until = self._clock.now() + JAWS_S
        self._link.ask("jaws", {"close": close})
        while (grip := self.grip()) is Grip.UNKNOWN:
            if self._clock.now() >= until:
                raise DeviceTimeout(self._name, f"jaws still moving after {JAWS_S:.0f} s")
            stop.wait(POLL_S)
        return grip

    def grip(self) -> Grip:
        """What the jaws hold; UNKNOWN while they move."""
        answer = self._link.ask("grip")
        try:
            return Grip(answer.text("grip"))
        except (ProtocolError, ValueError) as error:
            self._link.doubt(error)
