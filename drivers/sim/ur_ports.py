"""The listening ports of a simulated controller, and what can go wrong on the wire.

One thread, sockets that never block. `Ports` accepts, reads and writes; what the bytes mean is each `Port`'s
business. Faults act here: cut, refuse, freeze, delay, jitter, pieces, half a frame.
"""

from __future__ import annotations

import random
import selectors
import socket
import struct
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal, Protocol

How = Literal["rst", "fin"]
READ_BYTES = 65536
LONGEST_QUEUE = 1 << 20
LONGEST_BLOCKED_S = 10.0
"""A client that does not read for this long is dropped, as a controller does."""


class Talk(Protocol):
    """What a connection says and understands.

    ``greeting`` is sent first; ``received`` returns answers, None ends the connection.
    """

    greeting: bytes

    def received(self, data: bytes) -> Iterable[bytes] | None: ...

    def closed(self) -> None: ...


class Connection:
    """One client's socket with what is still to be sent."""

    def __init__(self, sock: socket.socket, port: Port, number: int) -> None:
        self.socket, self.port, self.number = sock, port, number
        self.ends_when_sent = False
        self.mute = False
        self.halved: str | None = None  # "stall" or "close": the next package is cut in its middle
        self.blocked_since: float | None = None
        self._queue: deque[tuple[float, bytes, bool]] = deque()  # when, what, whether not begun yet
        self.queued_bytes = 0
        self.talk: Talk = port.talk(self)

    def fileno(self) -> int:
        """For select."""
        return self.socket.fileno()

    @property
    def empty(self) -> bool:
        """Nothing waits to be sent."""
        return not self._queue

    def put(self, data: bytes, due_at: float) -> None:
        """Queue; never earlier than what waits before it."""
        if self._queue:
            due_at = max(due_at, self._queue[-1][0])
        self._queue.append((due_at, data, True))
        self.queued_bytes += len(data)

    def flush(self, now: float, piece: int | None) -> None:
        """Send what is due, as much as the other side takes; `OSError` when it is gone.

        With ``piece`` each package goes in two: so many bytes, and the rest the next time.
        """
        while self._queue and self._queue[0][0] <= now:
            due_at, data, fresh = self._queue.popleft()
            try:
                sent = self.socket.send(data[:piece] if fresh else data)
            except BlockingIOError:
                sent = 0
            self.queued_bytes -= sent
            if sent < len(data):
                self._queue.appendleft((due_at, data[sent:], fresh and sent == 0))
                if sent > 0:
                    self.blocked_since = None
                elif self.blocked_since is None:
                    self.blocked_since = now
                return
            self.blocked_since = None


@dataclass(slots=True, eq=False)
class Port:
    """One listening port.

    ``talk`` makes what a new connection speaks; ``patient``: clients that never read are kept.
    """

    name: str
    number: int
    talk: Callable[[Connection], Talk]
    listener: socket.socket | None = None
    frozen: bool = False
    delay_s: float = 0.0
    jitter_s: float = 0.0
    piece: int | None = None
    patient: bool = False


class Ports:
    """All ports of one address."""

    def __init__(self, host: str, seed: int) -> None:
        self.host = host
        self.by_name: dict[str, Port] = {}
        self.connections: list[Connection] = []
        self.dropped = 0
        self._selector = selectors.SelectSelector()  # the other kinds wait in whole milliseconds
        self._numbers = 0
        self._random = random.Random(seed)

    # ------------------------------------------------------------------ listening

    def open(self, port: Port) -> int:
        """Listen; the port's number. `OSError` when the address is not free."""
        listener = socket.socket()
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind((self.host, port.number))
            listener.listen(16)
            listener.setblocking(False)
        except OSError:
            listener.close()
            raise
        port.number = int(listener.getsockname()[1])
        port.listener = listener
        self.by_name[port.name] = port
        self._selector.register(listener, selectors.EVENT_READ, port)
        return port.number

    def watch(self, sock: socket.socket, act: Callable[[], None]) -> None:
        """Call ``act`` when somebody else's socket can be read."""
        self._selector.register(sock, selectors.EVENT_READ, act)

    def unwatch(self, sock: socket.socket) -> None:
        """Undo `watch`."""
        self._selector.unregister(sock)

    def refuse(self, port: Port) -> None:
        """New clients are refused from now on."""
        if port.listener is not None:
            if not port.frozen:
                self._selector.unregister(port.listener)
            port.listener.close()
            port.listener = None

    def accept(self, port: Port) -> None:
        """New clients are welcome again; `OSError` if somebody else took the port."""
        if port.listener is None:
            self.open(port)
            if port.frozen:
                port.frozen = False
                self.freeze(port, True)

    def close(self) -> None:
        """Everything."""
        for connection in tuple(self.connections):
            self.end(connection, "fin")
        for port in self.by_name.values():
            if port.listener is not None:
                port.listener.close()
        self._selector.close()

    # ------------------------------------------------------------------ faults

    def freeze(self, port: Port, frozen: bool) -> None:
        """Nobody reads, answers or is accepted, and no connection ends: half open."""
        if port.frozen == frozen:
            return
        port.frozen = frozen
        sockets = [connection for connection in self.connections if connection.port is port]
        change = self._unlisten if frozen else self._listen
        for connection in sockets:
            change(connection)
        if port.listener is not None:
            if frozen:
                self._selector.unregister(port.listener)
            else:
                self._selector.register(port.listener, selectors.EVENT_READ, port)

    def _listen(self, connection: Connection) -> None:
        self._selector.register(connection, selectors.EVENT_READ, connection)

    def _unlisten(self, connection: Connection) -> None:
        self._selector.unregister(connection)

    def cut(self, port: Port, how: How) -> int:
        """End the port's connections; how many there were."""
        ended = [connection for connection in self.connections if connection.port is port]
        for connection in ended:
            self.end(connection, how)
        return len(ended)

    def end(self, connection: Connection, how: How) -> None:
        """End one connection; "rst" throws away what neither side has read."""
        if connection not in self.connections:
            return
        self.connections.remove(connection)
        if not connection.port.frozen:
            self._unlisten(connection)
        if how == "rst":
            connection.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        connection.socket.close()
        connection.talk.closed()

    # ------------------------------------------------------------------ traffic

    def serve(self, timeout_s: float, now: Callable[[], float]) -> None:
        """Wait for traffic, at most so long, and deal with it."""
        for key, _ in self._selector.select(max(0.0, timeout_s)):
            if isinstance(key.data, Port):
                self._welcome(key.data, now())
            elif isinstance(key.data, Connection):
                self._read(key.data, now())
            else:
                key.data()

    def _welcome(self, port: Port, now: float) -> None:
        if port.listener is None:
            return
        try:
            sock, _ = port.listener.accept()
        except OSError:
            return  # it went away again
        sock.setblocking(False)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._numbers += 1
        connection = Connection(sock, port, self._numbers)
        self.connections.append(connection)
        self._listen(connection)
        if connection.talk.greeting:
            self.send(connection, connection.talk.greeting, now)

    def _read(self, connection: Connection, now: float) -> None:
        if connection not in self.connections:
            return  # cut by what was read before it
        try:
            data = connection.socket.recv(READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        answers = connection.talk.received(data) if data else None
        if answers is None:
            self.end(connection, "fin")
            return
        for answer in answers:
            self.send(connection, answer, now)

    def send(self, connection: Connection, data: bytes, now: float) -> None:
        """Send or queue; nothing on a frozen or muted connection."""
        port = connection.port
        if port.frozen or connection.mute or connection not in self.connections:
            return
        if connection.halved is not None:
            data = data[: max(1, len(data) // 2)]
            connection.mute = True
            connection.ends_when_sent = connection.halved == "close"
            connection.halved = None
        jitter_s = port.jitter_s * self._random.random() if port.jitter_s > 0.0 else 0.0
        connection.put(data, now + port.delay_s + jitter_s)
        self._flush(connection, now)

    def flush(self, now: float) -> None:
        """Send what became due or was held up."""
        for connection in tuple(self.connections):
            if not (connection.port.frozen or (connection.empty and not connection.ends_when_sent)):
                self._flush(connection, now)

    def _flush(self, connection: Connection, now: float) -> None:
        try:
            connection.flush(now, connection.port.piece)
        except OSError:
            self.end(connection, "fin")
            return
        since = connection.blocked_since
        blocked = since is not None and now - since > LONGEST_BLOCKED_S and not connection.port.patient
        if blocked or connection.queued_bytes > LONGEST_QUEUE:
            self.dropped += 1
            self.end(connection, "rst")
        elif connection.empty and connection.ends_when_sent:
            self.end(connection, "fin")
