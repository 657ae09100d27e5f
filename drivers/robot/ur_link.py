"""What the driver and its worker process say to each other, and the lease under which the arm moves.

One message a datagram over a pair of local sockets, as JSON: boundaries are the kernel's, the end of either
process is the end of the socket. The lease is one number in memory that both see: the instant (monotonic, the
same for all processes of a machine) at which the driver last looked after a motion.
"""

from __future__ import annotations

import json
import math
import mmap
import os
import struct
from dataclasses import dataclass
from enum import Enum
from typing import Final

MESSAGE_LIMIT: Final = 16 * 1024
LEASE_S: Final = 0.2
"""A motion nobody has looked after for this long is broken off by the worker."""

_AT: Final = struct.Struct("=d")


class LinkError(Exception):
    """The other side sent what this protocol does not know."""


class Do(Enum):
    """What the worker may be asked. Values: see `Request`."""

    ARM = "arm"
    MOVE_LINE = "move_line"
    MOVE_JOINTS = "move_joints"
    STOP_LINE = "stop_line"
    STOP_JOINTS = "stop_joints"
    RESTS = "rests"
    PING = "ping"
    TOOL = "tool"
    SET_TOOL = "set_tool"
    SET_PAYLOAD = "set_payload"
    WITHIN_LIMITS = "within_limits"
    END = "end"


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """One order to the worker.

    ``values``: six numbers of the target, speed, acceleration for a move; deceleration for a stop; six
    for SET_TOOL and WITHIN_LIMITS; mass and three of its centre for SET_PAYLOAD; nothing for the others.
    """

    number: int
    do: Do
    values: tuple[float, ...] = ()

    def pack(self) -> bytes:
        """As it goes over the socket."""
        return json.dumps([self.number, self.do.value, list(self.values)], allow_nan=False).encode()


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """The answer to the request of the same number; number 0 says that the worker is ready, or why not."""

    number: int
    ok: bool
    detail: str = ""
    values: tuple[float, ...] = ()

    def pack(self) -> bytes:
        """As it goes over the socket."""
        return json.dumps([self.number, self.ok, self.detail[:2000], list(self.values)]).encode()


def request_of(data: bytes) -> Request:
    """A request from the socket; `LinkError` when it is none."""
    number, do, values = _items(data, 3)
    try:
        return Request(number=_whole(number), do=Do(do), values=_numbers(values))
    except ValueError as error:
        raise LinkError(f"{do!r} is not known") from error


def reply_of(data: bytes) -> Reply:
    """A reply from the socket; `LinkError` when it is none."""
    number, ok, detail, values = _items(data, 4)
    if not isinstance(ok, bool) or not isinstance(detail, str):
        raise LinkError(f"not a reply: {data[:80]!r}")
    return Reply(number=_whole(number), ok=ok, detail=detail, values=_numbers(values))


def _items(data: bytes, count: int) -> list[object]:
    try:
        items = json.loads(data)
    except ValueError as error:
        raise LinkError(f"not JSON: {data[:80]!r}") from error
    if not isinstance(items, list) or len(items) != count:
        raise LinkError(f"not {count} items: {data[:80]!r}")
    return items


def _whole(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise LinkError(f"{value!r} is not a whole number")
    return value


def _numbers(value: object) -> tuple[float, ...]:
    if not isinstance(value, list):
        raise LinkError(f"{value!r} is not a list")
    for one in value:
        if isinstance(one, bool) or not isinstance(one, int | float) or not math.isfinite(one):
            raise LinkError(f"{one!r} is not a finite number")
    return tuple(float(one) for one in value)


class Lease:
    """The instant at which a motion was last looked after, in memory of two processes."""

    def __init__(self, file: int) -> None:
        self._memory = mmap.mmap(file, mmap.PAGESIZE)

    @staticmethod
    def make() -> int:
        """A file descriptor to make a lease of, here and in the worker."""
        file = os.memfd_create("lease", os.MFD_CLOEXEC)
        os.ftruncate(file, mmap.PAGESIZE)
        return file

    def renew(self, now: float) -> None:
        """Somebody looks after the motion now. Eight bytes at a page's start are written at once."""
        self._memory[: _AT.size] = _AT.pack(now)

    def fresh(self, now: float) -> bool:
        """Whether somebody did within `LEASE_S`."""
        (at,) = _AT.unpack(self._memory[: _AT.size])
        return abs(now - float(at)) <= LEASE_S

    def close(self) -> None:
        """Give the memory back; may come twice."""
        self._memory.close()
