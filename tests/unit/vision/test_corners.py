"""Corners become nodes; straight and loop edges stay as they are."""

import numpy as np

from vision import corners, graph


def test_an_l_gets_its_corner() -> None:
    skeleton = np.zeros((60, 60), np.bool_)
    skeleton[10, 10:50] = True
    skeleton[10:40, 10] = True
    bent = graph.trace(skeleton)
    assert len(bent.edges) == 1
    found = corners.with_corners(bent, 8.0)
    assert found.degree.tolist() == [1, 1, 2]
    assert np.linalg.norm(found.points[2] - [10.0, 10.0]) < 2.0
    assert len(found.edges) == 2
    assert found.component.tolist() == [0, 0, 0]
    np.testing.assert_allclose(sorted(found.lengths_px), [29.0, 39.0], atol=2.0)


def test_a_straight_line_and_a_gentle_bow_have_no_corner() -> None:
    skeleton = np.zeros((60, 120), np.bool_)
    u = np.arange(10, 110)
    skeleton[np.rint(30 + 8 * np.sin((u - 10) / 100 * np.pi)).astype(int), u] = True
    bow = graph.trace(skeleton)
    assert len(corners.with_corners(bow, 8.0).points) == len(bow.points)


def test_a_loop_is_left_alone() -> None:
    skeleton = np.zeros((40, 40), np.bool_)
    skeleton[10, 10:30] = skeleton[29, 10:30] = skeleton[10:30, 10] = skeleton[10:30, 29] = True
    ring = graph.trace(skeleton)
    found = corners.with_corners(ring, 8.0)
    assert len(found.points) == len(ring.points) == 1
    assert len(found.edges) == 1


def test_an_empty_graph_stays_empty() -> None:
    nothing = graph.trace(np.zeros((5, 5), np.bool_))
    assert len(corners.with_corners(nothing, 8.0).points) == 0
