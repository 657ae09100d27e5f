"""What must hold for the graph of any skeleton, and of any mask taken for one."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from tests.reference.topology import euler_number, pieces
from vision.graph import SPUR_RADII, prune, trace
from vision.thin import guo_hall, zhang_suen
from vision.types import Graph

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


def sticks(random: np.random.Generator, size: tuple[int, int]) -> npt.NDArray[np.bool_]:
    """Drawn lines of any width, most of which run off the picture."""
    canvas = np.zeros(size, np.uint8)
    for _ in range(random.integers(1, 9)):
        start, end = (random.uniform(-10, [size[1] + 10, size[0] + 10]) for _ in range(2))
        width = int(random.integers(1, 8))
        cv2.line(canvas, np.rint(start).astype(int).tolist(), np.rint(end).astype(int).tolist(), 255, width)
    return canvas > 0


def a_mask(kind: str, random: np.random.Generator) -> npt.NDArray[np.bool_]:
    size = (int(random.integers(1, 60)), int(random.integers(1, 90)))
    if kind == "sticks":
        return sticks(random, size)
    if kind == "noise":
        return random.random(size) < random.uniform(0.02, 0.95)
    blobs = ndimage.gaussian_filter(random.normal(size=size), random.uniform(0.7, 4.0), mode="nearest")
    mask = np.asarray(blobs > random.normal() * blobs.std() * 0.5)
    if kind == "border":  # foreground along all four sides
        mask[[0, -1]] = True
        mask[:, [0, -1]] = True
    return mask


def coverage(graph: Graph, size: tuple[int, int]) -> npt.NDArray[np.int64]:
    """How many paths go through each pixel, their two ends left out."""
    count = np.zeros(size, np.int64)
    for (a, b), path in zip(graph.edges.tolist(), graph.paths, strict=True):
        inner = path[1:-1]
        whole = inner[(inner == np.rint(inner)).all(axis=1)].astype(int)
        rows, columns = whole[:, 1], whole[:, 0]
        if a == b and len(path) == 4:
            # may be a hole within one node: the pixels of its loop are the node's
            count[rows, columns] = np.maximum(count[rows, columns], 1)
        else:
            np.add.at(count, (rows, columns), 1)
    return count


@pytest.mark.parametrize("kind", ["blobs", "border", "noise", "sticks"])
def test_a_thousand_masks_of_each_kind_keep_their_topology(kind: str) -> None:
    random = np.random.default_rng(1971)
    for _ in range(1000):
        mask = a_mask(kind, random)
        skeleton = guo_hall(mask)

        graph = trace(skeleton)

        assert len(graph.points) - len(graph.edges) == euler_number(mask)
        assert (graph.component.max() + 1 if len(graph.points) else 0) == pieces(mask)
        count = coverage(graph, mask.shape)
        assert not (count[~skeleton] > 0).any()
        assert count.max(initial=0) <= 1
        neighbours = ndimage.convolve(skeleton.astype(int), np.ones((3, 3), int), mode="constant") - 1
        plain = skeleton & (neighbours <= 2)
        nodes = graph.points[(graph.points == np.rint(graph.points)).all(axis=1)].astype(int)
        plain[nodes[:, 1], nodes[:, 0]] = False
        assert (count[plain] == 1).all()


@pytest.mark.parametrize("kind", ["blobs", "noise", "sticks"])
def test_pruning_by_width_keeps_holes_and_pieces_and_leaves_no_spur(kind: str) -> None:
    random = np.random.default_rng(1989)
    for _ in range(300):
        mask = a_mask(kind, random)
        graph = trace(guo_hall(mask))
        distance = ndimage.distance_transform_edt(np.pad(mask, 200, mode="edge"))[200:-200, 200:-200]

        left = prune(graph, 2.0, mask)

        # what goes is a tree with one end in what stays, or a whole small piece, which has no hole
        small = pieces(mask) - (left.component.max() + 1 if len(left.points) else 0)
        assert small >= 0
        assert len(left.points) - len(left.edges) == euler_number(mask) - small
        for (a, b), length_px in zip(left.edges.tolist(), left.lengths_px.tolist(), strict=True):
            if (left.degree[[a, b]] == 1).sum() == 1:
                u, v = np.rint(left.points[a if left.degree[b] == 1 else b]).astype(int)
                assert length_px >= min(2.0, SPUR_RADII * distance[v, u])
