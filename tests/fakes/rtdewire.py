"""A small RTDE client on a bare socket, to see the bytes of a controller as they come."""

from __future__ import annotations

import socket
import struct
import time

RECIPE = "timestamp,actual_q,runtime_state,actual_digital_output_bits"
PACKAGE = struct.Struct(">HBBd6dIQ")


class RtdeWire:
    """One connection to port 30004 that has started a stream."""

    def __init__(self, host: str, hertz: float = 500.0) -> None:
        self.socket = socket.create_connection((host, 30004), timeout=3.0)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._buffer = b""
        accepted = [
            self.ask("V", b"\x00\x02"),
            self.ask("O", struct.pack(">d", hertz) + RECIPE.encode())[:1],
            self.ask("S"),
        ]
        if accepted != [b"\x01"] * 3:
            self.socket.close()
            raise ConnectionError(f"the controller refused version, outputs or start: {accepted}")

    def send(self, kind: str, payload: bytes = b"") -> None:
        """One package."""
        self.socket.sendall(struct.pack(">HB", 3 + len(payload), ord(kind)) + payload)

    def ask(self, kind: str, payload: bytes = b"") -> bytes:
        """One package, and the payload of the answer; data packages in between are skipped."""
        self.send(kind, payload)
        while True:
            told, answer = self.next()
            if told == kind:
                return answer

    def next(self, timeout_s: float = 3.0) -> tuple[str, bytes]:
        """The next package; `TimeoutError` when none comes, `EOFError` when the connection ended."""
        ends_at = time.monotonic() + timeout_s
        while True:
            if len(self._buffer) >= 3:
                size, kind = struct.unpack_from(">HB", self._buffer)
                if len(self._buffer) >= size:
                    payload, self._buffer = self._buffer[3:size], self._buffer[size:]
                    return chr(kind), payload
            self.socket.settimeout(max(0.001, ends_at - time.monotonic()))
            data = self.socket.recv(65536)
            if not data:
                raise EOFError("the controller closed the connection")
            self._buffer += data

    def timestamp(self, timeout_s: float = 3.0) -> float:
        """The controller's clock in the next data package."""
        while True:
            kind, payload = self.next(timeout_s)
            if kind == "U":
                (seconds,) = struct.unpack_from(">d", payload, 1)
                return float(seconds)

    def read_on(self, timeout_s: float = 3.0) -> None:
        """Packages until there are no more: ends by the error `next` raises."""
        while True:
            self.next(timeout_s)

    def drain(self) -> int:
        """Throw away what has come; how many bytes that were. A package cut in its middle stays."""
        self.socket.settimeout(0.001)
        count = len(self._buffer)
        try:
            while data := self.socket.recv(65536):
                count += len(data)
                self._buffer += data
        except TimeoutError:
            while len(self._buffer) >= 3 and len(self._buffer) >= struct.unpack_from(">H", self._buffer)[0]:
                self._buffer = self._buffer[struct.unpack_from(">H", self._buffer)[0] :]
        return count

    @property
    def half(self) -> int:
        """Bytes of a package that has not come whole."""
        return len(self._buffer)

    def close(self) -> None:
        """The socket."""
        self.socket.close()
