"""Whatever a PLC writes where: what lies in the command block lands there, and nothing else changes."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from drivers.plc.served import CONTROL, ServedRegisters
from drivers.plc_map import COMMAND_WORDS, STATUS_WORDS, Area
from tests.fakes.clock import FakeClock

TEST_WORDS = [0x1234] * 8
STATUS_WORDS_SHOWN = list(range(1000, 1000 + STATUS_WORDS))
WRITES = st.lists(
    st.one_of(
        st.tuples(
            st.just(Area.HOLDING_REGISTER),
            st.integers(0, 250),
            st.lists(st.integers(0, 65535), min_size=1, max_size=30),
        ),
        st.tuples(
            st.just(Area.COIL), st.integers(0, 20), st.lists(st.integers(0, 1), min_size=1, max_size=18)
        ),
        st.tuples(
            st.sampled_from([Area.INPUT_REGISTER, Area.DISCRETE_INPUT]),
            st.integers(0, 210),
            st.lists(st.integers(0, 1), min_size=1, max_size=8),
        ),
    ),
    max_size=12,
)


@given(writes=WRITES)
def test_writes_land_in_the_command_block_or_nowhere(writes: list[tuple[Area, int, list[int]]]) -> None:
    registers = ServedRegisters(FakeClock(), TEST_WORDS)
    registers.show(STATUS_WORDS_SHOWN)
    wanted, touched = [0] * COMMAND_WORDS, set()
    for area, address, values in writes:
        last = address + len(values)
        inside = (area is Area.HOLDING_REGISTER and last <= 24) or (area is Area.COIL and last <= 16)
        assert registers.write(area, address, values) is inside
        if not inside:
            continue
        if area is Area.HOLDING_REGISTER:
            wanted[address:last] = values
            touched |= set(range(address, last))
        else:
            for number, on in zip(range(address, last), values, strict=True):
                wanted[CONTROL] = wanted[CONTROL] & ~(1 << number) | on << number
            touched.add(CONTROL)
    taken = registers.take()
    assert list(taken.words) == wanted
    assert set(taken.unwritten) == set(range(COMMAND_WORDS)) - touched
    assert registers.read(Area.HOLDING_REGISTER, 0, COMMAND_WORDS) == wanted
    assert registers.read(Area.COIL, 0, 16) == [wanted[CONTROL] >> i & 1 for i in range(16)]
    assert registers.read(Area.INPUT_REGISTER, 0, STATUS_WORDS) == STATUS_WORDS_SHOWN
    assert registers.read(Area.HOLDING_REGISTER, 100, STATUS_WORDS) == STATUS_WORDS_SHOWN
    assert registers.read(Area.HOLDING_REGISTER, 200, 8) == TEST_WORDS


@given(area=st.sampled_from(list(Area)), address=st.integers(0, 65535), count=st.integers(1, 2000))
def test_only_reading_the_status_word_ends_an_exchange(area: Area, address: int, count: int) -> None:
    registers = ServedRegisters(FakeClock(), TEST_WORDS)
    fetched = registers.show(STATUS_WORDS_SHOWN)
    read = registers.read(area, address, count)
    covered = {
        Area.INPUT_REGISTER: address <= 2 < address + count,
        Area.HOLDING_REGISTER: address <= 102 < address + count,
        Area.DISCRETE_INPUT: True,
        Area.COIL: False,
    }[area]
    assert fetched.is_set() is (read is not None and covered)
