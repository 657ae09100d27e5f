"""Edges looked up where a flank or an end should be, on tables made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from vision.edges import Ids, Reals
from vision.flank import nearest_edge, tip_offset


def board(edges: list[tuple[float, float, float, float]]) -> tuple[Reals, Ids]:
    """Edges x, y and unit direction, as a table with its map (40, 40)."""
    table = np.array([(*edge, 1.0) for edge in edges], np.float32).reshape(-1, 5)
    at = np.full((40, 40), -1, np.int32)
    for number, (x, y, *_) in enumerate(edges):
        at[int(y + 0.5), int(x + 0.5)] = number
    return table, at


def look(edges: list[tuple[float, float, float, float]], taken: tuple[int, ...] = ()) -> tuple[int, float]:
    """The edge nearest to (20, 20) that looks down, within 3 px."""
    table, at = board(edges)
    counts = np.zeros(len(table) + 1, np.uint16)
    counts[list(taken)] = 1
    return nearest_edge(table, at, counts, 20.0, 20.0, 0.0, 1.0, 3.0)


def test_the_nearer_of_two_is_found_with_its_offset() -> None:
    assert look([(20.0, 17.6, 0, 1), (20.0, 21.4, 0, 1)]) == pytest.approx((1, 1.4))
    assert look([(20.0, 18.8, 0, 1), (20.0, 21.4, 0, 1)]) == pytest.approx((0, -1.2))


def test_one_that_looks_away_or_aside_or_is_taken_is_passed_over() -> None:
    assert look([(20.0, 20.0, 0, -1), (20.0, 22.0, 0, 1)])[0] == 1
    assert look([(20.0, 20.0, 1, 0), (20.0, 22.0, 0, 1)])[0] == 1
    assert look([(20.0, 20.0, 0, 1), (20.0, 22.0, 0, 1)], taken=(0,))[0] == 1


def test_beyond_its_reach_and_off_the_picture_there_is_nothing() -> None:
    assert look([(20.0, 23.6, 0, 1)]) == (-1, 0.0)
    table, at = board([(20.0, 20.0, 0, 1)])
    free = np.zeros(2, np.uint16)
    assert nearest_edge(table, at, free, 500.0, -90.0, 0.0, 1.0, 3.0)[0] == -1


def test_an_end_is_where_most_lanes_have_it_and_counts_by_all_of_them() -> None:
    # a face 2 px beyond (20, 20) to the right: bright is to the left
    face = [(22.0, float(y), -1.0, 0.0) for y in range(17, 24)]

    whole = tip_offset(*board(face), np.zeros(8, np.uint16), 20.0, 20.0, 1.0, 0.0, 10.0, 3.0)
    half = tip_offset(*board(face[4:]), np.zeros(8, np.uint16), 20.0, 20.0, 1.0, 0.0, 10.0, 3.0)

    assert whole == pytest.approx((2.0, 5, 1.0))
    assert half == pytest.approx((2.0, 2, 0.4))
