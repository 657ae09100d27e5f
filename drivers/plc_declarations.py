"""The register map as declarations for PLC programs, made from `drivers.plc_map`. Pure: text out.

Structures lie over the words as they come off the wire, so their layout is the controller's own: S7 keeps
words big-endian and numbers bits of a word from its second byte; CODESYS and Logix run on little-endian
processors. Where the words of a 32-bit value do not lie as the controller would have them, the value is
declared as its two words, with a function that puts them together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final, Literal, TypeAlias, assert_never

from drivers.plc_codec import WordOrder
from drivers.plc_map import (
    COMMAND,
    COMMAND_WORDS,
    MAP_VERSION,
    SERVER_WINDOWS,
    STATUS,
    STATUS_WORDS,
    TEST,
    TEST_WORDS,
    Area,
    Block,
    Kind,
    Register,
)
from drivers.types import PlcCommand, ResultCode

Dialect: TypeAlias = Literal["siemens-scl", "codesys", "rockwell-csv"]
DIALECTS: Final[tuple[Dialect, ...]] = ("siemens-scl", "codesys", "rockwell-csv")

_BLOCKS: Final = (
    (Block.COMMAND, "MikadoCommand", COMMAND, COMMAND_WORDS, "command block, PLC to cell"),
    (Block.STATUS, "MikadoStatus", STATUS, STATUS_WORDS, "status block, cell to PLC"),
    (Block.TEST, "MikadoTest", TEST, TEST_WORDS, "test registers, cell to PLC"),
)


def declarations(dialect: Dialect, word_order: WordOrder) -> str:
    """A whole file, with the line ends its tools expect."""
    match dialect:
        case "siemens-scl":
            return _text(_siemens(word_order))
        case "codesys":
            return _text(_codesys(word_order))
        case "rockwell-csv":
            return _text(_rockwell(word_order))
        case _:
            assert_never(dialect)


def _text(lines: Iterator[str]) -> str:
    return "\r\n".join(lines) + "\r\n"


def _first(block: Block) -> int:
    """Holding register at which a block begins by default, in either role."""
    return next(w.first for w in SERVER_WINDOWS if w.block is block and w.area is Area.HOLDING_REGISTER)


def _scale(register: Register) -> str:
    return f" [1/{register.per_unit} {register.unit}]".replace(" ]", "]") if register.per_unit != 1 else ""


def _bit_names(register: Register) -> list[tuple[int, str, str]]:
    """All 16 bits: number, name, meaning."""
    named = {bit.number: (bit.name, bit.meaning) for bit in register.bits}
    prefix = register.name
    return [(i, *named.get(i, (f"{prefix}_bit_{i}", "not used"))) for i in range(16)]


def _head(mark: Callable[[str], str], word_order: WordOrder) -> Iterator[str]:
    first = "high" if word_order == "big" else "low"
    yield mark(f"Mikado, register map v{MAP_VERSION}; made by: mikado plc export")
    yield mark(
        f"32-bit values: {first} word first (plc.word_order: {word_order}); counts, see the scale in [ ]"
    )


def _codes(mark: Callable[[str], str]) -> Iterator[str]:
    yield mark("cmd_code: " + ", ".join(f"{int(c)} {c.name}" for c in PlcCommand))
    yield mark("ack_code, result_code: " + ", ".join(f"{int(c)} {c.name}" for c in ResultCode))


# --------------------------------------------------------------------------- Siemens

_S7_TYPE: Final = {
    Kind.UINT16: "UInt",
    Kind.INT16: "Int",
    Kind.UINT32: "UDInt",
    Kind.INT32: "DInt",
    Kind.BITS: "Struct",
}


def _siemens(word_order: WordOrder) -> Iterator[str]:
    """An external source for TIA Portal: types, one data block with standard access, conversions."""
    mark = "// {}".format
    yield from _head(mark, word_order)
    yield from _codes(mark)
    swapped = word_order == "little"
    if swapped:
        yield from (
            "",
            'TYPE "MikadoSwapped"',
            "VERSION : 0.1",
            "   STRUCT",
            "      low : Word;",
            "      high : Word;",
            "   END_STRUCT;",
            "",
            "END_TYPE",
        )
        for name, kind in (("MikadoDInt", "DInt"), ("MikadoUDInt", "UDInt")):
            yield from (
                "",
                f'FUNCTION "{name}" : {kind}',
                "{ S7_Optimized_Access := 'TRUE' }",
                "VERSION : 0.1",
                "   VAR_INPUT",
                '      value : "MikadoSwapped";',
                "   END_VAR",
                "BEGIN",
                f"   #{name} := DWORD_TO_{kind.upper()}(SHL(IN := WORD_TO_DWORD(#value.high), N := 16)"
                " OR WORD_TO_DWORD(#value.low));",
                "END_FUNCTION",
            )
    for _, name, table, _, title in _BLOCKS:
        yield from ("", f'TYPE "{name}"', f"// {title}", "VERSION : 0.1", "   STRUCT")
        for register in table:
            yield from _siemens_field(register, swapped)
        yield from ("   END_STRUCT;", "", "END_TYPE")
    yield from _siemens_data()


def _siemens_field(register: Register, swapped: bool) -> Iterator[str]:
    remark = f"   // {register.offset}: {register.meaning}{_scale(register)}"
    kind = _S7_TYPE[register.kind]
    if register.kind is Kind.BITS:
        yield f"      {register.name} : Struct{remark}"
        bits = _bit_names(register)
        for number, name, meaning in bits[8:] + bits[:8]:  # byte 0 of a word holds its upper half
            yield f"         {name} : Bool;   // bit {number}: {meaning}"
        yield "      END_STRUCT;"
        return
    if register.kind.words == 2 and swapped:
        kind = '"MikadoSwapped"'
    yield f"      {register.name} : {kind};{remark}"


def _siemens_data() -> Iterator[str]:
    """What MB_SERVER's MB_HOLD_REG or MB_CLIENT's MB_DATA_PTR points at: word n is holding register n."""
    yield from (
        "",
        'DATA_BLOCK "MikadoData"',
        "{ S7_Optimized_Access := 'FALSE' }",
        "VERSION : 0.1",
        "NON_RETAIN",
        "   STRUCT",
    )
    at = 0
    for block, name, _, words, _ in _BLOCKS:
        if _first(block) > at:
            yield f"      unused_{at} : Array[0..{_first(block) - at - 1}] of Word;"
        yield f'      {block.name.lower()} : "{name}";   // holding register {_first(block)}'
        at = _first(block) + words
    yield from ("   END_STRUCT;", "", "BEGIN", "", "END_DATA_BLOCK")


# --------------------------------------------------------------------------- CODESYS, TwinCAT

_IEC_TYPE: Final = {
    Kind.UINT16: "UINT",
    Kind.INT16: "INT",
    Kind.UINT32: "UDINT",
    Kind.INT32: "DINT",
    Kind.BITS: "bits",
}


def _codesys(word_order: WordOrder) -> Iterator[str]:
    """Types to paste into the project, one object each; a union lays each block over its words."""
    mark = "// {}".format
    yield from _head(mark, word_order)
    swapped = word_order == "big"
    if swapped:
        yield mark("with plc.word_order: little the 32-bit values need no conversion on this controller")
        yield from (
            "",
            "{attribute 'pack_mode' := '1'}",
            "TYPE MikadoSwapped :",
            "STRUCT",
            "    high : WORD;",
            "    low : WORD;",
            "END_STRUCT",
            "END_TYPE",
        )
        for name, kind in (("MikadoDint", "DINT"), ("MikadoUdint", "UDINT")):
            yield from (
                "",
                f"FUNCTION {name} : {kind}",
                "VAR_INPUT",
                "    value : MikadoSwapped;",
                "END_VAR",
                f"{name} := DWORD_TO_{kind}(SHL(WORD_TO_DWORD(value.high), 16) OR WORD_TO_DWORD(value.low));",
                "END_FUNCTION",
            )
    for enum, codes in (("MikadoCommandCode", PlcCommand), ("MikadoResultCode", ResultCode)):
        members = ", ".join(f"{code.name} := {int(code)}" for code in codes)
        yield from ("", "{attribute 'qualified_only'}", f"TYPE {enum} : ({members}) UINT;", "END_TYPE")
    for _, name, table, words, title in _BLOCKS:
        for register in table:
            if register.bits:
                yield from _codesys_bits(name, register)
        yield from ("", "{attribute 'pack_mode' := '1'}", f"TYPE {name} :   // {title}", "STRUCT")
        for register in table:
            kind = _IEC_TYPE[register.kind]
            if register.bits:
                kind = _bits_type(name, register)
            elif register.kind.words == 2 and swapped:
                kind = "MikadoSwapped"
            remark = f"{register.offset}: {register.meaning}{_scale(register)}"
            yield f"    {register.name} : {kind};   // {remark}"
        yield from ("END_STRUCT", "END_TYPE")
        yield from (
            "",
            f"TYPE {name}Block :   // holding registers {_first_of(name)} to {_first_of(name) + words - 1}",
            "UNION",
            f"    words : ARRAY[0..{words - 1}] OF WORD;",
            f"    fields : {name};",
            "END_UNION",
            "END_TYPE",
        )


def _first_of(name: str) -> int:
    return next(_first(block) for block, other, *_ in _BLOCKS if other == name)


def _bits_type(block: str, register: Register) -> str:
    return block + "".join(part.capitalize() for part in register.name.split("_"))


def _codesys_bits(block: str, register: Register) -> Iterator[str]:
    yield from ("", "{attribute 'pack_mode' := '1'}", f"TYPE {_bits_type(block, register)} :", "STRUCT")
    for number, name, meaning in _bit_names(register):
        yield f"    {name} : BIT;   // bit {number}: {meaning}"
    yield from ("END_STRUCT", "END_TYPE")


# --------------------------------------------------------------------------- Rockwell

_WORDS_TAG: Final = {"MikadoCommand": "Mikado_C", "MikadoStatus": "Mikado_S", "MikadoTest": "Mikado_T"}
_TAG_ATTRIBUTES: Final = '"(RADIX := Decimal, Constant := false, ExternalAccess := Read/Write)"'
_ALIAS_ATTRIBUTES: Final = '"(RADIX := Decimal, ExternalAccess := Read/Write)"'


def _rockwell(word_order: WordOrder) -> Iterator[str]:
    """A tag list for Studio 5000: the words of each block as INT[], everything else an alias of them."""

    def remark(text: str) -> str:
        return f'remark,"{_escaped(text)}"'

    yield remark("CSV-Import-Export")
    yield from _head(remark, word_order)
    if word_order == "big":
        yield remark("with plc.word_order: little a COP of two words makes a DINT on this controller")
    remark("INT is signed: add 65536 to what reads negative; two of them compare for equality as they are")
    yield from _codes(remark)
    yield "0.3"
    yield "TYPE,SCOPE,NAME,DESCRIPTION,DATATYPE,SPECIFIER,ATTRIBUTES"
    for _, name, table, words, title in _BLOCKS:
        tag = _WORDS_TAG[name]
        yield _tag(tag, title, f"INT[{words}]")
        for register in table:
            yield from _rockwell_rows(tag, register, word_order)


def _tag(name: str, description: str, datatype: str) -> str:
    return f'TAG,,{name},"{_escaped(description)}","{datatype}","",{_TAG_ATTRIBUTES}'


def _alias(name: str, description: str, where: str) -> str:
    return f'ALIAS,,{name},"{_escaped(description)}","","{where}",{_ALIAS_ATTRIBUTES}'


def _escaped(text: str) -> str:
    """Quotes as Logix writes them in text."""
    return text.replace("$", "$$").replace("'", "$'").replace('"', "$Q")


def _rockwell_rows(tag: str, register: Register, word_order: WordOrder) -> Iterator[str]:
    name, at = f"{tag}_{register.name}", register.offset
    what = f"{register.meaning}{_scale(register)}"
    if register.kind.words == 1:
        yield _alias(name, what, f"{tag}[{at}]")
        for bit in register.bits:
            yield _alias(f"{tag}_{bit.name}", bit.meaning, f"{tag}[{at}].{bit.number}")
        return
    high, low = (at, at + 1) if word_order == "big" else (at + 1, at)
    how = (
        f"COP({tag}[{at}], {name}, 1)"
        if word_order == "little"
        else f"{name}_high * 65536 OR ({name}_low AND 65535)"
    )
    yield _tag(name, f"{what}: {how}", "DINT")
    yield _alias(f"{name}_high", f"{what}, high word", f"{tag}[{high}]")
    yield _alias(f"{name}_low", f"{what}, low word", f"{tag}[{low}]")
