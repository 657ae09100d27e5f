"""One RTDE connection, protocol version 2, without its socket: bytes in, bytes out.

Frames as UR's RTDE guide defines them: size (2 bytes, header included), type (1 byte), payload; everything
big-endian. `Owners` says which connection owns which input variable, across connections.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import IntEnum

from drivers.sim.ur_core import Core
from drivers.sim.ur_program import STEP_S
from drivers.sim.ur_variables import FORMATS, INPUTS, WIDTHS, Masked, Read, Write, input_type, output_of

HEADER = struct.Struct(">HB")
VERSION = 2
SLOWEST_HZ = 0.01
FASTEST_HZ = round(1.0 / STEP_S)
MOST_RECIPES = 255


class Kind(IntEnum):
    """Types of packages: the letters of the guide."""

    REQUEST_VERSION = ord("V")
    GET_VERSION = ord("v")
    TEXT = ord("M")
    DATA = ord("U")
    SETUP_OUTPUTS = ord("O")
    SETUP_INPUTS = ord("I")
    START = ord("S")
    PAUSE = ord("P")


class Level(IntEnum):
    """Levels of text messages."""

    EXCEPTION = 0
    ERROR = 1
    WARNING = 2
    INFO = 3


def frame(kind: Kind, payload: bytes) -> bytes:
    """One package."""
    return HEADER.pack(HEADER.size + len(payload), kind) + payload


def text_message(text: str, source: str, level: Level) -> bytes:
    """A text message package; texts are cut at 255 bytes."""
    words, whence = text.encode()[:255], source.encode()[:255]
    return frame(Kind.TEXT, bytes([len(words)]) + words + bytes([len(whence)]) + whence + bytes([level]))


class NotRtde(Exception):
    """The client does not speak the protocol; its connection is to be closed."""


class Owners:
    """Which connection owns which input variable.

    ``taken``: variables a fieldbus holds, ``hidden``: outputs this controller claims not to know.
    """

    def __init__(self) -> None:
        self._owner: dict[str, int] = {}
        self.taken: frozenset[str] = frozenset()
        self.hidden: frozenset[str] = frozenset()

    def free_for(self, name: str, connection: int) -> bool:
        """Whether this connection may have the variable."""
        return name not in self.taken and self._owner.get(name, connection) == connection

    def take(self, names: Iterable[str], connection: int) -> None:
        """They are this connection's until it ends."""
        for name in names:
            self._owner[name] = connection

    def let_go(self, connection: int) -> None:
        """The connection is gone."""
        self._owner = {name: owner for name, owner in self._owner.items() if owner != connection}

    def owned(self) -> int:
        """How many variables somebody owns."""
        return len(self._owner)


@dataclass(frozen=True, slots=True)
class _Outputs:
    packing: struct.Struct
    reads: tuple[tuple[Read, bool], ...]  # the second says whether it is a vector
    every: int  # cycles

    def package(self, core: Core) -> bytes:
        values: list[float] = []
        for read, is_vector in self.reads:
            if is_vector:
                values.extend(read(core))  # type: ignore[arg-type]  # vectors only, by the table
            else:
                values.append(read(core))  # type: ignore[arg-type]  # a number, by the table
        return self.packing.pack(self.packing.size, Kind.DATA, 1, *values)


@dataclass(frozen=True, slots=True)
class _Inputs:
    packing: struct.Struct
    writes: tuple[tuple[str, Write | None, int], ...]  # name, how (None: in pairs), width


class Session:
    """What one client has set up, and what it gets."""

    def __init__(self, core: Core, owners: Owners, number: int) -> None:
        self._core, self._owners, self._number = core, owners, number
        self._buffer = b""
        self._outputs: _Outputs | None = None
        self._inputs: list[_Inputs] = []
        self._masked = Masked()
        self.started = False
        self.sent = 0
        self.received = 0

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Packages that answer what came, in order.

        Raises
        ------
        NotRtde
            A frame that cannot be one.
        """
        self._buffer += data
        while len(self._buffer) >= HEADER.size:
            size, kind = HEADER.unpack_from(self._buffer)
            if size < HEADER.size:
                raise NotRtde(f"a frame of {size} bytes")
            if len(self._buffer) < size:
                return
            payload, self._buffer = self._buffer[HEADER.size : size], self._buffer[size:]
            answer = self._answer(kind, payload)
            if answer is not None:
                yield answer

    def due(self) -> bool:
        """Whether a data package is due in this cycle."""
        outputs = self._outputs
        return self.started and outputs is not None and self._core.steps % outputs.every == 0

    @property
    def every(self) -> int:
        """Cycles from one data package to the next; 0 without a recipe."""
        return 0 if self._outputs is None else self._outputs.every

    def package(self) -> bytes:
        """The data package of now."""
        self.sent += 1
        return b"" if self._outputs is None else self._outputs.package(self._core)

    def end(self) -> None:
        """The connection is gone: what it owned is free, what it wrote stays."""
        self._owners.let_go(self._number)

    # ------------------------------------------------------------------ packages

    def _answer(self, kind: int, payload: bytes) -> bytes | None:
        match kind:
            case Kind.DATA:
                return self._data(payload)
            case Kind.REQUEST_VERSION if len(payload) == 2:
                return frame(Kind.REQUEST_VERSION, bytes([payload == struct.pack(">H", VERSION)]))
            case Kind.GET_VERSION:
                return frame(Kind.GET_VERSION, struct.pack(">4I", *self._core.version, 0))
            case Kind.SETUP_OUTPUTS if len(payload) >= 8:
                (hertz,) = struct.unpack_from(">d", payload)
                return self._setup_outputs(hertz, payload[8:].decode("ascii", "replace"))
            case Kind.SETUP_INPUTS:
                return self._setup_inputs(payload.decode("ascii", "replace"))
            case Kind.START:
                self.started = self._outputs is not None or bool(self._inputs)
                return frame(Kind.START, bytes([self.started]))
            case Kind.PAUSE:
                self.started = False
                return frame(Kind.PAUSE, b"\x01")
            case Kind.TEXT:
                self._core.note(f"text message of RTDE client {self._number}: {payload!r}")
                return None
        return text_message(f"package {kind} of {len(payload)} bytes is not known", "RTDE", Level.ERROR)

    @staticmethod
    def _names(text: str) -> list[str]:
        names = text.split(",")
        return names[:-1] if names and names[-1] == "" else names

    def _setup_outputs(self, hertz: float, text: str) -> bytes:
        names = self._names(text)
        self.started, self._outputs = False, None
        found = [None if n in self._owners.hidden else output_of(n, self._core.version) for n in names]
        types = ",".join("NOT_FOUND" if each is None else each.type for each in found)
        known = [each for each in found if each is not None]
        if len(known) < len(found) or not SLOWEST_HZ <= hertz <= FASTEST_HZ:
            return frame(Kind.SETUP_OUTPUTS, b"\x00" + types.encode())
        formats = "".join(FORMATS[each.type] for each in known)
        self._outputs = _Outputs(
            packing=struct.Struct(">HBB" + formats),
            reads=tuple((each.read, WIDTHS[each.type] > 1) for each in known),
            every=max(1, round(FASTEST_HZ / hertz)),
        )
        return frame(Kind.SETUP_OUTPUTS, b"\x01" + types.encode())

    def _setup_inputs(self, text: str) -> bytes:
        names = self._names(text)
        types = []
        for name in names:
            kind = input_type(name)
            if kind is None:
                types.append("NOT_FOUND")
            else:
                types.append(kind if self._owners.free_for(name, self._number) else "IN_USE")
        told = ",".join(types).encode()
        refused = "NOT_FOUND" in types or "IN_USE" in types or len(self._inputs) >= MOST_RECIPES
        if refused or not names:
            self._core.counts["inputs_refused"] += 1
            return frame(Kind.SETUP_INPUTS, b"\x00" + told)
        self._owners.take(names, self._number)
        writes = tuple(
            (name, INPUTS[name].write if name in INPUTS else None, WIDTHS[kind])
            for name, kind in zip(names, types, strict=True)
        )
        self._inputs.append(_Inputs(struct.Struct(">" + "".join(FORMATS[t] for t in types)), writes))
        return frame(Kind.SETUP_INPUTS, bytes([len(self._inputs)]) + told)

    def _data(self, payload: bytes) -> bytes | None:
        """Values in; bytes beyond the recipe are ignored, a package too short is, with a warning."""
        number = payload[0] if payload else 0
        if not 1 <= number <= len(self._inputs):
            return text_message(f"there is no input recipe {number}", "RTDE", Level.WARNING)
        recipe = self._inputs[number - 1]
        if len(payload) - 1 < recipe.packing.size:
            self._core.counts["short_packages"] += 1
            text = f"input recipe {number} takes {recipe.packing.size} bytes, not {len(payload) - 1}"
            return text_message(text, "RTDE", Level.WARNING)
        values = recipe.packing.unpack_from(payload, 1)
        self.received += 1
        at, masked = 0, False
        for name, write, width in recipe.writes:
            if write is None:
                self._masked.hold(name, values[at])
                masked = True
            else:
                write(self._core, values[at : at + width])
            at += width
        if masked:
            self._masked.settle(self._core)
        return None
