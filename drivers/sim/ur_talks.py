"""What each port of the simulated UR controller speaks, and the streams it sends by itself."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from drivers.sim.ur_core import Core
from drivers.sim.ur_dashboard import BANNER, GOODBYE, Dashboard
from drivers.sim.ur_ports import Connection, Port, Ports
from drivers.sim.ur_primary import real_time_package, robot_state, version_message
from drivers.sim.ur_program import STEP_S
from drivers.sim.ur_script import Uploads
from drivers.sim.ur_session import NotRtde, Owners, Session

DASHBOARD, PRIMARY, SECONDARY, REAL_TIME, RTDE = 29999, 30001, 30002, 30003, 30004
POLYSCOPE_X = 10
"""From this version on there is no dashboard."""
STATE_EVERY = round(0.1 / STEP_S)
"""Primary and secondary clients hear of the robot ten times a second."""
LONGEST_LINE = 4096


class DashboardTalk:
    """Lines in, lines out; the banner first."""

    greeting = (BANNER + "\n").encode()

    def __init__(self, dashboard: Dashboard, connection: Connection) -> None:
        self._dashboard, self._connection = dashboard, connection
        self._rest = b""

    def received(self, data: bytes) -> Iterable[bytes] | None:
        """Answers to the whole lines."""
        *whole, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > LONGEST_LINE:
            return None
        return self._answers(whole)

    def _answers(self, whole: list[bytes]) -> Iterable[bytes]:
        for line in whole:
            text = line.decode("utf-8", "replace").strip()
            if not text:
                continue
            yield (self._dashboard.answer(text) + "\n").encode()
            if text.lower() in GOODBYE:
                self._connection.ends_when_sent = True
                return

    def closed(self) -> None:
        """Nothing to clear away."""


class ScriptTalk:
    """Programs in; what goes out is the stream's business."""

    def __init__(self, core: Core, greeting: bytes) -> None:
        self.greeting = greeting
        self._core = core
        self._uploads = Uploads()

    def received(self, data: bytes) -> Iterable[bytes] | None:
        """Run what is complete."""
        for text in self._uploads.feed(data):
            self._core.upload(text)
        return ()

    def closed(self) -> None:
        """Half a program is no program."""


class RtdeTalk:
    """One RTDE connection."""

    greeting = b""

    def __init__(self, session: Session, core: Core) -> None:
        self.session = session
        self._core = core

    def received(self, data: bytes) -> Iterable[bytes] | None:
        """Answers to the whole packages; None for what is no RTDE."""
        try:
            return list(self.session.feed(data))
        except NotRtde as error:
            self._core.note(f"RTDE client dropped: {error}")
            return None

    def closed(self) -> None:
        """Its variables are free."""
        self.session.end()


def make_ports(core: Core, owners: Owners, dashboard: Dashboard) -> tuple[Port, ...]:
    """The ports of a controller, not listening yet."""

    def script(connection: Connection) -> ScriptTalk:
        return ScriptTalk(core, b"" if connection.port.number == REAL_TIME else version_message(core))

    def rtde(connection: Connection) -> RtdeTalk:
        return RtdeTalk(Session(core, owners, connection.number), core)

    ports = (
        Port("dashboard", DASHBOARD, lambda connection: DashboardTalk(dashboard, connection)),
        Port("primary", PRIMARY, script, patient=True),
        Port("secondary", SECONDARY, script, patient=True),
        Port("script", REAL_TIME, script, patient=True),
        Port("rtde", RTDE, rtde),
    )
    return ports if core.version[0] < POLYSCOPE_X else ports[1:]


class Streams:
    """What the controller sends without being asked."""

    def __init__(self, core: Core, ports: Ports) -> None:
        self._core, self._ports = core, ports
        self._cycle = 0  # counts on while the controller's clock stands

    def step(self, now: float) -> None:
        """After each cycle: data packages that are due, and the streams of the other ports.

        A stream is dropped for a client whose last package has not gone out; RTDE packages queue up.
        """
        self._cycle += 1
        for connection in tuple(self._ports.connections):
            if isinstance(connection.talk, RtdeTalk):
                session = connection.talk.session
                if session.started and self._cycle % session.every == 0:
                    self._ports.send(connection, session.package(), now)
            elif isinstance(connection.talk, ScriptTalk) and connection.empty:
                package = self._stream(connection.port.number)
                if package is not None:
                    self._ports.send(connection, package(self._core), now)

    def _stream(self, port: int) -> Callable[[Core], bytes] | None:
        if port == REAL_TIME:
            return real_time_package
        return robot_state if self._cycle % STATE_EVERY == 0 else None
