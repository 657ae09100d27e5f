"""Modbus TCP by hand: frames written from the specification, no library. For peers of both roles."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence

from drivers.plc_map import COMMAND_WORDS, STATUS_WORDS

QUIET = [1, *([0] * (COMMAND_WORDS - 1))]
"""A command block of the right version that asks for nothing."""


def frame(pdu: bytes, *, transaction: int = 1, unit: int = 1) -> bytes:
    """A whole frame around a request or an answer."""
    return (
        transaction.to_bytes(2, "big") + b"\x00\x00" + (len(pdu) + 1).to_bytes(2, "big") + bytes([unit]) + pdu
    )


def receive(peer: socket.socket) -> bytes:
    """One whole frame; b"" when the peer has hung up."""
    data = b""
    while len(data) < 6 or len(data) < 6 + int.from_bytes(data[4:6], "big"):
        more = peer.recv(6 - len(data) if len(data) < 6 else 6 + int.from_bytes(data[4:6], "big") - len(data))
        if not more:
            return b""
        data += more
    return data


def ask(peer: socket.socket, pdu: bytes, *, transaction: int = 1, unit: int = 1) -> bytes:
    """The PDU of the answer; b"" when the peer hangs up instead."""
    peer.sendall(frame(pdu, transaction=transaction, unit=unit))
    answer = receive(peer)
    if answer:
        assert answer[:2] == transaction.to_bytes(2, "big")
        assert answer[6] == unit
    return answer[7:]


def words_of(values: Sequence[int]) -> bytes:
    return b"".join(value.to_bytes(2, "big") for value in values)


def read_pdu(function: int, address: int, count: int) -> bytes:
    """FC 1 to 4."""
    return bytes([function]) + words_of([address, count])


def write_pdu(address: int, values: Sequence[int]) -> bytes:
    """FC 16."""
    return b"\x10" + words_of([address, len(values)]) + bytes([2 * len(values)]) + words_of(values)


def read_words(peer: socket.socket, function: int, address: int, count: int) -> list[int]:
    """Registers, or an assertion."""
    answer = ask(peer, read_pdu(function, address, count))
    assert answer[:2] == bytes([function, 2 * count]), answer.hex()
    return [int.from_bytes(answer[i : i + 2], "big") for i in range(2, len(answer), 2)]


def write_words(peer: socket.socket, address: int, values: Sequence[int]) -> None:
    """FC 16, or an assertion."""
    assert ask(peer, write_pdu(address, values)) == b"\x10" + words_of([address, len(values)])


class PollingPlc:
    """A PLC that is the client: writes its command block and reads the status block, again and again; its
    heartbeat counts. ``slowest_s`` is the longest it waited for both answers."""

    def __init__(self, port: int, period_s: float = 0.01, command: Sequence[int] = QUIET) -> None:
        self.command = list(command)
        self.status: list[int] = []
        self.polls = 0
        self.errors: list[str] = []
        self.slowest_s = 0.0
        self._port = port
        self._period_s = period_s
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="polling-plc")

    def start(self) -> PollingPlc:
        self._thread.start()
        return self

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                with socket.create_connection(("127.0.0.1", self._port), timeout=2.0) as peer:
                    while not self._stop.wait(self._period_s):
                        self.command[1] = (self.command[1] + 1) & 0xFFFF
                        began_at = time.monotonic()
                        write_words(peer, 0, self.command)
                        self.status = read_words(peer, 4, 0, STATUS_WORDS)
                        self.slowest_s = max(self.slowest_s, time.monotonic() - began_at)
                        self.polls += 1
            except ConnectionRefusedError:
                self._stop.wait(self._period_s)
            except (OSError, AssertionError) as error:
                self.errors.append(repr(error))
                self._stop.wait(self._period_s)

    def close(self) -> None:
        self._stop.set()
        self._thread.join(5.0)
        assert not self._thread.is_alive()


@contextlib.contextmanager
def polling(port: int, period_s: float = 0.01, command: Sequence[int] = QUIET) -> Iterator[PollingPlc]:
    """One that has stopped when the context ends."""
    plc = PollingPlc(port, period_s, command).start()
    try:
        yield plc
    finally:
        plc.close()


class BareServer:
    """Listens on loopback and hands every connection, one after the other, to ``talk``."""

    def __init__(self, talk: Callable[[socket.socket], None], port: int = 0) -> None:
        self._talk = talk
        self._listener = socket.create_server(("127.0.0.1", port))
        self.port = int(self._listener.getsockname()[1])
        self.connections = 0
        self.received = b""
        self._open: list[socket.socket] = []
        self._thread = threading.Thread(target=self._run, name="bare-server")
        self._thread.start()

    def _run(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = self._listener.accept()
                self.connections += 1
                self._open.append(connection)
                with contextlib.suppress(OSError), connection:
                    self._talk(connection)

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        for connection in self._open:
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
        self._thread.join(5.0)
        assert not self._thread.is_alive()


@contextlib.contextmanager
def bare(talk: Callable[[socket.socket], None], port: int = 0) -> Iterator[BareServer]:
    server = BareServer(talk, port)
    try:
        yield server
    finally:
        server.close()


def reply(asked: bytes, pdu: bytes) -> bytes:
    """The answer frame to this request."""
    return asked[:4] + (len(pdu) + 1).to_bytes(2, "big") + asked[6:7] + pdu


def good_answer(asked: bytes, words: list[int] | None = None) -> bytes:
    """What a PLC that does all it is asked says."""
    if asked[7] == 16:
        return reply(asked, asked[7:12])
    block = words or [1, *([0] * 23)]
    return reply(asked, bytes([3, 2 * len(block)]) + b"".join(word.to_bytes(2, "big") for word in block))


def obliging(connection: socket.socket) -> None:
    while asked := receive(connection):
        connection.sendall(good_answer(asked))


def silent(connection: socket.socket) -> None:
    while receive(connection):
        pass
