"""Lines of one picture on drawn sticks: where they are, with their ends, also where masks merge."""

from __future__ import annotations

import numpy as np
import pytest

from tests.reference.looks import Seen, drawn, ends_px, frame
from tests.reference.sticks import Stick, lying
from vision.proposals import Lines, lines
from vision.types import Floats

FRAME = frame()


def proposed(of: Seen, side: int = 0, pieces: Floats | None = None) -> Lines:
    edges = (of.left, of.right)[side]
    return lines(edges, np.zeros((0, 4)) if pieces is None else pieces, FRAME.width_px, FRAME.length_px)


def nearest_line(found: Lines, stick: Stick, side: int = 0) -> tuple[int, float]:
    """Which line passes nearest to both ends of a stick, and how far off it is at the worse of them, px."""
    ends = ends_px(stick, FRAME).reshape(2, 3)
    places = ends[:, :2] - side * np.stack([ends[:, 2], np.zeros(2)], axis=1)
    away = places[None] - found.table[:, None, :2]
    way = found.table[:, None, 2:]
    off = np.abs(away[..., 0] * way[..., 1] - away[..., 1] * way[..., 0]).max(axis=1)
    return int(np.argmin(off)), float(off.min())


@pytest.mark.parametrize("angle_deg", [0, 25, 45, 90, 110, 150, 179])
@pytest.mark.parametrize("side", [0, 1])
def test_a_drawn_stick_is_a_line_without_a_skeleton(angle_deg: int, side: int) -> None:
    stick = lying(0.01, -0.01, angle_deg)

    found = proposed(drawn([stick], FRAME), side)

    assert nearest_line(found, stick, side)[1] < 0.4


def test_sticks_side_by_side_whose_mask_is_one_are_lines_of_their_own() -> None:
    first = lying(0.0, 0.0, 35)
    along = (first.end - first.start) / 0.1
    step = 0.0042 * np.array([-along[1], along[0], 0.0])
    sticks = [Stick(start=first.start + k * step, end=first.end + k * step) for k in range(3)]

    found = proposed(drawn(sticks, FRAME))

    # at a seam grey changes most on the shoulders of both: the middle one looks narrower
    assert max(nearest_line(found, stick)[1] for stick in sticks) < 1.5
    assert len({nearest_line(found, stick)[0] for stick in sticks}) == 3


def test_evidence_is_along_the_stick_and_its_ends_look_outwards() -> None:
    stick = lying(0.0, 0.0, 60)
    found = proposed(drawn([stick], FRAME))
    line, _ = nearest_line(found, stick)
    ends = ends_px(stick, FRAME).reshape(2, 3)
    along = np.sort((ends[:, :2] - found.table[line, :2]) @ found.table[line, 2:])
    first, last = (round(float(t)) + found.reach_px for t in along)

    value = np.diff(found.total[line])
    inside = value[first + 8 : last - 8]
    assert np.median(inside) > 1.0
    assert value[: first - 8].max() < 0
    assert value[last + 8 :].max() < 0
    assert abs(int(np.argmax(found.tips[line, :, 0])) - first) <= 2
    assert abs(int(np.argmax(found.tips[line, :, 1])) - last) <= 2
    assert found.tips[line].max() > 0.6


def test_a_piece_of_the_graph_is_a_line_though_few_edges_vote_for_it() -> None:
    stick = lying(0.0, 0.0, 60)
    of = drawn([stick], FRAME)
    ends = ends_px(stick, FRAME).reshape(2, 3)[:, :2]
    way = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    aside = np.array([[*(ends.mean(axis=0) + 0.8 * np.array([-way[1], way[0]])), *way]])

    found = lines(of.left, aside, FRAME.width_px, FRAME.length_px)

    assert nearest_line(found, stick)[1] < 0.4


def test_a_picture_of_nothing_has_no_lines() -> None:
    found = proposed(drawn([], FRAME))

    assert found.table.shape == (0, 4)
    assert found.total.shape == (0, 2 * found.reach_px + 2)
    assert found.tips.shape == (0, 2 * found.reach_px + 1, 2)
