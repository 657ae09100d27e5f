"""RTDE frames, and how old news is."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.robot.rtde import IN_USE, Frame, Frames, Kind, Recipe, RtdeError, frame, text_of
from drivers.robot.ur_codes import Runtime
from drivers.robot.ur_stream import STALE_S, Ageing, snapshot_of
from drivers.types import SafetyMode

RECIPE = Recipe(
    number=1,
    names=("timestamp", "actual_q", "robot_mode", "on", "bits"),
    types=("DOUBLE", "VECTOR6D", "INT32", "BOOL", "UINT64"),
)


@given(
    st.lists(st.tuples(st.sampled_from(list(Kind)), st.binary(max_size=40)), max_size=6),
    st.integers(min_value=1, max_value=17),
)
def test_frames_come_out_as_they_went_in_wherever_the_network_cuts(
    sent: list[tuple[Kind, bytes]], piece: int
) -> None:
    wire = b"".join(frame(kind, body) for kind, body in sent)
    frames = Frames()
    got: list[Frame] = []
    for at in range(0, len(wire), piece):
        got += frames.feed(wire[at : at + piece])
    assert [(one.kind, one.body) for one in got] == sent


def test_a_size_no_frame_can_have_ends_the_conversation() -> None:
    with pytest.raises(RtdeError, match="2 bytes"):
        Frames().feed(struct.pack(">HB", 2, Kind.DATA))


def test_a_recipe_takes_apart_what_it_puts_together() -> None:
    flat = (12.5, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 7, True, 1 << 40)
    values = RECIPE.unpack(RECIPE.pack(flat))
    assert values == {
        "timestamp": 12.5,
        "actual_q": (0.1, 0.2, 0.3, 0.4, 0.5, 0.6),
        "robot_mode": 7,
        "on": True,
        "bits": 1 << 40,
    }


@pytest.mark.parametrize("body", [b"", b"\x01", b"\x02" + bytes(69), b"\x01" + bytes(70)])
def test_data_of_another_recipe_or_length_is_refused(body: bytes) -> None:
    with pytest.raises(RtdeError, match="recipe"):
        RECIPE.unpack(body)


def test_a_recipe_says_what_others_hold() -> None:
    held = Recipe(number=0, names=("a", "b"), types=("DOUBLE", IN_USE))
    assert not held.usable
    assert held.missing(IN_USE) == ("b",)


def test_texts_are_read_and_broken_ones_too() -> None:
    assert text_of(b"\x05hello\x02me\x02") == "me: hello"
    assert text_of(b"\x50short") == "Pshort"


def test_news_that_comes_in_time_is_fresh() -> None:
    ageing = Ageing()
    for i in range(2000):
        ageing.came(100.0 + 0.008 * i, 3.0 + 0.008 * i)
    assert ageing.age_s(3.0 + 0.008 * 1999 + 0.004) == pytest.approx(0.004)


def test_news_that_comes_late_is_as_old_as_it_is_late() -> None:
    ageing = Ageing()
    ageing.came(100.0, 3.0)
    ageing.came(100.5, 4.2)
    assert ageing.age_s(4.2) == pytest.approx(0.7)


def test_a_clock_that_stands_grows_old_though_frames_keep_coming() -> None:
    ageing = Ageing()
    now = 3.0
    ageing.came(100.0, now)
    for _ in range(3000):
        now += 0.008
        assert not ageing.came(100.0, now)
    assert ageing.age_s(now) > 20.0 > STALE_S


def test_clocks_that_drift_apart_stay_fresh() -> None:
    ageing = Ageing()
    oldest = 0.0
    for i in range(500_000):  # over an hour, the controller's clock slower by 100 parts in a million
        now = 0.008 * i
        ageing.came(50.0 + now * (1.0 - 1e-4), now)
        oldest = max(oldest, ageing.age_s(now))
    assert oldest < 0.01


def test_a_controller_that_starts_anew_is_fresh_again() -> None:
    ageing = Ageing()
    ageing.came(5000.0, 3.0)
    ageing.came(1.0, 4.0)
    assert ageing.age_s(4.0) == 0.0


def test_a_frame_becomes_a_snapshot() -> None:
    six = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
    snapshot = snapshot_of(
        {
            "timestamp": 9.0,
            "actual_q": six,
            "actual_qd": (0.0,) * 6,
            "target_qd": (0.0,) * 6,
            "actual_TCP_pose": six,
            "robot_mode": 7,
            "safety_mode": 1,
            "safety_status_bits": 1 << 2,  # the bits say more than the mode: the worse one counts
            "runtime_state": 2,
            "target_speed_fraction": 0.5,
            "actual_digital_input_bits": 1 << 17,
            "actual_digital_output_bits": 3,
            "payload": 0.9,
            "payload_cog": (0.0, 0.0, 0.05),
            "output_int_register_24": 1,
            "output_int_register_26": (5 << 24) | (1 << 15),
        },
        1.0,
        24,
    )
    assert snapshot.safety is SafetyMode.PROTECTIVE_STOP
    assert not snapshot.may_move
    assert (snapshot.operation_id, snapshot.operation_runs, snapshot.moving) == (5, True, False)
    assert snapshot.runtime == Runtime.PLAYING
