"""What the pictures show along a part: flanks, background, ends, what goes on beyond; what it claims."""

from __future__ import annotations

import numpy as np
import pytest

from tests.reference.looks import Seen, drawn, frame, hypotheses
from tests.reference.sticks import lying
from vision.traits import SAMPLE_PX, Traits, claimed_edges, traits
from vision.types import Floats, Ints

FRAME = frame()
STICK = lying(0.01, -0.01, 60)
PICTURES = drawn([STICK], FRAME)


def read(rows: Floats, of: Seen = PICTURES) -> Traits:
    return traits(rows, of.left, of.right, FRAME.camera, 2.8 * FRAME.length_px)


def test_a_stick_in_the_open_shows_both_flanks_both_ends_and_nothing_beyond() -> None:
    found = read(hypotheses([STICK], FRAME))

    for view in range(2):
        steps = int(found.count[0, view])
        size = float(np.hypot(*(found.ends[0, view, 2:] - found.ends[0, view, :2])))
        assert steps == int(size / SAMPLE_PX)
        assert (found.value[0, view, 4 : steps - 4] > 0.3).mean() > 0.95
        assert (found.ground[0, view, :steps] == 1).all()
        assert (found.tip_value[0, view].mean(axis=1) > 0.3).all()
        assert found.beyond_value[0, view].max() == 0.0
    assert found.width[0] == pytest.approx(FRAME.width_px, rel=0.05)


def test_beside_it_is_background_and_beyond_the_border_is_outside() -> None:
    rows = np.repeat(hypotheses([STICK], FRAME), 2, axis=0)
    rows[0, [1, 4]] += 40.0
    rows[1, [2, 5]] += 2000.0

    found = read(rows)

    assert (found.ground[0, 0, : found.count[0, 0]] == 0).all()
    assert (found.edge[0, 0] < 0).all()
    assert (found.ground[1, 0, : found.count[1, 0]] == 2).all()


def test_a_window_that_is_too_short_sees_the_flanks_go_on() -> None:
    rows = hypotheses([STICK], FRAME)
    a, b = rows[0, 1:4].copy(), rows[0, 4:7].copy()
    rows[0, 4:7] = a + 0.7 * (b - a)

    found = read(rows)

    assert (found.beyond_value[0, :, 1] > 0.2).mean() > 0.75
    assert found.tip_value[0, :, 1].max() == 0.0
    assert found.beyond_value[0, :, 0].max() == 0.0


def test_a_part_claims_the_edges_of_its_own_outline_and_not_its_neighbours() -> None:
    other = lying(0.03, -0.01, 62)
    of = drawn([STICK, other], FRAME)
    found = read(hypotheses([STICK, other], FRAME), of)
    claims: list[Ints] = []
    for part in range(2):
        out = np.zeros(4000, np.int64)
        width = found.width[part]
        count = claimed_edges(of.left.table, of.left.at, found.ends[part, 0], width[0], width[1], out)
        claims.append(out[:count])

    assert len(claims[0]) > 1.5 * FRAME.length_px
    assert not set(claims[0].tolist()) & set(claims[1].tolist())
    own = found.edge[0, 0, : found.count[0, 0]].reshape(-1)
    assert np.isin(own[own >= 0], claims[0]).mean() > 0.94
