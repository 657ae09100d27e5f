"""The RTDE of the simulated UR controller, byte by byte and without a socket."""

from __future__ import annotations

import struct

import pytest

from drivers.sim.ur_codes import Safety
from drivers.sim.ur_core import Core, Setup
from drivers.sim.ur_session import Kind, NotRtde, Owners, Session, frame
from drivers.sim.ur_variables import FORMATS, INPUTS, MASKED_TYPES, OUTPUTS


@pytest.fixture
def core() -> Core:
    return Core(Setup(polyscope=(5, 15, 0)))


@pytest.fixture
def owners() -> Owners:
    return Owners()


@pytest.fixture
def session(core: Core, owners: Owners) -> Session:
    return Session(core, owners, 1)


def ask(session: Session, kind: Kind, payload: bytes = b"") -> tuple[int, bytes]:
    """One package to its one answer: type and payload."""
    (answer,) = session.feed(frame(kind, payload))
    size, told = struct.unpack_from(">HB", answer)
    assert size == len(answer)
    return told, answer[3:]


def outputs(session: Session, *names: str, hertz: float = 500.0) -> tuple[int, list[str]]:
    kind, payload = ask(session, Kind.SETUP_OUTPUTS, struct.pack(">d", hertz) + ",".join(names).encode())
    assert kind == Kind.SETUP_OUTPUTS
    return payload[0], payload[1:].decode().split(",")


def inputs(session: Session, *names: str) -> tuple[int, list[str]]:
    kind, payload = ask(session, Kind.SETUP_INPUTS, ",".join(names).encode())
    assert kind == Kind.SETUP_INPUTS
    return payload[0], payload[1:].decode().split(",")


def test_version_2_is_spoken_and_no_other(session: Session) -> None:
    assert ask(session, Kind.REQUEST_VERSION, b"\x00\x02") == (Kind.REQUEST_VERSION, b"\x01")
    assert ask(session, Kind.REQUEST_VERSION, b"\x00\x01") == (Kind.REQUEST_VERSION, b"\x00")
    assert ask(session, Kind.GET_VERSION) == (Kind.GET_VERSION, struct.pack(">4I", 5, 15, 0, 0))


def test_outputs_come_by_their_recipe(session: Session, core: Core) -> None:
    names = (
        "timestamp",
        "actual_q",
        "runtime_state",
        "robot_mode",
        "actual_digital_output_bits",
        "payload_cog",
    )
    assert outputs(session, *names) == (1, ["DOUBLE", "VECTOR6D", "UINT32", "INT32", "UINT64", "VECTOR3D"])
    assert ask(session, Kind.START) == (Kind.START, b"\x01")
    core.step()
    core.set_output_bit(17, True)
    package = session.package()
    size, kind, recipe, *values = struct.unpack(">HBB d 6d I i Q 3d", package)
    assert (size, kind, recipe) == (len(package), Kind.DATA, 1)
    assert values == [0.002, *core.arm.q, 1, 7, 1 << 17, 0.0, 0.0, 0.0]


def test_every_variable_fits_the_type_it_says(session: Session, core: Core) -> None:
    core.version = (5, 23, 0)
    core.safety = Safety.PROTECTIVE_STOP
    for name, output in OUTPUTS.items():
        number, types = outputs(session, name)
        assert (number, types) == (1, [output.type])
        ask(session, Kind.START)
        assert len(session.package()) == 4 + struct.calcsize(">" + FORMATS[output.type])


def test_an_unknown_output_is_not_found_and_no_recipe_is_made(session: Session) -> None:
    assert outputs(session, "timestamp", "nonsense") == (0, ["DOUBLE", "NOT_FOUND"])
    assert ask(session, Kind.START) == (Kind.START, b"\x00")
    assert not session.started


@pytest.mark.parametrize(
    ("name", "too_old", "old_enough"),
    [
        ("payload", (5, 5, 0), (5, 6, 0)),
        ("ft_raw_wrench", (5, 8, 0), (5, 9, 0)),
        ("payload_inertia", (5, 10, 0), (5, 11, 0)),
        ("actual_current_as_torque", (5, 22, 0), (5, 23, 0)),
    ],
)
def test_younger_variables_are_not_found_on_an_older_polyscope(
    session: Session, core: Core, name: str, too_old: tuple[int, int, int], old_enough: tuple[int, int, int]
) -> None:
    core.version = too_old
    assert outputs(session, name)[1] == ["NOT_FOUND"]
    core.version = old_enough
    assert outputs(session, name)[0] == 1


def test_a_hidden_output_is_not_found(session: Session, owners: Owners) -> None:
    owners.hidden = frozenset({"actual_q"})
    assert outputs(session, "actual_q") == (0, ["NOT_FOUND"])


@pytest.mark.parametrize(("hertz", "every"), [(500.0, 1), (250.0, 2), (125.0, 4), (10.0, 50)])
def test_the_frequency_divides_500_hz(session: Session, hertz: float, every: int) -> None:
    outputs(session, "timestamp", hertz=hertz)
    assert session.every == every


@pytest.mark.parametrize("hertz", [0.0, -1.0, 1e-320, 501.0, float("nan")])
def test_an_impossible_frequency_is_refused(session: Session, hertz: float) -> None:
    assert outputs(session, "timestamp", hertz=hertz)[0] == 0


def test_input_recipes_count_up_and_a_trailing_comma_does_not_matter(session: Session) -> None:
    assert inputs(session, "input_int_register_0", "") == (1, ["INT32"])
    assert inputs(session, "input_int_register_0", "input_double_register_3") == (2, ["INT32", "DOUBLE"])
    assert inputs(session, "nonsense") == (0, ["NOT_FOUND"])
    assert inputs(session, "external_force_torque") == (3, ["VECTOR6D"])


def test_an_input_belongs_to_one_connection_until_that_ends(core: Core, owners: Owners) -> None:
    first, second = Session(core, owners, 1), Session(core, owners, 2)
    assert inputs(first, "input_int_register_0")[0] == 1
    assert inputs(second, "input_int_register_1", "input_int_register_0") == (0, ["INT32", "IN_USE"])
    assert inputs(second, "input_int_register_1")[0] == 1  # a refused recipe owns nothing
    first.end()
    assert inputs(second, "input_int_register_0")[0] == 2


def test_a_fieldbus_holds_its_registers(session: Session, owners: Owners) -> None:
    owners.taken = frozenset({"input_int_register_0"})
    assert inputs(session, "input_int_register_0") == (0, ["IN_USE"])
    assert inputs(session, "input_int_register_24")[0] == 1


def test_values_arrive_without_a_start(session: Session, core: Core) -> None:
    inputs(session, "input_int_register_5", "input_double_register_7")
    (*answers,) = session.feed(frame(Kind.DATA, struct.pack(">B i d", 1, -3, 2.5)))
    assert answers == []
    assert (core.input_ints[5], core.input_doubles[7]) == (-3, 2.5)


def test_every_input_can_be_written(session: Session, core: Core) -> None:
    for number, (name, kind) in enumerate(
        {**{n: i.type for n, i in INPUTS.items()}, **MASKED_TYPES}.items(), 1
    ):
        if number > 255:
            break
        assert inputs(session, name) == (number, [kind])
        size = struct.calcsize(">" + FORMATS[kind])
        assert list(session.feed(frame(Kind.DATA, bytes([number]) + bytes(size)))) == []


def test_outputs_switch_by_mask_in_whatever_order(session: Session, core: Core) -> None:
    inputs(session, "standard_digital_output_mask", "standard_digital_output")
    inputs(session, "tool_digital_output", "tool_digital_output_mask")
    core.io.outputs = 0b1000
    list(session.feed(frame(Kind.DATA, bytes([1, 0b0011, 0b0001]))))
    assert core.io.outputs == 0b1001
    list(session.feed(frame(Kind.DATA, bytes([2, 0b10, 0b10]))))
    assert core.io.outputs == 0b1001 | 1 << 17


def test_the_slider_moves_only_with_its_mask(session: Session, core: Core) -> None:
    inputs(session, "speed_slider_mask", "speed_slider_fraction")
    list(session.feed(frame(Kind.DATA, struct.pack(">B I d", 1, 0, 0.3))))
    assert core.arm.slider == 1.0
    list(session.feed(frame(Kind.DATA, struct.pack(">B I d", 1, 1, 0.3))))
    assert core.arm.slider == 0.3


def test_bits_and_single_bit_registers(session: Session, core: Core) -> None:
    inputs(session, "input_bit_registers0_to_31", "input_bit_register_64", "input_bit_register_127")
    list(session.feed(frame(Kind.DATA, struct.pack(">B I ? ?", 1, 0xF0, True, True))))
    assert core.input_bits == [0xF0, 0, 1, 1 << 31]


def test_a_package_too_short_changes_nothing_and_is_warned_of(session: Session, core: Core) -> None:
    inputs(session, "input_int_register_0", "input_double_register_0")
    kind, payload = ask(session, Kind.DATA, struct.pack(">B i", 1, 7))
    assert kind == Kind.TEXT
    assert b"takes 12 bytes, not 4" in payload
    assert payload[-1] == 2
    assert core.input_ints[0] == 0


def test_bytes_beyond_the_recipe_are_ignored(session: Session, core: Core) -> None:
    inputs(session, "input_int_register_0")
    assert list(session.feed(frame(Kind.DATA, struct.pack(">B i 48x", 1, 7)))) == []
    assert core.input_ints[0] == 7


def test_an_unknown_recipe_or_package_is_answered_by_a_text(session: Session) -> None:
    assert ask(session, Kind.DATA, b"\x09")[0] == Kind.TEXT
    (answer,) = session.feed(struct.pack(">HB", 3, ord("?")))
    assert answer[2] == Kind.TEXT


def test_pause_stops_the_stream_and_start_resumes_it(session: Session) -> None:
    outputs(session, "timestamp")
    ask(session, Kind.START)
    streams = [session.started]
    assert ask(session, Kind.PAUSE) == (Kind.PAUSE, b"\x01")
    streams.append(session.started)
    ask(session, Kind.START)
    streams.append(session.started)
    assert streams == [True, False, True]


def test_a_text_message_of_the_client_is_kept(session: Session, core: Core) -> None:
    assert list(session.feed(frame(Kind.TEXT, b"\x02hi\x02me\x03"))) == []
    assert "hi" in core.events[-1]


def test_frames_may_come_byte_by_byte_or_many_at_once(session: Session) -> None:
    stream = frame(Kind.REQUEST_VERSION, b"\x00\x02") + frame(Kind.GET_VERSION, b"")
    pieces = [answer for i in range(len(stream)) for answer in session.feed(stream[i : i + 1])]
    assert pieces == list(session.feed(stream))
    assert len(pieces) == 2


def test_a_frame_that_cannot_be_one_ends_the_connection(session: Session) -> None:
    with pytest.raises(NotRtde):
        list(session.feed(b"\x00\x02V"))
