"""pymodbus as the server of `drivers.plc.served`, and what it leaves to us: who may connect, how many, one
request after the other on each connection, and bounds on everything a peer can make us keep.

The library answers requests one by one as long as they come one by one: of several in one segment it answers
the first only, and it writes answers to a peer that does not read them without an end. So each connection
here cuts its bytes into frames, hands over one at a time, and reads no further while the peer does not. Of
bytes that are no Modbus frame nobody knows where they end: the connection is closed.
"""

from __future__ import annotations

import asyncio
import errno
import ipaddress
import logging
import socket
import struct
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from typing import Any, Final, cast

import structlog
from pymodbus.constants import ExcCodes
from pymodbus.pdu import ExceptionResponse, ModbusPDU
from pymodbus.server import ModbusTcpServer
from pymodbus.server.requesthandler import ServerRequestHandler
from pymodbus.simulator import DataType, SimData, SimDevice

from drivers.plc.served import ServedRegisters, window_of
from drivers.plc_map import SERVER_WINDOWS, Area, Window
from drivers.settings import ModbusServerPlcSettings

log = structlog.get_logger(part="plc")

GIVES_WAY_S: Final = 2.0
"""A connection without a whole request for this long is closed when a new one needs its place."""
SILENT_S: Final = 60.0
"""One without a whole request for this long is closed in any case."""
ANSWER_S: Final = 2.0
_SWEEP_S: Final = 1.0
_MOST_WAITING: Final = 4096
_MOST_NAMED: Final = 16
"""Peers named in the log one by one; more are only counted."""

_AREA_OF: Final = {
    1: Area.COIL,
    2: Area.DISCRETE_INPUT,
    3: Area.HOLDING_REGISTER,
    4: Area.INPUT_REGISTER,
    5: Area.COIL,
    6: Area.HOLDING_REGISTER,
    15: Area.COIL,
    16: Area.HOLDING_REGISTER,
    22: Area.HOLDING_REGISTER,
    23: Area.HOLDING_REGISTER,
}
"""Function codes served, and what they are about; every other one is refused with exception 1."""

_FIXED_LENGTH: Final = {1: 5, 2: 5, 3: 5, 4: 5, 5: 5, 6: 5, 22: 7}
_BYTE_COUNT_AT: Final = {15: 5, 16: 5, 23: 9}


class ListeningFailed(Exception):
    """The address cannot be listened on; the message says why and what to do."""


class Server:
    """One life of the server: `run` in a thread of its own, `end` from any."""

    def __init__(self, settings: ModbusServerPlcSettings, registers: ServedRegisters) -> None:
        self._settings = settings
        self._registers = registers
        self._allowed = [ipaddress.ip_network(peer, strict=False) for peer in settings.peers]
        self._loop: asyncio.AbstractEventLoop | None = None
        self._asked_to_end = asyncio.Event()
        self._connections: list[_Connection] = []
        self._named: set[str] = set()
        self._met: set[str] = set()
        self.refused = 0

    @property
    def connected(self) -> int:
        """Connections served now."""
        return len(self._connections)

    def run(self, started: Future[None]) -> None:
        """Listen and serve until `end`; ``started`` gets `ListeningFailed` where that is not possible."""
        _quieten_vendor_log()
        asyncio.run(self._serve(started))

    def end(self) -> None:
        """Stop serving; returns at once."""
        loop = self._loop
        if loop is None:
            self._asked_to_end.set()
            return
        try:
            loop.call_soon_threadsafe(self._asked_to_end.set)
        except RuntimeError:
            return  # it has ended already, and its loop is closed

    async def _serve(self, started: Future[None]) -> None:
        self._loop = asyncio.get_running_loop()
        try:
            listener = _listening_socket(self._settings.bind, self._settings.port)
        except ListeningFailed as error:
            started.set_exception(error)
            return
        server = _TcpServer(self, self._device())
        with listener:
            server.listen_on(listener)
            await server.serve_forever(background=True)
            started.set_result(None)
            while not self._asked_to_end.is_set():
                try:
                    await asyncio.wait_for(self._asked_to_end.wait(), _SWEEP_S)
                except TimeoutError:
                    self._sweep()
            shutdown = cast("Callable[[], Awaitable[None]]", server.shutdown)
            await shutdown()
            await asyncio.sleep(0)  # connections end in the loop's next turn

    def _sweep(self) -> None:
        now = asyncio.get_running_loop().time()
        for connection in list(self._connections):
            if connection.silent_s(now) > SILENT_S or connection.unanswered_s(now) > ANSWER_S:
                connection.hang_up()

    # who may connect

    def admit(self, connection: _Connection, peer: str) -> bool:
        """Whether a new connection is served; it is counted when not."""
        address = ipaddress.ip_address(peer.partition("%")[0])
        mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
        if not any((mapped or address) in network for network in self._allowed):
            self._refuse(peer, "not in plc.peers", "add it to plc.peers if it is the PLC")
            return False
        if len(self._connections) >= self._settings.max_connections and not self._make_room():
            self._refuse(
                peer, "all connections are taken", "raise plc.max_connections or find who holds them"
            )
            return False
        self._connections.append(connection)
        if peer not in self._met and len(self._met) < _MOST_NAMED:
            self._met.add(peer)
            log.info("plc_peer_connected", peer=peer)
        return True

    def forget(self, connection: _Connection) -> None:
        """It has ended."""
        if connection in self._connections:
            self._connections.remove(connection)

    def _make_room(self) -> bool:
        """Close the connection that has been silent longest, if that is long enough: a PLC that was switched
        off and on again has left its old one open."""
        now = asyncio.get_running_loop().time()
        oldest = max(self._connections, key=lambda connection: connection.silent_s(now))
        if oldest.silent_s(now) < GIVES_WAY_S:
            return False
        oldest.hang_up()
        return True

    def _refuse(self, peer: str, reason: str, action: str) -> None:
        self.refused += 1
        key = f"{peer} {reason}"
        if key not in self._named and len(self._named) < _MOST_NAMED:
            self._named.add(key)
            log.warning("plc_peer_refused", peer=peer, reason=reason, action=action)

    # what is served

    def _device(self) -> SimDevice:
        """The library's own store: it knows which addresses there are, `_touched` knows the values."""
        parts: dict[Area, list[SimData]] = {area: [] for area in Area}
        for window in sorted(SERVER_WINDOWS, key=lambda w: w.first):
            parts[window.area].append(_cells(window))
        return SimDevice(
            id=0,  # every unit number: gateways and PLCs send 0, 1 or 255
            simdata=(
                parts[Area.COIL],
                parts[Area.DISCRETE_INPUT],
                parts[Area.HOLDING_REGISTER],
                parts[Area.INPUT_REGISTER],
            ),
            action=self._touched,
        )

    async def _touched(
        self,
        function_code: int,
        start: int,
        address: int,
        count: int,
        cells: list[int],
        values: list[int] | list[bool] | None,
    ) -> ExcCodes | None:
        """Called for every read and write of the store: the image answers, the store only carries it."""
        area = _AREA_OF[function_code]
        if values is not None:
            written = self._registers.write(area, address, [int(value) for value in values])
            return None if written else ExcCodes.ILLEGAL_ADDRESS
        if area in (Area.COIL, Area.DISCRETE_INPUT):
            # the library asks for whole words of 16 bits here and takes out the bits itself
            bits = self._registers.read(area, 0, 16)
            if bits is None:
                return ExcCodes.ILLEGAL_ADDRESS
            cells[0] = sum(1 << i for i, on in enumerate(bits) if on)
            return None
        words = self._registers.read(area, address, count)
        if words is None:
            return ExcCodes.ILLEGAL_ADDRESS
        cells[address - start : address - start + count] = words
        return None


def _cells(window: Window) -> SimData:
    bits = window.area in (Area.COIL, Area.DISCRETE_INPUT)
    return SimData(
        window.first,
        values=[False] * window.count if bits else [0] * window.count,
        datatype=DataType.BITS if bits else DataType.REGISTERS,
        readonly=not window.writable,
    )


class _TcpServer(ModbusTcpServer):
    """The library's server on a socket of ours, with connections of ours."""

    def __init__(self, gate: Server, device: SimDevice) -> None:
        super().__init__(device, address=("", 0))
        self._gate = gate

    def listen_on(self, listener: socket.socket) -> None:
        """Instead of an address: the library does not say why it cannot listen."""
        loop = asyncio.get_running_loop()

        async def create() -> asyncio.Server:
            return await loop.create_server(self.handle_new_connection, sock=listener, backlog=16)

        self.call_create = create

    def callback_new_connection(self) -> _Connection:
        return _Connection(self, self._gate)


class _Connection(ServerRequestHandler):
    """One peer. The library gets whole frames, the next one when it has answered the one before."""

    def __init__(self, server: _TcpServer, gate: Server) -> None:
        construct: Callable[..., None] = super().__init__
        construct(server, None, None, None)
        self._gate = gate
        self._wire: asyncio.Transport | None = None
        self._waiting = bytearray()
        self._asked = 0
        self._last_request_at = self.loop.time()
        self._peer_reads = True

    def silent_s(self, now: float) -> float:
        """Since its last whole request, or since it connected."""
        return now - self._last_request_at

    def unanswered_s(self, now: float) -> float:
        """How long a request has been waiting for its answer."""
        return now - self._last_request_at if self._asked else 0.0

    def hang_up(self) -> None:
        """Close, whatever waits to be sent."""
        if self._wire is not None:
            self._wire.abort()

    # called by the event loop

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self._wire = cast(asyncio.Transport, transport)
        name = transport.get_extra_info("peername")
        if not name or not self._gate.admit(self, str(name[0])):
            self._wire.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        self._gate.forget(self)
        self._wire = None
        self._waiting.clear()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        self._waiting += data
        self._go_on()
        if self._wire is not None and len(self._waiting) > _MOST_WAITING:
            self._wire.pause_reading()

    def pause_writing(self) -> None:
        self._peer_reads = False

    def resume_writing(self) -> None:
        self._peer_reads = True
        self._go_on()

    # one request after the other

    def _go_on(self) -> None:
        if self._asked or not self._peer_reads or self._wire is None or self._wire.is_closing():
            return
        length = _frame_length(self._waiting)
        if length < 0:
            self.hang_up()
            return
        if length == 0 or len(self._waiting) < length:
            return
        frame = bytes(self._waiting[:length])
        del self._waiting[:length]
        if len(self._waiting) <= _MOST_WAITING:
            self._wire.resume_reading()
        self._asked = frame[7]
        self._last_request_at = self.loop.time()
        refusal = _refusal(frame[7:])
        if refusal is None:
            self.recv_buffer = b""
            super().data_received(frame)
            return
        self.server_send(
            ExceptionResponse(
                frame[7] & 0x7F, refusal, device_id=frame[6], transaction=int.from_bytes(frame[:2], "big")
            ),
            None,
        )

    def server_send(self, pdu: ModbusPDU, addr: tuple[str, int] | None) -> None:
        """The library has an answer."""
        if isinstance(pdu, ExceptionResponse) and pdu.function_code == 0x80 and self._asked in _AREA_OF:
            # a request it could not read: it has forgotten what was asked for
            pdu.function_code, pdu.exception_code = self._asked | 0x80, int(ExcCodes.ILLEGAL_VALUE)
        send: Callable[[ModbusPDU, Any], None] = super().server_send
        send(pdu, addr)
        self._asked = 0
        self.loop.call_soon(self._go_on)


def _frame_length(data: bytearray) -> int:
    """Of the frame that begins here, header included; 0 while that cannot be said, -1 when it is none."""
    if len(data) >= 4 and data[2:4] != b"\x00\x00":
        return -1
    if len(data) < 6:
        return 0
    length = int.from_bytes(data[4:6], "big")
    return 6 + length if 2 <= length <= 254 else -1


def _refusal(request: bytes) -> ExcCodes | None:
    """What is wrong with a request that the library would not see: it overlooks lengths, and takes any value
    for a coil that is on."""
    function = request[0]
    if function not in _AREA_OF:
        return ExcCodes.ILLEGAL_FUNCTION
    expected = _FIXED_LENGTH.get(function)
    if expected is None:
        at = _BYTE_COUNT_AT[function]
        expected = at + 1 + request[at] if len(request) > at else -1
    if len(request) != expected:
        return ExcCodes.ILLEGAL_VALUE
    if function == 5 and request[3:5] not in (b"\x00\x00", b"\xff\x00"):
        return ExcCodes.ILLEGAL_VALUE
    if function == 23:
        # it would write first and find out about the read afterwards
        address, count = struct.unpack(">HH", request[1:5])
        if not 1 <= count <= 125:
            return ExcCodes.ILLEGAL_VALUE
        if window_of(Area.HOLDING_REGISTER, address, count) is None:
            return ExcCodes.ILLEGAL_ADDRESS
    return None


def _listening_socket(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family, backlog=16)
    except OSError as error:
        reasons = {
            errno.EACCES: "not permitted; a port below 1024 needs CAP_NET_BIND_SERVICE, which "
            "systemd/mikado.service gives",
            errno.EADDRINUSE: "another program listens there already",
            errno.EADDRNOTAVAIL: "this computer has no such address; correct plc.bind",
        }
        raise ListeningFailed(reasons.get(error.errno or 0, str(error.strerror))) from error


def _quieten_vendor_log() -> None:
    """What it would report is in our counters; without a handler it would write on stderr."""
    logger = logging.getLogger("pymodbus")
    if logger.level == logging.NOTSET:
        logger.setLevel(logging.CRITICAL)
