"""The left graph in space: which nodes, which couples, how straight the ways are."""

import numpy as np
import pytest

from vision import graph as graphs
from vision import reconstruct, transforms
from vision.stereo import rectification
from vision.types import CameraModel, Graph, Matches, StereoModel

CAMERA = CameraModel(
    matrix=np.array([[600.0, 0, 320], [0, 600.0, 240], [0, 0, 1]]),
    distortion=np.zeros(5),
    width_px=640,
    height_px=480,
)
RECT = rectification(
    StereoModel(left=CAMERA, right=CAMERA, right_from_left=transforms.make(np.zeros(3), [-0.08, 0.0, 0.0]))
)


def traced(*strokes: tuple[int, int, int, int]) -> Graph:
    """The graph of straight horizontal or vertical strokes (u0, v0, u1, v1), both ends included."""
    skeleton = np.zeros((480, 640), np.bool_)
    for u0, v0, u1, v1 in strokes:
        skeleton[v0 : v1 + 1, u0 : u1 + 1] = True
    return graphs.trace(skeleton)


def by_shift(left: Graph, right: Graph, disparity: float = 120.0) -> Matches:
    """Nodes that lie exactly ``disparity`` columns apart."""
    expected = left.points - [disparity, 0.0]
    away = np.linalg.norm(expected[:, None] - right.points[None], axis=2)
    left_index, right_index = np.nonzero(away < 0.5)
    return Matches(
        left=left_index.astype(np.int64),
        right=right_index.astype(np.int64),
        cost_px=np.zeros(len(left_index)),
        unmatched=0,
        ambiguous=0,
    )


PLUS = ((200, 200, 300, 200), (250, 150, 250, 250))
SHIFTED_PLUS = ((80, 200, 180, 200), (130, 150, 130, 250))


def test_a_plus_in_space_has_five_nodes_at_one_depth() -> None:
    left, right = traced(*PLUS), traced(*SHIFTED_PLUS)
    found = reconstruct.space_graph(left, right, by_shift(left, right), RECT)
    assert sorted(found.degree.tolist()) == [1, 1, 1, 1, 4]
    np.testing.assert_allclose(found.points[:, 2], 0.4, atol=1e-9)
    assert len(found.edges) == 4


def test_edges_become_segments_with_their_length_in_metres() -> None:
    left, right = traced(*PLUS), traced(*SHIFTED_PLUS)
    found = reconstruct.edge_segments(reconstruct.space_graph(left, right, by_shift(left, right), RECT))
    lengths = np.linalg.norm(found.end - found.start, axis=1)
    np.testing.assert_allclose(lengths, 50 * 0.4 / 600, rtol=0.03)
    assert sorted(found.edge.tolist()) == [0, 1, 2, 3]


def test_a_node_without_a_partner_is_not_in_space() -> None:
    left, right = traced(*PLUS), traced(*SHIFTED_PLUS)
    matches = by_shift(left, right)
    fewer = Matches(
        left=matches.left[1:],
        right=matches.right[1:],
        cost_px=matches.cost_px[1:],
        unmatched=1,
        ambiguous=0,
    )
    found = reconstruct.space_graph(left, right, fewer, RECT)
    assert len(found.points) == 4
    assert matches.left[0] not in found.node
    assert len(found.edges) == 3


def test_all_nodes_of_an_object_make_couples_but_only_straight_ways_link_them() -> None:
    left, right = traced(*PLUS), traced(*SHIFTED_PLUS)
    found = reconstruct.space_graph(left, right, by_shift(left, right), RECT)
    every, _ = reconstruct.couples(found, np.inf)
    straight, rows = reconstruct.couples(found, 0.05)
    assert len(every.start) == 10
    # four arms and the two lines across the crossing; the four ways round a corner are out
    assert len(straight.start) == 6
    across = [edge for edge in straight.edge.tolist() if edge < 0]
    assert len(across) == 2
    np.testing.assert_array_equal(found.points[rows[:, 0]], straight.start)


def test_two_objects_make_no_couple() -> None:
    strokes = ((200, 200, 300, 200), (200, 300, 300, 300))
    left = traced(*strokes)
    right = traced(*((a - 120, b, c - 120, d) for a, b, c, d in strokes))
    found = reconstruct.space_graph(left, right, by_shift(left, right), RECT)
    every, _ = reconstruct.couples(found, np.inf)
    assert len(every.start) == 2


def test_a_diagonal_staircase_is_straight() -> None:
    def stairs(offset: int) -> Graph:
        skeleton = np.zeros((480, 640), np.bool_)
        for k in range(60):
            skeleton[200 + k, 200 + k + offset] = skeleton[200 + k, 201 + k + offset] = True
        return graphs.trace(skeleton)

    left, right = stairs(0), stairs(-120)
    found = reconstruct.space_graph(left, right, by_shift(left, right), RECT)
    assert found.detour.max() < 0.02


@pytest.mark.parametrize("detour", [np.inf, 0.05])
def test_nothing_matched_gives_nothing(detour: float) -> None:
    left, right = traced(*PLUS), traced(*SHIFTED_PLUS)
    none = Matches(
        left=np.zeros(0, np.int64),
        right=np.zeros(0, np.int64),
        cost_px=np.zeros(0),
        unmatched=5,
        ambiguous=0,
    )
    found = reconstruct.space_graph(left, right, none, RECT)
    couples, rows = reconstruct.couples(found, detour)
    assert couples.start.shape == (0, 3)
    assert rows.shape == (0, 2)
    assert reconstruct.edge_segments(found).start.shape == (0, 3)
