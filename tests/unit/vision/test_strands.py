"""Whole parts in one drawn picture: joined through crossings, tips placed and named."""

from __future__ import annotations

import numpy as np
import pytest

from tests.reference.sticks import Stick, lying, pair, rig
from vision.foreground import stands_out
from vision.graph import prune, trace
from vision.lines import straight_pieces
from vision.look import Look
from vision.stereo import project, rectification, rectify_points
from vision.strands import Strands, Tip, find_strands
from vision.thin import guo_hall
from vision.types import Floats

WIDTH_PX, LENGTH_PX = 5.7, 143.0


def strands_of(sticks: list[Stick], light: float = 160.0) -> Strands:
    grey = pair(sticks, light=light)[0]
    found = stands_out(grey, WIDTH_PX)
    look = Look(
        grey=grey.astype(np.float32),
        mask=found.mask,
        rect=rectification(rig()),
        side="left",
        width_px=WIDTH_PX,
        contrast_grey=found.contrast_grey,
    )
    pieces = straight_pieces(prune(trace(guo_hall(found.mask)), 8.0), 1.4, 4.4, 5.7)
    return find_strands(look, pieces, 0.6 * LENGTH_PX, 1.1 * LENGTH_PX)


def ends_px(stick: Stick) -> Floats:
    raw = project(np.stack([stick.start, stick.end]), rig())[0]
    return rectify_points(raw, rectification(rig()), "left")


def strand_of(strands: Strands, stick: Stick) -> tuple[int, float]:
    """The strand nearest to a stick, and how far the worse of its tips is off in px."""
    wanted = ends_px(stick)
    off = [
        min(np.linalg.norm(t - wanted, axis=1).max(), np.linalg.norm(t[::-1] - wanted, axis=1).max())
        for t in strands.tips
    ]
    best = int(np.argmin(off))
    return best, float(off[best])


def test_a_stick_in_the_open_is_one_strand_with_two_free_tips() -> None:
    stick = lying(0.01, 0.0, 33)

    strands = strands_of([stick])

    assert len(strands) == 1
    assert strands.kind.tolist() == [[Tip.FREE, Tip.FREE]]
    # a silhouette reaches up to half a pixel beyond the axis
    assert strand_of(strands, stick)[1] < 0.9
    assert strands.seen[0] > 0.95
    assert strands.width_px[0] == pytest.approx(5.5, abs=0.8)


@pytest.mark.parametrize("angle_deg", [15, 30, 60, 90])
def test_crossed_sticks_are_two_strands(angle_deg: int) -> None:
    sticks = [lying(0, 0, 10, height_m=0.002), lying(0, 0, 10 + angle_deg, height_m=0.006)]

    strands = strands_of(sticks)

    assert len(strands) == 2
    assert all(strand_of(strands, stick)[1] < 1.5 for stick in sticks)


def test_three_sticks_through_one_point_are_three_strands() -> None:
    sticks = [lying(0, 0, 5 + 60 * k, height_m=0.002 + 0.004 * k) for k in range(3)]

    strands = strands_of(sticks)

    assert len(strands) == 3
    assert all(strand_of(strands, stick)[1] < 1.5 for stick in sticks)


def test_two_sticks_in_line_with_a_gap_stay_two() -> None:
    sticks = [lying(-0.055, 0, 0), lying(0.055, 0, 0)]

    assert len(strands_of(sticks)) == 2


def test_a_tip_under_a_broad_part_is_hidden_and_may_reach_across_it() -> None:
    lower = lying(0, 0, 0)
    cover = Stick(start=np.array([0.05, -0.04, 0.39]), end=np.array([0.05, 0.04, 0.39]), radius_m=0.006)

    strands = strands_of([lower, cover])

    number = min(range(len(strands)), key=lambda n: abs(float(strands.direction[n, 1])))
    right = int(np.argmax(strands.tips[number, :, 0]))
    assert strands.kind[number, 1 - right] == Tip.FREE
    assert strands.kind[number, right] == Tip.HIDDEN
    beyond = ends_px(lower)[:, 0].max() - strands.tips[number, right, 0]
    assert 0 < beyond < strands.reach_px[number, right]
    assert strands.tip_sigma_px[number, right] > 10


def test_a_part_that_leaves_the_picture_has_a_border_tip() -> None:
    strands = strands_of([lying(0.21, 0.0, 3)])

    assert Tip.BORDER in strands.kind[0].tolist()
    assert np.isinf(strands.reach_px).any()


def test_an_empty_picture_has_no_strands() -> None:
    strands = strands_of([])

    assert len(strands) == 0
    assert strands.tips.shape == (0, 2, 2)
