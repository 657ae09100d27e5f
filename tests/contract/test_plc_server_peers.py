"""The role in which the cell is the Modbus server: who may connect and how many, and the address it has."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import structlog

from drivers.errors import DeviceUnavailable
from drivers.plc import modbus_server
from drivers.plc.server import ModbusServerPlc
from drivers.settings import ModbusServerPlcSettings
from drivers.types import PlcOutputs
from tests.contract.plc_serving import CLOCK, OUTPUTS, connected, serving
from tests.fakes.modbuswire import (
    frame,
    polling,
    read_pdu,
    read_words,
)
from tests.fakes.ports import free_port

ROOT = Path(__file__).parents[2]


# who may connect


def refusals(logs: list[structlog.typing.EventDict]) -> list[tuple[str, str]]:
    return [(str(e["peer"]), str(e["reason"])) for e in logs if e["event"] == "plc_peer_refused"]


def hung_up(peer: socket.socket) -> bool:
    try:
        return peer.recv(1) == b""
    except ConnectionResetError:
        return True


def test_a_peer_that_is_not_on_the_list_is_hung_up_on_counted_and_named_once() -> None:
    with (
        structlog.testing.capture_logs() as logs,
        serving(peers=("127.0.0.2", "127.0.1.0/24")) as (plc, port),
    ):
        for _ in range(5):
            with connected(port) as peer:
                assert hung_up(peer)
        for source in ("127.0.0.2", "127.0.1.77"):
            with connected(port, source) as peer:
                assert read_words(peer, 3, 200, 1) == [0x1234]
        assert plc.refused == 5
    assert refusals(logs) == [("127.0.0.1", "not in plc.peers")]


def test_there_is_a_bound_on_connections_and_one_that_went_silent_gives_way(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with (
        structlog.testing.capture_logs() as logs,
        serving(most=2) as (plc, port),
        connected(port) as first,
        connected(port) as second,
    ):
        assert read_words(first, 3, 200, 1) == read_words(second, 3, 200, 1) == [0x1234]
        with connected(port) as third:
            assert hung_up(third)
        assert plc.refused == 1
        # a PLC that was switched off has left its connection open; here it may be replaced at once
        monkeypatch.setattr(modbus_server, "GIVES_WAY_S", 0.0)
        read_words(second, 3, 200, 1)
        with connected(port) as third:
            assert read_words(third, 3, 200, 1) == [0x1234]
            assert hung_up(first)
            assert read_words(second, 3, 200, 1) == [0x1234]
    assert refusals(logs) == [("127.0.0.1", "all connections are taken")]


def test_a_peer_that_does_not_read_its_answers_is_not_read_from_either() -> None:
    """Otherwise its answers would pile up here."""
    request = frame(read_pdu(4, 0, 40)) * 100
    with serving() as (_, port), connected(port) as greedy:
        greedy.settimeout(0.5)
        sent = 0
        with contextlib.suppress(TimeoutError):
            while sent < 50_000_000:
                sent += greedy.send(request)
        assert sent < 50_000_000
        with connected(port) as other:
            assert read_words(other, 3, 200, 1) == [0x1234]


# the address


def test_an_address_in_use_is_said_and_nothing_is_left_behind() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        settings = ModbusServerPlcSettings(
            driver="modbus_server", bind="127.0.0.1", port=port, peers=("127.0.0.1",)
        )
        plc = ModbusServerPlc("plc", settings, CLOCK)
        with pytest.raises(DeviceUnavailable, match=rf"127\.0\.0\.1:{port}: another program listens there"):
            plc.open()
        with pytest.raises(DeviceUnavailable, match="not open"):
            plc.exchange(PlcOutputs())
    plc.open()
    with polling(port):
        assert plc.exchange(PlcOutputs()).map_version == 1
    plc.close()


def test_an_address_of_another_computer_is_said() -> None:
    settings = ModbusServerPlcSettings(
        driver="modbus_server", bind="192.0.2.5", port=free_port(), peers=("192.0.2.20",)
    )
    with pytest.raises(DeviceUnavailable, match=r"no such address; correct plc\.bind"):
        ModbusServerPlc("plc", settings, CLOCK).open()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bind": "cell.example"}, "'cell.example' is not an address in numbers"),
        ({"peers": ["plc"]}, "'plc' is neither an address nor a network"),
        ({"peers": []}, "at least 1 item"),
        ({"max_connections": 0}, "greater than or equal to 1"),
    ],
)
def test_settings_that_cannot_work_are_refused(change: dict[str, object], message: str) -> None:
    good = {"driver": "modbus_server", "bind": "192.0.2.5", "peers": ["192.0.2.20"]}
    assert ModbusServerPlcSettings.model_validate(good).port == 502
    with pytest.raises(ValueError, match=message):
        ModbusServerPlcSettings.model_validate({**good, **change})


def test_closing_ends_connections_and_the_thread_at_once() -> None:
    with serving() as (plc, port), connected(port) as peer:
        read_words(peer, 3, 200, 1)
        began_at = time.monotonic()
        plc.close()
        assert time.monotonic() - began_at < 1.0
        assert hung_up(peer)
        assert not any(thread.name == "plc-server" for thread in threading.enumerate())
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", port), timeout=2.0)


def test_a_server_that_has_ended_by_itself_is_started_again_by_the_next_exchange() -> None:
    with serving(timeout_s=2.0) as (plc, port):
        assert plc._server is not None
        assert plc._thread is not None
        plc._server.end()
        plc._thread.join(5.0)
        with polling(port):
            assert plc.exchange(OUTPUTS).map_version == 1


def test_the_library_writes_nothing_on_stderr() -> None:
    script = (
        "import socket, logging\n"
        "import structlog\n"
        "structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))\n"
        "from drivers.plc.server import ModbusServerPlc\n"
        "from drivers.settings import ModbusServerPlcSettings\n"
        "from drivers.timing import MonotonicClock\n"
        f"s = ModbusServerPlcSettings(driver='modbus_server', bind='127.0.0.1', port={free_port()},\n"
        "    peers=('127.0.0.1',))\n"
        "plc = ModbusServerPlc('plc', s, MonotonicClock())\n"
        "plc.open()\n"
        "for data in (b'GET / HTTP/1.0\\r\\n\\r\\n', bytes(8), b'\\0\\1\\0\\0\\0\\3\\1\\3\\0'):\n"
        "    with socket.create_connection((s.bind, s.port), timeout=2.0) as peer:\n"
        "        peer.sendall(data)\n"
        "        print(len(peer.recv(100)))\n"
        "plc.close()\n"
    )
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", script],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=30,
        check=True,
    )
    assert done.stdout.split() == ["0", "0", "9"]
    assert done.stderr == ""
