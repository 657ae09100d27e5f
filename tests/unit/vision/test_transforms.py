"""Rigid motions on examples small enough to check by hand."""

import numpy as np
import pytest

from vision import transforms

QUARTER = np.pi / 2


def test_a_quarter_turn_about_z_takes_x_to_y() -> None:
    a_from_b = transforms.make([0.0, 0.0, QUARTER], [0.0, 0.0, 1.0])
    np.testing.assert_allclose(transforms.apply(a_from_b, [[1.0, 0.0, 0.0]]), [[0.0, 1.0, 1.0]], atol=1e-12)


def test_composing_applies_the_right_one_first() -> None:
    a_from_b = transforms.make([0.0, 0.0, QUARTER], [0.0, 0.0, 0.0])
    b_from_c = transforms.make(np.eye(3), [1.0, 0.0, 0.0])
    a_from_c = transforms.compose(a_from_b, b_from_c)
    np.testing.assert_allclose(transforms.apply(a_from_c, np.zeros(3)), [0.0, 1.0, 0.0], atol=1e-12)


def test_the_average_of_two_turns_is_half_way() -> None:
    turns = [transforms.make([0.0, 0.0, a], [a, 0.0, 0.0]) for a in (0.0, 0.4)]
    middle = transforms.average(turns)
    np.testing.assert_allclose(transforms.vector_from_matrix(middle.rotation), [0.0, 0.0, 0.2], atol=1e-12)
    np.testing.assert_allclose(middle.translation, [0.2, 0.0, 0.0])


def test_small_angles_keep_their_digits() -> None:
    turned = transforms.matrix_from_vector([1e-9, 0.0, 0.0])
    assert transforms.rotation_distance_rad(np.eye(3), turned) == pytest.approx(1e-9, rel=1e-6)


def test_a_mirror_is_not_a_transform() -> None:
    with pytest.raises(ValueError, match="rotation"):
        transforms.make(np.diag([1.0, 1.0, -1.0]), np.zeros(3))


def test_wrong_shapes_and_numbers_are_refused() -> None:
    with pytest.raises(ValueError, match=r"\(3, 3\)"):
        transforms.make(np.eye(2), np.zeros(3))
    with pytest.raises(ValueError, match="finite"):
        transforms.make(np.eye(3), [np.nan, 0.0, 0.0])
    with pytest.raises(ValueError, match="at least one"):
        transforms.average([])


def test_flat_points_are_turned_over_not_mirrored() -> None:
    flat = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    turned_over = flat * [1.0, -1.0, 1.0]
    motion = transforms.align(flat, turned_over)
    assert np.linalg.det(motion.rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(transforms.apply(motion, flat), turned_over, atol=1e-12)


def test_the_arrays_of_a_transform_are_closed_for_writing() -> None:
    motion = transforms.identity()
    with pytest.raises(ValueError, match="read-only"):
        motion.translation[0] = 1.0
