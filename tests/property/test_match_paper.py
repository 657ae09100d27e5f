"""What holds for the published matching of any two node sets."""

from random import Random

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from vision import match_paper, transforms
from vision.match_paper import Gates
from vision.stereo import rectification, rectified_depth
from vision.types import CameraModel, Floats, Graph, StereoModel

CAMERA = CameraModel(
    matrix=np.array([[600.0, 0, 320], [0, 600.0, 240], [0, 0, 1]]),
    distortion=np.zeros(5),
    width_px=640,
    height_px=480,
)
RECT = rectification(
    StereoModel(left=CAMERA, right=CAMERA, right_from_left=transforms.make(np.zeros(3), [-0.08, 0.0, 0.0]))
)
GATES = Gates(depth_m=(0.35, 0.45), position_px=(-2.5, 2.5))

columns = st.integers(min_value=200, max_value=400)
rows = st.integers(min_value=100, max_value=140)
node_sets = st.lists(st.tuples(columns, rows), max_size=14, unique=True)


def graph(points: Floats) -> Graph:
    return Graph(
        points=points,
        degree=np.ones(len(points), np.int64),
        component=np.zeros(len(points), np.int64),
        edges=np.zeros((0, 2), np.int64),
        lengths_px=np.zeros(0),
        paths=(),
    )


def as_points(nodes: list[tuple[int, int]], shift: float = 0.0) -> Floats:
    return np.array(nodes, np.float64).reshape(-1, 2) - [shift, 0.0]


@given(node_sets, node_sets, st.randoms(use_true_random=False))
@settings(deadline=None)
def test_matching_does_not_depend_on_the_order_of_nodes(
    left_nodes: list[tuple[int, int]], right_nodes: list[tuple[int, int]], random: Random
) -> None:
    left, right = as_points(left_nodes), as_points(right_nodes, 120.0)
    left_order = np.array(random.sample(range(len(left)), len(left)), np.int64)
    right_order = np.array(random.sample(range(len(right)), len(right)), np.int64)
    plain = match_paper.match(graph(left), graph(right), RECT, GATES)
    mixed = match_paper.match(graph(left[left_order]), graph(right[right_order]), RECT, GATES)
    expected = set(zip(plain.left.tolist(), plain.right.tolist(), strict=True))
    found = set(zip(left_order[mixed.left].tolist(), right_order[mixed.right].tolist(), strict=True))
    assert found == expected


@given(node_sets, node_sets)
@settings(deadline=None)
def test_no_node_is_used_twice_and_every_pair_keeps_the_gates(
    left_nodes: list[tuple[int, int]], right_nodes: list[tuple[int, int]]
) -> None:
    left, right = as_points(left_nodes), as_points(right_nodes, 120.0)
    found = match_paper.match(graph(left), graph(right), RECT, GATES)
    assert len(set(found.left.tolist())) == len(set(found.right.tolist())) == len(found.left)
    assert found.unmatched == len(left) - len(found.left)
    depth = rectified_depth(left[found.left, 0], right[found.right, 0], RECT)
    assert ((depth > 0.35) & (depth < 0.45)).all()
    assert (np.abs(left[found.left, 1] - right[found.right, 1]) < 2.5).all()


@given(node_sets, node_sets)
def test_the_table_of_labels_is_algorithm_1_as_printed(
    left_nodes: list[tuple[int, int]], right_nodes: list[tuple[int, int]]
) -> None:
    left, right = as_points(left_nodes), as_points(right_nodes, 120.0)
    table = match_paper.labels(left, right, RECT, GATES)
    for i, v in enumerate(left):
        for j, w in enumerate(right):
            disparity = v[0] - w[0] - (RECT.left_centre_px[0] - RECT.right_centre_px[0])
            depth = RECT.focal_px * RECT.baseline_m / disparity if disparity > 0 else -1.0
            assert bool(table[i, j]) == (0.35 < depth < 0.45 and -2.5 < v[1] - w[1] < 2.5)
