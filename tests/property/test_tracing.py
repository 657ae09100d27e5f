"""What must hold for the strands of any mask."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.crossings import curves_of
from tests.property.test_graph import a_mask
from vision.tracing import label
from vision.tracing_bends import continuation, sagitta_px


@pytest.mark.parametrize("kind", ["blobs", "border", "noise", "sticks"])
@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_curves_of_any_mask_are_whole_and_within_the_picture(kind: str, seed: int) -> None:
    random = np.random.default_rng(seed)
    mask = a_mask(kind, random)
    rows, columns = mask.shape

    curves = curves_of(mask)
    found = label(mask, curves)

    assert np.isfinite(curves.points).all()
    measured = curves.points[~curves.bridged]
    assert (measured >= -1.0).all()
    assert (measured <= [columns, rows]).all()
    assert curves.starts[0] == 0
    assert curves.starts[-1] == len(curves.points) == len(curves.bridged)
    assert (np.diff(curves.starts) > 0).all()
    assert len(curves) == len(curves.closed) == len(curves.radius_px)
    assert (found[~mask] == -1).all()
    assert found.min(initial=-1) >= -1
    assert found.max(initial=-1) < len(curves)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_bulges_and_continuations_of_any_strands_are_numbers_in_their_range(seed: int) -> None:
    random = np.random.default_rng(seed)
    curves = curves_of(a_mask("sticks", random))
    segment = random.uniform(0, 60, (2, 2))

    bulge = sagitta_px(curves, float(random.uniform(1, 80)))
    found = continuation(curves, segment, 5.0)
    back = continuation(curves, segment[::-1], 5.0)

    assert bulge.shape == (len(curves),)
    assert ((bulge >= 0) & np.isfinite(bulge)).all()
    assert -1 <= found.strand < len(curves)
    assert 0 <= found.covered <= 1
    assert (found.beyond_px >= 0).all()
    assert ((found.bend_rad >= 0) & (found.bend_rad <= np.pi)).all()
    assert back.strand == found.strand
    assert back.beyond_px == pytest.approx(found.beyond_px[::-1])
    assert back.bend_rad == pytest.approx(found.bend_rad[::-1])
