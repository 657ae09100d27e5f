"""Places are taken in order, are durable before they are used, and run out loudly."""

from __future__ import annotations

from pathlib import Path

import pytest
from pydantic import ValidationError

from cell.journal import Journal
from cell.operation import GridConfig
from cell.pattern import Places

GRID = GridConfig(rows=2, columns=3, row_pitch_m=(0.0, 0.05), column_pitch_m=(0.02, 0.0))


def test_row_by_row_and_then_full() -> None:
    places = Places(GRID)
    taken = [places.take() for _ in range(6)]
    assert taken == [(0.0, 0.0), (0.02, 0.0), (0.04, 0.0), (0.0, 0.05), (0.02, 0.05), (0.04, 0.05)]
    assert not places.any_free
    assert places.take() is None
    places.free()
    assert places.take() == (0.0, 0.0)


def test_a_pattern_may_wrap() -> None:
    places = Places(GRID.model_copy(update={"when_full": "wrap"}))
    taken = [places.take() for _ in range(7)]
    assert taken[6] == taken[0]


def test_a_box_is_never_full() -> None:
    places = Places()
    assert [places.take() for _ in range(3)] == [(0.0, 0.0)] * 3


def test_places_are_remembered_across_a_restart(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "journal.sqlite")
    journal.open()
    Places(GRID, journal).take()
    journal.close()
    journal.open()
    again = Places(GRID, journal)
    assert again.take() == (0.02, 0.0)
    again.free()
    assert again.take() == (0.0, 0.0)
    journal.close()


def test_places_on_one_another_are_refused() -> None:
    with pytest.raises(ValidationError, match="all would lie in one place"):
        GridConfig(rows=2)
