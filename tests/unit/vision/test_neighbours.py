"""Cells: whatever is near is in one's own cell or beside it."""

from __future__ import annotations

import numpy as np
import pytest

from vision.neighbours import cells_of, row_of_cells


@pytest.mark.parametrize("seed", range(6))
def test_everything_within_a_cells_size_is_met_once_and_nothing_beyond_two(seed: int) -> None:
    random = np.random.default_rng(seed)
    at = random.uniform(-300.0, 700.0, (200, 2)) * random.uniform(0.05, 1.0, 2)
    size = float(random.uniform(5.0, 120.0))

    cells = cells_of(at, size)

    for place in range(len(at)):
        met = []
        for turn in range(3):
            first, last = row_of_cells(cells, place, turn)
            met += cells.members[first:last].tolist()
        apart = np.abs(at - at[place]).max(axis=1)
        assert len(met) == len(set(met))
        assert set(np.flatnonzero(apart <= size)) <= set(met)
        assert apart[met].max() <= 2 * size


def test_no_places_have_no_neighbours() -> None:
    assert len(cells_of(np.zeros((0, 2)), 10.0).members) == 0
