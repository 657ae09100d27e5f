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


def strands_of(sticks: list[Stick], light: float = 160.0, width_px: float = WIDTH_PX) -> Strands:
    grey = pair(sticks, light=light)[0]
    found = stands_out(grey, width_px)
    look = Look(
        grey=grey.astype(np.float32),
        mask=found.mask,
        rect=rectification(rig()),
        side="left",
        width_px=width_px,
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


def beside(stick: Stick, shift_m: float, turn_deg: float, angle_deg: float) -> Stick:
    """A stick that touches another one, shifted along it or turned about the end where they touch."""
    along = (stick.end - stick.start) / np.linalg.norm(stick.end - stick.start)
    aside = np.array([-along[1], along[0], 0.0])
    turned = np.radians(angle_deg + turn_deg)
    way = np.array([np.cos(turned), np.sin(turned), 0.0])
    start = stick.start + shift_m * along + 0.004 * aside
    return Stick(start=start, end=start + 0.1 * way)


@pytest.mark.parametrize("angle_deg", [0, 25, 45, 78, 110, 135, 160])
@pytest.mark.parametrize(("shift_m", "turn_deg"), [(0.0, 0.0), (0.004, 0.0), (0.03, 0.0), (0.0, 3.0)])
def test_two_sticks_side_by_side_are_two_strands(angle_deg: int, shift_m: float, turn_deg: float) -> None:
    first = lying(0.005, 0.003, angle_deg)
    sticks = [first, beside(first, shift_m, turn_deg, angle_deg)]

    strands = strands_of(sticks)

    assert len(strands) == 2
    found = [strand_of(strands, stick) for stick in sticks]
    assert {number for number, _ in found} == {0, 1}
    assert all(off_px < 2.0 for _, off_px in found)
    # edges at a seam lie on the parts' shoulders
    assert strands.width_px == pytest.approx(4.8, abs=1.0)


@pytest.mark.parametrize("angle_deg", [0, 45, 78])
def test_three_sticks_side_by_side_are_three_strands(angle_deg: int) -> None:
    first = lying(0.005, 0.003, angle_deg)
    second = beside(first, 0.01, 0.0, angle_deg)

    strands = strands_of([first, second, beside(second, -0.02, 0.0, angle_deg)])

    assert len(strands) == 3


@pytest.mark.parametrize("angle_deg", [0, 30, 60, 135])
def test_a_part_of_twice_the_width_is_one_strand_where_parts_are_that_wide(angle_deg: int) -> None:
    thin = lying(0, 0, angle_deg)

    strands = strands_of([Stick(start=thin.start, end=thin.end, radius_m=0.004)], width_px=2 * WIDTH_PX)

    assert len(strands) == 1
    assert strands.width_px[0] == pytest.approx(2 * WIDTH_PX, abs=1.5)


@pytest.mark.parametrize("angle_deg", [0, 30, 60, 135])
def test_a_part_of_twice_the_width_is_not_taken_for_two(angle_deg: int) -> None:
    thin = lying(0, 0, angle_deg)

    assert len(strands_of([Stick(start=thin.start, end=thin.end, radius_m=0.004)])) == 0


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
