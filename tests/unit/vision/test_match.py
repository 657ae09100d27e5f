"""Whole-strand matching on drawn piles: the right partner, whatever the order."""

from __future__ import annotations

import numpy as np

from tests.reference.sticks import TABLE, Stick, lying, pair, rig
from vision.foreground import stands_out
from vision.graph import prune, trace
from vision.lines import straight_pieces
from vision.look import Look
from vision.match import Placed, match
from vision.reconstruct_lines import level_of_table
from vision.stereo import Side, rectification
from vision.strands import Strands, find_strands, rows_of
from vision.thin import guo_hall
from vision.types import Grey, PartModel

ROD = PartModel(code=1, name="rod", length_m=0.1, length_tolerance_m=0.004, diameter_m=0.004)
RECT = rectification(rig())
LEVEL = level_of_table(RECT, TABLE, (-0.005, 0.06))


def seen(grey: Grey, side: Side) -> tuple[Look, Strands]:
    found = stands_out(grey, 5.7)
    look = Look(
        grey=grey.astype(np.float32),
        mask=found.mask,
        rect=RECT,
        side=side,
        width_px=5.7,
        contrast_grey=found.contrast_grey,
    )
    pieces = straight_pieces(prune(trace(guo_hall(found.mask)), 8.0), 1.4, 4.4, 5.7)
    return look, find_strands(look, pieces, 86.0, 157.0)


def worst_m(placed: Placed, sticks: list[Stick]) -> float:
    """Distance of the worst stick to the part nearest to it."""
    off = []
    for stick in sticks:
        ends = np.stack([stick.start, stick.end])
        off.append(
            min(
                min(np.linalg.norm(e - ends, axis=1).max(), np.linalg.norm(e[::-1] - ends, axis=1).max())
                for e in placed.ends_m
            )
        )
    return float(max(off))


PARALLEL = [lying(-0.03 + 0.015 * k, 0.0, 80 + 2 * k) for k in range(5)]


def test_nearly_parallel_sticks_are_not_mixed_up() -> None:
    left, right = pair(PARALLEL)
    (look_l, strands_l), (look_r, strands_r) = seen(left, "left"), seen(right, "right")

    matches, placed = match(strands_l, strands_r, (look_l, look_r), LEVEL, ROD)

    assert len(matches.left) == 5
    assert matches.unmatched == 0
    assert worst_m(placed, PARALLEL) < 0.001
    assert (placed.cover > 0.95).all()
    assert not placed.completed.any()


def test_the_order_of_strands_does_not_matter() -> None:
    left, right = pair(PARALLEL)
    (look_l, strands_l), (look_r, strands_r) = seen(left, "left"), seen(right, "right")
    order = np.array([3, 0, 4, 2, 1])

    first, _ = match(strands_l, strands_r, (look_l, look_r), LEVEL, ROD)
    second, _ = match(strands_l, rows_of(strands_r, order), (look_l, look_r), LEVEL, ROD)

    assert dict(zip(first.left, first.right, strict=True)) == {
        a: order[b] for a, b in zip(second.left, second.right, strict=True)
    }


def test_a_stick_only_one_camera_sees_stays_alone() -> None:
    left, _ = pair(PARALLEL)
    _, right = pair(PARALLEL[:4])
    (look_l, strands_l), (look_r, strands_r) = seen(left, "left"), seen(right, "right")

    matches, placed = match(strands_l, strands_r, (look_l, look_r), LEVEL, ROD)

    assert matches.unmatched == 1
    assert len(placed.cost) == 4


def test_nothing_matches_nothing() -> None:
    left, right = pair([])
    (look_l, strands_l), (look_r, strands_r) = seen(left, "left"), seen(right, "right")

    matches, placed = match(strands_l, strands_r, (look_l, look_r), LEVEL, ROD)

    assert len(matches.left) == 0
    assert placed.ends_m.shape == (0, 2, 3)
