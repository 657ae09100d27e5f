"""What goes over the wire to the simulated cell: length-prefixed JSON with an optional binary payload.

Eight bytes, big-endian: length of the JSON text, length of the payload; then both. Lengths are bounded, so a
stranger on the port costs a closed connection and no memory.
"""

from __future__ import annotations

import json
import socket
import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:  # the simulated UR controller speaks this without numpy
    from drivers.types import Six

Json: TypeAlias = bool | int | float | str | list["Json"] | dict[str, "Json"] | None

HEADER_LIMIT = 256 * 1024
PAYLOAD_LIMIT = 64 * 1024 * 1024
_LENGTHS = struct.Struct(">II")


class ProtocolError(Exception):
    """The other side sent what this protocol does not know."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Message:
    """One request or answer: named values, and perhaps bytes."""

    values: dict[str, Json]
    payload: bytes = b""

    def has(self, key: str) -> bool:
        """Whether a value of that name came."""
        return key in self.values

    def text(self, key: str) -> str:
        """A string; `ProtocolError` if it is missing or something else."""
        value = self.values.get(key)
        if not isinstance(value, str):
            raise ProtocolError(f"{key!r} is not a text")
        return value

    def number(self, key: str) -> float:
        """A finite number; `ProtocolError` if it is missing or something else."""
        value = self.values.get(key)
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e12:
            raise ProtocolError(f"{key!r} is not a number")
        return float(value)

    def whole(self, key: str) -> int:
        """A whole number; `ProtocolError` if it is missing or something else."""
        value = self.values.get(key)
        if isinstance(value, bool) or not isinstance(value, int):
            raise ProtocolError(f"{key!r} is not a whole number")
        return value

    def flag(self, key: str) -> bool:
        """True or false; `ProtocolError` if it is missing or something else."""
        value = self.values.get(key)
        if not isinstance(value, bool):
            raise ProtocolError(f"{key!r} is not true or false")
        return value

    def six(self, key: str) -> Six:
        """Six finite numbers; `ProtocolError` otherwise."""
        value = self.values.get(key)
        if not isinstance(value, list) or len(value) != 6:
            raise ProtocolError(f"{key!r} is not a list of six numbers")
        a, b, c, d, e, f = (Message(values={key: each}).number(key) for each in value)
        return (a, b, c, d, e, f)


def encode(message: Message) -> bytes:
    """One message as it goes over the wire."""
    text = json.dumps(message.values, allow_nan=False).encode()
    return _LENGTHS.pack(len(text), len(message.payload)) + text + message.payload


def decode(data: bytes) -> tuple[Message | None, bytes]:
    """The first message of what came so far, None while it is not whole; and the rest.

    Raises
    ------
    ProtocolError
        Lengths out of bounds, or no JSON object.
    """
    if len(data) < _LENGTHS.size:
        return None, data
    text_end, end = _ends(data)
    if len(data) < end:
        return None, data
    values = _values(data[_LENGTHS.size : text_end])
    return Message(values=values, payload=data[text_end:end]), data[end:]


def _ends(start: bytes) -> tuple[int, int]:
    """Where the text and the payload end, counted from the first byte of the lengths."""
    header_size, payload_size = _LENGTHS.unpack_from(start)
    if header_size > HEADER_LIMIT or payload_size > PAYLOAD_LIMIT:
        raise ProtocolError(f"message of {header_size} + {payload_size} bytes is too long")
    text_end = _LENGTHS.size + header_size
    return text_end, text_end + payload_size


def _values(text: bytes) -> dict[str, Json]:
    try:
        values: Json = json.loads(text)
    except ValueError as error:
        raise ProtocolError("message is not JSON") from error
    if not isinstance(values, dict):
        raise ProtocolError("message is not a JSON object")
    return values


def send(connection: socket.socket, message: Message) -> None:
    """Write one message; `OSError` as the socket raises it."""
    connection.sendall(encode(message))


def receive(connection: socket.socket, left_s: Callable[[], float] | None = None) -> Message | None:
    """Read one message; None when the other side closed between two messages.

    ``left_s`` tells how much time is left for the whole of it, however slowly it trickles in; without it the
    socket's own timeout counts for each piece.

    Raises
    ------
    ProtocolError
        Lengths out of bounds, no JSON object, or an end in the middle.
    OSError
        As the socket raises it, `TimeoutError` included.
    """
    start = _read(connection, _LENGTHS.size, left_s, may_end=True)
    if start is None:
        return None
    text_end, end = _ends(start)
    text = _read(connection, text_end - _LENGTHS.size, left_s, may_end=False) or b""
    payload = _read(connection, end - text_end, left_s, may_end=False) or b""
    return Message(values=_values(text), payload=payload)


def _read(
    connection: socket.socket, size: int, left_s: Callable[[], float] | None, *, may_end: bool
) -> bytes | None:
    parts: list[bytes] = []
    missing = size
    while missing > 0:
        if left_s is not None:
            remaining_s = left_s()
            if remaining_s <= 0.0:
                raise TimeoutError("no time left")
            connection.settimeout(remaining_s)
        part = connection.recv(min(missing, 1 << 20))
        if not part:
            if may_end and missing == size:
                return None
            raise ProtocolError("connection ended in the middle of a message")
        parts.append(part)
        missing -= len(part)
    return b"".join(parts)
