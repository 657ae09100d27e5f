"""The simulated cell's wire format: what goes in comes out, and strangers are refused cheaply."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator

import pytest

from drivers.sim.protocol import Message, ProtocolError, receive, send


@pytest.fixture
def wire() -> Iterator[tuple[socket.socket, socket.socket]]:
    here, there = socket.socketpair()
    here.settimeout(2.0)
    there.settimeout(2.0)
    yield here, there
    here.close()
    there.close()


def test_a_message_arrives_as_it_was_sent(wire: tuple[socket.socket, socket.socket]) -> None:
    send(wire[0], Message(values={"op": "grab", "n": 1, "six": [1, 2, 3, 4, 5, 6.5]}, payload=b"\x00\xff"))
    got = receive(wire[1])
    assert got is not None
    assert (got.text("op"), got.whole("n"), got.six("six")) == ("grab", 1, (1, 2, 3, 4, 5, 6.5))
    assert got.payload == b"\x00\xff"


def test_an_end_between_messages_is_an_end(wire: tuple[socket.socket, socket.socket]) -> None:
    wire[0].close()
    assert receive(wire[1]) is None


@pytest.mark.parametrize(
    "sent",
    [
        struct.pack(">II", 0xFFFFFFFF, 0),
        struct.pack(">II", 2, 0xFFFFFFFF) + b"{}",
        struct.pack(">II", 2, 0) + b"[]",
        struct.pack(">II", 2, 0) + b"{x",
        struct.pack(">II", 20, 0) + b"{}",
        b"GET /",
    ],
)
def test_what_is_not_a_message_is_refused(wire: tuple[socket.socket, socket.socket], sent: bytes) -> None:
    wire[0].sendall(sent)
    wire[0].close()
    with pytest.raises(ProtocolError):
        receive(wire[1])


@pytest.mark.parametrize("value", [None, "1", True, [1], float("inf"), float("nan")])
def test_what_is_not_a_number_is_refused(value: object) -> None:
    assert value is None or isinstance(value, str | bool | list | float)
    with pytest.raises(ProtocolError):
        Message(values={"x": value}).number("x")


def test_a_list_of_five_is_not_a_pose() -> None:
    with pytest.raises(ProtocolError):
        Message(values={"target": [1, 2, 3, 4, 5]}).six("target")
