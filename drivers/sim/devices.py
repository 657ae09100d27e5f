"""Camera, arm and gripper of the simulated cell, as clients of its process (`drivers.sim.cell`).

Every call is bounded: a request that is not answered in time closes the connection, so that a late answer is
never taken for the next one; the next call connects anew.
"""

from __future__ import annotations

import socket
from contextlib import suppress
from typing import NoReturn

import numpy as np

from drivers.camera_settings import SimCameraSettings
from drivers.errors import (
    CommandRejected,
    DeviceTimeout,
    DeviceUnavailable,
    DriverError,
    SafetyStop,
    StaleData,
)
from drivers.settings import SimGripperSettings, SimRobotSettings
from drivers.sim.protocol import Json, Message, ProtocolError, receive, send
from drivers.timing import Clock, StopRequested, StopToken
from drivers.types import (
    Frame,
    Grip,
    JointAngles,
    JointMotion,
    LineMotion,
    RobotState,
    SafetyMode,
    ToolPose,
)

CONNECT_S = 1.0
REQUEST_S = 1.0
POLL_S = 0.02
GRACE_S = 0.25
"""For the eye's own "not in time" to arrive, or a picture that was exposed just in time."""
CLOSE_S = 0.3
HALT_S = 1.0
"""How long the arm may take to come to rest after a halt."""
STALE_S = 0.25
"""The controller's own clock may stand for this long."""
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
        try:
            self._connect()
        except BaseException:
            self.close()
            raise

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


class SimWatch:
    """The arm of the simulated cell, only looked at: whoever has control goes on having it."""

    def __init__(
        self, name: str, settings: SimRobotSettings, clock: Clock, greeting: str | None = None
    ) -> None:
        self._name = name
        self._clock = clock
        self._link = Link(name, settings.host, settings.port, clock, greeting=greeting)
        self._controller_time_s = float("-inf")
        self._ticked_at = float("-inf")

    @property
    def name(self) -> str:
        """How logs and faults call it."""
        return self._name

    def open(self) -> None:
        """Connect."""
        self._link.open()
        self._controller_time_s = self._ticked_at = float("-inf")

    def close(self) -> None:
        """Disconnect; never raises, may come twice."""
        self._link.close()

    def state(self) -> RobotState:
        """What the arm says of itself; `StaleData` once its clock has stood for `STALE_S`."""
        return self._read(self._link.ask("state"))

    def _read(self, answer: Message) -> RobotState:
        try:
            state = RobotState(
                safety=SafetyMode(answer.text("safety")),
                powered=answer.flag("powered"),
                program_running=answer.flag("program_running"),
                tool=ToolPose.of(answer.six("tool")),
                joints=JointAngles(q_rad=answer.six("q_rad")),
                moving=answer.flag("moving"),
                speed_fraction=answer.number("speed_fraction"),
                controller_time_s=answer.number("controller_time_s"),
                read_at=answer.number("read_at"),
            )
        except (ProtocolError, ValueError) as error:
            self._link.doubt(error)
        now = self._clock.now()
        if state.controller_time_s != self._controller_time_s:
            self._controller_time_s, self._ticked_at = state.controller_time_s, now
        elif now - self._ticked_at > STALE_S:
            raise StaleData(self._name, f"its clock has stood at {state.controller_time_s:.3f} s")
        return state


class SimRobot(SimWatch):
    """The arm of the simulated cell. Moves are started, then asked after until they end.

    `open` takes control; `CommandRejected` while another client has it.
    """

    def __init__(self, name: str, settings: SimRobotSettings, clock: Clock) -> None:
        super().__init__(name, settings, clock, greeting="take_control")

    def close(self) -> None:
        """Give control back and disconnect; the controller halts whatever still moves."""
        if self._link.connected:
            with suppress(DriverError):  # a lost connection gives control back as well
                self._link.ask("drop_control", wait_s=CLOSE_S)
        super().close()

    def reachable(self, target: ToolPose) -> bool:
        """Whether some posture brings the tool there."""
        answer = self._link.ask("reachable", {"target": list(target.six())})
        try:
            return answer.flag("reachable")
        except ProtocolError as error:
            self._link.doubt(error)

    def move_line(self, target: ToolPose, motion: LineMotion, stop: StopToken) -> None:
        """Straight to ``target``; see `drivers.interfaces.Robot`."""
        request: dict[str, Json] = {
            "target": list(target.six()),
            "speed": motion.speed_m_s,
            "accel": motion.accel_m_s2,
        }
        self._move("move_line", request, motion.timeout_s, stop)

    def move_joints(self, target: JointAngles, motion: JointMotion, stop: StopToken) -> None:
        """All joints to ``target``; see `drivers.interfaces.Robot`."""
        request: dict[str, Json] = {
            "target": list(target.q_rad),
            "speed": motion.speed_rad_s,
            "accel": motion.accel_rad_s2,
        }
        self._move("move_joints", request, motion.timeout_s, stop)

    def _move(self, operation: str, request: dict[str, Json], timeout_s: float, stop: StopToken) -> None:
        stop.check()
        self._refuse_unsafe(self.state())
        until = self._clock.now() + timeout_s
        self._link.ask(operation, request, min(timeout_s, REQUEST_S))
        try:
            while True:
                motion, state = self._poll()
                self._refuse_unsafe(state)
                if motion == "done":
                    return
                if motion != "running":
                    raise DeviceTimeout(self._name, f"the controller ended the motion early: {motion}")
                if self._clock.now() >= until:
                    raise DeviceTimeout(self._name, f"not there within {timeout_s:.2f} s; halted")
                stop.wait(min(POLL_S, max(0.0, until - self._clock.now())))
        except (StopRequested, DeviceTimeout, StaleData):
            self._come_to_rest()
            raise

    def _poll(self) -> tuple[str, RobotState]:
        answer = self._link.ask("poll")
        state = self._read(answer)
        try:
            return answer.text("motion"), state
        except ProtocolError as error:
            self._link.doubt(error)

    def _refuse_unsafe(self, state: RobotState) -> None:
        if state.safety not in (SafetyMode.NORMAL, SafetyMode.REDUCED):
            raise SafetyStop(self._name, state.safety)

    def _come_to_rest(self) -> None:
        """Halt and wait, within `HALT_S`, until the arm stands; what stops it beyond that is its watchdog."""
        until = self._clock.now() + HALT_S
        resting = StopToken(self._clock)
        try:
            self.halt()
            while self._poll()[1].moving and self._clock.now() < until:
                resting.wait(POLL_S)
        except (DeviceUnavailable, DeviceTimeout, StaleData):
            return  # the reason for halting is what the caller has to hear; the controller halts unasked

    def halt(self) -> None:
        """Ask the arm to come to rest."""
        self._link.ask("halt")

    def recover(self) -> None:
        """Clear a protective or safeguard stop; `CommandRejected` while the emergency stop is pressed."""
        self._link.ask("recover")

    def set_output(self, pin: int, on: bool) -> None:
        """Switch a digital output."""
        self._link.ask("set_output", {"pin": pin, "on": on})

    def read_input(self, pin: int) -> bool:
        """Read a digital input."""
        answer = self._link.ask("read_input", {"pin": pin})
        try:
            return answer.flag("on")
        except ProtocolError as error:
            self._link.doubt(error)


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
