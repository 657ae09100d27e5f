"""What belongs to the empty tray is neither a part nor in the way; a part that lies there is not lost."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.reference.looks import ROD
from tests.reference.sticks import TABLE, Grey, Stick, lying, pair, rig
from vision.empty import change, near_changes, put_there
from vision.foreground import stands_out
from vision.locate import locate
from vision.types import Candidate, EmptyTray, Scene, Tuning

BAR = lying(0.01, -0.005, 35)
"""Belongs to the tray, and looks in every respect like a part."""
NEAR_M = 0.004


def found(sticks: list[Stick], empty: list[Stick] | None, seed: int = 0) -> Scene:
    """A look at sticks, with pictures of the empty tray taken at another time or without."""
    left, right = pair(sticks, seed=seed)
    reference = None
    if empty is not None:
        reference = EmptyTray(**dict(zip(("left", "right"), pair(empty, seed=seed + 1000), strict=True)))
    return locate(left, right, rig(), ROD, Tuning(empty=reference), TABLE)


def is_there(stick: Stick, candidates: tuple[Candidate, ...]) -> bool:
    ends = np.stack([stick.start, stick.end])
    return any(
        min(
            np.linalg.norm(np.stack(pair) - ends, axis=1).mean()
            for pair in ((c.start, c.end), (c.end, c.start))
        )
        < NEAR_M
        for c in candidates
    )


def anywhere(random: np.random.Generator, half_m: float, height_m: float = 0.002) -> Stick:
    x, y = random.uniform(-half_m, half_m, 2)
    return lying(float(x), float(y), float(random.uniform(0, 180)), height_m=height_m)


# ------------------------------------------------------------------------------ pictures


def test_the_same_tray_has_not_changed_whatever_the_noise() -> None:
    for seed in range(4):
        then, now = pair([BAR], seed=seed)[0], pair([BAR], seed=seed + 50)[0]
        assert change(now, then).mask.mean() < 1e-4


@pytest.mark.parametrize("factor", [0.6, 0.8, 1.25])
def test_another_exposure_changes_nothing(factor: float) -> None:
    then = pair([BAR], seed=1)[0]
    darker = np.clip(pair([BAR], seed=2)[0] * factor, 0, 255).astype(np.uint8)
    here = change(darker, then)
    assert here.light is not None
    assert here.light.factor == pytest.approx(factor, rel=0.03)
    assert here.mask.mean() < 1e-4


def test_a_camera_that_trembles_by_most_of_a_pixel_changes_nothing() -> None:
    then, now = pair([BAR], seed=1)[0], pair([BAR], seed=2)[0]
    moved = cv2.warpAffine(
        now, np.array([[1.0, 0.0, 0.7], [0.0, 1.0, -0.6]]), (640, 480), borderMode=cv2.BORDER_REPLICATE
    )
    assert change(np.asarray(moved, np.uint8), then).mask.mean() < 1e-3


def test_a_part_is_a_change_where_it_lies() -> None:
    stick = lying(-0.03, 0.02, 110)
    drawn, there = pair([stick], noise_grey=0.0)[0], pair([BAR, stick], seed=3)[0]
    inside = drawn > 150
    elsewhere = inside & ~(pair([BAR], noise_grey=0.0)[0] > 60)
    assert change(there, pair([BAR], seed=4)[0]).mask[elsewhere].mean() > 0.99


def test_a_part_as_bright_as_what_it_crosses_stays_in_one_piece() -> None:
    across = lying(0.01, -0.005, 125, height_m=0.006)
    now, then = pair([BAR, across], seed=5)[0], pair([BAR], seed=6)[0]
    alone = pair([across], noise_grey=0.0)[0] > 150
    kept = put_there(stands_out(now, 5.7), now, then, 5.7)
    assert kept.mask[alone].mean() > 0.97


@pytest.mark.parametrize(
    "now",
    [
        np.zeros((480, 640), np.uint8),
        np.full((480, 640), 255, np.uint8),
        np.random.default_rng(1).integers(20, 220, (480, 640)).astype(np.uint8),
    ],
    ids=["black", "white", "another scene"],
)
def test_a_reference_that_most_of_the_picture_contradicts_is_left_out(now: Grey) -> None:
    here = change(now, pair([BAR])[0])
    assert not here.usable
    assert here.mask.all()
    assert near_changes(now, pair([BAR])[0], 5.0).all()


def test_without_a_reference_the_foreground_is_the_same_object() -> None:
    now = pair([BAR])[0]
    seen = stands_out(now, 5.7)
    assert put_there(seen, now, None, 5.7) is seen


# ------------------------------------------------------------------------------ looks


def test_a_bar_of_the_tray_is_a_part_without_its_reference_and_none_with_it() -> None:
    assert is_there(BAR, found([BAR], None).offered)
    scene = found([BAR], [BAR])
    assert scene.candidates == ()
    assert len(scene.segments.start) == 0


@pytest.mark.parametrize("seed", range(4))
def test_parts_over_and_beside_the_bar_are_found_as_if_it_were_not_there(seed: int) -> None:
    random = np.random.default_rng(seed)
    bar = anywhere(random, 0.03)
    sticks = [anywhere(random, 0.07, 0.002 + 0.004 * (k % 3)) for k in range(5)]
    alone, among = found(sticks, None, seed), found([*sticks, bar], [bar], seed)
    for stick in sticks:
        assert is_there(stick, among.recognised) == is_there(stick, alone.recognised)
        assert is_there(stick, among.offered) >= is_there(stick, alone.offered)
    assert not is_there(bar, among.recognised)


def test_what_has_moved_since_is_a_part_again() -> None:
    """A loose stick in the reference that somebody pushed aside is found where it lies now."""
    assert is_there(BAR, found([BAR], [lying(-0.04, 0.03, 100)]).offered)


def test_the_published_method_leaves_the_bar_out_too() -> None:
    stick = lying(-0.05, 0.03, 100)
    left, right = pair([BAR, stick], seed=7)
    empty = EmptyTray(**dict(zip(("left", "right"), pair([BAR], seed=8), strict=True)))
    without = Tuning(method="published", band=(110, 255))
    assert len(locate(left, right, rig(), ROD, without, TABLE).left.graph.points) == 4
    seen = locate(left, right, rig(), ROD, replace(without, empty=empty), TABLE)
    assert len(seen.left.graph.points) == 2
    assert is_there(stick, seen.candidates)
