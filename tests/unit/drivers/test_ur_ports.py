"""Sockets of the simulated UR controller: slow readers, delays, pieces, half frames; time is the test's."""

from __future__ import annotations

import socket
from collections.abc import Iterable, Iterator

import pytest

from drivers.sim.ur_ports import LONGEST_BLOCKED_S, Connection, Port, Ports


class Echo:
    """Says back what it hears."""

    greeting = b"hello"

    def __init__(self, connection: Connection) -> None:
        self.ended = False

    def received(self, data: bytes) -> Iterable[bytes] | None:
        return None if data == b"bye" else (data,)

    def closed(self) -> None:
        self.ended = True


@pytest.fixture
def ports() -> Iterator[Ports]:
    made = Ports("127.0.0.1", seed=1)
    yield made
    made.close()


@pytest.fixture
def port(ports: Ports) -> Port:
    made = Port("echo", 0, Echo)
    ports.open(made)
    return made


@pytest.fixture
def client(ports: Ports, port: Port) -> Iterator[socket.socket]:
    """A connected client that has heard the greeting."""
    with socket.socket() as made:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        made.settimeout(3.0)
        made.connect(("127.0.0.1", port.number))
        ports.serve(3.0, lambda: 0.0)
        assert made.recv(100) == b"hello"
        yield made


def said(client: socket.socket) -> bytes:
    """What has come; nothing is waited for."""
    client.setblocking(False)
    try:
        return client.recv(1 << 20)
    except BlockingIOError:
        return b""


def test_what_comes_is_answered(ports: Ports, client: socket.socket) -> None:
    client.sendall(b"one")
    ports.serve(3.0, lambda: 0.0)
    assert client.recv(100) == b"one"


def test_a_client_that_leaves_is_forgotten(ports: Ports, client: socket.socket) -> None:
    (connection,) = ports.connections
    client.close()
    ports.serve(3.0, lambda: 0.0)
    assert ports.connections == []
    assert isinstance(connection.talk, Echo)
    assert connection.talk.ended


def test_a_talk_may_end_its_connection(ports: Ports, client: socket.socket) -> None:
    client.sendall(b"bye")
    ports.serve(3.0, lambda: 0.0)
    assert client.recv(100) == b""


def test_a_delayed_answer_comes_when_it_is_due(ports: Ports, port: Port, client: socket.socket) -> None:
    port.delay_s = 2.0
    ports.send(ports.connections[0], b"late", now=10.0)
    ports.flush(11.9)
    assert said(client) == b""
    ports.flush(12.0)
    assert said(client) == b"late"


def test_jitter_keeps_the_order(ports: Ports, port: Port, client: socket.socket) -> None:
    port.jitter_s = 1.0
    for letter in b"abcdefgh":
        ports.send(ports.connections[0], bytes([letter]), now=0.0)
    heard = b""
    for tenth in range(11):
        ports.flush(0.1 * tenth)
        heard += said(client)
    assert heard == b"abcdefgh"


def test_in_pieces_a_package_comes_in_two(ports: Ports, port: Port, client: socket.socket) -> None:
    port.piece = 2
    ports.send(ports.connections[0], b"abcdef", now=0.0)
    assert said(client) == b"ab"
    ports.flush(0.0)
    assert said(client) == b"cdef"


def test_half_a_package_and_then_nothing(ports: Ports, client: socket.socket) -> None:
    ports.connections[0].halved = "stall"
    for _ in range(3):
        ports.send(ports.connections[0], b"abcdef", now=0.0)
    assert said(client) == b"abc"
    assert len(ports.connections) == 1


def test_half_a_package_and_then_the_end(ports: Ports, client: socket.socket) -> None:
    ports.connections[0].halved = "close"
    ports.send(ports.connections[0], b"abcdef", now=0.0)
    assert client.recv(100) == b"abc"
    assert client.recv(100) == b""
    assert ports.connections == []


def block(ports: Ports) -> None:
    """Send until the system takes no more."""
    connection = ports.connections[0]
    connection.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
    for _ in range(1000):
        ports.send(connection, bytes(1000), now=0.0)
        if connection.blocked_since is not None:
            return
    pytest.fail("nothing blocked")


def test_a_client_that_does_not_read_is_dropped_after_its_time(ports: Ports, client: socket.socket) -> None:
    block(ports)
    ports.flush(LONGEST_BLOCKED_S - 0.1)
    assert len(ports.connections) == 1
    ports.flush(LONGEST_BLOCKED_S + 0.1)
    assert ports.connections == []
    assert ports.dropped == 1


def test_a_patient_port_keeps_it(ports: Ports, port: Port, client: socket.socket) -> None:
    port.patient = True
    block(ports)
    ports.flush(10.0 * LONGEST_BLOCKED_S)
    assert len(ports.connections) == 1


def test_a_client_that_reads_again_is_no_longer_blocked(ports: Ports, client: socket.socket) -> None:
    block(ports)
    for _ in range(200):
        if ports.connections[0].empty:
            break
        said(client)
        ports.flush(LONGEST_BLOCKED_S - 0.1)
    assert ports.connections[0].empty
    assert ports.connections[0].blocked_since is None
    ports.flush(3.0 * LONGEST_BLOCKED_S)
    assert len(ports.connections) == 1


def test_nothing_leaves_a_frozen_port_and_what_waited_leaves_after(
    ports: Ports, port: Port, client: socket.socket
) -> None:
    port.delay_s = 1.0
    ports.send(ports.connections[0], b"waits", now=0.0)
    ports.freeze(port, True)
    ports.send(ports.connections[0], b"lost", now=0.0)
    client.sendall(b"unheard")
    ports.serve(0.0, lambda: 5.0)
    ports.flush(5.0)
    assert said(client) == b""
    port.delay_s = 0.0
    ports.freeze(port, False)
    ports.flush(5.0)
    assert said(client) == b"waits"
    ports.serve(3.0, lambda: 6.0)
    assert said(client) == b"unheard"


def test_a_cut_by_reset_is_an_error_for_the_client(ports: Ports, port: Port, client: socket.socket) -> None:
    assert ports.cut(port, "rst") == 1
    with pytest.raises(ConnectionResetError):
        client.recv(100)
