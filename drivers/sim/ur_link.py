"""The wire from the simulated UR controller to the simulated cell: joints and outputs there, inputs back.

The controller is a client of `drivers.sim.service` that drives the arm: what it holds, the cell's cameras see
and its jaws touch. One request is under way at a time; nothing here waits. While the link is down the inputs
are low, as with a cut cable, and the arm goes on without a world.
"""

from __future__ import annotations

import socket
from collections.abc import Callable

from drivers.sim.protocol import Message, ProtocolError, decode, encode, receive, send
from drivers.sim.ur_codes import Safety
from drivers.sim.ur_core import Core
from drivers.sim.ur_kinematics import Six
from drivers.sim.ur_ports import Ports

EVERY_S = 0.004
AGAIN_S = 0.5
CONNECT_S = 10.0
_WORDS = {
    Safety.NORMAL: "normal",
    Safety.REDUCED: "reduced",
    Safety.PROTECTIVE_STOP: "protective_stop",
    Safety.SAFEGUARD_STOP: "safeguard_stop",
    Safety.SYSTEM_EMERGENCY_STOP: "emergency_stop",
    Safety.ROBOT_EMERGENCY_STOP: "emergency_stop",
}


class LinkDown(Exception):
    """There is no simulated cell at that address, or it does not want to be driven."""


def start_posture(host: str, port: int) -> Six:
    """Where the cell's arm stands; for the beginning, waits. `LinkDown` when nobody says so."""
    try:
        with socket.create_connection((host, port), timeout=CONNECT_S) as connection:
            send(connection, Message(values={"op": "state"}))
            answer = receive(connection)
        if answer is None:
            raise LinkDown(f"the simulated cell at {host}:{port} closed the connection")
        return answer.six("q_rad")
    except (OSError, ProtocolError) as error:
        raise LinkDown(f"no simulated cell at {host}:{port}: {error}") from error


class WorldLink:
    """The client; `step` after each waking of the controller."""

    def __init__(self, core: Core, ports: Ports, host: str, port: int) -> None:
        self._core, self._ports, self._address = core, ports, (host, port)
        self._socket: socket.socket | None = None
        self._came = b""
        self._asked = False
        self._next_at = 0.0
        self._orders: dict[str, Callable[[], object]] = {
            "normal": core.release,
            "protective_stop": lambda: core.protective_stop("the simulated cell: a crash, or asked for"),
            "safeguard_stop": core.safeguard_stop,
            "emergency_stop": core.emergency_stop,
        }

    @property
    def up(self) -> bool:
        """Whether there is a connection."""
        return self._socket is not None

    def step(self, now: float) -> None:
        """Send what the arm is and does, when it is time."""
        if now < self._next_at or self._asked:
            return
        if self._socket is None and not self._connect(now):
            return
        self._next_at = now + EVERY_S
        arm = self._core.arm
        values = Message(
            values={
                "op": "drive",
                "q_rad": list(arm.q),
                "moving": any(arm.qd),
                "safety": _WORDS.get(self._core.safety, "unknown"),
                "outputs": self._core.io.outputs & 0xFFFF,
            }
        )
        try:
            if self._socket is not None:
                self._socket.sendall(encode(values))  # far smaller than the empty buffer it goes to
                self._asked = True
        except OSError as error:
            self._down(now, str(error))

    def _connect(self, now: float) -> bool:
        self._next_at = now + AGAIN_S
        sock = socket.socket()
        try:
            sock.settimeout(EVERY_S)
            sock.connect(self._address)
        except OSError:
            sock.close()
            return False
        sock.setblocking(False)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket = sock
        self._ports.watch(sock, self._read)
        self._core.note("the simulated cell is there")
        return True

    def _read(self) -> None:
        if self._socket is None:
            return
        try:
            data = self._socket.recv(65536)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        try:
            if not data:
                raise ProtocolError("it closed the connection")
            answer, self._came = decode(self._came + data)
            if answer is not None:
                self._asked = False
                self._heard(answer)
        except ProtocolError as error:
            self._down(self._next_at, str(error))

    def _heard(self, answer: Message) -> None:
        if not answer.flag("ok"):
            raise ProtocolError(answer.text("detail"))
        self._core.io.inputs = answer.whole("inputs")
        order = self._orders.get(answer.text("asked"))
        if order is not None:
            order()

    def _down(self, now: float, why: str) -> None:
        if self._socket is not None:
            self._ports.unwatch(self._socket)
            self._socket.close()
        self._socket, self._came, self._asked = None, b"", False
        self._next_at = now + AGAIN_S
        self._core.io.inputs = 0
        self._core.counts["world_lost"] += 1
        self._core.note(f"the simulated cell is gone: {why}")

    def close(self) -> None:
        """The connection, if there is one."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
