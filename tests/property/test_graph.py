"""What must hold for the graph of any skeleton, and of any mask taken for one."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from tests.reference.topology import euler_number, pieces
from vision.graph import prune, trace
from vision.thin import guo_hall, zhang_suen

seeds = st.integers(0, 2**32 - 1)
sizes = st.tuples(st.integers(1, 40), st.integers(1, 70))


def mask_of(seed: int, size: tuple[int, int], density: float) -> npt.NDArray[np.bool_]:
    random = np.random.default_rng(seed)
    mask = random.random(size) < density
    if seed % 3 == 0:
        mask = ndimage.binary_dilation(mask)
    return mask


@pytest.mark.parametrize("thin", [None, zhang_suen, guo_hall], ids=["raw", "zhang_suen", "guo_hall"])
@settings(max_examples=150, deadline=None)
@given(seed=seeds, size=sizes, density=st.floats(0.01, 0.95))
def test_the_graph_has_the_topology_of_its_skeleton(thin, seed, size, density) -> None:  # type: ignore[no-untyped-def]  # parametrised function
    mask = mask_of(seed, size, density)
    skeleton = mask if thin is None else thin(mask)

    graph = trace(skeleton)

    assert len(graph.points) - len(graph.edges) == euler_number(skeleton)
    assert (graph.component.max() + 1 if len(graph.points) else 0) == pieces(skeleton)
    assert graph.degree.sum() == 2 * len(graph.edges)
    bends = np.flatnonzero(graph.degree == 2)
    loops = graph.edges[graph.edges[:, 0] == graph.edges[:, 1], 0]
    assert set(bends.tolist()) <= set(loops.tolist())


@settings(max_examples=150, deadline=None)
@given(seed=seeds, size=sizes, density=st.floats(0.01, 0.95))
def test_paths_run_between_their_nodes_on_the_skeleton_and_cover_it(
    seed: int, size: tuple[int, int], density: float
) -> None:
    skeleton = guo_hall(mask_of(seed, size, density))

    graph = trace(skeleton)

    covered = np.zeros_like(skeleton)
    for (a, b), path, length_px in zip(graph.edges, graph.paths, graph.lengths_px, strict=True):
        assert np.array_equal(path[0], graph.points[a])
        assert np.array_equal(path[-1], graph.points[b])
        steps = np.hypot(*np.diff(path, axis=0).T)
        assert length_px == pytest.approx(steps.sum())
        inner = path[1:-1]
        whole = inner[(inner == np.rint(inner)).all(axis=1)].astype(int)
        on = skeleton[whole[:, 1], whole[:, 0]]
        assert on.sum() >= len(inner) - np.count_nonzero((inner != np.rint(inner)).any(axis=1)) - 1
        covered[whole[on, 1], whole[on, 0]] = True
    # what no path covers is part of a node: an end point, a single pixel or a junction pixel
    v, u = np.nonzero(skeleton & ~covered)
    neighbours = ndimage.convolve(skeleton.astype(int), np.ones((3, 3), int), mode="constant") - 1
    for x, y in zip(u, v, strict=True):
        is_node = (np.abs(graph.points - (x, y)).max(axis=1) < 0.5).any() if len(graph.points) else False
        assert is_node or neighbours[y, x] >= 3


@settings(max_examples=100, deadline=None)
@given(seed=seeds, density=st.floats(0.05, 0.6), spur_px=st.floats(0.5, 12.0))
def test_pruning_leaves_no_short_free_end_and_no_bend(seed: int, density: float, spur_px: float) -> None:
    graph = trace(guo_hall(mask_of(seed, (30, 40), density)))

    left = prune(graph, spur_px)

    free = (left.degree[left.edges] == 1).any(axis=1)
    assert (left.lengths_px[free] >= spur_px).all()
    assert left.degree.min(initial=1) >= 1
    loops = left.edges[left.edges[:, 0] == left.edges[:, 1], 0]
    assert set(np.flatnonzero(left.degree == 2).tolist()) <= set(loops.tolist())
    old = {tuple(point) for point in graph.points.tolist()}
    assert {tuple(point) for point in left.points.tolist()} <= old


@settings(max_examples=50, deadline=None)
@given(seed=seeds, density=st.floats(0.05, 0.6))
def test_pruning_nothing_changes_nothing(seed: int, density: float) -> None:
    graph = trace(guo_hall(mask_of(seed, (30, 40), density)))

    left = prune(graph, 0.0)

    assert np.array_equal(left.points, graph.points)
    assert sorted(left.lengths_px.tolist()) == pytest.approx(sorted(graph.lengths_px.tolist()))
