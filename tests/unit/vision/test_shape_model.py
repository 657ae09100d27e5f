"""The sampled shape of a part: its edge, its inside, its straight runs and what must not go on."""

from __future__ import annotations

import numpy as np
import pytest

from tests.reference.shapes import BRACKET, ELL, KEY, PLATE_TEE, SPANNER, TEE, WYE
from vision.shape_model import inside, shape_model, width_of
from vision.types import PartModel

ALL = [TEE, WYE, ELL, KEY, BRACKET, PLATE_TEE, SPANNER]
names = [part.name + (" plate" if part.outline else "") for part in ALL]


@pytest.mark.parametrize("part", ALL, ids=names)
def test_edges_point_outwards_and_the_body_lies_inside(part: PartModel) -> None:
    shape = shape_model(part, 0.001)

    np.testing.assert_allclose(np.linalg.norm(shape.normals, axis=1), 1.0)
    if part.outline is not None:
        assert np.all(inside(part.outline, shape.points - 0.0005 * shape.normals) > 0)
        assert np.all(inside(part.outline, shape.points + 0.0005 * shape.normals) < 0)
        assert np.all(inside(part.outline, shape.body) > 0)


@pytest.mark.parametrize(("part", "differs"), list(zip(ALL, [0, 0, 1, 1, 1, 0, 0], strict=True)), ids=names)
def test_only_shapes_that_are_no_mirror_images_of_themselves_have_two_faces(
    part: PartModel, differs: int
) -> None:
    assert shape_model(part, 0.001).two_faced == bool(differs)


def test_bars_that_continue_each_other_are_one_straight_run() -> None:
    lengths = [float(np.hypot(x1 - x0, y1 - y0)) for x0, y0, x1, y1, _ in shape_model(TEE, 0.001).lines]

    assert sorted(lengths) == pytest.approx([0.044, 0.060])


@pytest.mark.parametrize(("part", "faces"), list(zip(ALL, [3, 3, 2, 2, 2, 3, 0], strict=True)), ids=names)
def test_every_free_end_has_a_face_and_a_junction_has_none(part: PartModel, faces: int) -> None:
    tips = shape_model(part, 0.001).tip

    assert len(np.unique(tips[tips >= 0])) == faces


def test_the_bend_of_a_rod_is_left_out_because_nobody_states_its_radius() -> None:
    shape = shape_model(ELL, 0.001)
    assert ELL.topology is not None
    corner = ELL.topology.points[1, :2]

    assert np.linalg.norm(shape.points - corner, axis=1).min() > 1.2 * ELL.diameter_m


def test_a_flat_part_keeps_its_sharp_corner_and_its_holes() -> None:
    shape = shape_model(BRACKET, 0.001)

    assert np.linalg.norm(shape.points - np.array([-0.028, -0.008]), axis=1).min() < 0.001
    hole = np.linalg.norm(shape.points - np.array([0.038, 0.0]), axis=1) < 0.0033
    assert hole.sum() >= 12
    # the material ends at the hole: its edge points to the hole's middle
    assert np.all(np.sum(shape.normals[hole] * (np.array([0.038, 0.0]) - shape.points[hole]), axis=1) > 0)


def test_flanks_continued_past_an_end_lie_outside_the_part() -> None:
    for part in (BRACKET, PLATE_TEE, SPANNER):
        assert part.outline is not None
        shape = shape_model(part, 0.001)
        middle = shape.beyond - 0.5 * width_of(part) * shape.beyond_normals
        assert np.all(inside(part.outline, middle, ignore_cuts=True) < 0)


def test_a_part_without_a_topology_is_refused() -> None:
    stick = PartModel(code=1, name="stick", length_m=0.1, length_tolerance_m=0.004, diameter_m=0.004)
    with pytest.raises(ValueError, match="no topology"):
        shape_model(stick, 0.001)
