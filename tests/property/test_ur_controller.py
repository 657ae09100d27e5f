"""Whatever comes over the wire, the simulated UR controller goes on and says only what its protocols know."""

from __future__ import annotations

import struct

from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.sim.ur_core import Core, Setup
from drivers.sim.ur_dashboard import Dashboard
from drivers.sim.ur_faults import Faults
from drivers.sim.ur_motion import Trapezoid
from drivers.sim.ur_ports import Ports
from drivers.sim.ur_program import MOVES, STOPS
from drivers.sim.ur_script import Uploads, statement
from drivers.sim.ur_session import Kind, NotRtde, Owners, Session, frame

SCRIPT = "def c():\n  x = # float register offset\n0  y = # int register offset\n0 z\nend"
QUICK = settings(max_examples=60, deadline=None)
KINDS = st.sampled_from([int(kind) for kind in Kind]) | st.integers(0, 255)
NAMES = st.sampled_from(
    ["timestamp", "actual_q", "input_int_register_0", "speed_slider_mask", "tool_digital_output", "x", ""]
)


class Machine:
    """What the fault port may stop."""

    standing = False
    world = "none"


def payloads() -> st.SearchStrategy[bytes]:
    """Nonsense, and things that look like a recipe."""
    recipe = st.lists(NAMES, max_size=6).map(lambda names: ",".join(names).encode())
    with_hertz = st.tuples(st.floats(), recipe).map(lambda both: struct.pack(">d", both[0]) + both[1])
    return st.binary(max_size=40) | recipe | with_hertz


@QUICK
@given(st.lists(st.tuples(KINDS, payloads()), max_size=12))
def test_any_packages_are_answered_by_whole_packages(packages: list[tuple[int, bytes]]) -> None:
    core = Core(Setup())
    session = Session(core, Owners(), 1)
    for kind, payload in packages:
        stream = struct.pack(">HB", 3 + len(payload), kind) + payload
        for answer in session.feed(stream):
            assert struct.unpack_from(">H", answer) == (len(answer),)
        core.step()
        if session.started and session.every:
            package = session.package()
            assert struct.unpack_from(">H", package) == (len(package),)


@QUICK
@given(st.binary(max_size=200))
def test_any_bytes_end_a_session_or_are_waited_for(data: bytes) -> None:
    session = Session(Core(Setup()), Owners(), 1)
    try:
        list(session.feed(data))
    except NotRtde:
        return


def commands() -> st.SearchStrategy[tuple[int, list[float], int]]:
    """A command of the control script, registers with numbers of every kind, asynchronous or not."""
    others = {8, 17, 26, 28, 29, 30, 35, 36, 37, 39, 44, 46, 60, 61, 65}
    known = st.sampled_from(sorted(MOVES | STOPS | others))
    numbers = st.floats() | st.floats(-4.0, 4.0)
    return st.tuples(known, st.lists(numbers, min_size=14, max_size=14), st.integers(0, 1))


@QUICK
@given(st.lists(commands(), min_size=1, max_size=4))
def test_any_registers_leave_a_controller_that_can_be_read(
    orders: list[tuple[int, list[float], int]],
) -> None:
    core = Core(Setup())
    session = Session(core, Owners(), 1)
    names = b"timestamp,actual_q,actual_qd,actual_TCP_pose,actual_TCP_speed,output_int_register_2,payload"
    list(session.feed(frame(Kind.SETUP_OUTPUTS, struct.pack(">d", 500.0) + names)))
    core.upload(SCRIPT)
    for command, doubles, asynchronous in orders:
        core.input_doubles[:14] = doubles
        core.input_ints[:2] = [command, asynchronous]
        for _ in range(60):
            core.step()
        core.input_ints[0] = 0
        core.step()
        assert len(session.package()) == 4 + 8 + 4 * 48 + 4 + 8
        assert core.arm.within_limits(core.arm.q)
        assert all(abs(v) < 4.0 for v in core.arm.qd)


@QUICK
@given(st.lists(st.text(max_size=60), max_size=8), st.lists(st.integers(1, 50), min_size=1, max_size=8))
def test_any_text_is_cut_into_programs_that_run_or_die(lines: list[str], sizes: list[int]) -> None:
    core, uploads = Core(Setup()), Uploads()
    stream = ("def p():\n" + "\n".join(lines) + "\nend\n").encode()
    programs: list[str] = []
    while stream:
        for size in sizes:
            programs += uploads.feed(stream[:size])
            stream = stream[size:]
    for text in programs:
        core.upload(text)
        for _ in range(30):
            core.step()


@QUICK
@given(
    st.sampled_from(["movej", "movel", "sleep", "write_output_integer_register", "set_digital_out", "x"]),
    st.lists(st.floats() | st.integers(), max_size=8),
)
def test_any_numbers_in_a_small_program_are_carried_out_or_not_understood(
    name: str, values: list[float]
) -> None:
    line = f"{name}({', '.join(map(repr, values))})"
    statement(line)
    core = Core(Setup())
    core.upload(f"def p():\n{line}\n{name}([{', '.join(map(repr, values))}], a=1, v=1)\nend")
    for _ in range(60):
        core.step()


@QUICK
@given(st.text(max_size=80))
def test_any_line_of_the_dashboard_has_one_line_as_its_answer(line: str) -> None:
    answer = Dashboard(Core(Setup())).answer(line)
    assert "\n" not in answer
    assert answer


@QUICK
@given(
    st.binary(max_size=80)
    | st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(max_size=8),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    ).map(lambda value: repr(value).encode("utf-8", "replace"))
)
def test_any_line_of_the_fault_port_is_answered(line: bytes) -> None:
    ports = Ports("127.0.0.1", seed=0)
    try:
        assert "error" in Faults(Core(Setup()), ports, Owners(), Machine()).answer(line)
    finally:
        ports.close()


@QUICK
@given(st.floats(1e-4, 3.0), st.floats(1e-3, 4.0), st.floats(1e-2, 20.0), st.floats(0.0, 1.0))
def test_a_trapezoid_never_turns_back_nor_passes_its_speed(
    length: float, speed: float, accel: float, share: float
) -> None:
    profile = Trapezoid(length, speed, accel)
    here, v = profile.at(share * profile.duration_s)
    later, _ = profile.at(share * profile.duration_s + 1e-3)
    assert -1e-12 <= here <= later + 1e-9 <= length + 2e-9
    assert v <= speed * (1.0 + 1e-9)
