"""A UR arm: the driver's side. It never loads ur-rtde; a worker process does (`ur_worker`).

State comes from a connection of its own (`ur_stream`), stops also go over the dashboard, and what the library
says is believed only when the controller's state agrees (`ur_motion`). Whatever is in doubt ends with the
worker killed: it kicks the watchdog on the controller, so the arm stops 0.1 s later; a reset starts afresh.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from typing import Final

import structlog

from drivers.errors import (
    CommandRejected,
    DeviceTimeout,
    DeviceUnavailable,
    DriverError,
    SafetyStop,
    StaleData,
)
from drivers.robot import ur_limits, ur_recovery
from drivers.robot.ur_codes import ROBOT_MODES, RUNNING, Runtime, runtime_name
from drivers.robot.ur_dashboard import Dashboard
from drivers.robot.ur_link import Do
from drivers.robot.ur_motion import Progress, Watch
from drivers.robot.ur_preflight import TCP_TOLD_M, TCP_TOLD_RAD, look, offset_of, payload_line, tcp_line
from drivers.robot.ur_process import WorkerProcess
from drivers.robot.ur_reach import UrKinematics
from drivers.robot.ur_stream import PINS, Snapshot, UrStream
from drivers.robot.ur_watch import state_of
from drivers.settings import UrRobotSettings
from drivers.timing import Clock, StopRequested, StopToken
from drivers.types import JointAngles, JointMotion, LineMotion, RobotState, ToolPose

POLL_S: Final = 0.01
ASK_S: Final = 0.6
"""A command takes the library 4 to 7 ms; one that takes this long never ends."""
STOP_ASK_S: Final = 0.2
STOP_PANEL_S: Final = 0.3
REST_S: Final = 0.4
"""Beyond the deceleration itself, until the next step of the stop ladder."""
PROGRAM_S: Final = 2.0
CAUSE_S: Final = 0.05
"""Until the controller's state shows why a motion ended; the worker hears of it some frames earlier."""

log = structlog.get_logger()


class UrRobot:
    """Satisfies `drivers.interfaces.Robot`."""

    def __init__(self, name: str, settings: UrRobotSettings, clock: Clock) -> None:
        self._name = name
        self._settings = settings
        self._clock = clock
        self._geometry = ur_limits.Geometry.of(settings)
        self._kinematics = UrKinematics(settings)
        self._stream = UrStream(name, clock, offset_of(settings), self._doubt)
        self._worker: WorkerProcess | None = None
        self._opened = False
        self._line = True
        self._careful = False
        self._unsafe_since: float | None = None

    @property
    def name(self) -> str:
        """How logs and faults call it."""
        return self._name

    @property
    def worker_pid(self) -> int | None:
        """The process that holds the library; None when there is none."""
        return None if self._worker is None else self._worker.pid

    # ------------------------------------------------------------------ open and close

    def open(self) -> None:
        """Look at the controller, connect, and start the control program; all or nothing.

        An arm stopped by its safety system is opened without a program, so that its state can be seen;
        `recover` starts one.
        """
        self.close()
        with ExitStack() as undo:
            undo.callback(self._end)
            wrong = [one.error for one in look(self._name, self._settings, self._clock, self._stream)]
            for error in wrong:
                if error is not None and not isinstance(error, SafetyStop):
                    raise error
            if self._stream.latest().may_move:
                self._start()
            undo.pop_all()
        self._opened = True

    def _start(self) -> None:
        """A fresh worker, its program, and the tool it works with."""
        self._worker = worker = WorkerProcess(self._name, self._clock)
        worker.start(self._settings.host, self._settings.registers == "upper")
        runs = self._see(PROGRAM_S, lambda s: s.runtime == Runtime.PLAYING)
        if not runs or not worker.ask(Do.PING, within_s=ASK_S).ok:
            raise CommandRejected(self._name, "the control program was sent but does not run")
        self._check_tool(worker)
        self._need(worker.ask(Do.ARM, within_s=ASK_S).ok, "the controller's watchdog could not be armed")
        log.info("robot_program_started", device=self._name, controller=str(self._stream.version))

    def _check_tool(self, worker: WorkerProcess) -> None:
        s = self._settings
        if s.tool_from == "configuration":
            self._need(worker.ask(Do.SET_TOOL, s.tcp_m_rad, within_s=ASK_S).ok, "tool not set")
            payload = (s.payload_kg, *s.payload_cog_m)
            self._need(worker.ask(Do.SET_PAYLOAD, payload, within_s=ASK_S).ok, "payload not set")
        told = worker.ask(Do.TOOL, within_s=ASK_S)
        self._need(told.ok and len(told.values) == 6, "the controller does not tell its tool")
        x, y, z, rx, ry, rz = told.values
        tool = tcp_line(self._name, s, (x, y, z, rx, ry, rz), TCP_TOLD_M, TCP_TOLD_RAD)
        self._see(0.5, lambda snapshot: payload_line(self._name, s, snapshot).error is None)
        for line in (tool, payload_line(self._name, s, self._stream.latest())):
            if line.error is not None:
                raise line.error

    def _need(self, good: bool, otherwise: str) -> None:
        if not good:
            raise CommandRejected(self._name, otherwise)

    def close(self) -> None:
        """Bring the arm to rest, end the program and hang up; never raises, may come twice."""
        if self._opened and self._worker is not None:
            try:
                self.halt()
            except DriverError as error:
                log.warning("robot_halt_failed", device=self._name, detail=error.detail)
        self._opened = False
        self._end()

    def _end(self) -> None:
        worker, self._worker = self._worker, None
        if worker is not None:
            clean = worker.alive
            worker.end()
            if not clean or worker.killed:
                self._stop_at_panel()
        self._stream.close()

    # ------------------------------------------------------------------ state

    def state(self) -> RobotState:
        """What the arm says of itself; see `drivers.interfaces.Robot`."""
        return state_of(self._fresh())

    def _fresh(self) -> Snapshot:
        """The newest state; a link in doubt costs the worker its life."""
        if not self._opened:
            raise DeviceUnavailable(self._name, "not open")
        try:
            snapshot = self._stream.latest()
        except (DeviceUnavailable, StaleData) as error:
            self._doubt(error.detail)
            raise
        if snapshot.may_move:
            self._unsafe_since = None
            if self._worker is not None and not self._worker.alive:
                self._worker.listen()
                raise self._worker.gone()
        elif self._unsafe_since is None:
            self._unsafe_since = self._clock.now()
        return snapshot

    def _doubt(self, why: str) -> None:
        """Kill the worker before the library acts on its own. Also called from the stream's thread."""
        worker = self._worker
        if worker is not None:
            worker.kill(why)

    def _see(self, within_s: float, reached: Callable[[Snapshot], bool]) -> bool:
        """Wait until the controller's state is so; False when it is not in time, or cannot be seen."""
        until = self._clock.now() + within_s
        waiting = StopToken(self._clock)
        while True:
            try:
                if reached(self._stream.latest()):
                    return True
            except DriverError:
                return False
            if self._clock.now() >= until:
                return False
            if self._worker is not None:
                self._worker.look_after()
            waiting.wait(POLL_S)

    def reachable(self, target: ToolPose) -> bool:
        """Whether the arm may and can be there: tool box, some posture, the controller's safety limits."""
        _, worker = self._ready()
        six = target.six()
        if self._geometry.outside(six) is not None or not self._geometry.some_posture(six):
            return False
        reply = worker.ask(Do.WITHIN_LIMITS, six, within_s=ASK_S)
        if not reply.ok or len(reply.values) != 1:
            raise CommandRejected(self._name, f"reach not told: {reply.detail}")
        return reply.values[0] == 1.0

    # ------------------------------------------------------------------ motion

    def move_line(self, target: ToolPose, motion: LineMotion, stop: StopToken) -> None:
        """Straight to ``target``; see `drivers.interfaces.Robot`."""
        six = target.six()
        self._refuse(ur_limits.refused_line(six, motion, self._geometry))
        motion = self._kinematics.paced(JointAngles(q_rad=self._fresh().q_rad), target, motion)
        slow = self._fraction()
        values = (*six, motion.speed_m_s * slow, motion.accel_m_s2)
        missed: Callable[[Snapshot], str | None] = lambda s: ur_limits.line_missed(six, s.tool)  # noqa: E731
        self._move(Do.MOVE_LINE, values, motion.timeout_s / slow, missed, stop)

    def move_joints(self, target: JointAngles, motion: JointMotion, stop: StopToken) -> None:
        """All joints to ``target``; see `drivers.interfaces.Robot`."""
        q = target.q_rad
        self._refuse(ur_limits.refused_joints(q, motion, self._geometry))
        slow = self._fraction()
        values = (*q, motion.speed_rad_s * slow, motion.accel_rad_s2)
        missed: Callable[[Snapshot], str | None] = lambda s: ur_limits.joints_missed(q, s.q_rad)  # noqa: E731
        self._move(Do.MOVE_JOINTS, values, motion.timeout_s / slow, missed, stop)

    def _fraction(self) -> float:
        return self._settings.first_speed_fraction if self._careful else 1.0

    def _refuse(self, why: str | None) -> None:
        if why is not None:
            raise CommandRejected(self._name, why)

    def _move(
        self,
        do: Do,
        values: tuple[float, ...],
        timeout_s: float,
        missed: Callable[[Snapshot], str | None],
        stop: StopToken,
    ) -> None:
        stop.check()
        before, worker = self._ready()
        began_at = self._clock.now()
        until = began_at + timeout_s
        self._line = do is Do.MOVE_LINE
        worker.look_after()
        try:
            reply = worker.ask(do, values, within_s=ASK_S)
            if not reply.ok:
                raise CommandRejected(self._name, f"motion refused: {reply.detail}")
            watch = Watch(self._name, before, missed, self._clock.now())
            while watch.look(self._fresh(), self._clock.now()) is not Progress.ARRIVED:
                if self._clock.now() >= until:
                    raise DeviceTimeout(self._name, f"not there within {timeout_s:.2f} s; halted")
                worker.look_after()
                stop.wait(min(POLL_S, max(0.0, until - self._clock.now())))
        except StopRequested:
            self._come_to_rest()
            raise
        except DriverError as error:
            cause = self._cause(error)
            if isinstance(cause, SafetyStop):
                self._abandon("stopped by the safety system")
            else:
                self._come_to_rest()
            if cause is error:
                raise
            raise cause from error
        worker.ask(Do.RESTS, within_s=STOP_ASK_S)
        self._careful = False

    def _ready(self) -> tuple[Snapshot, WorkerProcess]:
        """State and worker, when the arm may be told to move."""
        snapshot = self._fresh()
        if not snapshot.may_move:
            raise SafetyStop(self._name, snapshot.safety)
        if snapshot.robot_mode != RUNNING:
            mode = ROBOT_MODES.get(snapshot.robot_mode, str(snapshot.robot_mode))
            raise CommandRejected(self._name, f"arm is {mode}: reset powers it on")
        if self._worker is None:
            raise CommandRejected(self._name, "no control program since the safety stop: reset starts one")
        if snapshot.runtime != Runtime.PLAYING:
            raise CommandRejected(
                self._name,
                f"the control program does not run ({runtime_name(snapshot.runtime)}); reset restarts it",
            )
        return snapshot, self._worker

    def _cause(self, error: DriverError) -> DriverError:
        """What ended a motion: the controller's state may say more than what was seen first."""
        # a motion that may still go on is stopped first
        wait_s = CAUSE_S if isinstance(error, DeviceUnavailable | CommandRejected) else 0.0
        self._see(wait_s, lambda s: not s.may_move or s.runtime != Runtime.PLAYING)
        try:
            snapshot = self._stream.latest()
        except DriverError as lost:
            return lost
        if not snapshot.may_move:
            return SafetyStop(self._name, snapshot.safety)
        if snapshot.runtime != Runtime.PLAYING and not isinstance(error, CommandRejected):
            ended = f"the control program ended ({runtime_name(snapshot.runtime)})"
            return CommandRejected(self._name, f"{ended}; seen as: {error.detail}")
        return error

    # ------------------------------------------------------------------ stopping

    def halt(self) -> None:
        """Bring the arm to rest; `DeviceUnavailable` when it cannot be seen to rest."""
        if not self._opened:
            raise DeviceUnavailable(self._name, "not open")
        if not self._see(0.0, _stands) and not self._come_to_rest():
            raise DeviceUnavailable(self._name, "the arm cannot be seen to rest; its watchdog stops it")

    def _come_to_rest(self) -> bool:
        """The stop ladder: the worker decelerates, the panel stops the program, the worker is killed."""
        if self._ask_to_stop():
            return True
        log.warning("robot_stop_escalated", device=self._name, step="dashboard")
        if self._stop_at_panel() and self._see(REST_S, _stands):
            return True
        log.warning("robot_stop_escalated", device=self._name, step="kill")
        self._doubt("the arm did not stop otherwise")
        return self._see(REST_S, _stands)

    def _ask_to_stop(self) -> bool:
        worker = self._worker
        if worker is None or not worker.alive:
            return False
        s = self._settings
        do, rate = (Do.STOP_LINE, s.stop_line_m_s2) if self._line else (Do.STOP_JOINTS, s.stop_joint_rad_s2)
        top = ur_limits.MAX_SPEED_M_S if self._line else ur_limits.MAX_SPEED_RAD_S
        worker.look_after()
        try:
            worker.ask(do, (rate,), within_s=STOP_ASK_S)
            if not self._see(REST_S + top / rate, _stands):
                return False
            worker.ask(Do.RESTS, within_s=STOP_ASK_S)
        except DriverError as error:
            log.warning("robot_stop_failed", device=self._name, detail=error.detail)
            return False
        return True

    def _abandon(self, why: str) -> None:
        """No motion may go on from here: the worker dies, and the program with it."""
        self._doubt(why)
        self._stop_at_panel()
        self._see(REST_S, _stands)

    def _stop_at_panel(self) -> bool:
        try:
            with Dashboard(self._name, self._settings.host, self._clock, STOP_PANEL_S) as panel:
                panel.stop()
        except DriverError as error:
            log.warning("robot_stop_failed", device=self._name, detail=error.detail)
            return False
        return True

    def recover(self) -> None:
        """Clear what software may clear, on a person's word that the cause is gone. Never ``play``.

        The next motion is slow when something was cleared.
        """
        ours = self._worker is not None
        if self._worker is not None:
            self._worker.kill("recovering")
            self._worker.close()
            self._worker = None
        with Dashboard(self._name, self._settings.host, self._clock) as panel:
            cleared = ur_recovery.recover(self._name, panel, self._clock, ours, self._unsafe_since)
        self._careful = self._careful or cleared
        if self._opened:
            self.open()

    # ------------------------------------------------------------------ pins

    def set_output(self, pin: int, on: bool) -> None:
        """Switch a digital output and see it follow: 0-7 standard, 8-15 configurable, 16-17 at the tool."""
        self._fresh()
        self._stream.switch(pin, on)

    def read_input(self, pin: int) -> bool:
        """Read a digital input, numbered as the outputs."""
        snapshot = self._fresh()
        if not 0 <= pin < PINS:
            raise CommandRejected(self._name, f"no digital input {pin}; there are 0 to {PINS - 1}")
        return bool(snapshot.inputs >> pin & 1)


def _stands(snapshot: Snapshot) -> bool:
    """Whether the arm rests and nothing goes on."""
    return not snapshot.moving and not (snapshot.operation_runs and snapshot.runtime == Runtime.PLAYING)
