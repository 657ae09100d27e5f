"""Algorithm 1, the referents and the smooth function on graphs of a few nodes."""

import numpy as np
import pytest

from vision import match_paper, transforms
from vision.match_paper import Gates
from vision.stereo import Rectification, project, rectification, rectify_points
from vision.types import CameraModel, Floats, Graph, StereoModel

CAMERA = CameraModel(
    matrix=np.array([[600.0, 0, 320], [0, 600.0, 240], [0, 0, 1]]),
    distortion=np.zeros(5),
    width_px=640,
    height_px=480,
)
# f B = 48 px m: a column difference of 120 px is 0.4 m, 100 px 0.48 m, 160 px 0.3 m
RIG = StereoModel(
    left=CAMERA, right=CAMERA, right_from_left=transforms.make([0.0, 0.0, 0.0], [-0.08, 0.0, 0.0])
)
GATES = Gates(depth_m=(0.35, 0.45), position_px=(-2.0, 2.0))


@pytest.fixture(scope="module")
def rect() -> Rectification:
    return rectification(RIG)


def graph(points: list[tuple[float, float]]) -> Graph:
    """Bare nodes: matching looks at nothing else."""
    count = len(points)
    return Graph(
        points=np.array(points, np.float64).reshape(-1, 2),
        degree=np.ones(count, np.int64),
        component=np.zeros(count, np.int64),
        edges=np.zeros((0, 2), np.int64),
        lengths_px=np.zeros(0),
        paths=(),
    )


def moved(points: list[tuple[float, float]], disparity: float = 120.0) -> list[tuple[float, float]]:
    return [(u - disparity, v) for u, v in points]


def pairs(left: Graph, right: Graph, rect: Rectification, gates: Gates = GATES) -> set[tuple[int, int]]:
    found = match_paper.match(left, right, rect, gates)
    return set(zip(found.left.tolist(), found.right.tolist(), strict=True))


def test_a_label_needs_depth_and_position(rect: Rectification) -> None:
    left = np.array([[300.0, 100.0]])
    right = np.array([[180.0, 100.0], [180.0, 103.0], [140.0, 100.0], [200.0, 100.0], [300.0, 100.0]])
    found = match_paper.labels(left, right, rect, GATES)
    #                        fits  wrong row  too near  too far  behind
    assert found.tolist() == [[True, False, False, False, False]]


def test_the_ends_of_the_intervals_are_outside(rect: Rectification) -> None:
    found = match_paper.labels(
        np.array([[300.0, 100.0]]), np.array([[180.0, 98.0], [180.0, 98.1]]), rect, GATES
    )
    assert found.tolist() == [[False, True]]


def test_only_candidates_of_each_other_agree() -> None:
    labelled = np.array([[1, 0, 0], [0, 1, 1], [0, 0, 1]], bool)
    assert match_paper.agreed(labelled).tolist() == [[0, 0]]


def test_the_smooth_function_takes_matched_nodes_out() -> None:
    labelled = np.array([[1, 1], [1, 1]], bool)
    left = match_paper.withdraw(labelled, np.array([[0, 1]]))
    assert left.tolist() == [[False, False], [True, False]]
    assert labelled.all()


def test_withdrawing_a_node_can_decide_the_next(rect: Rectification) -> None:
    # node 1 sees both right nodes, node 0 only the first: once 0 is gone, 1 has a single candidate
    left = graph([(300, 100), (300, 101.5), (340, 200), (260, 200)])
    right = graph([(180, 99), (180, 102), (220, 200), (140, 200)])
    assert pairs(left, right, rect) == {(0, 0), (1, 1), (2, 2), (3, 3)}


def test_referents_are_the_two_nearest_agreed_nodes() -> None:
    points = np.array([[0.0, 0.0], [10.0, 0.0], [3.0, 0.0], [5.0, 0.0]])
    chosen = match_paper.referents(points, 0, np.array([[1, 7], [2, 8], [3, 9]]))
    assert chosen.tolist() == [[2, 8], [3, 9]]


def test_the_mirror_image_has_the_wrong_angle() -> None:
    left_pair = np.array([[10.0, 0.0], [0.0, 10.0]])
    point = np.array([0.0, 0.0])
    mirror = np.array([10.0, 10.0])
    costs = match_paper.disagreement_px(point, np.stack([point, mirror]), left_pair, left_pair, None)
    assert costs[0] == 0.0
    assert costs[1] > 10.0


def test_the_angle_threshold_forgives_below_and_refuses_above() -> None:
    left_pair = np.array([[10.0, 0.0], [0.0, 10.0]])
    right_pair = np.array([[10.0, 0.0], [1.0, 9.95]])
    point, far = np.array([0.0, 0.0]), np.array([10.0, 10.0])
    costs = match_paper.disagreement_px(point, np.stack([point, far]), left_pair, right_pair, 0.2)
    assert costs[0] == pytest.approx(0.0, abs=0.01)
    assert np.isinf(costs[1])


def test_two_candidates_are_told_apart_by_the_referents(rect: Rectification) -> None:
    # as in figure 2: one node of the left picture has two candidates in the right one
    left = graph([(300, 100), (350, 200), (250, 220), (305, 101)])
    right = graph(moved([(300, 100), (350, 200), (250, 220), (305, 101)]))
    found = match_paper.match(left, right, rect, GATES)
    assert found.left.tolist() == found.right.tolist() == [0, 1, 2, 3]
    assert found.ambiguous == 2
    assert found.unmatched == 0


def test_without_two_referents_nothing_is_guessed(rect: Rectification) -> None:
    left = graph([(300, 100), (305, 101)])
    found = match_paper.match(left, graph(moved([(300, 100), (305, 101)])), rect, GATES)
    assert len(found.left) == 0
    assert found.unmatched == 2


def test_empty_graphs_match_to_nothing(rect: Rectification) -> None:
    found = match_paper.match(graph([]), graph([]), rect, GATES)
    assert len(found.left) == 0
    assert found.unmatched == found.ambiguous == 0


def test_depth_is_that_of_the_raw_left_camera() -> None:
    # cameras turned towards each other: rectified depth and raw depth differ across the picture
    turned = StereoModel(
        left=CAMERA, right=CAMERA, right_from_left=transforms.make([0.0, 0.16, 0.0], [-0.079, 0.0, 0.012])
    )
    ideal = rectification(turned)
    points: Floats = np.array([[-0.12, 0.0, 0.4], [0.1, 0.05, 0.4]])
    left, right = project(points, turned)
    left_px, right_px = rectify_points(left, ideal, "left"), rectify_points(right, ideal, "right")
    tight = Gates(depth_m=(0.3999, 0.4001), position_px=(-0.01, 0.01))
    assert match_paper.labels(left_px, right_px, ideal, tight).diagonal().all()
