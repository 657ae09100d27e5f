"""The role in which the cell is the Modbus server, met by raw sockets: what is shown where, what may be
written, and what of that the cell takes over. Bytes are written by hand.
"""

from __future__ import annotations

import socket

import pytest

from drivers.errors import DeviceTimeout
from drivers.plc_codec import WordOrder, encode_status
from drivers.types import PlcInputs
from tests.contract.plc_serving import OUTPUTS, Exchange, connected, serving, shown
from tests.fakes.modbuswire import (
    QUIET,
    ask,
    frame,
    read_pdu,
    read_words,
    receive,
    words_of,
    write_pdu,
    write_words,
)

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
