"""Straight pieces of small skeletons, and the same on the canvas."""

from __future__ import annotations

import numpy as np
import pytest

from tests.reference.sticks import rig
from vision.canvas import canvas, points_through_grid
from vision.graph import trace
from vision.pieces import on_canvas_lines, straight_pieces
from vision.types import Floats

WIDTH_PX = 5.0


def lengths(pieces: Floats) -> list[float]:
    return sorted(float(x) for x in np.linalg.norm(pieces[:, 1] - pieces[:, 0], axis=1).round(1))


def test_a_bent_path_is_cut_at_its_corner_and_trimmed_at_both_ends() -> None:
    mask = np.zeros((60, 60), bool)
    mask[5, 5:50] = True
    mask[5:45, 49] = True

    pieces = straight_pieces(trace(mask), WIDTH_PX)

    assert lengths(pieces) == pytest.approx([39 - 6, 44 - 6], abs=1.5)


def test_a_junction_ends_pieces_and_short_ones_are_left_out() -> None:
    mask = np.zeros((60, 60), bool)
    mask[30, 5:55] = True
    mask[20:30, 20] = True

    pieces = straight_pieces(trace(mask), WIDTH_PX)

    assert len(pieces) == 2
    assert np.abs(pieces[..., 1] - 30).max() < 1.0


def test_on_the_canvas_a_piece_is_its_middle_and_its_direction() -> None:
    on = canvas(rig())
    piece = np.array([[[100.0, 200.0], [300.0, 120.0]]])

    line = on_canvas_lines(piece, on, 1, 1.5)[0]

    ends = points_through_grid(on.from_raw[1], piece[0]) + np.array([0.0, 1.5])
    assert line[:2] == pytest.approx(ends.mean(axis=0))
    assert line[2:] == pytest.approx((ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0]))


def test_no_graph_no_pieces() -> None:
    pieces = straight_pieces(trace(np.zeros((9, 9), bool)), WIDTH_PX)

    assert pieces.shape == (0, 2, 2)
    assert on_canvas_lines(pieces, canvas(rig()), 0, 0.0).shape == (0, 4)
