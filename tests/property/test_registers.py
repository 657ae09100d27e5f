"""Packing registers and unpacking them is the identity, in both directions and both word orders."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import cast

from hypothesis import given
from hypothesis import strategies as st

from drivers.plc_codec import WordOrder, decode_command, decode_status, encode_command, encode_status
from drivers.plc_map import COMMAND_WORDS, CRC_OFFSET, STATUS, STATUS_WORDS
from drivers.types import PlcOutputs, ToolPose

ORDERS = st.sampled_from(["big", "little"]).map(lambda order: cast(WordOrder, order))
WORD = st.integers(0, 65535)


@given(words=st.lists(WORD, min_size=STATUS_WORDS, max_size=STATUS_WORDS), order=ORDERS)
def test_any_status_words_survive_the_record(words: list[int], order: WordOrder) -> None:
    words[-3:] = [0, 0, 0]
    assert encode_status(decode_status(words, order), order) == words


@given(words=st.lists(WORD, min_size=COMMAND_WORDS, max_size=COMMAND_WORDS), order=ORDERS)
def test_any_command_words_without_check_word_survive_the_record(words: list[int], order: WordOrder) -> None:
    words[CRC_OFFSET] = 0
    record = decode_command(words, 5.0, order)
    words[2] &= 0b11_1111  # the upper control bits have no meaning and are not kept
    assert encode_command(record, order) == words
    assert record.crc_ok
    assert record.read_at == 5.0


@given(words=st.lists(WORD, min_size=COMMAND_WORDS, max_size=COMMAND_WORDS), order=ORDERS)
def test_a_check_word_that_was_written_is_found_right(words: list[int], order: WordOrder) -> None:
    words[CRC_OFFSET] = 0
    plain = decode_command(words, 0.0, order)
    from_wire = decode_command(encode_command(replace(plain, crc_used=True), order), 0.0, order)
    assert from_wire.crc_ok
    assert from_wire.pose == plain.pose


def test_the_rows_of_the_table_are_the_fields_of_the_record() -> None:
    rows = {r.name for r in STATUS if not r.bits} | {b.name for r in STATUS for b in r.bits}
    pose = {f.name for f in fields(ToolPose)}
    named = {f.name.removesuffix("_s") for f in fields(PlcOutputs)} - {"pose"} | pose
    assert rows == named
