"""The bench of first picks: its counts, and that a heap can be drawn again by what is printed."""

from __future__ import annotations

from dataclasses import replace

from bench.first import Answered, answered, sheet


def one(family: str, number: int, first: bool | None, free: bool | None, first_ms: float = 9.0) -> Answered:
    return Answered(
        family=family,
        number=number,
        first=first,
        free=free,
        early=first_ms < 9.0,
        first_ms=first_ms,
        whole_ms=9.0,
    )


def test_wrong_ones_are_counted_and_named_and_heaps_without_a_part_do_not_count() -> None:
    made = sheet(
        [
            one("H10", 0, True, True, 3.0),
            replace(one("H10", 1, None, None), refused="left picture black"),
            one("H20", 0, False, False),
            one("H20", 1, True, False),
        ],
        "command",
    )

    assert made.rows[0][:6] == ("H10", "2", "100.00 (0 of 1)", "100.00 (0 of 1)", "1", "50")
    assert made.rows[1][:6] == ("H20", "2", "50.00 (1 of 2)", "0.00 (2 of 2)", "0", "0")
    assert made.rows[2][:4] == ("all", "4", "66.67 (1 of 3)", "33.33 (2 of 3)")
    assert made.notes[:2] == (
        "H20 number 1: not right, or not to be picked",
        "H20 number 2: something lies on it",
    )


def test_a_heap_drawn_again_is_answered_alike() -> None:
    first, again = (answered("H10", "webcam", 3, 2) for _ in range(2))

    assert (first.family, first.number, first.first, first.free) == ("H10", 2, True, again.free)
    assert 0 < first.first_ms <= first.whole_ms
