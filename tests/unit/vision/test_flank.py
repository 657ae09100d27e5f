"""Edges looked up where a flank or an end should be, on tables made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from vision.edges import Signposts, signposts
from vision.flank import nearest_edge, tip_offset


def board(edges: list[tuple[float, float, float, float]]) -> Signposts:
    """Edges x, y and unit direction, with the signposts to them on a canvas of 40 by 40 px."""
    at = np.full((40, 40), -1, np.int32)
    for number, (x, y, *_) in enumerate(edges):
        at[int(y + 0.5), int(x + 0.5)] = number
    return signposts(np.array([(*edge, 1.0) for edge in edges], np.float32).reshape(-1, 5), at)


def look(edges: list[tuple[float, float, float, float]], taken: tuple[int, ...] = ()) -> tuple[int, float]:
    """The edge nearest to (20, 20) that looks down, within 3 px."""
    counts = np.zeros(len(edges) + 1, np.uint16)
    counts[list(taken)] = 1
    return nearest_edge(board(edges), counts, 20.0, 20.0, 0.0, 1.0, 3.0)


def test_the_nearer_of_two_is_found_with_its_offset() -> None:
    assert look([(20.0, 17.6, 0, 1), (20.0, 21.4, 0, 1)]) == pytest.approx((1, 1.4))
    assert look([(20.0, 18.8, 0, 1), (20.0, 21.4, 0, 1)]) == pytest.approx((0, -1.2))


def test_one_that_looks_away_or_aside_or_is_taken_is_passed_over() -> None:
    assert look([(20.0, 20.0, 0, -1), (20.0, 22.0, 0, 1)])[0] == 1
    assert look([(20.0, 20.0, 1, 0), (20.0, 22.0, 0, 1)])[0] == 1
    assert look([(20.0, 20.0, 0, 1), (20.0, 22.0, 0, 1)], taken=(0,))[0] == 1


def test_beyond_its_reach_and_off_the_picture_there_is_nothing() -> None:
    assert look([(20.0, 23.6, 0, 1)]) == (-1, 0.0)
    free = np.zeros(2, np.uint16)
    assert nearest_edge(board([(20.0, 20.0, 0, 1)]), free, 500.0, -90.0, 0.0, 1.0, 3.0)[0] == -1


@pytest.mark.parametrize("turn_deg", range(0, 360, 15))
def test_from_nearly_every_place_near_it_a_flank_is_found_where_it_is(turn_deg: int) -> None:
    """A straight flank at any angle, looked up along directions up to 20 degrees askew, from either side."""
    turn = np.radians(turn_deg)
    look_x, look_y = np.cos(turn), np.sin(turn)
    flank = [(20.0 - k * look_y, 20.0 + k * look_x, look_x, look_y) for k in np.arange(-17.0, 17.5)]
    posts, free = board(flank), np.zeros(len(flank) + 1, np.uint16)
    looks = found = 0
    for along in np.arange(-8.0, 8.5, 0.7):
        for off in np.arange(-2.4, 2.5, 0.6):
            for askew_deg in (-20, 0, 20):
                way = turn + np.radians(askew_deg)
                x, y = 20.0 - along * look_y - off * look_x, 20.0 + along * look_x - off * look_y
                edge, away = nearest_edge(posts, free, x, y, np.cos(way), np.sin(way), 3.0)
                looks += 1
                found += edge >= 0
                if edge >= 0:
                    # one a px beside is as good
                    assert away == pytest.approx(off, abs=0.1 + 1.6 * abs(np.sin(way - turn)))
                assert nearest_edge(posts, free, x, y, -look_x, -look_y, 3.0) == (-1, 0.0)
    assert found > 0.97 * looks


def test_an_end_is_where_most_lanes_have_it_and_counts_by_all_of_them() -> None:
    # a face 2 px beyond (20, 20) to the right: bright is to the left
    face = [(22.0, float(y), -1.0, 0.0) for y in range(17, 24)]

    whole = tip_offset(board(face), np.zeros(8, np.uint16), 20.0, 20.0, 1.0, 0.0, 10.0, 3.0)
    half = tip_offset(board(face[4:]), np.zeros(8, np.uint16), 20.0, 20.0, 1.0, 0.0, 10.0, 3.0)

    assert whole == pytest.approx((2.0, 5, 1.0))
    assert half == pytest.approx((2.0, 2, 0.4))
