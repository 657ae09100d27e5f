"""Pieces of cables are told from straight parts."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from bench.crossings import curves_of
from tests.unit.vision.test_tracing import bar, drawn
from vision.foreground import stands_out
from vision.tracing_bends import continuation, curved, sagitta_px

SCENES = Path(__file__).parents[4] / "shared" / "data" / "scenes-dev" / "scenes"
TURN = np.linspace(np.pi, 1.9 * np.pi, 100)
CABLE = np.stack([200 + 150 * np.cos(TURN), 220 + 150 * np.sin(TURN)], axis=1)


def test_a_cable_bulges_over_a_part_of_its_length_and_a_bar_does_not() -> None:
    cable = curves_of(drawn([(CABLE, 6.0)]))
    straight = curves_of(drawn([(bar(33.0), 6.0)]))

    # an arc of 100 px on a circle of 150 px: 150 (1 - cos(1/3)) = 8.3 px
    assert sagitta_px(cable, 100.0) == pytest.approx([8.3], abs=0.5)
    assert sagitta_px(straight, 100.0)[0] < 1.0


def test_the_corner_of_two_bars_whose_ends_touch_is_no_bulge() -> None:
    corner = np.array([[80.0, 60.0], [80.0, 200.0], [220.0, 230.0]])
    curves = curves_of(drawn([(corner, 6.0)]))

    assert len(curves) == 1
    assert sagitta_px(curves, 200.0)[0] < 1.5


def test_crossings_are_no_bulge() -> None:
    curves = curves_of(drawn([(bar(a), 6.0) for a in (0.0, 25.0, 70.0)]))

    assert sagitta_px(curves, 200.0).max() < 1.5


def test_a_whole_bar_does_not_go_on_beyond_its_ends_and_half_of_it_does() -> None:
    line = bar(33.0)
    middle = line.mean(axis=0)
    curves = curves_of(drawn([(line, 6.0)]))

    whole = continuation(curves, line, 6.0)
    half = continuation(curves, np.array([line[0], middle]), 6.0)
    turned = continuation(curves, np.array([middle, line[0]]), 6.0)

    assert whole.strand == half.strand == turned.strand == 0
    assert whole.covered > 0.95
    assert whole.beyond_px.max() < 5.0
    assert half.beyond_px == pytest.approx([3.0, 123.0], abs=2.0)
    assert turned.beyond_px == pytest.approx([123.0, 3.0], abs=2.0)
    assert half.bend_rad.max() < 0.05


def test_a_piece_of_a_cable_goes_on_and_bends() -> None:
    curves = curves_of(drawn([(CABLE, 6.0)]))
    chord = CABLE[[40, 55]]

    found = continuation(curves, chord, 6.0)

    size = float(np.linalg.norm(chord[1] - chord[0]))
    arc = 150 * (TURN[1] - TURN[0])
    assert found.beyond_px == pytest.approx([40 * arc + 3, 44 * arc + 3], abs=4.0)
    # as far out as the segment is long, and half of it: the tangent there against the chord
    assert found.bend_rad == pytest.approx([1.5 * size / 150] * 2, abs=0.06)


def test_beside_every_strand_there_is_none() -> None:
    curves = curves_of(drawn([(bar(0.0), 6.0)]))

    found = continuation(curves, bar(90.0), 6.0)
    nowhere = continuation(curves, bar(0.0, middle=(200.0, 60.0)), 6.0)

    assert found.covered < 0.1
    assert nowhere.strand == -1
    assert nowhere.beyond_px.tolist() == [0.0, 0.0]


@pytest.mark.shared_data
@pytest.mark.skipif(not SCENES.is_dir(), reason="no shared data here")
@pytest.mark.parametrize(
    ("scene", "is_cable"),
    [("N-cable", True), ("N-wrongsize", False), ("B1", False), ("H10-3", False), ("H20-1", False)],
)
def test_the_strands_of_a_cable_are_curved_and_those_of_sticks_are_not(scene: str, is_cable: bool) -> None:
    grey = cv2.imread(str(SCENES / scene / "left.png"), cv2.IMREAD_GRAYSCALE)
    assert grey is not None
    curves = curves_of(stands_out(np.asarray(grey, np.uint8), 5.5).mask)

    long = curves.length_px > 50.0  # a third of a stick

    assert long.any()
    assert (curved(curves, 145.0, 5.5)[long] == is_cable).all()
