"""The arm of the simulated cell, a client of its process (`drivers.sim.cell`): moved, or only looked at."""

from __future__ import annotations

from contextlib import suppress

from drivers.errors import (
    DeviceTimeout,
    DeviceUnavailable,
    DriverError,
    SafetyStop,
    StaleData,
)
from drivers.settings import SimRobotSettings
from drivers.sim.devices import POLL_S, REQUEST_S, Link
from drivers.sim.protocol import Json, Message, ProtocolError
from drivers.timing import Clock, StopRequested, StopToken
from drivers.types import (
    JointAngles,
    JointMotion,
    LineMotion,
    RobotState,
    SafetyMode,
    ToolPose,
)

CLOSE_S = 0.3
HALT_S = 1.0
"""How long the arm may take to come to rest after a halt."""
STALE_S = 0.25
"""The controller's own clock may stand for this long."""


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
