"""URScript as it arrives on ports 30001 to 30003: texts cut out of the stream, and what is needed of them.

Not an interpreter. Two kinds of programs are understood: the control script ur-rtde uploads, whose text says
where its registers begin and perhaps a path; and small programs of one statement a line, read statement by
statement. Anything else is an `Unknown` program, and says which line.
"""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass
from typing import TypeAlias

LONGEST_TEXT = 2_000_000
LARGEST = 1e9
"""A program with larger numbers is not understood."""
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_SIX = re.compile(r"(?P<pose>p)?\[(?P<values>[^\]]*)\]")
_NAMED = re.compile(rf"\b(?P<name>[avrt])\s*=\s*(?P<value>{_NUMBER})")
_CALL = re.compile(r"^(?P<name>[a-z_0-9]+)\((?P<arguments>.*)\)$", re.IGNORECASE)


@dataclass(frozen=True, slots=True, kw_only=True)
class Move:
    """``movej``, ``movel`` or ``movep``; ``target`` is joint angles, or a pose. Blends are not gone."""

    straight: bool
    pose: bool
    target: tuple[float, ...]
    speed: float
    accel: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Progress:
    """``signal_async_progress(n)`` of a path."""

    value: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Write:
    """``write_output_integer_register`` or ``write_output_float_register``."""

    register: int
    value: float
    whole: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class SetOutput:
    """``set_standard_digital_out``, ``set_digital_out`` and their kin; ``bit`` in the output word."""

    bit: int
    on: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Sleep:
    """``sleep(seconds)``; ``sync()`` is a sleep of one cycle."""

    seconds: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Unknown:
    """A line nobody here can carry out: the program dies there with a runtime exception."""

    line: str


Statement: TypeAlias = Move | Progress | Write | SetOutput | Sleep | Unknown


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlScript:
    """ur-rtde's control script: where its registers begin, and the path it carries."""

    name: str
    int_offset: int
    float_offset: int
    path: tuple[Statement, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class LineProgram:
    """A program of one statement a line; ``secondary`` runs beside the one that is on."""

    name: str
    statements: tuple[Statement, ...]
    secondary: bool


Program: TypeAlias = ControlScript | LineProgram


class Uploads:
    """Text in pieces in, whole programs out."""

    def __init__(self) -> None:
        self._rest = ""
        self._lines: list[str] = []

    def feed(self, data: bytes) -> list[str]:
        """Whole programs that ended in this piece, in order. Text outside of a program is dropped."""
        self._rest += data.decode("utf-8", "replace")
        *whole, self._rest = self._rest.split("\n")
        if len(self._rest) + sum(map(len, self._lines)) > LONGEST_TEXT:
            self._rest, self._lines = "", []
        done = []
        for line in whole:
            text = line.rstrip("\r")
            if not self._lines and not text.startswith(("def ", "sec ")):
                continue
            self._lines.append(text)
            if text.rstrip() == "end":
                done.append("\n".join(self._lines))
                self._lines = []
        return done


def read(text: str) -> Program:
    """A whole text as a program."""
    head, _, _ = text.partition("\n")
    name = head.removeprefix("def ").removeprefix("sec ").partition("(")[0].strip()
    lines = text.split("\n")[1:-1]
    if "# int register offset" in text:
        return ControlScript(
            name=name,
            int_offset=_digits_after(lines, "# int register offset"),
            float_offset=_digits_after(lines, "# float register offset"),
            path=_injected(lines),
        )
    bare = [line.strip() for line in lines]
    return LineProgram(
        name=name,
        statements=tuple(statement(line) for line in bare if line and not line.startswith(("#", "$"))),
        secondary=head.startswith("sec "),
    )


def _digits_after(lines: list[str], mark: str) -> int:
    """The number the line after this comment begins with; 0 where there is none."""
    for here, following in itertools.pairwise(lines):
        if mark in here:
            found = re.match(r"\s*(\d+)", following)
            return int(found.group(1)) if found is not None else 0
    return 0


def _injected(lines: list[str]) -> tuple[Statement, ...]:
    marks = [i for i, line in enumerate(lines) if "# inject move path" in line]
    if not marks:
        return ()
    path = []
    for line in lines[marks[0] + 1 :]:
        bare = line.strip()
        if bare == "end":
            break
        if bare and not bare.startswith("#"):
            path.append(statement(bare))
    return tuple(path)


def statement(line: str) -> Statement:
    """One line of a small program."""
    call = _CALL.match(line)
    if call is None:
        return Unknown(line=line)
    name, arguments = call.group("name"), call.group("arguments")
    if name in ("movej", "movel", "movep"):
        return _move(name, arguments) or Unknown(line=line)
    values = _numbers(arguments)
    if values is None:
        return Unknown(line=line)
    match name, values:
        case "signal_async_progress", [value]:
            return Progress(value=int(value))
        case "write_output_integer_register", [register, value]:
            return Write(register=int(register), value=value, whole=True)
        case "write_output_float_register", [register, value]:
            return Write(register=int(register), value=value, whole=False)
        case (("set_standard_digital_out" | "set_digital_out"), [pin, on]) if 0 <= pin < 8:
            return SetOutput(bit=int(pin), on=bool(on))
        case "set_configurable_digital_out", [pin, on] if 0 <= pin < 8:
            return SetOutput(bit=8 + int(pin), on=bool(on))
        case "set_tool_digital_out", [pin, on] if 0 <= pin < 2:
            return SetOutput(bit=16 + int(pin), on=bool(on))
        case "sleep", [seconds]:
            return Sleep(seconds=seconds)
        case "sync", []:
            return Sleep(seconds=0.0)
    return Unknown(line=line)


def _numbers(arguments: str) -> list[float] | None:
    """Plain numbers, sums of two whole ones (``0 + 24``), True and False; None for anything else."""
    values = []
    for each in filter(None, (part.strip() for part in arguments.split(","))):
        if each in ("True", "False"):
            values.append(float(each == "True"))
            continue
        is_sum = re.fullmatch(r"\d+\s*\+\s*\d+", each) is not None
        terms = [term.strip() for term in each.split("+")] if is_sum else [each]
        if not all(re.fullmatch(_NUMBER, term) for term in terms):
            return None
        values.append(sum(map(float, terms)))
    return values if all(abs(value) <= LARGEST for value in values) else None


def _move(name: str, arguments: str) -> Move | None:
    target = _SIX.search(arguments)
    if target is None:
        return None
    values = _numbers(target.group("values"))
    named = {found["name"]: float(found["value"]) for found in _NAMED.finditer(arguments)}
    if values is None or len(values) != 6:
        return None
    straight = name != "movej"
    return Move(
        straight=straight,
        pose=target.group("pose") is not None,
        target=tuple(values),
        speed=named.get("v", 0.25 if straight else 1.05),
        accel=named.get("a", 1.2 if straight else 1.4),
    )
