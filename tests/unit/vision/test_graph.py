"""Graphs of pictures small enough to read."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from vision.graph import prune, trace
from vision.thin import guo_hall
from vision.types import Graph


def picture(text: str) -> npt.NDArray[np.bool_]:
    return np.array([[c == "#" for c in line.strip()] for line in text.strip().splitlines()])


def test_a_line_is_one_edge_between_two_end_points() -> None:
    graph = trace(picture("......\n.####.\n......"))

    assert graph.points.tolist() == [[1.0, 1.0], [4.0, 1.0]]
    assert graph.edges.tolist() == [[0, 1]]
    assert graph.paths[0].tolist() == [[1.0, 1.0], [2.0, 1.0], [3.0, 1.0], [4.0, 1.0]]
    assert graph.lengths_px.tolist() == [3.0]


def test_a_cross_is_one_junction_with_four_arms() -> None:
    graph = trace(
        picture(
            """
            ..#..
            ..#..
            #####
            ..#..
            ..#..
            """
        )
    )

    assert sorted(graph.degree.tolist()) == [1, 1, 1, 1, 4]
    assert graph.points[graph.degree == 4].tolist() == [[2.0, 2.0]]


def test_junction_pixels_that_touch_are_one_node() -> None:
    graph = trace(
        picture(
            """
            #....#
            .#..#.
            ..##..
            .#..#.
            #....#
            """
        )
    )

    assert sorted(graph.degree.tolist()) == [1, 1, 1, 1, 4]
    assert graph.points[graph.degree == 4].tolist() == [[2.5, 2.0]]


def test_a_ring_is_one_loop_and_a_dot_is_one_node() -> None:
    graph = trace(picture(".##...\n#..#..\n#..#.#\n.##..."))

    assert len(graph.points) == 2
    assert graph.edges.shape == (1, 2)
    assert graph.edges[0, 0] == graph.edges[0, 1]
    assert sorted(graph.degree.tolist()) == [0, 2]
    assert len(set(graph.component.tolist())) == 2


def test_a_line_along_the_border_of_the_picture_is_kept() -> None:
    graph = trace(np.ones((1, 5), bool))

    assert graph.lengths_px.tolist() == [4.0]


def test_an_empty_picture_has_an_empty_graph() -> None:
    graph = trace(np.zeros((4, 6), bool))

    assert graph.points.shape == (0, 2)
    assert graph.edges.shape == (0, 2)
    assert len(graph.paths) == 0
    assert prune(graph, 5.0).points.shape == (0, 2)


def test_pruning_a_spur_joins_the_line_it_sat_on() -> None:
    graph = trace(
        picture(
            """
            ......#......
            ......#......
            #############
            """
        )
    )

    left = prune(graph, 4.0)

    assert left.points.tolist() == [[0.0, 2.0], [12.0, 2.0]]
    assert left.edges.tolist() == [[0, 1]]
    assert left.lengths_px.tolist() == pytest.approx([12.0], abs=1.0)


def test_the_shortest_twig_of_a_forked_tip_goes_first_and_the_tip_stays_long() -> None:
    mask = np.zeros((9, 30), bool)
    mask[4, :26] = True
    mask[[3, 2, 1], [26, 27, 28]] = True
    mask[[5, 6], [26, 27]] = True

    left = prune(trace(mask), 8.0)

    assert len(left.edges) == 1
    assert [28.0, 1.0] in left.points.tolist()


def test_a_stub_of_a_thin_part_stays_and_a_longer_branch_into_a_bump_of_a_wide_part_goes() -> None:
    mask = np.zeros((120, 200), bool)
    mask[20:61, 20:180] = True  # 41 px wide,
    mask[14:20, 97:103] = True  # with a bump that sticks out by 6, whose branch is 22 px long
    mask[90:95, 20:180] = True  # 5 px wide,
    mask[81:90, 100:105] = True  # with a stub that sticks out by 9, whose branch is 8 px long
    graph = trace(guo_hall(mask))

    def tips(left: Graph) -> list[bool]:
        ends = left.points[left.degree == 1]
        return [bool((np.hypot(*(ends - tip).T) < 8.0).any()) for tip in ((100, 16), (102, 83))]

    assert tips(prune(graph, 4.0, mask)) == [False, True]
    assert [tips(prune(graph, px)) for px in (4.0, 12.0, 30.0)] == [
        [True, True],
        [True, False],
        [False, False],
    ]


def test_paths_are_views_of_one_array() -> None:
    graph = trace(picture("###...\n......\n.#####"))

    flat = graph.flat_paths

    assert flat.starts.tolist() == [0, 3, 8]
    assert [path.tolist() for path in graph.paths] == [path.tolist() for path in graph.paths[:]]
    assert graph.paths[-1].tolist() == flat.pixels[3:].tolist()
    assert not graph.paths[0].flags.writeable
    with pytest.raises(IndexError):
        graph.paths[2]


def test_records_are_closed_for_writing() -> None:
    graph = trace(np.ones((1, 5), bool))

    with pytest.raises(ValueError):
        graph.points[0, 0] = 1.0
