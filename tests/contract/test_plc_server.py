"""The role in which the cell is the Modbus server, met by raw sockets: what is shown where, what may be
written, who may connect and how many, and what of that the cell takes over. Bytes are written by hand.
"""

from __future__ import annotations

import contextlib
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import structlog

from drivers.errors import DeviceTimeout, DeviceUnavailable
from drivers.plc import modbus_server
from drivers.plc.server import ModbusServerPlc
from drivers.plc_codec import WordOrder, encode_status
from drivers.settings import ModbusServerPlcSettings
from drivers.timing import MonotonicClock
from drivers.types import PlcInputs, PlcOutputs, ToolPose
from tests.fakes.modbuswire import (
    QUIET,
    ask,
    frame,
    polling,
    read_pdu,
    read_words,
    receive,
    words_of,
    write_pdu,
    write_words,
)

ROOT = Path(__file__).parents[2]
CLOCK = MonotonicClock()
OUTPUTS = PlcOutputs(
    heartbeat=0x0102,
    ready=True,
    robot_link=True,
    operator_needed=True,
    state=6,
    pose=ToolPose(x=-0.1, y=0.0, z=0.0, rx=0.0, ry=0.0, rz=1e-6),
    boot_id=0xABCD,
)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextlib.contextmanager
def serving(
    *,
    peers: tuple[str, ...] = ("127.0.0.1",),
    bind: str = "127.0.0.1",
    timeout_s: float = 0.3,
    word_order: WordOrder = "big",
    most: int = 4,
) -> Iterator[tuple[ModbusServerPlc, int]]:
    """An open driver and its port."""
    port = free_port()
    settings = ModbusServerPlcSettings(
        driver="modbus_server",
        bind=bind,
        port=port,
        peers=peers,
        timeout_s=timeout_s,
        word_order=word_order,
        max_connections=most,
    )
    plc = ModbusServerPlc("plc", settings, CLOCK)
    plc.open()
    try:
        yield plc, port
    finally:
        plc.close()


@contextlib.contextmanager
def connected(port: int, source: str = "127.0.0.1") -> Iterator[socket.socket]:
    with socket.create_connection(("127.0.0.1", port), timeout=2.0, source_address=(source, 0)) as peer:
        yield peer


class Exchange:
    """One exchange in a thread, so that the test can be the PLC meanwhile."""

    def __init__(self, plc: ModbusServerPlc, outputs: PlcOutputs) -> None:
        self.inputs: PlcInputs | None = None
        self.error: Exception | None = None
        self._thread = threading.Thread(target=self._run, args=(plc, outputs), name="exchange")
        self._thread.start()

    def _run(self, plc: ModbusServerPlc, outputs: PlcOutputs) -> None:
        try:
            self.inputs = plc.exchange(outputs)
        except Exception as error:  # noqa: BLE001 - handed to the test
            self.error = error

    @property
    def over(self) -> bool:
        return not self._thread.is_alive()

    def end(self) -> PlcInputs:
        self._thread.join(5.0)
        assert self.over
        if self.error is not None:
            raise self.error
        assert self.inputs is not None
        return self.inputs


def shown(plc: ModbusServerPlc, peer: socket.socket, outputs: PlcOutputs) -> None:
    """Have the PLC shown these outputs."""
    write_words(peer, 0, QUIET)
    exchange = Exchange(plc, outputs)
    while not exchange.over:
        read_words(peer, 4, 0, 40)
    exchange.end()


# what is shown where


@pytest.mark.parametrize("order", ["big", "little"])
def test_the_status_block_is_the_same_in_input_and_holding_registers(order: WordOrder) -> None:
    with serving(word_order=order) as (plc, port), connected(port) as peer:
        shown(plc, peer, OUTPUTS)
        words = encode_status(OUTPUTS, order)
        assert read_words(peer, 4, 0, 40) == words
        assert read_words(peer, 3, 100, 40) == words
        assert read_words(peer, 4, 12, 2) == ([0xFFFE, 0x7960] if order == "big" else [0x7960, 0xFFFE])


def test_the_bits_of_the_status_word_are_discrete_inputs_0_to_15() -> None:
    with serving() as (plc, port), connected(port) as peer:
        shown(plc, peer, OUTPUTS)
        assert ask(peer, read_pdu(2, 0, 16)) == b"\x02\x02\x01\x81"  # bits 0, 8 and 15
        assert ask(peer, read_pdu(2, 8, 8)) == b"\x02\x01\x81"
        assert ask(peer, read_pdu(2, 15, 1)) == b"\x02\x01\x01"


@pytest.mark.parametrize("function", [3, 4])
def test_the_test_registers_have_their_fixed_values(function: int) -> None:
    with serving() as (_, port), connected(port) as peer:
        assert ask(peer, read_pdu(function, 200, 8)) == bytes([function, 16]) + bytes.fromhex(
            "1234 cfc7 12345678 fffe1dc0 0001 0001"
        )
    with serving(word_order="little") as (_, port), connected(port) as peer:
        assert ask(peer, read_pdu(function, 200, 8))[2:] == bytes.fromhex(
            "1234 cfc7 56781234 1dc0fffe 0001 0002"
        )


@pytest.mark.parametrize("unit", [0, 1, 17, 255])
def test_every_unit_number_is_answered(unit: int) -> None:
    with serving() as (_, port), connected(port) as peer:
        assert ask(peer, read_pdu(4, 0, 1), unit=unit) == b"\x04\x02\x00\x00"


# what may be written


def test_the_command_block_can_be_written_in_every_way_there_is() -> None:
    with serving(timeout_s=2.0) as (plc, port), connected(port) as peer:
        write_words(peer, 0, QUIET)
        assert ask(peer, b"\x06\x00\x05\x00\x07") == b"\x06\x00\x05\x00\x07"  # recipe 7
        assert ask(peer, b"\x05\x00\x00\xff\x00") == b"\x05\x00\x00\xff\x00"  # enable on
        assert ask(peer, b"\x0f\x00\x02\x00\x03\x01\x05") == b"\x0f\x00\x02\x00\x03"  # hold on, dry run on
        assert ask(peer, b"\x05\x00\x04\x00\x00") == b"\x05\x00\x04\x00\x00"  # dry run off again
        assert ask(peer, b"\x16\x00\x02\xff\xff\x00\x08") == b"\x16\x00\x02\xff\xff\x00\x08"  # nothing set
        assert ask(peer, b"\x16\x00\x08\x00\x00\x00\x05") == b"\x16\x00\x08\x00\x00\x00\x05"  # 5 attempts
        exchange = Exchange(plc, OUTPUTS)
        answer = ask(peer, b"\x17" + words_of([100, 3, 3, 2]) + b"\x04" + words_of([513, 3]))
        while not exchange.over:  # the exchange may have begun after that
            answer = ask(peer, b"\x17" + words_of([100, 3, 3, 2]) + b"\x04" + words_of([513, 3]))
        assert answer[:2] == b"\x17\x06"
        got = exchange.end()
        assert (got.recipe, got.cmd_seq, got.cmd_code, got.max_attempts) == (7, 513, 3, 5)
        assert (got.enable, got.abort, got.hold, got.dry_run) == (True, False, True, False)
        assert ask(peer, read_pdu(1, 0, 8)) == b"\x01\x01\x05"
        assert read_words(peer, 3, 2, 1) == [5]


@pytest.mark.parametrize(
    ("asked", "answer"),
    [
        (write_pdu(100, [1]), "9002"),  # the mirrored status
        (write_pdu(200, [1]), "9002"),  # test registers
        (write_pdu(20, [1] * 8), "9002"),  # runs out of the command block
        (write_pdu(24, [1]), "9002"),
        (b"\x06\x00\x64\x00\x01", "8602"),
        (b"\x16\x00\x64\x00\x00\x00\x01", "9602"),
        (b"\x05\x00\x10\xff\x00", "8502"),  # coil 16
        (b"\x0f\x00\x0c\x00\x08\x01\xff", "8f02"),
        (read_pdu(3, 20, 10), "8302"),
        (read_pdu(4, 0, 41), "8402"),
        (read_pdu(1, 10, 10), "8102"),
        (read_pdu(2, 16, 1), "8202"),
        (b"\x17" + words_of([300, 1, 0, 1]) + b"\x02" + words_of([9]), "9702"),
        (b"\x17" + words_of([0, 1, 100, 1]) + b"\x02" + words_of([9]), "9702"),
        (b"\x05\x00\x00\x12\x34", "8503"),  # neither on nor off
        (read_pdu(3, 0, 0), "8303"),
        (read_pdu(3, 0, 126), "8303"),
        (b"\x03\x00\x00", "8303"),
        (b"\x03\x00\x00\x00\x01\x00", "8303"),  # a byte too many
        (b"\x10\x00\x00\x00\x02\x02\x00\x01", "9003"),  # count and bytes disagree
        (b"\x10\x00\x00\x00\x01\x04\x00\x01", "9003"),
        (b"\x10\x00\x00\x00\x00\x00", "9003"),
        (b"\x08\x00\x01\x00\x00", "8801"),  # restart communications
        (b"\x08\x00\x04\x00\x00", "8801"),  # listen only
        (b"\x2b\x0e\x01\x00", "ab01"),
        (b"\x14\x07\x06\x00\x00\x00\x00\x00\x01", "9401"),
        (b"\x41", "c101"),
        (b"\x83\x02", "8301"),  # an exception is no request
        (b"\x00", "8001"),
    ],
)
def test_everything_else_is_refused_with_the_right_exception_and_changes_nothing(
    asked: bytes, answer: str
) -> None:
    with serving() as (_, port), connected(port) as peer:
        write_words(peer, 0, range(1, 25))
        assert ask(peer, asked).hex() == answer
        assert read_words(peer, 3, 0, 24) == list(range(1, 25))
        assert read_words(peer, 4, 0, 40) == [0] * 40


# what an exchange is


def test_an_exchange_is_over_when_the_status_word_has_been_read_and_not_before() -> None:
    with serving(timeout_s=5.0) as (plc, port), connected(port) as peer:
        write_words(peer, 0, QUIET)
        exchange = Exchange(plc, OUTPUTS)
        while read_words(peer, 4, 3, 1) != [6]:  # word 3 is shown, but is not the status word
            pass
        write_words(peer, 3, [9])
        assert not exchange.over
        assert read_words(peer, 4, 2, 1) == [0x8101]
        assert exchange.end().cmd_seq == 9


@pytest.mark.parametrize("asked", [read_pdu(4, 0, 40), read_pdu(3, 102, 1), read_pdu(2, 3, 1)])
def test_the_status_word_counts_as_read_in_each_of_its_places(asked: bytes) -> None:
    with serving(timeout_s=5.0) as (plc, port), connected(port) as peer:
        write_words(peer, 0, QUIET)
        exchange = Exchange(plc, OUTPUTS)
        while not exchange.over:
            ask(peer, asked)
        assert exchange.end().map_version == 1


def test_a_command_block_the_plc_has_not_written_whole_is_not_believed() -> None:
    """After a restart of the cell the words are 0 until the PLC comes: an old order must not look new."""
    with serving() as (plc, port), connected(port) as peer:

        def exchanged() -> PlcInputs:
            exchange = Exchange(plc, OUTPUTS)
            while not exchange.over:
                read_words(peer, 4, 0, 40)
            return exchange.end()

        write_words(peer, 0, [1, 5, 1])
        with pytest.raises(DeviceTimeout, match=r"not written words 3-23 of the command block .* all 24"):
            exchanged()
        write_words(peer, 3, [0] * 20)
        with pytest.raises(DeviceTimeout, match="word 23"):
            exchanged()
        write_words(peer, 23, [0])
        assert exchanged().heartbeat == 5
        plc.close()
        plc.open()
    # and what was written before a new start is forgotten
    with serving() as (plc, port), connected(port) as peer, pytest.raises(DeviceTimeout, match="words 0-23"):
        exchanged()


def test_a_plc_that_connects_anew_for_each_request_is_no_different() -> None:
    with serving(timeout_s=5.0) as (plc, port):
        with connected(port) as peer:
            write_words(peer, 0, QUIET)
        for _ in range(3):
            exchange = Exchange(plc, OUTPUTS)
            while not exchange.over:
                with connected(port) as peer:
                    read_words(peer, 4, 0, 40)
            assert exchange.end().map_version == 1


def test_several_requests_in_one_segment_are_answered_in_their_order() -> None:
    with serving() as (_, port), connected(port) as peer:
        peer.sendall(b"".join(frame(read_pdu(3, 200, n), transaction=n) for n in range(1, 9)))
        answers = [receive(peer) for _ in range(8)]
        assert [int.from_bytes(a[:2], "big") for a in answers] == list(range(1, 9))
        assert [a[8] // 2 for a in answers] == list(range(1, 9))


def test_a_request_that_comes_byte_by_byte_is_answered() -> None:
    with serving() as (_, port), connected(port) as peer:
        peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for byte in frame(read_pdu(3, 200, 1)):
            peer.sendall(bytes([byte]))
        assert receive(peer)[7:] == b"\x03\x02\x12\x34"


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
