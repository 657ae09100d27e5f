"""Declarations read back by parsers that know the dialects and not the map: what they say about memory is
laid over words the codec made, and every value is found where the declaration puts it.
"""

from __future__ import annotations

import csv
import io
import re
import struct
from dataclasses import dataclass, replace
from typing import Literal

import pytest

from drivers.plc_codec import WordOrder, encode_command, encode_status, encode_test
from drivers.plc_declarations import DIALECTS, Dialect, declarations
from drivers.plc_map import COMMAND, STATUS, TEST, Kind, Register
from drivers.types import PlcOutputs, ResultCode, ToolPose
from tests.fakes.plc import IDLE

ORDERS: tuple[WordOrder, ...] = ("big", "little")
BLOCKS = {"MikadoCommand": COMMAND, "MikadoStatus": STATUS, "MikadoTest": TEST}

COMMAND_RECORD = replace(
    IDLE,
    heartbeat=65535,
    enable=True,
    hold=True,
    home_on_stop=True,
    cmd_seq=40000,
    cmd_code=3,
    recipe=7,
    source_id=11,
    destination_id=12,
    max_attempts=2,
    speed_percent=50,
    pose=ToolPose(x=-0.1, y=0.000001, z=0.5, rx=-3.141593, ry=1.0, rz=2.0),
    result_ack_seq=39999,
)
STATUS_RECORD = PlcOutputs(
    heartbeat=9,
    busy=True,
    result_valid=True,
    robot_link=True,
    operator_needed=True,
    state=6,
    accepted_seq=40000,
    ack_code=53,
    result_seq=39999,
    result_code=13,
    result_detail=4,
    quantity=2,
    part_type=7,
    confidence=0.987,
    pose=ToolPose(x=0.1, y=-0.000001, z=0.65, rx=3.141593, ry=-1.0, rz=-2.0),
    cycle_time_s=4000000.538,
    total_picks=3131073,
    robot_mode=-1,
    safety_mode=1,
    runtime_state=2,
    fault_code=413,
    fault_count=3,
    plc_link_age_s=0.05,
    active_recipe=8,
    actual_speed_percent=80,
    boot_id=0xBEEF,
)


def words_of(block: str, order: WordOrder) -> list[int]:
    match block:
        case "MikadoCommand":
            return encode_command(COMMAND_RECORD, order)
        case "MikadoStatus":
            return encode_status(STATUS_RECORD, order)
    return encode_test(order)


def expected(block: str, order: WordOrder) -> dict[str, int]:
    """Each register's and bit's count."""
    found: dict[str, int] = {}
    for register in BLOCKS[block]:
        words = words_of(block, "big")[register.offset : register.offset + register.kind.words]
        raw = b"".join(word.to_bytes(2, "big") for word in words)
        signed = register.kind in (Kind.INT16, Kind.INT32)
        if register.kind is Kind.BITS:
            found.update({bit.name: words[0] >> bit.number & 1 for bit in register.bits})
        else:
            found[register.name] = int.from_bytes(raw, "big", signed=signed)
    if block == "MikadoTest":
        found["test_word_order"] = ORDERS.index(order) + 1
    return found


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where a declaration puts a value in memory."""

    byte: int
    bit: int = 0
    kind: str
    """A type of the dialect."""


SIZES = {"UINT": 2, "INT": 2, "WORD": 2, "UDINT": 4, "DINT": 4}
FORMATS = {"UINT": "H", "INT": "h", "WORD": "H", "UDINT": "I", "DINT": "i"}


def value_at(memory: bytes, place: Place, endian: Literal["<", ">"]) -> int:
    if place.kind == "BOOL":
        return memory[place.byte] >> place.bit & 1
    (value,) = struct.unpack_from(endian + FORMATS[place.kind], memory, place.byte)
    return int(value)


def without_remarks(text: str) -> str:
    return re.sub(r"//.*", "", text)


# --------------------------------------------------------------------------- S7: an SCL source


def siemens(text: str) -> dict[str, dict[str, Place]]:
    """Types by name; a Bool takes the next bit, everything else begins at an even byte, structures too."""
    types: dict[str, dict[str, Place]] = {}
    for name, body in re.findall(
        r'TYPE "(\w+)"\s*VERSION : 0\.1\s*STRUCT(.*?)\n {3}END_STRUCT;\s*END_TYPE',
        without_remarks(text),
        re.S,
    ):
        places: dict[str, Place] = {}
        byte, bit = 0, 0

        def align() -> None:
            nonlocal byte, bit
            byte, bit = byte + (bit > 0), 0
            byte += byte % 2

        for line in filter(None, map(str.strip, body.replace("Struct", "Struct;").split(";"))):
            if line == "END_STRUCT":
                align()
                continue
            field, kind = (part.strip() for part in line.split(":"))
            kind = kind.strip('"')
            if kind == "Bool":
                places[field] = Place(byte=byte, bit=bit, kind="BOOL")
                bit += 1
                byte, bit = byte + bit // 8, bit % 8
                continue
            align()
            if kind in types:
                for inner, place in types[kind].items():
                    places[f"{field}.{inner}"] = replace(place, byte=byte + place.byte)
                byte += 4
            elif kind != "Struct":
                places[field] = Place(byte=byte, kind=kind.upper())
                byte += SIZES[kind.upper()]
        types[name] = places
    return types


# --------------------------------------------------------------------------- CODESYS


def codesys(text: str) -> dict[str, dict[str, Place]]:
    """Packed structures: no gaps; BIT takes the next bit of a byte, from the lowest."""
    types: dict[str, dict[str, Place]] = {}
    for name, body in re.findall(r"TYPE (\w+) :\s*STRUCT(.*?)END_STRUCT", without_remarks(text), re.S):
        places: dict[str, Place] = {}
        byte, bit = 0, 0
        for line in filter(None, map(str.strip, body.split(";"))):
            field, kind = (part.strip() for part in line.split(":"))
            if kind == "BIT":
                places[field] = Place(byte=byte, bit=bit, kind="BOOL")
                bit += 1
                byte, bit = byte + bit // 8, bit % 8
            elif kind in types:
                for inner, place in types[kind].items():
                    key = inner if place.kind == "BOOL" else f"{field}.{inner}"
                    places[key] = replace(place, byte=byte + place.byte)
                byte += 2 if any(p.kind == "BOOL" for p in types[kind].values()) else 4
            else:
                places[field] = Place(byte=byte, kind=kind)
                byte += SIZES[kind]
        assert bit == 0, f"{name} ends inside a byte"
        types[name] = places
    return types


# --------------------------------------------------------------------------- Rockwell


def rockwell(text: str) -> tuple[dict[str, int], dict[str, Place]]:
    """Sizes of the word tags, and where each alias points: INT is two bytes, bits are numbered in it."""
    rows = list(csv.reader(io.StringIO(text)))
    head = rows.index(["TYPE", "SCOPE", "NAME", "DESCRIPTION", "DATATYPE", "SPECIFIER", "ATTRIBUTES"])
    sizes: dict[str, int] = {}
    places: dict[str, Place] = {}
    for kind, _, name, _, datatype, specifier, _ in rows[head + 1 :]:
        assert len(name) <= 40
        if kind == "TAG":
            array = re.fullmatch(r"INT\[(\d+)\]", datatype)
            if array:
                sizes[name] = int(array[1])
            continue
        where = re.fullmatch(r"(\w+)\[(\d+)\](?:\.(\d+))?", specifier)
        assert where is not None, specifier
        assert int(where[2]) < sizes[where[1]]
        if where[3] is None:
            places[name] = Place(byte=2 * int(where[2]), kind="INT")
        else:
            bit = int(where[3])
            places[name] = Place(byte=2 * int(where[2]) + bit // 8, bit=bit % 8, kind="BOOL")
    return sizes, places


# --------------------------------------------------------------------------- what they say


def joined(value: dict[str, int], name: str, register: Register) -> int:
    """A value declared as two words, put together as the declared function does."""
    unsigned = (value[f"{name}.high"] & 0xFFFF) << 16 | value[f"{name}.low"] & 0xFFFF
    return unsigned - 2**32 if register.kind is Kind.INT32 and unsigned >= 2**31 else unsigned


def found_in(
    places: dict[str, Place], block: str, order: WordOrder, endian: Literal["<", ">"]
) -> dict[str, int]:
    memory = b"".join(
        word.to_bytes(2, "big" if endian == ">" else "little") for word in words_of(block, order)
    )
    raw = {name: value_at(memory, place, endian) for name, place in places.items()}
    found = {name: value for name, value in raw.items() if "." not in name}
    for register in BLOCKS[block]:
        if f"{register.name}.high" in raw:
            found[register.name] = joined(raw, register.name, register)
    return {name: value for name, value in found.items() if "_bit_" not in name or name == "test_bit_0"}


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("block", BLOCKS)
def test_a_siemens_type_over_the_words_of_a_data_block_has_every_value(block: str, order: WordOrder) -> None:
    types = siemens(declarations("siemens-scl", order))
    assert found_in(types[block], block, order, ">") == expected(block, order)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("block", BLOCKS)
def test_a_codesys_type_over_an_array_of_words_has_every_value(block: str, order: WordOrder) -> None:
    types = codesys(declarations("codesys", order))
    assert found_in(types[block], block, order, "<") == expected(block, order)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(
    ("tag", "block"), [("C", "MikadoCommand"), ("S", "MikadoStatus"), ("T", "MikadoTest")]
)
def test_rockwell_aliases_over_the_words_have_every_value(tag: str, block: str, order: WordOrder) -> None:
    sizes, places = rockwell(declarations("rockwell-csv", order))
    prefix = f"Mikado_{tag}_"
    own = {
        re.sub(r"_(high|low)$", r".\1", name.removeprefix(prefix)): place
        for name, place in places.items()
        if name.startswith(prefix)
    }
    words = words_of(block, order)
    assert sizes[prefix[:-1]] == len(words)
    found = found_in(own, block, order, "<")
    wanted = expected(block, order)
    unsigned = {r.name for r in BLOCKS[block] if r.kind is Kind.UINT16}
    for register in BLOCKS[block]:
        if register.kind is Kind.BITS:  # the whole word has an alias too
            assert found.pop(register.name) & 0xFFFF == words[register.offset]
    assert {n: v & 0xFFFF if n in unsigned else v for n, v in found.items()} == wanted


@pytest.mark.parametrize("order", ORDERS)
def test_the_siemens_data_block_has_the_blocks_where_the_registers_are(order: WordOrder) -> None:
    text = without_remarks(declarations("siemens-scl", order))
    body = text[text.index('DATA_BLOCK "MikadoData"') :]
    assert "S7_Optimized_Access := 'FALSE'" in body  # the server needs words where they are declared
    at, begins = 0, {}
    sizes = {"MikadoCommand": 24, "MikadoStatus": 40, "MikadoTest": 8}
    for kind in re.findall(r'\w+ : ("\w+"|Array\[0\.\.\d+\] of Word);', body):
        if kind.startswith('"'):
            begins[kind.strip('"')] = at
            at += sizes[kind.strip('"')]
        else:
            at += int(kind[9:].split("]")[0]) + 1
    assert begins == {"MikadoCommand": 0, "MikadoStatus": 100, "MikadoTest": 200}


def test_codesys_unions_are_as_long_as_the_blocks() -> None:
    text = without_remarks(declarations("codesys", "big"))
    found = re.findall(r"words : ARRAY\[0\.\.(\d+)\] OF WORD;\s*fields : (\w+);", text)
    assert found == [("23", "MikadoCommand"), ("39", "MikadoStatus"), ("7", "MikadoTest")]


@pytest.mark.parametrize("dialect", DIALECTS)
def test_a_file_names_every_result_code_and_its_word_order_in_plain_characters(dialect: Dialect) -> None:
    for order in ORDERS:
        text = declarations(dialect, order)
        assert all(code.name in text for code in ResultCode)
        assert f"plc.word_order: {order}" in text
        assert text.isascii()
        assert text.endswith("\r\n")
        assert "\n" not in text.replace("\r\n", "")


@pytest.mark.parametrize("dialect", ["siemens-scl", "codesys"])
def test_a_wrong_layout_would_be_seen(dialect: Dialect) -> None:
    """The tests above can fail: a register more, and nothing after it is where it should be."""
    text = declarations(dialect, "big")
    word = {"siemens-scl": "UInt", "codesys": "UINT"}[dialect]
    wrong = re.sub(rf"(\s+)recipe : {word};", rf"\1spare : {word};\1recipe : {word};", text, count=1)
    assert wrong != text
    read = siemens if dialect == "siemens-scl" else codesys
    endian: Literal["<", ">"] = ">" if dialect == "siemens-scl" else "<"
    places = {n: p for n, p in read(wrong)["MikadoCommand"].items() if p.byte < 46}
    assert found_in(places, "MikadoCommand", "big", endian) != expected("MikadoCommand", "big")
