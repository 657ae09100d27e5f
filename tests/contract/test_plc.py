"""The role in which the PLC is the server, over real sockets: against servers that do all they are asked,
refuse, stay silent, talk nonsense, hang up or are absent. What both roles keep is in `test_plc_roles.py`.

Real time passes here because time limits are the subject; every wait ends by an event or by its limit.
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

from drivers.errors import CommandRejected, DeviceTimeout, DeviceUnavailable
from drivers.plc.modbus import ModbusPlc
from drivers.plc_codec import WordOrder
from drivers.settings import ModbusPlcSettings
from drivers.timing import MonotonicClock
from drivers.types import PlcOutputs, ToolPose
from tests.fakes.modbuswire import bare, good_answer, obliging, reply, silent
from tests.fakes.modbuswire import receive as request
from tests.fakes.ports import free_port

ROOT = Path(__file__).parents[2]
LIMIT_S = 0.2
MARGIN_S = 0.3
CLOCK = MonotonicClock()


def settings(port: int, timeout_s: float = LIMIT_S, word_order: WordOrder = "big") -> ModbusPlcSettings:
    return ModbusPlcSettings(
        driver="modbus", host="127.0.0.1", port=port, timeout_s=timeout_s, word_order=word_order
    )


@contextlib.contextmanager
def modbus(port: int, timeout_s: float = LIMIT_S, word_order: WordOrder = "big") -> Iterator[ModbusPlc]:
    plc = ModbusPlc("plc", settings(port, timeout_s, word_order), CLOCK)
    try:
        yield plc
    finally:
        plc.close()


def test_constructing_connects_to_nothing() -> None:
    with bare(obliging) as server, modbus(server.port) as plc:
        with pytest.raises(DeviceUnavailable, match="not open"):
            plc.exchange(PlcOutputs())
        assert server.connections == 0


# errors and time limits


def test_an_absent_plc_is_unavailable_at_open() -> None:
    with modbus(free_port()) as plc, pytest.raises(DeviceUnavailable, match="no connection"):
        plc.open()


def test_a_plc_that_comes_after_open_is_found_by_the_next_exchange() -> None:
    port = free_port()
    with modbus(port) as plc:
        with pytest.raises(DeviceUnavailable):
            plc.open()
        with pytest.raises(DeviceUnavailable):
            plc.exchange(PlcOutputs())
        with bare(obliging, port):
            assert plc.exchange(PlcOutputs()).map_version == 1


def test_a_silent_plc_costs_the_time_limit_and_no_more() -> None:
    with bare(silent) as server, modbus(server.port) as plc:
        plc.open()
        for _ in range(3):
            started = time.monotonic()
            with pytest.raises(DeviceTimeout, match=r"no answer to a write of 40 registers at 100 in 0\.2 s"):
                plc.exchange(PlcOutputs())
            assert LIMIT_S * 0.9 <= time.monotonic() - started < LIMIT_S + MARGIN_S


def test_a_slow_write_leaves_less_time_for_the_read() -> None:
    clock_waits = threading.Event()

    def slow_then_silent(connection: socket.socket) -> None:
        asked = request(connection)
        clock_waits.wait(LIMIT_S * 0.7)
        connection.sendall(good_answer(asked))
        request(connection)
        clock_waits.wait(2 * LIMIT_S)

    with bare(slow_then_silent) as server, modbus(server.port) as plc:
        plc.open()
        started = time.monotonic()
        with pytest.raises(DeviceTimeout, match="read of 24 registers at 0"):
            plc.exchange(PlcOutputs())
        assert time.monotonic() - started < LIMIT_S * 1.6


def test_a_plc_that_trickles_bytes_is_bounded_too() -> None:
    stop = threading.Event()

    def trickling(connection: socket.socket) -> None:
        answer = good_answer(request(connection))
        for i in range(len(answer) - 1):
            connection.sendall(answer[i : i + 1])
            if stop.wait(LIMIT_S / 4):
                return
        stop.wait(5.0)

    with bare(trickling) as server, modbus(server.port) as plc:
        plc.open()
        started = time.monotonic()
        with pytest.raises(DeviceTimeout):
            plc.exchange(PlcOutputs())
        assert time.monotonic() - started < 2 * LIMIT_S + MARGIN_S
        stop.set()


def test_a_late_answer_is_not_taken_for_the_next_one() -> None:
    wait = threading.Event()
    first = [True]

    def late_once(connection: socket.socket) -> None:
        while asked := request(connection):
            if first[0]:
                first[0] = False
                wait.wait(LIMIT_S * 1.5)
            connection.sendall(good_answer(asked, [1, 4711, *([0] * 22)]))

    with bare(late_once) as server, modbus(server.port) as plc:
        plc.open()
        with pytest.raises(DeviceTimeout):
            plc.exchange(PlcOutputs())
        got = None
        for _ in range(20):
            with contextlib.suppress(DeviceTimeout):
                got = plc.exchange(PlcOutputs())
                break
        assert got is not None
        assert got.heartbeat == 4711
        assert server.connections >= 2


def test_a_plc_that_hangs_up_is_unavailable_and_the_next_exchange_connects_anew() -> None:
    hung_up = [False]

    def hangs_up_once(connection: socket.socket) -> None:
        if not hung_up[0]:
            request(connection)
            hung_up[0] = True
            return
        obliging(connection)

    with bare(hangs_up_once) as server, modbus(server.port) as plc:
        plc.open()
        with pytest.raises(DeviceUnavailable, match="connection lost in a write"):
            plc.exchange(PlcOutputs())
        assert plc.exchange(PlcOutputs()).map_version == 1
        assert server.connections == 2


def test_a_plc_that_resets_the_connection_is_unavailable() -> None:
    def resets(connection: socket.socket) -> None:
        request(connection)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\x00\x00\x00\x00\x00\x00\x00")

    with bare(resets) as server, modbus(server.port) as plc:
        plc.open()
        with pytest.raises(DeviceUnavailable, match="connection lost"):
            plc.exchange(PlcOutputs())


@pytest.mark.parametrize(
    "noise", [b"HTTP/1.0 400 Bad Request\r\n\r\n", b"\x00" * 64, b"\x00\x01\x00\x00\x00\x03\x01\x65\x00"]
)
def test_nonsense_is_a_driver_error_in_bounded_time(noise: bytes) -> None:
    def nonsense(connection: socket.socket) -> None:
        while request(connection):
            connection.sendall(noise)

    with bare(nonsense) as server, modbus(server.port) as plc:
        plc.open()
        started = time.monotonic()
        with pytest.raises((DeviceUnavailable, DeviceTimeout)):
            plc.exchange(PlcOutputs())
        assert time.monotonic() - started < 2 * LIMIT_S + MARGIN_S


def test_a_refusing_plc_is_a_rejection_that_says_what_and_why_and_keeps_the_connection() -> None:
    def refusing(connection: socket.socket) -> None:
        while asked := request(connection):
            connection.sendall(reply(asked, bytes([asked[7] | 0x80, 2])))

    with bare(refusing) as server, modbus(server.port) as plc:
        plc.open()
        for _ in range(3):
            with pytest.raises(
                CommandRejected,
                match="write of 40 registers at 100 refused: exception 2, illegal data address",
            ):
                plc.exchange(PlcOutputs())
        assert server.connections == 1


def test_an_answer_with_too_few_registers_is_refused() -> None:
    def short(connection: socket.socket) -> None:
        while asked := request(connection):
            connection.sendall(good_answer(asked, [1] * 23))

    with bare(short) as server, modbus(server.port) as plc:
        plc.open()
        with pytest.raises(CommandRejected, match="about something else"):
            plc.exchange(PlcOutputs())


def test_a_write_confirmed_for_another_place_is_refused() -> None:
    def elsewhere(connection: socket.socket) -> None:
        while asked := request(connection):
            connection.sendall(reply(asked, b"\x10\x00\x00\x00\x28"))

    with bare(elsewhere) as server, modbus(server.port) as plc:
        plc.open()
        with pytest.raises(CommandRejected, match="about something else"):
            plc.exchange(PlcOutputs())


def test_outputs_that_do_not_fit_are_refused_before_anything_is_sent() -> None:
    def none_expected(connection: socket.socket) -> None:
        assert request(connection) == b""

    with bare(none_expected) as server, modbus(server.port) as plc:
        plc.open()
        with pytest.raises(ValueError, match=r"status\.result_detail: 70000"):
            plc.exchange(PlcOutputs(result_detail=70000))


def test_the_library_writes_nothing_on_stderr() -> None:
    script = (
        "from drivers.errors import DriverError\n"
        "from drivers.plc.modbus import ModbusPlc\n"
        "from drivers.settings import ModbusPlcSettings\n"
        "from drivers.timing import MonotonicClock\n"
        "from drivers.types import PlcOutputs\n"
        f"s = ModbusPlcSettings(driver='modbus', host='127.0.0.1', port={free_port()}, timeout_s=0.1)\n"
        "plc = ModbusPlc('plc', s, MonotonicClock())\n"
        "for call in (plc.open, lambda: plc.exchange(PlcOutputs())):\n"
        "    try:\n"
        "        call()\n"
        "    except DriverError as error:\n"
        "        print(type(error).__name__)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, timeout=30, check=True
    )
    assert done.stdout.split() == ["DeviceUnavailable"] * 2
    assert done.stderr == ""


# bytes


def test_one_exchange_is_these_bytes_and_no_others() -> None:
    """Every byte written out by hand from the Modbus specification and the map."""
    seen: list[bytes] = []
    command = [1, 258, 0b1_0001, 7, 1, 4, 0, 0, 2, 30, *([0] * 12), 0, 6]

    def recording(connection: socket.socket) -> None:
        while asked := request(connection):
            seen.append(asked)
            connection.sendall(good_answer(asked, command))

    outputs = PlcOutputs(
        heartbeat=0x0102,
        result_valid=True,
        robot_link=True,
        state=6,
        accepted_seq=0x0304,
        result_seq=0x0304,
        result_code=1,
        confidence=0.5,
        pose=ToolPose(x=-0.1, y=0.0, z=0.0, rx=0.0, ry=0.0, rz=1e-6),
        cycle_time_s=65.536,
        boot_id=0xABCD,
    )
    with bare(recording) as server, modbus(server.port) as plc:
        plc.open()
        inputs = plc.exchange(outputs)
    write, read = seen
    assert write[2:] == bytes.fromhex(
        "0000 0057 01"  # protocol, 87 bytes follow, unit 1
        "10 0064 0028 50"  # FC16, register 100, 40 registers, 80 bytes
        "0001 0102 0108 0006 0304 0000"  # version, beat, bits 3 and 8, state, accepted, ack
        "0304 0001 0000 0000 0000 01f4"  # result of, code, detail, quantity, type, 0.5
        "fffe7960 00000000 00000000 00000000 00000000 00000001"
        "00010000 00000000 ffff 0000 0000 0000 0000 0000 0000 0000 abcd 0000 0000 0000"
    )
    assert read[2:] == bytes.fromhex("0000 0006 01 03 0000 0018")
    assert read[:2] != write[:2]
    assert (inputs.heartbeat, inputs.enable, inputs.dry_run, inputs.hold) == (258, True, True, False)
    assert (inputs.cmd_seq, inputs.cmd_code, inputs.recipe) == (7, 1, 4)
    assert (inputs.max_attempts, inputs.speed_percent, inputs.result_ack_seq) == (2, 30, 6)
    assert abs(inputs.read_at - time.monotonic()) < 5.0


def test_the_test_registers_are_written_once_per_connection_where_configured() -> None:
    seen: list[bytes] = []

    def recording(connection: socket.socket) -> None:
        while asked := request(connection):
            seen.append(asked[7:])
            connection.sendall(good_answer(asked))

    with bare(recording) as server:
        wanted = settings(server.port).model_copy(update={"test_base": 200})
        plc = ModbusPlc("plc", wanted, CLOCK)
        for _ in range(2):
            plc.open()
            plc.exchange(PlcOutputs())
            plc.exchange(PlcOutputs())
            plc.close()
    tests = [pdu for pdu in seen if pdu[:3] == b"\x10\x00\xc8"]
    assert tests == [bytes.fromhex("10 00c8 0008 10 1234 cfc7 12345678 fffe1dc0 0001 0001")] * 2
    assert len(seen) == 10
