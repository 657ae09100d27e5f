"""What holds for every rigid motion."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from vision import transforms
from vision.types import Transform

numbers = st.floats(min_value=-3.0, max_value=3.0)
vectors = st.tuples(numbers, numbers, numbers)
motions = st.builds(lambda r, t: transforms.make(list(r), list(t)), vectors, vectors)


def close(first: Transform, second: Transform) -> bool:
    turn = transforms.rotation_distance_rad(first.rotation, second.rotation)
    return turn < 1e-7 and bool(np.allclose(first.translation, second.translation, atol=1e-9))


@given(motions)
def test_inverting_twice_is_the_same(a_from_b: Transform) -> None:
    assert close(transforms.invert(transforms.invert(a_from_b)), a_from_b)


@given(motions)
def test_a_motion_and_its_inverse_cancel(a_from_b: Transform) -> None:
    assert close(transforms.compose(a_from_b, transforms.invert(a_from_b)), transforms.identity())


@given(motions, motions, vectors)
def test_composing_is_applying_one_after_the_other(
    a_from_b: Transform, b_from_c: Transform, point: tuple[float, float, float]
) -> None:
    together = transforms.apply(transforms.compose(a_from_b, b_from_c), list(point))
    one_by_one = transforms.apply(a_from_b, transforms.apply(b_from_c, list(point)))
    np.testing.assert_allclose(together, one_by_one, atol=1e-9)


@given(vectors)
def test_vector_and_matrix_say_the_same(vector: tuple[float, float, float]) -> None:
    matrix = transforms.matrix_from_vector(list(vector))
    again = transforms.matrix_from_vector(transforms.vector_from_matrix(matrix))
    assert transforms.rotation_distance_rad(matrix, again) < 1e-6


@given(motions, motions)
def test_distance_is_symmetric_and_at_most_half_a_turn(first: Transform, second: Transform) -> None:
    there = transforms.rotation_distance_rad(first.rotation, second.rotation)
    back = transforms.rotation_distance_rad(second.rotation, first.rotation)
    assert abs(there - back) < 1e-9
    assert 0.0 <= there <= np.pi


@given(motions, st.lists(vectors, min_size=4, max_size=8, unique=True))
def test_aligning_finds_the_motion(a_from_b: Transform, cloud: list[tuple[float, float, float]]) -> None:
    points = np.array(cloud)
    moved = transforms.apply(a_from_b, points)
    found = transforms.align(points, moved)
    np.testing.assert_allclose(transforms.apply(found, points), moved, atol=1e-6)
