"""RTDE, version 2, the client's side: frames, types, and one connection whose every call ends in time.

Real-Time Data Exchange is the controller's own interface on port 30004. A frame is its size (two bytes,
these three bytes included), a kind (one byte) and what belongs to the kind. Numbers are big-endian.
Source: "Real-Time Data Exchange (RTDE) Guide", Universal Robots.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import IntEnum
from typing import Final, TypeAlias

PORT: Final = 30004
PROTOCOL: Final = 2
NOT_FOUND: Final = "NOT_FOUND"
IN_USE: Final = "IN_USE"

Value: TypeAlias = int | float | bool | tuple[int | float, ...]

_HEAD: Final = struct.Struct(">HB")
_FORMATS: Final = {
    "BOOL": "?",
    "UINT8": "B",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "DOUBLE": "d",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
    "VECTOR6UINT32": "6I",
}


class Kind(IntEnum):
    """What a frame is."""

    VERSION = 86
    CONTROLLER_VERSION = 118
    TEXT = 77
    DATA = 85
    OUTPUTS = 79
    INPUTS = 73
    START = 83
    PAUSE = 80


class RtdeError(Exception):
    """The controller sent what RTDE does not know, refused, or ended the connection."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """One frame without its head."""

    kind: int
    body: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Version:
    """Of the controller's software."""

    major: int
    minor: int
    bugfix: int
    build: int

    def __str__(self) -> str:
        return f"{self.major}.{self.minor}.{self.bugfix}.{self.build}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """Variables that travel in one data frame, in this order."""

    number: int
    names: tuple[str, ...]
    types: tuple[str, ...]

    def missing(self, mark: str) -> tuple[str, ...]:
        """Names the controller answered with `NOT_FOUND` or `IN_USE`."""
        return tuple(name for name, kind in zip(self.names, self.types, strict=True) if kind == mark)

    @property
    def usable(self) -> bool:
        """Whether the controller has, and gives, every variable."""
        return all(kind in _FORMATS for kind in self.types)

    def pack(self, values: Sequence[int | float | bool]) -> bytes:
        """The body of a data frame; one plain value for each name."""
        form = ">B" + "".join(_FORMATS[kind] for kind in self.types)
        return struct.pack(form, self.number, *values)

    def unpack(self, body: bytes) -> dict[str, Value]:
        """Values by name; `RtdeError` when the length is not this recipe's, or the number another's."""
        form = struct.Struct(">B" + "".join(_FORMATS[kind] for kind in self.types))
        if len(body) != form.size or body[0] != self.number:
            raise RtdeError(
                f"data frame of {len(body)} bytes for recipe {body[0] if body else '?'}; "
                f"{form.size} bytes for recipe {self.number} were agreed"
            )
        flat = form.unpack(body)[1:]
        values: dict[str, Value] = {}
        at = 0
        for name, kind in zip(self.names, self.types, strict=True):
            many = int(_FORMATS[kind][0]) if _FORMATS[kind][0].isdigit() else 1
            values[name] = flat[at] if many == 1 else tuple(flat[at : at + many])
            at += many
        return values


def frame(kind: Kind, body: bytes = b"") -> bytes:
    """A frame as it goes over the wire."""
    return _HEAD.pack(_HEAD.size + len(body), kind) + body


class Frames:
    """Bytes to frames, wherever the network cut them."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[Frame]:
        """The frames that are whole now; `RtdeError` for a size no frame can have."""
        rest = self._rest + data
        whole: list[Frame] = []
        at = 0
        while len(rest) - at >= _HEAD.size:
            size, kind = _HEAD.unpack_from(rest, at)
            if size < _HEAD.size:
                raise RtdeError(f"frame of {size} bytes")
            if len(rest) - at < size:
                break
            whole.append(Frame(kind=kind, body=rest[at + _HEAD.size : at + size]))
            at += size
        self._rest = rest[at:]
        return whole


def text_of(body: bytes) -> str:
    """What a text frame says: source and message."""
    try:
        length = body[0]
        message = body[1 : 1 + length].decode("utf-8", "replace")
        source = body[2 + length : 2 + length + body[1 + length]].decode("utf-8", "replace")
    except IndexError:
        return body.decode("utf-8", "replace")
    return f"{source}: {message}" if source else message


class Connection:
    """One RTDE connection. ``now`` is the clock; every call has a time limit of its own."""

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._socket: socket.socket | None = None
        self._frames = Frames()
        self._waiting: list[Frame] = []
        self.texts: list[str] = []

    def open(self, host: str, timeout_s: float, port: int = PORT) -> None:
        """Connect and agree on the protocol's version.

        Raises
        ------
        OSError
            Nobody there, or not in time.
        RtdeError
            It does not speak this protocol.
        """
        self._socket = socket.create_connection((host, port), timeout=timeout_s)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        answer = self.ask(Kind.VERSION, struct.pack(">H", PROTOCOL), timeout_s)
        if answer != b"\x01":
            raise RtdeError(f"protocol version {PROTOCOL} was refused")

    def close(self) -> None:
        """End it; may come twice."""
        connection, self._socket = self._socket, None
        if connection is not None:
            with suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)  # wakes whoever reads
            connection.close()

    def _live(self) -> socket.socket:
        if self._socket is None:
            raise RtdeError("not connected")
        return self._socket

    def send(self, kind: Kind, body: bytes, timeout_s: float) -> None:
        """Send one frame."""
        connection = self._live()
        connection.settimeout(timeout_s)
        connection.sendall(frame(kind, body))

    def put(self, body: bytes) -> None:
        """Send a data frame, within the time limit of whoever reads at the same time."""
        self._live().sendall(frame(Kind.DATA, body))

    def receive(self, timeout_s: float) -> list[Frame]:
        """Frames that have come or come in time; none when none came. Text frames are put aside."""
        if self._waiting:
            waiting, self._waiting = self._waiting, []
            return waiting
        connection = self._live()
        connection.settimeout(max(timeout_s, 1e-4))
        try:
            data = connection.recv(65536)
        except TimeoutError:
            return []
        if not data:
            raise RtdeError("the controller ended the connection")
        got = self._frames.feed(data)
        self.texts += [text_of(one.body) for one in got if one.kind == Kind.TEXT]
        return [one for one in got if one.kind != Kind.TEXT]

    def ask(self, kind: Kind, body: bytes, timeout_s: float) -> bytes:
        """One request, and the body of the frame that answers it.

        Raises
        ------
        TimeoutError
            No answer in time.
        OSError, RtdeError
            The connection is lost.
        """
        until = self._now() + timeout_s
        self.send(kind, body, timeout_s)
        kept: list[Frame] = []
        while (left_s := until - self._now()) > 0.0:
            got = self.receive(left_s)
            for place, one in enumerate(got):
                if one.kind == kind:
                    self._waiting = kept + got[place + 1 :]
                    return one.body
            kept += got
        raise TimeoutError(f"no answer to {kind.name} within {timeout_s:.1f} s")

    def controller_version(self, timeout_s: float) -> Version:
        """Of the controller's software."""
        body = self.ask(Kind.CONTROLLER_VERSION, b"", timeout_s)
        if len(body) != 16:
            raise RtdeError(f"version of {len(body)} bytes")
        major, minor, bugfix, build = struct.unpack(">4I", body)
        return Version(major=major, minor=minor, bugfix=bugfix, build=build)

    def outputs(self, names: Sequence[str], rate_hz: float, timeout_s: float) -> Recipe:
        """Agree on what the controller sends; look at `Recipe.usable` before starting."""
        body = struct.pack(">d", rate_hz) + ",".join(names).encode()
        return self._recipe(Kind.OUTPUTS, names, body, timeout_s)

    def inputs(self, names: Sequence[str], timeout_s: float) -> Recipe:
        """Agree on what we send; variables another client holds come back as `IN_USE`."""
        return self._recipe(Kind.INPUTS, names, ",".join(names).encode(), timeout_s)

    def _recipe(self, kind: Kind, names: Sequence[str], body: bytes, timeout_s: float) -> Recipe:
        answer = self.ask(kind, body, timeout_s)
        types = tuple(answer[1:].decode("ascii", "replace").strip(",").split(","))
        if len(types) != len(names):
            raise RtdeError(f"{len(types)} types for {len(names)} variables")
        return Recipe(number=answer[0], names=tuple(names), types=types)

    def start(self, timeout_s: float) -> None:
        """Begin the stream of outputs."""
        if self.ask(Kind.START, b"", timeout_s) != b"\x01":
            raise RtdeError("the controller did not start its stream")
