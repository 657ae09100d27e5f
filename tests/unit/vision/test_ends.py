"""Where the ends of steep parts are seen: beyond their axes, and at which rim of the end face."""

from __future__ import annotations

import numpy as np
import pytest

from bench import own, piles, rigs
from bench.looks import see
from bench.rigs import RIGS
from bench.scoring import answer_of, assign
from tests.reference.looks import Seen, frame, hypotheses, outlined
from tests.reference.sticks import Stick, lying
from vision.ends import LANES, RIM_LANES, cap_px, look_at_ends
from vision.refine import UNIT
from vision.types import Bools, Floats

FRAME = frame()
STEEP, FLAT = (
    hypotheses([lying(0.0, 0.0, 75, height_m=0.03, tilt_deg=tilt_deg)], FRAME)[0] for tilt_deg in (35, 8)
)


def outline_beyond(stick: Stick, end: int, view: int) -> float:
    """How far the far rim of an end face is seen beyond the axis, mean of five lanes, by brute force."""
    on = FRAME.on
    rotation = on.rect.rect_from_left
    start, stop = rotation @ stick.start, rotation @ stick.end
    here, other = (start, stop) if end == 0 else (stop, start)
    centre = np.array([on.baseline_m, 0.0, 0.0]) if view else np.zeros(3)
    axis = (here - other) / np.linalg.norm(here - other)
    first = np.cross(axis, [0.3, 0.4, 0.5])
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    angle = np.linspace(0, 2 * np.pi, 4000)[:, None]
    rim = here + stick.radius_m * (np.cos(angle) * first + np.sin(angle) * second) - centre
    pixel = on.focal_px * rim[:, :2] / rim[:, 2:]
    tip, far = (on.focal_px * (p - centre)[:2] / (p - centre)[2] for p in (here, other))
    way = (tip - far) / np.linalg.norm(tip - far)
    along, across = (pixel - tip) @ way, (pixel - tip) @ np.array([-way[1], way[0]])
    width = float(np.ptp(across))
    lanes = [along[np.abs(across - lane * 0.17 * width) < 0.02 * width].max() for lane in range(-2, 3)]
    return float(np.mean(lanes))


@pytest.mark.parametrize("tilt_deg", [-30, 0, 30])
@pytest.mark.parametrize("view", [0, 1])
def test_an_end_that_looks_away_is_seen_between_its_rounded_and_its_sharp_rim(
    tilt_deg: int, view: int
) -> None:
    stick = lying(0.03, 0.02, 30, height_m=0.03, tilt_deg=tilt_deg)
    row = hypotheses([stick], FRAME)[0]

    for end in range(2):
        width = FRAME.unit * row[3 + 3 * end]
        cap, doubt = cap_px(row[1:7].copy(), end, view, width, FRAME.camera, False)
        sharp = outline_beyond(stick, end, view)
        if cap > 0:
            assert cap - doubt - 0.05 < 0.5 / 0.87 * sharp < cap + doubt + 0.05
            assert cap - doubt - 0.05 < sharp < cap + doubt + 0.05
        else:
            # it looks towards the camera: its rim is seen at either side of the axis' end
            assert doubt == pytest.approx(0.4 / 0.87 * sharp, abs=0.06)


def reach_px(row: Floats) -> Floats:
    """(2, 2) how far the far rims of both ends are seen beyond the axis, by view and end."""
    return np.array(
        [
            [
                cap_px(row[1:7].copy(), end, view, row[UNIT] * row[3 + 3 * end], FRAME.camera, True)[0]
                for end in range(2)
            ]
            for view in range(2)
        ]
    )


def towards() -> int:
    """Which end of the steep part looks towards the camera."""
    away = [cap_px(STEEP[1:7].copy(), end, 0, FRAME.width_px, FRAME.camera, False)[0] > 0 for end in range(2)]
    assert sorted(away) == [False, True]
    return away.index(False)


def looked(row: Floats, of: Seen, *, with_rims: bool = True) -> tuple[Floats, Bools]:
    tips, far = np.zeros((2, 2, LANES, 2)), np.zeros((2, 2), np.bool_)
    for view, edges in enumerate((of.left, of.right)):
        free = np.zeros(len(edges.table) + 1, np.uint16)
        look_at_ends(row[1:7], row[UNIT], view, with_rims, 2.5, edges.posts, free, FRAME.camera, tips, far)
    return tips, far


def test_the_far_rim_of_a_bright_face_is_found_where_it_is_looked_for() -> None:
    of = outlined(STEEP, FRAME, reach_px(STEEP))

    tips, far = looked(STEEP, of)
    assert far.all()
    assert np.isfinite(tips[..., 0]).sum(axis=2).min() >= RIM_LANES
    assert not looked(STEEP, of, with_rims=False)[1].any()


def test_of_a_dark_face_only_the_near_rim_is_seen() -> None:
    beyond = reach_px(STEEP)
    beyond[:, towards()] *= -1.0

    tips, far = looked(STEEP, outlined(STEEP, FRAME, beyond))

    assert not far[:, towards()].any()
    assert np.isfinite(tips[:, towards(), :, 0]).all()


def test_the_rims_of_a_part_that_lies_nearly_flat_are_not_told_apart() -> None:
    end = 0 if cap_px(FLAT[1:7].copy(), 0, 0, FRAME.width_px, FRAME.camera, False)[0] == 0 else 1

    _, far = looked(FLAT, outlined(FLAT, FRAME, reach_px(FLAT)))

    assert not far[:, end].any()


@pytest.mark.parametrize("number", [14, 34, 38])
def test_steep_parts_do_not_slide_along_themselves_beyond_their_doubt(number: int) -> None:
    """Sticks under bright and dark light that lean on a block: their ends are seen two pixels beyond them."""
    webcam = RIGS["webcam"]
    shot = piles.draw("T", webcam, 7701, number)
    case = own.case_of(shot, rigs.known(webcam), "T", f"T-{number + 1}", 7701)

    found = answer_of(see(case, "default").scene, None).found
    errors = [error for _, error in assign(found, case.truth.parts).values()]

    assert len(errors) == 3
    assert max(error.middle_m / error.sigma_m for error in errors) < 2.5
    assert np.median([error.middle_m for error in errors]) < 0.0006
