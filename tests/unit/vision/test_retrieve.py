"""What fits a product: straight parts by length, others by neighbours, distances and angles."""

import itertools

import numpy as np
import pytest

from vision import retrieve, transforms
from vision.reconstruct import SpaceGraph
from vision.types import (
    Floats,
    NodeKind,
    PartModel,
    Plane,
    Refusal,
    Segments3D,
    Topology,
    Transform,
    Tuning,
)

STICK = PartModel(code=3, name="rod-100", length_m=0.100, length_tolerance_m=0.004, diameter_m=0.004)
TEE = PartModel(
    code=4,
    name="tee",
    length_m=0.060,
    length_tolerance_m=0.004,
    diameter_m=0.004,
    topology=Topology(
        points=np.array([[-0.030, 0, 0], [0.030, 0, 0], [0, 0.045, 0], [0, 0, 0], [0.010, 0.010, 0]]),
        kinds=(NodeKind.END, NodeKind.END, NodeKind.END, NodeKind.JUNCTION, NodeKind.LOOP_CENTRE),
        edges=np.array([[0, 3], [1, 3], [2, 3]]),
        axis=(0, 1),
    ),
)
TABLE = Plane(normal=np.array([0.0, 0.0, -1.0]), offset_m=0.4)


def segments(*pieces: tuple[list[float], list[float]], residual_px: float = 0.0) -> Segments3D:
    ends = np.array(pieces, np.float64).reshape(-1, 2, 3)
    count = len(ends)
    return Segments3D(
        start=ends[:, 0], end=ends[:, 1], edge=np.arange(count), residual_px=np.full(count, residual_px)
    )


def flat(length_m: float, at_m: float = 0.0) -> tuple[list[float], list[float]]:
    return [0.0, at_m, 0.4], [length_m, at_m, 0.4]


def test_the_right_length_is_offered_best_first() -> None:
    found = retrieve.retrieve_sticks(
        segments(flat(0.103), flat(0.100, 0.01), flat(0.050, 0.02)), STICK, Tuning()
    )
    assert [c.offered for c in found] == [True, True]
    assert [round(c.length_m, 6) for c in found] == [0.100, 0.103]
    assert found[0].score == 1.0 > found[1].score
    assert found[0].part_code == 3
    np.testing.assert_allclose(found[0].centre, [0.05, 0.01, 0.4])
    np.testing.assert_allclose(found[0].axis, [1.0, 0.0, 0.0])


@pytest.mark.parametrize(("length_m", "limit_m"), [(0.106, 0.104), (0.094, 0.096)])
def test_a_near_miss_is_refused_with_its_number(length_m: float, limit_m: float) -> None:
    (found,) = retrieve.retrieve_sticks(segments(flat(length_m)), STICK, Tuning())
    reason = found.refusals[0]
    assert (reason.reason, reason.unit) == (Refusal.LENGTH, "m")
    assert reason.value == pytest.approx(length_m)
    assert reason.limit == pytest.approx(limit_m)


def test_refused_ones_do_not_flood() -> None:
    pieces = [flat(0.1055, 0.001 * k) for k in range(50)]
    found = retrieve.retrieve_sticks(segments(*pieces), STICK, Tuning())
    assert len(found) == retrieve.MAX_NEAR_MISSES


def test_a_steep_stick_is_refused_by_its_angle() -> None:
    rise = ([0.0, 0.0, 0.4], [0.06, 0.0, 0.32])
    (found,) = retrieve.retrieve_sticks(segments(rise), STICK, Tuning(max_tilt_rad=0.7), TABLE)
    assert [r.reason for r in found.refusals] == [Refusal.TILT]
    assert found.refusals[0].value == pytest.approx(np.arctan2(0.08, 0.06))


def test_measured_in_2d_a_steep_stick_is_too_short() -> None:
    steeper = ([0.0, 0.0, 0.4], [0.094, 0.0, 0.366])
    (in_3d,) = retrieve.retrieve_sticks(segments(steeper), STICK, Tuning(), TABLE)
    assert in_3d.offered
    (short,) = retrieve.retrieve_sticks(segments(steeper), STICK, Tuning(length_2d=True), TABLE)
    assert short.refusals[0].reason is Refusal.LENGTH
    assert short.refusals[0].value == pytest.approx(0.094)


def test_2d_is_parallel_to_the_table_not_to_the_picture() -> None:
    tilted = Plane(normal=np.array([0.6, 0.0, -0.8]), offset_m=0.4)
    along_table = ([0.0, 0.0, 0.4], [0.08, 0.0, 0.46])
    (found,) = retrieve.retrieve_sticks(segments(along_table), STICK, Tuning(length_2d=True), tilted)
    assert found.offered
    assert retrieve.tilt_rad(found.axis, tilted) == pytest.approx(0.0, abs=1e-9)


def test_depth_outside_the_given_range_is_refused() -> None:
    (found,) = retrieve.retrieve_sticks(segments(flat(0.1)), STICK, Tuning(depth_m=(0.41, 0.5)))
    assert [r.reason for r in found.refusals] == [Refusal.DEPTH]


def test_views_that_disagree_lower_the_score_and_then_refuse() -> None:
    (near,) = retrieve.retrieve_sticks(segments(flat(0.1), residual_px=1.0), STICK, Tuning())
    assert near.offered
    assert near.score < 1.0
    (far,) = retrieve.retrieve_sticks(segments(flat(0.1), residual_px=3.0), STICK, Tuning())
    assert [r.reason for r in far.refusals] == [Refusal.LOW_SCORE]


def space_graph(points: Floats, edges: list[tuple[int, int]]) -> SpaceGraph:
    count = len(points)
    pairs = np.array(edges, np.int64).reshape(-1, 2)
    return SpaceGraph(
        points=points,
        node=np.arange(count),
        degree=np.bincount(pairs.reshape(-1), minlength=count),
        component=np.zeros(count, np.int64),
        right_component=np.zeros(count, np.int64),
        edges=pairs,
        left_edge=np.arange(len(pairs)),
        residual_px=np.zeros(count),
        detour=np.zeros((count, count)),
    )


def tee_at(camera_from_part: Transform) -> Floats:
    assert TEE.topology is not None
    return transforms.apply(camera_from_part, TEE.topology.points)


def test_a_tee_is_found_with_its_nodes_in_the_order_of_the_model() -> None:
    true = tee_at(transforms.make([0.1, -0.2, 2.0], [0.03, -0.02, 0.4]))
    shuffled = [3, 2, 0, 1]
    graph = space_graph(true[shuffled], [(0, 1), (0, 2), (0, 3)])
    (found,) = retrieve.retrieve_topology(graph, TEE, Tuning())
    assert found.offered
    assert found.score > 0.99
    swapped = true[[1, 0, 2, 3, 4]]
    assert np.allclose(found.nodes[:4], true[:4]) or np.allclose(found.nodes[:4], swapped[:4])
    assert found.length_m == pytest.approx(0.060)


def test_a_node_without_an_edge_is_placed_by_the_model() -> None:
    true = tee_at(transforms.make([0.0, 0.0, 0.5], [0.0, 0.0, 0.4]))
    graph = space_graph(true[:4], [(0, 3), (1, 3), (2, 3)])
    (found,) = retrieve.retrieve_topology(graph, TEE, Tuning())
    mirrored = transforms.apply(transforms.make([0.0, 0.0, 0.5], [0.0, 0.0, 0.4]), [-0.010, 0.010, 0.0])
    assert min(np.linalg.norm(found.nodes[4] - p) for p in (true[4], mirrored)) < 1e-9


def test_a_junction_with_two_neighbours_is_no_tee() -> None:
    true = tee_at(transforms.identity())
    graph = space_graph(true[:4], [(0, 3), (1, 3)])
    assert retrieve.retrieve_topology(graph, TEE, Tuning()) == ()


def test_a_wrong_angle_is_no_tee() -> None:
    skew = tee_at(transforms.identity())[:4].copy()
    skew[2] = [0.045 * np.sin(0.5), 0.045 * np.cos(0.5), 0.0]
    graph = space_graph(skew, [(0, 3), (1, 3), (2, 3)])
    assert retrieve.retrieve_topology(graph, TEE, Tuning()) == ()


def test_neighbours_joined_by_a_detour_are_no_tee() -> None:
    true = tee_at(transforms.identity())[:4]
    graph = space_graph(true, [(0, 3), (1, 3), (2, 3)])
    detour = graph.detour.copy()
    detour[2, 3] = detour[3, 2] = 0.4
    bent = SpaceGraph(
        points=graph.points,
        node=graph.node,
        degree=graph.degree,
        component=graph.component,
        right_component=graph.right_component,
        edges=graph.edges,
        left_edge=graph.left_edge,
        residual_px=graph.residual_px,
        detour=detour,
    )
    assert len(retrieve.retrieve_topology(bent, TEE, Tuning())) == 1
    assert retrieve.retrieve_topology(bent, TEE, Tuning(), longest_detour=0.05) == ()


def test_a_junction_belongs_to_one_part_only() -> None:
    true = tee_at(transforms.identity())[:4]
    second_stem = np.array([[0.001, 0.046, 0.0]])
    graph = space_graph(np.concatenate([true, second_stem]), [(0, 3), (1, 3), (2, 3), (4, 3)])
    found = retrieve.retrieve_topology(graph, TEE, Tuning())
    assert [c.offered for c in found] == [True, False]
    assert found[1].refusals[0].reason is Refusal.DUPLICATE


def test_the_numbering_of_nodes_does_not_matter() -> None:
    true = tee_at(transforms.make([0.3, 0.1, 1.0], [0.0, 0.05, 0.4]))[:4]
    for order in itertools.permutations(range(4)):
        where = {node: k for k, node in enumerate(order)}
        graph = space_graph(true[list(order)], [(where[a], where[3]) for a in range(3)])
        (found,) = retrieve.retrieve_topology(graph, TEE, Tuning())
        np.testing.assert_allclose(found.nodes[3], true[3])


def test_a_stick_has_no_topology_to_look_for() -> None:
    with pytest.raises(ValueError, match="topology"):
        retrieve.retrieve_topology(space_graph(np.zeros((0, 3)), []), STICK, Tuning())
