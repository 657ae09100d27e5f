"""A Robotiq 2F gripper on the wire: the socket its URCap opens on a UR controller, as a process of its own.

``python -m drivers.sim.robotiq --host 127.0.0.2 [--port 63352] [--fault-port 0] [--world-port N]`` answers
``GET`` and ``SET`` lines of any number of clients. With ``--world-port`` its fingers are the jaws of that
simulated cell (`drivers.sim.cell`) and really pick sticks; without, the fault port puts parts between them.
First line on standard output: ``{"ready": true, ...}`` with the ports; SIGTERM ends it, and the last line is
what it counted.

The fault port takes one JSON object a line and answers with one: ``{"do": "status"}``, ``mute`` (for ``s``
seconds, 0: for ever), ``speak``, ``cut`` (``how`` rst or fin), ``refuse``, ``accept``, ``fault`` (``code``),
``deactivate``, ``power`` (``on``), ``stuck`` (``on``), ``thin`` (``on``), ``part`` (``at`` counts or null).
"""

from __future__ import annotations

import argparse
import json
import socket
import socketserver
import struct
import sys
import threading
from contextlib import suppress
from typing import Final

from drivers.errors import DeviceTimeout, DriverError
from drivers.sim import arguments
from drivers.sim.devices import Link
from drivers.sim.process import ending_signals
from drivers.sim.protocol import Json, ProtocolError
from drivers.sim.robotiq_hand import REACH, READABLE, WRITABLE, Hand, Touch
from drivers.timing import MonotonicClock
from drivers.types import Grip

PORT: Final = 63352
TICK_S: Final = 0.005
WORLD_S: Final = 0.02
PART_COUNTS: Final = 10
"""A stick keeps the fingers this far from closed: 3.8 mm of a 2F-85's 85 mm."""
LINE_LIMIT: Final = 512
RESET: Final = struct.pack("ii", 1, 0)


class Gripper:
    """The hand in real time, who talks to it, and what is wrong with it. Safe to call from many threads."""

    def __init__(self, hand: Hand, world: Link | None, speed: float) -> None:
        self.hand = hand
        self.lock = threading.Lock()
        self.ended = threading.Event()
        self.speaking = threading.Event()
        self.speaking.set()
        self.refusing = False
        self.part_at: float | None = None
        self.commands = 0
        self.world_lost: str | None = None
        self._world = world
        self._speed = speed
        self._clock = MonotonicClock()
        self._told_to_close: bool | None = None
        self._connections: set[socket.socket] = set()

    # ------------------------------------------------------------------ time and the world

    def run(self) -> None:
        """Step the hand until the process is asked to end."""
        since = asked_at = self._clock.now()
        touch = Touch()
        while not self.ended.wait(TICK_S):
            now = self._clock.now()
            closing = self.hand.closing
            if self._world is None:
                touch = Touch(at=self.part_at)
            elif closing is not self._told_to_close or now - asked_at >= WORLD_S:
                touch, asked_at = self._between(self._world, closing), now
            with self.lock:
                if closing is self.hand.closing:  # an order that has just come is first told to the world
                    self.hand.step(min(now - since, 0.1) * self._speed, touch)
            since = now

    def _between(self, world: Link, closing: bool) -> Touch:
        """Tell the world of an order, and ask it what lies between the fingers."""
        try:
            if closing is not self._told_to_close and (closing or self._told_to_close is not None):
                world.ask("jaws", {"close": closing})
            self._told_to_close = closing
            grip = Grip(world.ask("grip").text("grip"))
        except DeviceTimeout:  # a busy machine; asked again in a moment
            return Touch(at=self.hand.position, settled=False)
        except (DriverError, ProtocolError, ValueError) as error:
            self.world_lost = str(error)
            self.ended.set()
            return Touch()
        part = REACH[1] - PART_COUNTS
        if not closing:
            return Touch(settled=grip is not Grip.UNKNOWN)
        if grip is Grip.CLOSED_EMPTY:
            return Touch()
        return Touch(at=part, settled=grip is Grip.HOLDING)

    # ------------------------------------------------------------------ the socket

    def answer(self, line: str) -> bytes:
        """One line of a client."""
        words = line.split()
        with self.lock:
            self.commands += 1
            match words:
                case ["GET", name] if name in READABLE:
                    return f"{name} {self.hand.read(name)}\n".encode()
                case ["SET", *pairs] if len(pairs) % 2 == 0 and pairs:
                    names, values = pairs[::2], pairs[1::2]
                    if all(n in WRITABLE for n in names) and all(v.isdecimal() for v in values):
                        for name, value in zip(names, values, strict=True):
                            self.hand.write(name, min(int(value), 255))
                        return b"ack"
        return b"?\n"

    def joined(self, connection: socket.socket) -> bool:
        """Whether a client is let in."""
        with self.lock:
            if not self.refusing:
                self._connections.add(connection)
            return not self.refusing

    def left(self, connection: socket.socket) -> None:
        """A client is gone."""
        with self.lock:
            self._connections.discard(connection)

    def cut(self, *, reset: bool) -> None:
        """End every client's connection."""
        with self.lock:
            for connection in self._connections:
                with suppress(OSError):
                    if reset:
                        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
                    connection.shutdown(socket.SHUT_RD)  # wakes its handler, which closes it
            self._connections.clear()

    # ------------------------------------------------------------------ faults

    def upset(self, request: dict[str, Json]) -> dict[str, Json]:
        """One request of the fault port."""
        what = request.get("do")
        match what:
            case "mute":
                self.speaking.clear()
                seconds = request.get("s", 0.0)
                if isinstance(seconds, int | float) and seconds > 0:
                    threading.Timer(seconds, self.speaking.set).start()
            case "speak":
                self.speaking.set()
            case "cut":
                self.cut(reset=request.get("how", "rst") == "rst")
            case "refuse" | "accept":
                self.refusing = what == "refuse"
            case "fault":
                code = request.get("code")
                if not isinstance(code, int) or not 0 <= code <= 15:
                    return {"error": f"code {code!r} is not 0 to 15"}
                self.hand.fault = code
            case "deactivate":
                with self.lock:
                    self.hand.write("ACT", 0)
            case "power":
                self.hand.powered = bool(request.get("on", True))
            case "stuck":
                self.hand.stuck = bool(request.get("on", True))
            case "thin":
                self.hand.thin = bool(request.get("on", True))
            case "part":
                at = request.get("at")
                if at is not None and not isinstance(at, int | float):
                    return {"error": f"at {at!r} is not a position"}
                self.part_at = None if at is None else float(at)
            case "status":
                pass
            case _:
                return {"error": f"unknown request {what!r}"}
        return self.status()

    def status(self) -> dict[str, Json]:
        """Everything worth knowing."""
        with self.lock:
            return {
                **{name: self.hand.read(name) for name in ("STA", "FLT", "OBJ", "PRE", "POS", "GTO")},
                "clients": len(self._connections),
                "orders": self.hand.orders,
                "commands": self.commands,
            }


class _Lines(socketserver.StreamRequestHandler):
    """A client that sends lines."""

    server: _Server

    def handle(self) -> None:
        self.connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        gripper = self.server.gripper
        if self.server.faults:
            self._lines()
        elif gripper.joined(self.connection):
            try:
                self._lines()
            finally:
                gripper.left(self.connection)

    def _lines(self) -> None:
        gripper = self.server.gripper
        with suppress(OSError, ValueError):  # the client is gone, or its connection was cut under our hands
            while (line := self.rfile.readline(LINE_LIMIT)).endswith(b"\n"):
                if self.server.faults:
                    self.wfile.write(_upset(gripper, line))
                    continue
                answer = gripper.answer(line.decode("ascii", errors="replace"))
                while not gripper.speaking.wait(0.1):
                    if gripper.ended.is_set():
                        return
                self.wfile.write(answer)


def _upset(gripper: Gripper, line: bytes) -> bytes:
    try:
        request: Json = json.loads(line)
    except ValueError:
        request = None
    answer: dict[str, Json] = {"error": "not a JSON object"}
    if isinstance(request, dict):
        answer = gripper.upset(request)
    return json.dumps(answer).encode() + b"\n"


class _Server(socketserver.ThreadingTCPServer):
    daemon_threads = True
    block_on_close = False
    allow_reuse_address = True

    def __init__(self, gripper: Gripper, host: str, port: int, *, faults: bool) -> None:
        self.gripper = gripper
        self.faults = faults
        super().__init__((host, port), _Lines)

    @property
    def port(self) -> int:
        return int(self.server_address[1])

    def shutdown_request(self, request: socket.socket | tuple[bytes, socket.socket]) -> None:
        """Close, and nothing before it: what a connection was set to do on close is what its peer sees."""
        self.close_request(request)

    def handle_error(self, request: object, client_address: object) -> None:
        """A connection that was cut under its handler is not news."""


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = arguments.Parser(prog="python -m drivers.sim.robotiq", description="A Robotiq 2F gripper.")
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=arguments.port, default=PORT, help="0: any free one")
    parser.add_argument("--fault-port", type=arguments.port, default=0, help="0: any free one")
    parser.add_argument("--world-host", default="127.0.0.1")
    parser.add_argument(
        "--world-port", type=arguments.port, help="of the simulated cell whose jaws these are"
    )
    parser.add_argument("--speed", type=arguments.positive, default=1.0, help="simulated seconds per second")
    parser.add_argument("--not-activated", action="store_true", help="as after power-on")
    return parser.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    """Exit codes: 0 asked to end, 1 the simulated cell was lost, 2 wrong arguments."""
    options = _arguments(argv)
    for port in (options.port, options.fault_port):
        refused = arguments.refusal(options.host, port)
        if refused is not None:
            sys.stderr.write(f"simulated gripper: {refused}\n")
            return arguments.EXIT_USAGE
    hand = Hand()
    if not options.not_activated:
        hand.activate()
    world = None
    if options.world_port is not None:
        world = Link("robotiq", options.world_host, options.world_port, MonotonicClock())
        try:
            world.open()
        except DriverError as error:
            sys.stderr.write(f"simulated gripper: {error}\n")
            return 1
    asked_to_end = ending_signals()
    gripper = Gripper(hand, world, options.speed)
    with (
        _Server(gripper, options.host, options.port, faults=False) as server,
        _Server(gripper, options.host, options.fault_port, faults=True) as faults,
    ):
        threads = [
            threading.Thread(target=s.serve_forever, kwargs={"poll_interval": 0.05}) for s in (server, faults)
        ]
        threads.append(threading.Thread(target=gripper.run))
        for thread in threads:
            thread.start()
        ready = {"ready": True, "host": options.host, "port": server.port, "fault_port": faults.port}
        sys.stdout.write(json.dumps(ready) + "\n")
        sys.stdout.flush()
        asked_to_end.settimeout(0.2)
        while not gripper.ended.is_set():
            with suppress(TimeoutError):
                asked_to_end.recv(1)
                gripper.ended.set()
        server.shutdown()
        faults.shutdown()
        for thread in threads:
            thread.join()
        with suppress(BrokenPipeError):  # whoever started it may be gone already
            sys.stdout.write(json.dumps({"event": "ended", **gripper.status()}) + "\n")
            sys.stdout.flush()
    asked_to_end.close()
    if world is not None:
        world.close()
    if gripper.world_lost is not None:
        sys.stderr.write(f"simulated gripper: {gripper.world_lost}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
