"""The page of registers for a PLC programmer, made from the map."""

from __future__ import annotations

from cell.handshake import SUPPORTED
from drivers.plc_codec import crc16, encode_example
from drivers.plc_map import (
    COMMAND,
    COMMAND_WORDS,
    CRC_WORDS,
    SERVER_WINDOWS,
    STATUS,
    TEST,
    Area,
    Block,
    Kind,
    Register,
    Window,
    notation,
)
from drivers.types import PlcCommand, ResultCode

_AREAS = {
    Area.COIL: ("coils", "1, 5, 15"),
    Area.DISCRETE_INPUT: ("discrete inputs", "2"),
    Area.INPUT_REGISTER: ("input registers", "4"),
    Area.HOLDING_REGISTER: ("holding registers", "3"),
}
_WRITES = {Area.HOLDING_REGISTER: "3, 6, 16, 22, 23", Area.COIL: "1, 5, 15"}

INTRODUCTION = """\
One map for both roles. Which role your PLC takes is `plc.driver` in the cell's file; see [Connect a
PLC](../recipes/plc.md). Declarations for your PLC come from the same map: `mikado plc export --dialect
siemens-scl|codesys|rockwell-csv --out FILE`.

**Addresses** are given twice: the offset, 0-based as it goes over the wire, and PLC notation counted from 1
(4xxxx holding registers, 3xxxx input registers, 1xxxx discrete inputs, 0xxxx coils). If everything seems to
be one register off, your PLC counts the other way.

**Values.** UINT16 and INT16 take one register. UINT32 and INT32 take two, the high word first, or the low
word first with `word_order: little`. There are no floats: a position is an INT32 in micrometres, an angle
(rotation vector) in microradians; the column *scale* says what one count is. Examples are in hex, words in
the order of `word_order: big`.

**One order.** Wait for `ready`. Write the payload (words 4-21), then `cmd_seq`, the number after the last
one you used. The cell answers `accepted_seq` with `ack_code` 0 (taken) or a code from the table below
(refused, nothing moves). When it is done it writes the result, then `result_seq`, then `result_valid`. Copy
the result, write its number to `result_ack_seq`; `result_valid` drops and `ready` comes back. A sequence
number is executed at most once, also across a restart of the cell: an order that was cut short ends with
42.

**Heartbeats.** Yours must count at least every 500 ms; if it stands for 1.5 s the arm is stopped, the order
ends with 41, and `enable` has to go low and high again. Ours counts every 250 ms; if it stands for 1.5 s
the cell is not there and its bits are old. Neither side judges by the TCP connection.

**Check word.** With word 22 the cell takes an order as soon as it reads it; without it (0), when two reads
in a row show the same. An example follows. Modbus is not a safety function.
"""

PLACES = """\
**The PLC is the server** (`driver: modbus`): two blocks of holding registers in the PLC, C at `read_base`
(default 0) and S at `write_base` (default 100); the cell uses function codes 3 and 16. With `test_base` the
cell also writes the eight test registers there, each time it connects.

**The cell is the server** (`driver: modbus_server`): any unit number. Writes and reads elsewhere are refused
with exception 2, other function codes with exception 1, broken requests with exception 3. Read a block with
one request, and the status word at least every 0.3 s; write all 24 words of C, again and again.
"""


def page() -> str:
    """The whole page, without its note."""
    lines = [INTRODUCTION, *_check_word(), *_places()]
    lines += _table(COMMAND, Block.COMMAND, "Command block C (PLC to cell)")
    lines += _table(STATUS, Block.STATUS, "Status block S (cell to PLC)")
    lines += _table(TEST, Block.TEST, "Test registers T (cell to PLC)")
    lines += ["\n## Commands (`cmd_code`)\n", "| code | name | |", "|---|---|---|"]
    lines += [
        f"| {int(c)} | {c.name} | {'' if c in SUPPORTED else 'not yet: answered with 50'} |"
        for c in PlcCommand
    ]
    lines += ["\n## Result and acknowledge codes\n", "| code | name |", "|---|---|"]
    lines += [f"| {int(code)} | {code.name} |" for code in ResultCode]
    return "\n".join(lines) + "\n"


def _check_word() -> list[str]:
    """One order with its check word, to try a PLC's own computation against."""
    words = [0] * COMMAND_WORDS
    words[3:9] = [1, 3, 1, 0, 0, 3]
    shown = " ".join(f"{word:04X}" for word in words[CRC_WORDS])
    return [f"    words 3-21: {shown}", f"    word 22:    {crc16(words[CRC_WORDS]):04X}\n"]


def _places() -> list[str]:
    lines = [
        "## Where the blocks are\n",
        PLACES,
        "| what | table | offset | PLC notation | function codes |",
        "|---|---|---|---|---|",
    ]
    for window in SERVER_WINDOWS:
        table, reads = _AREAS[window.area]
        codes = _WRITES[window.area] if window.writable else reads
        last = window.first + window.count - 1
        lines.append(
            f"| {window.block.value}{'' if window.writable else ', read only'} | {table} | "
            f"{window.first}-{last} | {notation(window.area, window.first)}-{notation(window.area, last)} | "
            f"{codes} |"
        )
    return lines


def _windows(block: Block) -> list[Window]:
    return [w for w in SERVER_WINDOWS if w.block is block]


def _table(rows: tuple[Register, ...], block: Block, title: str) -> list[str]:
    windows = _windows(block)
    bits = {
        Block.COMMAND: _windows(Block.CONTROL_BITS),
        Block.STATUS: _windows(Block.STATUS_BITS),
    }.get(block, [])
    heads = " | ".join(f"{w.area.value}xxxx" for w in windows)
    lines = [
        f"\n## {title}\n",
        f"| offset | {heads} | name | type | scale | example, hex | meaning |",
        "|---|" + "---|" * len(windows) + "---|---|---|---|---|",
    ]
    for row in rows:
        last = row.offset + row.kind.words - 1
        offset = str(row.offset) if last == row.offset else f"{row.offset}-{last}"
        scale = f"1/{row.per_unit} {row.unit}".rstrip() if row.per_unit != 1 else row.unit
        places = [notation(w.area, w.first + row.offset) for w in windows]
        cells = (offset, *places, row.name, row.kind.value, scale, _example(row), row.meaning)
        lines.append("| " + " | ".join(cells) + " |")
        for bit in row.bits:
            where = ", ".join(notation(w.area, w.first + bit.number) for w in bits)
            empty = "| " * len(windows)
            name, mask = f"· bit {bit.number} {bit.name}", f"{1 << bit.number:04X}"
            lines.append(f"| {empty}| {name} | {where} | | {mask} | {bit.meaning} |")
    return lines


def _example(row: Register) -> str:
    if row.kind is Kind.BITS:
        return ""
    words = " ".join(f"{word:04X}" for word in encode_example(row))
    value = f"{row.example:g}" if row.per_unit == 1 or abs(row.example) >= 1e-3 else f"{row.example}"
    if isinstance(row.example, int):
        value = str(row.example)
    return f"{value} {row.unit}".rstrip() + f" = {words}"
