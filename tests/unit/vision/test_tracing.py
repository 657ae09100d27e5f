"""Strands of drawn shapes whose centre lines are known, and of a few photographs."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from bench.crossings import colour_mask, curves_of, judge
from vision.graph import trace
from vision.thin import guo_hall
from vision.tracing import Curves, label, trace_curves

PHOTOGRAPHS = Path(__file__).parents[4] / "shared" / "data" / "real" / "mbest_S1"
Floats = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


def drawn(lines: list[tuple[Floats, float]], size: tuple[int, int] = (300, 400)) -> Mask:
    """Every pixel within half a width of a line: (points (K, 2) px, width px)."""
    v, u = np.mgrid[: size[0], : size[1]]
    mask = np.zeros(size, bool)
    for points, width in lines:
        for a, b in pairwise(points):
            step = b - a
            t = np.clip(((u - a[0]) * step[0] + (v - a[1]) * step[1]) / (step @ step), 0, 1)
            mask |= np.hypot(u - a[0] - t * step[0], v - a[1] - t * step[1]) <= width / 2
    return mask


def bar(degrees: float, length: float = 240.0, middle: tuple[float, float] = (200.3, 150.4)) -> Floats:
    turn = np.radians(degrees)
    half = 0.5 * length * np.array([np.cos(turn), np.sin(turn)])
    return np.array([np.array(middle) - half, np.array(middle) + half])


def distance(points: Floats, line: Floats) -> Floats:
    """(K,) px from each point to a line of segments."""
    best = np.full(len(points), np.inf)
    for a, b in pairwise(line):
        t = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        best = np.minimum(best, np.hypot(*(points - a - t[:, None] * (b - a)).T))
    return best


def owners(curves: Curves, lines: list[Floats], off_px: float) -> list[int]:
    """For each curve the number of the one drawn line that all of it but its round tips follows, or -1."""
    found = []
    for curve in curves.lines:
        near = [k for k, line in enumerate(lines) if distance(curve[6:-6], line).max() < off_px]
        found.append(near[0] if len(near) == 1 else -1)
    return sorted(found)


@pytest.mark.parametrize("angle_deg", [90, 60, 45, 30, 20, 12])
def test_two_bars_that_cross_are_two_strands_at_any_angle(angle_deg: float) -> None:
    bars = [bar(17.0), bar(17.0 + angle_deg)]
    curves = curves_of(drawn([(line, 7.0) for line in bars]))

    assert owners(curves, bars, 2.0) == [0, 1]
    assert curves.length_px == pytest.approx([247.0, 247.0], abs=3.0)  # with the round tips
    assert curves.radius_px == pytest.approx([3.5, 3.5], abs=0.6)


@pytest.mark.parametrize("bars", [3, 5, 9])
def test_any_number_of_bars_through_one_place(bars: int) -> None:
    lines = [bar(10.0 + 180.0 * k / bars, 280.0) for k in range(bars)]
    curves = curves_of(drawn([(line, 5.0) for line in lines]))

    assert owners(curves, lines, 2.5) == list(range(bars))


def test_a_bar_that_ends_at_another_stays_alone() -> None:
    through = bar(0.0)
    ends_here = np.array([[180.0, 30.0], [200.0, 150.0]])
    curves = curves_of(drawn([(through, 7.0), (ends_here, 7.0)]))

    assert owners(curves, [through, ends_here], 2.0) == [0, 1]
    assert sorted(curves.length_px.tolist()) == pytest.approx([120.0, 247.0], abs=7.0)


def test_a_thick_strand_under_two_thin_ones_is_not_taken_for_their_bridge() -> None:
    thick = bar(0.0, 300.0)
    thin = [bar(80.0, 200.0, (160.0, 150.0)), bar(100.0, 200.0, (230.0, 150.0))]
    curves = curves_of(drawn([(thick, 13.0), (thin[0], 5.0), (thin[1], 5.0)]))

    assert owners(curves, [thick, *thin], 2.5) == [0, 1, 2]


def test_bent_strands_go_through_their_crossings() -> None:
    t = np.linspace(0, 1, 200)
    wave = np.stack([40 + 320 * t, 150 + 40 * np.sin(9 * t)], axis=1)
    turn = np.linspace(0.5, 2 * np.pi + 1.0, 200)
    loop = np.stack([200 + (90 - 4 * turn) * np.cos(turn), 150 + (110 - 8 * turn) * np.sin(turn)], axis=1)
    curves = curves_of(drawn([(wave, 6.0), (loop, 6.0)]))

    assert owners(curves, [wave, loop], 3.0) == [0, 1]


def test_a_ring_is_closed_also_when_a_bar_lies_across_it() -> None:
    turn = np.linspace(0, 2 * np.pi, 120)
    ring = np.stack([200 + 80 * np.cos(turn), 150 + 80 * np.sin(turn)], axis=1)
    across = bar(20.0)

    alone = curves_of(drawn([(ring, 6.0)]))
    both = curves_of(drawn([(ring, 6.0), (across, 6.0)]))

    assert alone.closed.tolist() == [True]
    assert alone.length_px == pytest.approx([2 * np.pi * 80], rel=0.02)
    assert sorted(both.closed.tolist()) == [False, True]
    assert owners(both, [ring, across], 2.5) == [0, 1]


@pytest.mark.parametrize("width", [4.0, 6.0, 9.0])
@pytest.mark.parametrize("degrees", [3.0, 13.0, 45.0, 81.0])
def test_the_points_are_on_the_axis_to_a_fraction_of_a_pixel(width: float, degrees: float) -> None:
    line = bar(degrees)
    curves = curves_of(drawn([(line, width)]))

    assert len(curves) == 1
    off = distance(curves.points[4:-4], line)
    assert np.sqrt((off**2).mean()) < 0.25
    tips = curves.points[[0, -1]]
    half = 0.5 * width
    true = line + half * np.array([[-1.0], [1.0]]) * (line[1] - line[0]) / np.linalg.norm(line[1] - line[0])
    gap = np.linalg.norm(tips[:, None] - true[None], axis=2)
    assert min(gap[0, 0] + gap[1, 1], gap[0, 1] + gap[1, 0]) < 2.4


def test_every_pixel_has_the_label_of_its_strand_and_specks_have_none() -> None:
    bars = [bar(17.0), bar(77.0)]
    masks = [drawn([(line, 7.0)]) for line in bars]
    speck = np.zeros_like(masks[0])
    speck[10:13, 10:13] = True
    mask = masks[0] | masks[1] | speck

    curves = curves_of(mask)
    found = label(mask, curves)

    assert (found[~mask] == -1).all()
    assert (found[speck] == -1).all()
    first = int(distance(curves.lines[0], bars[0]).max() > 2.0)
    only = [masks[first] & ~masks[1 - first], masks[1 - first] & ~masks[first]]
    assert [float((found[one] == k).mean()) > 0.99 for k, one in enumerate(only)] == [True, True]
    assert (found[masks[0] & masks[1]] >= 0).all()


def test_nothing_gives_nothing() -> None:
    mask = np.zeros((40, 60), bool)
    curves = trace_curves(mask, trace(guo_hall(mask)))

    assert len(curves) == 0
    assert (label(mask, curves) == -1).all()


@pytest.mark.shared_data
@pytest.mark.skipif(not PHOTOGRAPHS.is_dir(), reason="no shared data here")
@pytest.mark.parametrize("number", [3, 13, 24, 29, 33, 70])
def test_a_photographed_rod_that_crosses_itself_is_one_strand(number: int) -> None:
    picture = cv2.imread(str(PHOTOGRAPHS / "images" / f"img{number}.jpg"))
    truth = cv2.imread(str(PHOTOGRAPHS / "labels" / f"img{number}.png"), cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    assert truth is not None
    mask = colour_mask(np.asarray(picture, np.uint8))
    curves = curves_of(mask)

    exact, dice = judge(label(mask, curves), len(curves), np.asarray(truth, np.uint8))

    assert exact
    assert dice > 0.98
    assert not curves.closed.any()
