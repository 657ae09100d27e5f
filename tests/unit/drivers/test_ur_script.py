"""URScript texts as they arrive: cut out of the stream, and read as far as needed."""

from __future__ import annotations

import random

import pytest

from drivers.sim.ur_script import (
    ControlScript,
    LineProgram,
    Move,
    Progress,
    SetOutput,
    Sleep,
    Statement,
    Unknown,
    Uploads,
    Write,
    read,
    statement,
)

CONTROL = """def rtde_control():
# HEADER_BEGIN
    global reg_offset_float = # float register offset
24    global reg_offset_int = # int register offset
24    global force_mode_type = 2
    def exec_move_path():
        textmsg("exec_move_path")
        # inject move path
\tsignal_async_progress(0)
\tmovej([0.0,-1.5,1.5,-1.5,-1.5,0.0],a=1.4,v=1.05,r=0.0)
\tsignal_async_progress(1)
\tmovel(p[0.3,-0.2,0.3,3.1,0.0,0.0],a=1.2,v=0.25,r=0.02)
    end
    while True:
      sync()
    end
end
"""
SMALL = "def two():\n\twrite_output_integer_register(0 + 24, 1)\n\tsync()\nend\n"


def test_the_control_script_says_where_its_registers_begin_and_what_path_it_carries() -> None:
    (text,) = Uploads().feed(CONTROL.encode())
    program = read(text)
    assert isinstance(program, ControlScript)
    assert (program.name, program.int_offset, program.float_offset) == ("rtde_control", 24, 24)
    assert program.path == (
        Progress(value=0),
        Move(straight=False, pose=False, target=(0.0, -1.5, 1.5, -1.5, -1.5, 0.0), speed=1.05, accel=1.4),
        Progress(value=1),
        Move(straight=True, pose=True, target=(0.3, -0.2, 0.3, 3.1, 0.0, 0.0), speed=0.25, accel=1.2),
    )


def test_without_a_number_the_registers_begin_at_0_and_there_may_be_no_path() -> None:
    text = CONTROL.replace("24    global", "0    global").replace("# inject move path", "")
    program = read(text)
    assert isinstance(program, ControlScript)
    assert (program.int_offset, program.float_offset, program.path) == (0, 0, ())


def test_programs_are_whole_however_the_stream_was_cut() -> None:
    stream = ("noise before\n" + CONTROL + "\n" + SMALL).encode()
    numbers = random.Random(5)
    for _ in range(20):
        uploads, found, rest = Uploads(), [], stream
        while rest:
            size = numbers.randint(1, 400)
            found += uploads.feed(rest[:size])
            rest = rest[size:]
        assert [text.split("(")[0] for text in found] == ["def rtde_control", "def two"]
        assert found[0] == CONTROL.rstrip("\n")


def test_half_a_program_is_no_program() -> None:
    assert Uploads().feed(CONTROL[:-5].encode()) == []


def test_a_small_program_is_read_line_by_line() -> None:
    program = read(SMALL.rstrip("\n"))
    assert program == LineProgram(
        name="two",
        statements=(Write(register=24, value=1.0, whole=True), Sleep(seconds=0.0)),
        secondary=False,
    )
    assert isinstance(read("sec lamp():\n set_digital_out(3, True)\nend"), LineProgram)


@pytest.mark.parametrize(
    ("line", "wanted"),
    [
        ("set_standard_digital_out(0, True)", SetOutput(bit=0, on=True)),
        ("set_configurable_digital_out(7, False)", SetOutput(bit=15, on=False)),
        ("set_tool_digital_out(1, True)", SetOutput(bit=17, on=True)),
        ("set_tool_digital_out(2, True)", Unknown(line="set_tool_digital_out(2, True)")),
        ("write_output_float_register(3, -1.5e-3)", Write(register=3, value=-1.5e-3, whole=False)),
        ("sleep(0.5)", Sleep(seconds=0.5)),
        ('popup("hello")', Unknown(line='popup("hello")')),
        ("movej([0,0,0], a=1)", Unknown(line="movej([0,0,0], a=1)")),
        ("movej(get_inverse_kin(p[1,2]), a=1)", Unknown(line="movej(get_inverse_kin(p[1,2]), a=1)")),
        ("x = 3", Unknown(line="x = 3")),
        ("sleep(1e400)", Unknown(line="sleep(1e400)")),
    ],
)
def test_statements(line: str, wanted: Statement) -> None:
    assert statement(line) == wanted
