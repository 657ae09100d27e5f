"""The map is consistent, the words are the ones written in the map, and what does not fit is refused."""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import combinations, pairwise

import pytest
from pydantic import ValidationError

from drivers.plc_codec import (
    WordOrder,
    crc16,
    decode_command,
    decode_status,
    encode_command,
    encode_status,
    encode_test,
    read_test,
)
from drivers.plc_map import (
    COMMAND,
    COMMAND_WORDS,
    MAP_VERSION,
    SERVER_WINDOWS,
    STATUS,
    STATUS_WORDS,
    TEST,
    TEST_WORDS,
    Block,
    Kind,
    Register,
    next_sequence,
)
from drivers.settings import ModbusPlcSettings
from drivers.types import PlcOutputs, ToolPose
from tests.fakes.plc import IDLE

ORDERS: tuple[WordOrder, ...] = ("big", "little")

# written out by hand from the map, not by the codec
COMMAND_BY_HAND = [
    1, 0xFFFF, 0b00_1001, 513, 3, 7, 11, 12, 2, 50,
    0xFFFE, 0x7960,  # x = -0.1 m
    0x0000, 0x0001,  # y = 1 um
    0x0007, 0xA120,  # z = 0.5 m
    0x0000, 0x0000, 0x0000, 0x0000,
    0xFFD0, 0x0FBF,  # rz = -3.141697 rad
    0, 512,
]  # fmt: skip
COMMAND_RECORD = replace(
    IDLE,
    heartbeat=0xFFFF,
    reset_fault=True,
    cmd_seq=513,
    cmd_code=3,
    recipe=7,
    source_id=11,
    destination_id=12,
    max_attempts=2,
    speed_percent=50,
    pose=ToolPose(x=-0.1, y=1e-6, z=0.5, rx=0.0, ry=0.0, rz=-3.141697),
    result_ack_seq=512,
)

STATUS_BY_HAND = [
    1, 9, 0b0001_0000_0000_1010, 6, 513, 0, 512, 1, 4, 2, 7, 987,
    0x0000, 0x0000, 0xFFFF, 0xFFFF, 0x0000, 0x0000, 0x0000, 0x0000, 0x0000, 0x0000, 0x0000, 0x0000,
    0x0001, 0x0002,  # 65.538 s
    0x0002, 0x0001,  # 131073 picks
    0xFFFF, 1, 2, 413, 3, 50, 7, 80, 0xBEEF, 0, 0, 0,
]  # fmt: skip
STATUS_RECORD = PlcOutputs(
    heartbeat=9,
    busy=True,
    result_valid=True,
    plc_link_ok=True,
    state=6,
    accepted_seq=513,
    ack_code=0,
    result_seq=512,
    result_code=1,
    result_detail=4,
    quantity=2,
    part_type=7,
    confidence=0.987,
    pose=ToolPose(x=0.0, y=-1e-6, z=0.0, rx=0.0, ry=0.0, rz=0.0),
    cycle_time_s=65.538,
    total_picks=131073,
    robot_mode=-1,
    safety_mode=1,
    runtime_state=2,
    fault_code=413,
    fault_count=3,
    plc_link_age_s=0.05,
    active_recipe=7,
    actual_speed_percent=80,
    boot_id=0xBEEF,
)


def swapped(words: list[int], table: tuple[Register, ...]) -> list[int]:
    """The words with the halves of every 32-bit register exchanged."""
    out = list(words)
    for register in table:
        if register.kind.words == 2:
            i = register.offset
            out[i], out[i + 1] = out[i + 1], out[i]
    return out


@pytest.mark.parametrize(
    ("table", "size"), [(COMMAND, COMMAND_WORDS), (STATUS, STATUS_WORDS), (TEST, TEST_WORDS)]
)
def test_the_table_covers_its_block_without_gaps_or_overlaps(table: tuple[Register, ...], size: int) -> None:
    assert table[0].offset == 0
    for register, following in pairwise(table):
        assert following.offset == register.offset + register.kind.words
    assert table[-1].offset + table[-1].kind.words == size


@pytest.mark.parametrize("table", [COMMAND, STATUS, TEST])
def test_names_are_unique_and_every_row_says_what_it_means(table: tuple[Register, ...]) -> None:
    names = [r.name for r in table] + [b.name for r in table for b in r.bits]
    assert len(set(names)) == len(names)
    assert all(r.meaning for r in table)
    assert all(b.meaning for r in table for b in r.bits)
    assert all(bool(r.bits) == (r.kind is Kind.BITS) for r in table)


def test_every_field_of_the_status_record_changes_the_words() -> None:
    plain = PlcOutputs()
    silent = []
    for field in fields(PlcOutputs):
        change = {field.name: _other(getattr(plain, field.name))}
        other = replace(plain, **change)  # type: ignore[arg-type]  # fields by name, on purpose
        if encode_status(other) == encode_status(plain):
            silent.append(field.name)
    assert silent == []


def _other(value: object) -> object:
    match value:
        case bool():
            return not value
        case ToolPose():
            return replace(value, x=1.0)
        case int():
            return value + 1
        case float():
            return value + 1.0
    raise AssertionError(value)


def test_the_version_of_the_map_is_the_default_of_the_record() -> None:
    assert PlcOutputs().map_version == MAP_VERSION


def test_command_words_are_the_ones_of_the_map() -> None:
    assert encode_command(COMMAND_RECORD) == COMMAND_BY_HAND
    assert decode_command(COMMAND_BY_HAND, read_at=0.0) == COMMAND_RECORD


def test_status_words_are_the_ones_of_the_map() -> None:
    assert encode_status(STATUS_RECORD) == STATUS_BY_HAND
    assert decode_status(STATUS_BY_HAND) == STATUS_RECORD


def test_little_word_order_swaps_the_halves_of_32_bit_values_only() -> None:
    assert encode_command(COMMAND_RECORD, "little") == swapped(COMMAND_BY_HAND, COMMAND)
    assert decode_command(swapped(COMMAND_BY_HAND, COMMAND), 0.0, "little") == COMMAND_RECORD
    assert encode_status(STATUS_RECORD, "little") == swapped(STATUS_BY_HAND, STATUS)
    assert decode_status(swapped(STATUS_BY_HAND, STATUS), "little") == STATUS_RECORD


def test_the_check_word_is_the_modbus_crc() -> None:
    # the published check value of CRC-16/MODBUS is 0x4B37 for "123456789"; these are even lengths of it,
    # computed bit by bit as a polynomial division, reflected
    def reflected_division(data: bytes) -> int:
        register = 0xFFFF
        for bit in (byte >> i & 1 for byte in data for i in range(8)):
            carry = (register ^ bit) & 1
            register >>= 1
            if carry:
                register ^= 0xA001
        return register

    assert reflected_division(b"123456789") == 0x4B37
    assert crc16([0x3132, 0x3334, 0x3536, 0x3738]) == reflected_division(b"12345678")


def test_a_check_word_is_written_and_found_right_and_a_flipped_bit_is_seen() -> None:
    words = encode_command(replace(COMMAND_RECORD, crc_used=True))
    assert words[22] == crc16(words[3:22]) != 0
    assert decode_command(words, 0.0) == replace(COMMAND_RECORD, crc_used=True)
    words[9] ^= 1
    broken = decode_command(words, 0.0)
    assert broken.crc_used
    assert not broken.crc_ok


def test_without_a_check_word_nothing_is_checked() -> None:
    words = list(COMMAND_BY_HAND)
    words[9] ^= 1
    assert decode_command(words, 0.0).crc_ok


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"result_detail": 65536}, r"status\.result_detail: 65536 is outside 0\.\.65535 \(UINT16\)"),
        ({"fault_code": -1}, r"status\.fault_code: -1"),
        ({"confidence": 65.6}, r"status\.confidence: 65\.6 is outside 0\.\.65\.535"),
        ({"robot_mode": 40000}, r"status\.robot_mode: 40000 is outside -32768\.\.32767"),
        ({"total_picks": 2**32}, r"status\.total_picks: 4294967296"),
        ({"cycle_time_s": float("nan")}, r"status\.cycle_time: nan is not a number"),
        (
            {"pose": ToolPose(x=0.0, y=0.0, z=-2148.0, rx=0.0, ry=0.0, rz=0.0)},
            r"status\.z: -2148\.0 m is outside",
        ),
    ],
)
def test_what_does_not_fit_is_refused_by_name_and_value(change: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        encode_status(replace(PlcOutputs(), **change))  # type: ignore[arg-type]  # fields by name, on purpose


def test_a_wrong_check_word_cannot_be_written() -> None:
    with pytest.raises(ValueError, match="crc"):
        encode_command(replace(COMMAND_RECORD, crc_used=True, crc_ok=False))


@pytest.mark.parametrize("words", [[0] * 23, [0] * 25, [65536] + [0] * 23, [-1] + [0] * 23])
def test_a_block_of_the_wrong_shape_is_refused(words: list[int]) -> None:
    with pytest.raises(ValueError, match="command"):
        decode_command(words, 0.0)


def test_the_sequence_leaves_out_zero_at_the_wrap() -> None:
    assert [next_sequence(n) for n in (0, 1, 65534, 65535)] == [1, 2, 65535, 1]


@pytest.mark.parametrize(
    ("read_base", "write_base"),
    [(0, 0), (0, 23), (139, 100), (65513, 0), (0, 65497)],
)
def test_blocks_that_overlap_or_leave_the_address_space_are_refused(read_base: int, write_base: int) -> None:
    with pytest.raises(ValidationError, match=r"overlaps|less than or equal"):
        ModbusPlcSettings(driver="modbus", host="192.0.2.20", read_base=read_base, write_base=write_base)


@pytest.mark.parametrize(("read_base", "write_base"), [(0, 24), (40, 0), (65512, 0), (0, 65496)])
def test_blocks_that_just_fit_are_taken(read_base: int, write_base: int) -> None:
    s = ModbusPlcSettings(driver="modbus", host="192.0.2.20", read_base=read_base, write_base=write_base)
    assert (s.read_base, s.write_base) == (read_base, write_base)


@pytest.mark.parametrize("test_base", [0, 23, 93, 100, 139])
def test_test_registers_over_another_block_are_refused(test_base: int) -> None:
    with pytest.raises(ValidationError, match=r"test_base .* overlaps (read|write)_base"):
        ModbusPlcSettings(driver="modbus", host="192.0.2.20", test_base=test_base)


@pytest.mark.parametrize("order", ORDERS)
def test_the_test_registers_tell_the_word_order(order: WordOrder) -> None:
    words = encode_test(order)
    assert len(words) == TEST_WORDS
    assert read_test(words) == order
    assert read_test([*words[:-1], 3]) is None
    big = words[2:4] == [0x1234, 0x5678]
    assert big is (order == "big")


def test_every_window_of_the_server_shows_a_whole_block_and_none_overlap() -> None:
    sizes = {Block.COMMAND: COMMAND_WORDS, Block.STATUS: STATUS_WORDS, Block.TEST: TEST_WORDS}
    for window in SERVER_WINDOWS:
        assert window.count == sizes.get(window.block, 16)
        assert window.writable is (window.block in (Block.COMMAND, Block.CONTROL_BITS))
    for first, second in combinations(SERVER_WINDOWS, 2):
        apart = first.first + first.count <= second.first or second.first + second.count <= first.first
        assert first.area is not second.area or apart
