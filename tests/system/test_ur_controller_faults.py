"""The fault port of the simulated UR controller: what each fault does to the bytes on the wire.

Real sockets and real time, because that is what a fault is about.
"""

from __future__ import annotations

import itertools
import socket
import struct
import time
from collections.abc import Iterator
from contextlib import closing

import pytest

from tests.fakes.rtdewire import PACKAGE, RtdeWire
from tests.fakes.urcontroller import PORTS, UrController, ur_controller


@pytest.fixture(scope="module")
def one() -> Iterator[UrController]:
    with ur_controller() as running:
        yield running


@pytest.fixture
def ur(one: UrController) -> Iterator[UrController]:
    """The module's controller, mended after each test."""
    yield one
    one.do("thaw", what="all")
    one.do("thaw", what="clock")
    one.do("accept", ports=list(PORTS))
    for what in ("rtde", "dashboard"):
        one.do("delay", what=what, s=0.0)
    one.do("jitter", s=0.0)
    one.do("pieces", bytes=0)
    one.do("registers", taken="none")


@pytest.fixture
def wire(ur: UrController) -> Iterator[RtdeWire]:
    with closing(RtdeWire(ur.host)) as client:
        yield client


def dashboard(host: str, timeout_s: float = 3.0) -> socket.socket:
    connection = socket.create_connection((host, 29999), timeout=timeout_s)
    assert connection.recv(100) == b"Connected: Universal Robots Dashboard Server\n"
    return connection


def test_every_port_answers_as_a_controller(ur: UrController, wire: RtdeWire) -> None:
    first, second = wire.timestamp(), wire.timestamp()
    assert second - first == pytest.approx(0.002, abs=1e-9)
    with closing(dashboard(ur.host)) as client:
        client.sendall(b"robot")
        client.sendall(b"mode\nsafetystatus\n")
        said = b""
        while said.count(b"\n") < 2:
            said += client.recv(100)
        assert said == b"Robotmode: RUNNING\nSafetystatus: NORMAL\n"
        client.sendall(b"quit\n")
        assert client.recv(100) == b"Disconnected\n"
        assert client.recv(100) == b""
    for port, kind in ((30001, 20), (30002, 20)):
        with closing(socket.create_connection((ur.host, port), timeout=3.0)) as client:
            head = client.recv(5, socket.MSG_WAITALL)
            size, told = struct.unpack(">IB", head)
            assert told == kind
            client.recv(size - 5, socket.MSG_WAITALL)
            size, told = struct.unpack(">IB", client.recv(5, socket.MSG_WAITALL))
            assert told == 16  # a robot state follows
    with closing(socket.create_connection((ur.host, 30003), timeout=3.0)) as client:
        package = client.recv(1220, socket.MSG_WAITALL)
        assert struct.unpack_from(">I", package) == (1220,)
        assert struct.unpack_from(">6d", package, 4 + 8) == pytest.approx(ur.status()["q"])


@pytest.mark.parametrize(("how", "error"), [("rst", ConnectionResetError), ("fin", EOFError)])
def test_a_cut_ends_the_connections_of_a_port(
    ur: UrController, wire: RtdeWire, how: str, error: type[Exception]
) -> None:
    ur.do("cut", ports=[30004], how=how)
    with pytest.raises(error):
        wire.read_on()
    assert ur.status()["connections"]["rtde"] == 0
    with closing(RtdeWire(ur.host)) as again:
        assert again.timestamp() > 0.0


def test_what_is_refused_is_refused_until_it_is_accepted(ur: UrController, wire: RtdeWire) -> None:
    ur.do("refuse", ports=["rtde", 29999])
    for port in (30004, 29999):
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection((ur.host, port), timeout=1.0)
    assert wire.timestamp() > 0.0  # a connection that is there stays
    ur.do("accept", ports=["rtde", 29999])
    dashboard(ur.host).close()


def test_a_frozen_port_is_half_open(ur: UrController, wire: RtdeWire) -> None:
    before_s = wire.timestamp()
    ur.do("freeze", what="rtde")
    wire.drain()
    with pytest.raises(TimeoutError):
        wire.next(0.3)
    with closing(socket.create_connection((ur.host, 30004), timeout=1.0)) as new:  # the system accepts
        new.settimeout(0.3)
        new.sendall(b"\x00\x05V\x00\x02")
        with pytest.raises(TimeoutError):
            new.recv(10)
        dashboard(ur.host).close()  # the other ports go on
        ur.do("thaw", what="rtde")
        new.settimeout(3.0)
        assert new.recv(10) == b"\x00\x04V\x01"
    assert wire.timestamp() - before_s > 0.5  # the controller's clock went on meanwhile


def test_all_ports_can_be_frozen_but_the_fault_port(ur: UrController, wire: RtdeWire) -> None:
    with closing(dashboard(ur.host)) as client:
        ur.do("freeze", what="all")
        wire.drain()
        client.settimeout(0.3)
        client.sendall(b"robotmode\n")
        with pytest.raises(TimeoutError):
            client.recv(10)
        with pytest.raises(TimeoutError):
            wire.next(0.2)


def test_a_standing_clock_goes_on_talking(ur: UrController, wire: RtdeWire) -> None:
    ur.do("freeze", what="clock")
    wire.drain()
    assert {wire.timestamp() for _ in range(50)} == {wire.timestamp()}
    ur.do("thaw", what="clock")
    before = wire.timestamp()
    wire.drain()
    assert wire.timestamp() > before


def test_half_a_frame_and_silence(ur: UrController, wire: RtdeWire) -> None:
    ur.do("half_frame")
    with pytest.raises(TimeoutError):
        wire.read_on(0.3)
    assert wire.half == PACKAGE.size // 2


def test_half_a_frame_and_an_end(ur: UrController, wire: RtdeWire) -> None:
    ur.do("half_frame", then="close")
    with pytest.raises(EOFError):
        wire.read_on()
    assert wire.half == PACKAGE.size // 2


def test_frames_in_pieces_are_whole_in_the_end(ur: UrController, wire: RtdeWire) -> None:
    ur.do("pieces", bytes=2)
    wire.drain()
    stamps = [wire.timestamp() for _ in range(100)]
    gaps = [round(1e3 * (after - before)) for before, after in itertools.pairwise(stamps)]
    assert set(gaps) == {2}


def test_answers_of_the_dashboard_can_be_late(ur: UrController) -> None:
    with closing(dashboard(ur.host)) as client:
        ur.do("delay", what="dashboard", s=0.4)
        asked_at = time.monotonic()
        client.sendall(b"robotmode\n")
        assert client.recv(100) == b"Robotmode: RUNNING\n"
        assert 0.4 <= time.monotonic() - asked_at < 1.5


def test_data_packages_can_be_late_and_uneven_but_keep_their_order(ur: UrController, wire: RtdeWire) -> None:
    ur.do("jitter", s=0.05)
    wire.drain()
    arrivals, stamps = [], []
    for _ in range(200):
        stamps.append(wire.timestamp())
        arrivals.append(time.monotonic())
    assert all(after > before for before, after in itertools.pairwise(stamps))
    gaps = [after - before for before, after in itertools.pairwise(arrivals)]
    assert max(gaps) > 0.01
    ur.do("jitter", s=0.0)
    ur.do("delay", what="rtde", s=0.3)
    time.sleep(0.4)
    wire.drain()
    assert ur.status()["time_s"] - wire.timestamp() > 0.25


def test_a_text_message_reaches_every_rtde_client(ur: UrController, wire: RtdeWire) -> None:
    ur.do("message", text="something is odd", level=1)
    while True:
        kind, payload = wire.next()
        if kind == "M":
            break
    assert payload == b"\x10something is odd\x0afault port\x01"


def test_a_client_that_never_reads_holds_nobody_up(ur: UrController, wire: RtdeWire) -> None:
    with closing(socket.socket()) as lazy:
        lazy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        lazy.connect((ur.host, 30003))
        wire.drain()
        stamps = [wire.timestamp() for _ in range(1500)]
    assert stamps[-1] - stamps[0] == pytest.approx(1499 * 0.002, abs=1e-6)


def test_inputs_of_the_cabinet_can_be_set_and_variables_hidden(ur: UrController) -> None:
    ur.do("inputs", bits=5)
    assert ur.status()["inputs"] == 5
    ur.do("inputs", bits=0)
    ur.do("hide", names=["actual_q"])
    with pytest.raises(ConnectionError, match="refused"):
        RtdeWire(ur.host)
    ur.do("hide", names=["none of them"])


def test_a_fault_can_wait_for_its_time(ur: UrController) -> None:
    before_s = ur.status()["time_s"]
    ur.do("safeguard", at={"after_s": 0.2})
    assert ur.status()["armed"] == 1
    after_s = ur.wait(safety="SAFEGUARD_STOP")["time_s"]
    assert after_s - before_s >= 0.2 - 1e-6  # both are rounded in print
    ur.do("release")
    assert ur.status()["safety"] == "NORMAL"


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (b"nonsense", "not JSON"),
        (b"[]", "not a JSON object"),
        (b"{}", "'do' is None"),
        (b'{"do": "dance"}', "'do' is 'dance'; it must be status or accept"),
        (b'{"do": "cut", "ports": [80]}', "there is no port 80; there are 29999 (dashboard)"),
        (b'{"do": "cut", "ports": []}', "a list with something in it"),
        (b'{"do": "freeze", "what": "time"}', "rtde or dashboard"),
        (b'{"do": "delay", "s": -1}', "from 0 to 600"),
        (b'{"do": "slow", "factor": true}', "from 0 to 1"),
        (b'{"do": "remote", "on": 1}', "true or false"),
        (b'{"do": "version", "polyscope": "five"}', "such as 5.15.0"),
        (b'{"do": "safeguard", "at": 3}', "an object"),
        (b'{"do": "safeguard", "at": {}}', "after_s"),
    ],
)
def test_a_request_that_is_not_understood_says_what_is(ur: UrController, line: bytes, said: str) -> None:
    with closing(socket.create_connection((ur.host, ur.fault_port), timeout=3.0)) as client:
        client.sendall(line + b"\n")
        answer = client.makefile("r").readline()
    assert '"error"' in answer
    assert said in answer
