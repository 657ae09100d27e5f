"""Register map v1 as data: the only place that knows offsets, widths, scales and meanings.

`drivers.plc_codec` turns it into words; the documentation and the PLC declarations come from it too.

Words are as on the wire: unsigned 16 bit, 0-based offsets inside their block. 32-bit values take two
words, high word first unless ``word_order="little"``. There are no floats: a register holds counts, and
``per_unit`` counts make one unit of our system (metres, radians, seconds, 0..1).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Final

MAP_VERSION: Final = 1
COMMAND_WORDS: Final = 24
STATUS_WORDS: Final = 40
TEST_WORDS: Final = 8
SEQUENCE_COUNT: Final = 65535
"""Sequence numbers run 1..65535; 0 means none."""

CRC_OFFSET: Final = 22
CRC_WORDS: Final = slice(3, 22)
"""The command words the check word covers."""


class Kind(Enum):
    """How a register's words are read."""

    UINT16 = "UINT16"
    INT16 = "INT16"
    UINT32 = "UINT32"
    INT32 = "INT32"
    BITS = "BITS"

    @property
    def words(self) -> int:
        """1 or 2."""
        return 2 if self in (Kind.UINT32, Kind.INT32) else 1

    @property
    def signed(self) -> bool:
        """Two's complement."""
        return self in (Kind.INT16, Kind.INT32)


@dataclass(frozen=True, slots=True, kw_only=True)
class Bit:
    """One bit of a BITS register; bit 0 is the least significant."""

    number: int
    name: str
    meaning: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Register:
    """One row of the map. ``per_unit`` counts are one ``unit``; ``example`` is a value in that unit, which
    the documentation shows in hex and which a test register always has."""

    offset: int
    name: str
    kind: Kind
    meaning: str
    per_unit: int = 1
    unit: str = ""
    bits: tuple[Bit, ...] = ()
    example: float = 1


def _bits(*rows: tuple[int, str, str]) -> tuple[Bit, ...]:
    return tuple(Bit(number=number, name=name, meaning=meaning) for number, name, meaning in rows)


def _u16(offset: int, name: str, meaning: str, per_unit: int = 1, unit: str = "") -> Register:
    return Register(offset=offset, name=name, kind=Kind.UINT16, meaning=meaning, per_unit=per_unit, unit=unit)


def _pose(first: int, whose: str) -> tuple[Register, ...]:
    """Six INT32: micrometres, then the rotation vector in microradians, robot base frame."""
    return tuple(
        Register(
            offset=first + 2 * i,
            name=name,
            kind=Kind.INT32,
            meaning=f"{whose}, {'position' if i < 3 else 'rotation vector'}, robot base frame",
            per_unit=1_000_000,
            unit="m" if i < 3 else "rad",
            example=-0.1 if i < 3 else 3.141593,
        )
        for i, name in enumerate(("x", "y", "z", "rx", "ry", "rz"))
    )


COMMAND: Final[tuple[Register, ...]] = (
    _u16(0, "map_version", "1; any other value is refused with 55"),
    _u16(1, "heartbeat", "the PLC adds 1 at least every 500 ms"),
    Register(
        offset=2,
        name="control",
        kind=Kind.BITS,
        meaning="control word",
        bits=_bits(
            (0, "enable", "level: orders are taken only while high"),
            (1, "abort", "level: stop now, result 40"),
            (2, "hold", "level: pause"),
            (3, "reset_fault", "rising edge: acknowledge the fault"),
            (4, "dry_run", "go through the motions without closing the gripper"),
            (5, "home_on_stop", "go home when stopping; not used yet"),
        ),
    ),
    _u16(
        3,
        "cmd_seq",
        "sequence number 1..65535 of the order, 0 = none, 0 is left out at the wrap; written last",
    ),
    _u16(4, "cmd_code", "what to do, see the commands"),
    _u16(5, "recipe", "part code"),
    _u16(6, "source_id", "where to take from"),
    _u16(7, "destination_id", "where to put"),
    _u16(8, "max_attempts", "attempts before giving up, 0 = one; command 10: the choice, 11: the mode"),
    _u16(9, "speed_percent", "percent of the configured speeds, 0 = default"),
    *_pose(10, "target of the order"),
    _u16(22, "crc", "CRC-16 (Modbus polynomial) of words 3-21, high byte first; 0 = not used"),
    _u16(23, "result_ack_seq", "the result_seq the PLC has taken over"),
)

STATUS: Final[tuple[Register, ...]] = (
    _u16(0, "map_version", "1"),
    _u16(1, "heartbeat", "the cell adds 1 every 250 ms while its loop is alive"),
    Register(
        offset=2,
        name="status",
        kind=Kind.BITS,
        meaning="status word",
        bits=_bits(
            (0, "ready", "an order would be taken now"),
            (1, "busy", "an order is under way"),
            (2, "moving", "the arm moves"),
            (3, "result_valid", "the result words belong to result_seq and stay until acknowledged"),
            (4, "fault", "see fault_code"),
            (5, "emergency_stop", "the arm's emergency stop is active"),
            (6, "protective_stop", "the arm is in protective stop"),
            (7, "safeguard_stop", "the arm is in safeguard stop"),
            (8, "robot_link", "the arm answers"),
            (9, "remote_control", "the arm is in remote control"),
            (10, "program_running", "the arm's control program runs"),
            (11, "vision_ok", "both cameras deliver"),
            (12, "plc_link_ok", "the cell hears the PLC; after a loss enable must go low and high again"),
            (13, "part_in_gripper", "the gripper holds something"),
            (14, "at_home", "the arm is at its watch position"),
            (15, "operator_needed", "a person has to look"),
        ),
    ),
    _u16(3, "state", "PackML state number"),
    _u16(4, "accepted_seq", "the last order answered"),
    _u16(5, "ack_code", "0 = that order was accepted, else the result code it was refused with"),
    _u16(6, "result_seq", "the order the result belongs to"),
    _u16(7, "result_code", "result code"),
    _u16(8, "result_detail", "more about the result, by code"),
    _u16(9, "quantity", "parts delivered"),
    _u16(10, "part_type", "part code of what was picked"),
    _u16(11, "confidence", "how sure the detector was", per_unit=1000),
    *_pose(12, "where the part was taken"),
    Register(
        offset=24,
        name="cycle_time",
        kind=Kind.UINT32,
        meaning="duration of the order",
        per_unit=1000,
        unit="s",
        example=65.538,
    ),
    Register(
        offset=26,
        name="total_picks",
        kind=Kind.UINT32,
        meaning="picks since the counter was reset",
        example=131073,
    ),
    Register(
        offset=28,
        name="robot_mode",
        kind=Kind.INT16,
        meaning="the arm's robot mode; -1: not used yet",
        example=-1,
    ),
    _u16(
        29,
        "safety_mode",
        "0 unknown, 1 normal, 2 reduced, 3 protective stop, 5 safeguard stop, 7 emergency stop",
    ),
    _u16(30, "runtime_state", "the arm's program state; not used yet"),
    _u16(31, "fault_code", "latched fault, code / 100 is the device"),
    _u16(32, "fault_count", "faults since start"),
    _u16(33, "plc_link_age", "age of the last good read of the PLC, 65.535 = that or older", 1000, "s"),
    _u16(34, "active_recipe", "part code in use"),
    _u16(35, "actual_speed_percent", "speed in use"),
    _u16(36, "boot_id", "changes at each start of the cell"),
    _u16(37, "first_alarm", "code of the alarm that came first of those that are active, 0 = none"),
    _u16(38, "alarm_count", "alarms nobody has acknowledged yet"),
    _u16(39, "unit_mode", "1 production, 2 maintenance, 3 manual, 4 dry run"),
)

TEST: Final[tuple[Register, ...]] = (
    Register(
        offset=0,
        name="test_uint16",
        kind=Kind.UINT16,
        meaning="4660; 13330 means that your bytes are swapped",
        example=0x1234,
    ),
    Register(
        offset=1,
        name="test_int16",
        kind=Kind.INT16,
        meaning="-12345; 53191 means that you read it unsigned",
        example=-12345,
    ),
    Register(
        offset=2,
        name="test_uint32",
        kind=Kind.UINT32,
        meaning="305419896; 1450709556 means that your words are swapped: use the other word_order",
        example=0x12345678,
    ),
    Register(
        offset=4,
        name="test_int32",
        kind=Kind.INT32,
        meaning="-123456, which is -0.123456 m as all positions are given",
        per_unit=1_000_000,
        unit="m",
        example=-0.123456,
    ),
    Register(
        offset=6,
        name="test_bits",
        kind=Kind.BITS,
        meaning="bit 0 is on and nothing else; bit 8 on means that your bytes are swapped",
        bits=_bits((0, "test_bit_0", "always on")),
    ),
    _u16(7, "test_word_order", "1: the high word is sent first (big), 2: the low word first (little)"),
)
"""Fixed values, always shown: with them a PLC programmer finds out how his controller reads ours."""


class Area(Enum):
    """The four tables of Modbus; the value is the leading digit of an address in PLC notation."""

    COIL = 0
    DISCRETE_INPUT = 1
    INPUT_REGISTER = 3
    HOLDING_REGISTER = 4


class Block(Enum):
    """What is shown in an area."""

    COMMAND = "command block"
    STATUS = "status block"
    TEST = "test registers"
    CONTROL_BITS = "bits of the control word"
    STATUS_BITS = "bits of the status word"


@dataclass(frozen=True, slots=True, kw_only=True)
class Window:
    """Where the cell shows a block when it is the Modbus server; addresses are 0-based."""

    block: Block
    area: Area
    first: int
    count: int
    writable: bool = False


SERVER_WINDOWS: Final[tuple[Window, ...]] = (
    Window(block=Block.COMMAND, area=Area.HOLDING_REGISTER, first=0, count=COMMAND_WORDS, writable=True),
    Window(block=Block.CONTROL_BITS, area=Area.COIL, first=0, count=16, writable=True),
    Window(block=Block.STATUS, area=Area.INPUT_REGISTER, first=0, count=STATUS_WORDS),
    # once more, because some PLCs cannot read input registers
    Window(block=Block.STATUS, area=Area.HOLDING_REGISTER, first=100, count=STATUS_WORDS),
    Window(block=Block.STATUS_BITS, area=Area.DISCRETE_INPUT, first=0, count=16),
    Window(block=Block.TEST, area=Area.INPUT_REGISTER, first=200, count=TEST_WORDS),
    Window(block=Block.TEST, area=Area.HOLDING_REGISTER, first=200, count=TEST_WORDS),
)


def notation(area: Area, address: int) -> str:
    """A 0-based address as PLC manuals write it, counted from 1.

    >>> notation(Area.HOLDING_REGISTER, 0), notation(Area.COIL, 3), notation(Area.INPUT_REGISTER, 10000)
    ('40001', '00004', '310001')
    """
    return f"{area.value}{address + 1:04d}"


def offset_of(table: tuple[Register, ...], name: str) -> int:
    """Where a register lies in its block."""
    return next(register.offset for register in table if register.name == name)


def next_sequence(sequence: int) -> int:
    """The number after this one: 65535 is followed by 1.

    >>> next_sequence(7), next_sequence(65535), next_sequence(0)
    (8, 1, 1)
    """
    return sequence % SEQUENCE_COUNT + 1
