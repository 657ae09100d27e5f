"""Small loops get a node in their middle; heaps and trees stay as they are."""

import numpy as np

from vision import graph, loops
from vision.types import Graph


def ring_with_tail() -> Graph:
    """A square ring of 20 px and a tail of 30 px to its right."""
    skeleton = np.zeros((60, 90), np.bool_)
    skeleton[20, 10:31] = skeleton[40, 10:31] = True
    skeleton[20:41, 10] = skeleton[20:41, 30] = True
    skeleton[30, 30:61] = True
    return graph.trace(skeleton)


def test_a_ring_gets_its_centre_joined_to_its_junction() -> None:
    before = ring_with_tail()
    after = loops.with_loop_centres(before, 200.0)
    assert len(after.points) == len(before.points) + 1
    assert np.linalg.norm(after.points[-1] - [20.0, 30.0]) < 1.5
    junction = int(np.argmax(before.degree))
    assert after.edges[-1].tolist() == [len(before.points), junction]
    assert after.degree[-1] == 1
    assert after.component[-1] == before.component[junction]
    np.testing.assert_array_equal(after.points[:-1], before.points)


def test_a_ring_of_two_edges_is_one_hole() -> None:
    skeleton = np.zeros((60, 100), np.bool_)
    skeleton[20, 30:51] = skeleton[40, 30:51] = True
    skeleton[20:41, 30] = skeleton[20:41, 50] = True
    skeleton[30, 5:31] = skeleton[30, 50:81] = True
    after = loops.with_loop_centres(graph.trace(skeleton), 200.0)
    assert np.linalg.norm(after.points[-1] - [40.0, 30.0]) < 1.5
    assert after.degree[-1] == 2


def test_a_loop_that_is_too_long_is_a_heap() -> None:
    before = ring_with_tail()
    assert len(loops.with_loop_centres(before, 50.0).points) == len(before.points)


def test_a_tree_has_no_loop() -> None:
    skeleton = np.zeros((40, 40), np.bool_)
    skeleton[20, 5:35] = skeleton[5:35, 20] = True
    tree = graph.trace(skeleton)
    assert loops.with_loop_centres(tree, 1000.0) is tree


def test_an_empty_graph_stays_empty() -> None:
    nothing = graph.trace(np.zeros((5, 5), np.bool_))
    assert loops.with_loop_centres(nothing, 100.0) is nothing
