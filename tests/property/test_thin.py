"""Bit-parallel thinning is the published thinning, pixel for pixel, on any mask."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.reference import zhang_suen as reference
from tests.reference.topology import euler_number, pieces
from vision.thin import guo_hall, zhang_suen

METHODS = [(zhang_suen, reference.zhang_suen), (guo_hall, reference.guo_hall)]


def blobs(seed: int, rows: int, columns: int, density: float) -> npt.NDArray[np.bool_]:
    """Random pixels, half of the time grown to thicker shapes."""
    random = np.random.default_rng(seed)
    mask = random.random((rows, columns)) < density
    if seed % 2:
        grown = mask.copy()
        grown[1:] |= mask[:-1]
        grown[:, 1:] |= mask[:, :-1]
        grown[:-1, :-1] |= mask[1:, 1:]
        mask = grown
    return mask


@pytest.mark.parametrize(("fast", "slow"), METHODS, ids=["zhang_suen", "guo_hall"])
@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    rows=st.integers(1, 24),
    columns=st.one_of(st.integers(1, 24), st.integers(62, 67), st.integers(126, 131)),
    density=st.floats(0.02, 0.98),
)
def test_every_random_mask_thins_as_published(fast, slow, seed, rows, columns, density) -> None:  # type: ignore[no-untyped-def]  # parametrised functions
    mask = blobs(seed, rows, columns, density)
    before = mask.copy()

    result = fast(mask)

    assert np.array_equal(result, slow(mask))
    assert np.array_equal(mask, before)
    assert not (result & ~mask).any()


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), density=st.floats(0.05, 0.9))
def test_guo_hall_keeps_the_number_of_pieces_and_holes(seed: int, density: float) -> None:
    mask = blobs(seed, 40, 70, density)

    skeleton = guo_hall(mask)

    assert pieces(skeleton) == pieces(mask)
    assert euler_number(skeleton) == euler_number(mask)
