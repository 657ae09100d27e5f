"""The default method on drawn sticks: found, measured, completed, refused, ranked; on rendered scenes."""

from __future__ import annotations

import json
import runpy
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from tests.reference.sticks import DEPTH_M, TABLE, Stick, lying, pair, rig
from vision.default import locate_default, warm_up
from vision.types import Candidate, ColourRange, PartModel, Refusal, Scene, Tuning

ROD = PartModel(code=7, name="rod", length_m=0.1, length_tolerance_m=0.004, diameter_m=0.004)
SHARED = Path(__file__).parents[4] / "shared" / "data" / "scenes-dev"


def look(sticks: list[Stick], tuning: Tuning | None = None, part: PartModel = ROD) -> Scene:
    left, right = pair(sticks)
    return locate_default(left, right, rig(), part, tuning or Tuning(), TABLE)


def nearest(candidates: tuple[Candidate, ...], stick: Stick) -> tuple[Candidate, float]:
    """The candidate closest to a stick, and the distance of the worse of its ends in m."""

    def apart(c: Candidate) -> float:
        same = max(np.linalg.norm(c.start - stick.start), np.linalg.norm(c.end - stick.end))
        turned = max(np.linalg.norm(c.start - stick.end), np.linalg.norm(c.end - stick.start))
        return float(min(same, turned))

    best = min(candidates, key=apart)
    return best, apart(best)


def reasons(candidate: Candidate) -> set[Refusal]:
    return {refused.reason for refused in candidate.refusals}


@pytest.mark.parametrize("angle_deg", [0, 3, 20, 45, 70, 90, 120, 135, 160])
def test_a_stick_in_the_open_is_measured_to_a_millimetre_at_every_angle(angle_deg: int) -> None:
    stick = lying(0.01, -0.015, angle_deg)

    scene = look([stick])

    assert len(scene.offered) == 1
    found, off_m = nearest(scene.offered, stick)
    # a pixel of disparity is four millimetres here
    assert off_m < 0.0011
    assert np.linalg.norm(found.centre - 0.5 * (stick.start + stick.end)) < 3 * found.sigma_m
    assert found.length_m == pytest.approx(0.1, abs=0.0006)
    assert found.score > 0.8
    assert found.part_code == 7


@pytest.mark.parametrize("angle_deg", [0, 30, 60, 90, 135])
@pytest.mark.parametrize("shift_m", [0.0, 0.02])
def test_two_sticks_side_by_side_are_both_offered(angle_deg: int, shift_m: float) -> None:
    first = lying(0.0, 0.0, angle_deg)
    along = (first.end - first.start) / 0.1
    # half a millimetre between them: half a pixel
    step = shift_m * along + 0.0045 * np.array([-along[1], along[0], 0.0])
    second = Stick(start=first.start + step, end=first.end + step)

    scene = look([first, second])

    assert len(scene.offered) == 2
    # nearer than the parts' own width: each is itself and not the two of them
    assert all(nearest(scene.offered, stick)[1] < 0.002 for stick in (first, second))


def test_of_two_crossed_sticks_the_upper_is_offered_and_the_lower_refused() -> None:
    upper, lower = lying(0, 0, 20, height_m=0.006), lying(0, 0, 80, height_m=0.002)

    scene = look([upper, lower])

    assert len(scene.offered) == 1
    assert nearest(scene.offered, upper)[1] < 0.0015
    under, off_m = nearest(scene.candidates, lower)
    assert off_m < 0.0015
    assert reasons(under) == {Refusal.CROSSED}


def test_a_crossing_near_the_end_does_not_keep_a_stick_from_being_picked_but_comes_second() -> None:
    upper = lying(0.03, 0, 90, height_m=0.006)
    lower = Stick(start=np.array([-0.06, 0.02, 0.398]), end=np.array([0.04, 0.02, 0.398]))

    scene = look([upper, lower])

    assert [nearest((c,), upper)[1] < 0.002 for c in scene.offered] == [True, False]


def test_the_known_length_completes_a_tip_that_lies_under_others() -> None:
    lower = lying(0, 0, 60, height_m=0.002)
    along = (lower.end - lower.start) / 0.1
    hidden = lower.end - 0.001 * along
    cover = Stick(
        start=np.array([hidden[0] - 0.05, hidden[1] + 0.004, DEPTH_M - 0.006]),
        end=np.array([hidden[0] + 0.05, hidden[1] + 0.004, DEPTH_M - 0.006]),
        radius_m=0.006,
    )

    scene = look([lower, cover])

    found, off_m = nearest(scene.offered, lower)
    assert off_m < 0.003
    assert found.length_m == pytest.approx(0.1, abs=0.0003)


@pytest.mark.parametrize("length_m", [0.08, 0.13])
def test_a_stick_of_another_length_is_refused_with_its_length(length_m: float) -> None:
    scene = look([lying(0, 0, 50, length_m=length_m)])

    assert scene.offered == ()
    refused = scene.candidates[0].refusals[0]
    assert refused.reason is Refusal.LENGTH
    assert refused.value == pytest.approx(length_m, abs=0.001)
    assert refused.unit == "m"


def test_a_stick_twice_as_thick_is_refused_by_its_width() -> None:
    stick = lying(0, 0, 50, height_m=0.004)
    thick = Stick(start=stick.start, end=stick.end, radius_m=0.0036)

    scene = look([thick])

    assert scene.offered == ()


def test_a_steep_stick_is_refused_with_its_tilt() -> None:
    stick = lying(0, 0, 60, height_m=0.022, tilt_deg=25)

    fine = look([stick])
    strict = look([stick], Tuning(max_tilt_rad=0.3))

    assert len(fine.offered) == 1
    refused = {r.reason: r for r in strict.candidates[0].refusals}
    assert refused[Refusal.TILT].value == pytest.approx(np.radians(25), abs=0.03)


def test_a_stick_above_the_height_range_is_refused_by_depth() -> None:
    scene = look([lying(0, 0, 60, height_m=0.04)], Tuning(height_m=(-0.005, 0.025)))

    assert scene.offered == ()
    assert all(Refusal.DEPTH in reasons(c) for c in scene.candidates)


def test_a_depth_range_does_instead_of_a_table() -> None:
    stick = lying(0, 0, 60)
    left, right = pair([stick])

    scene = locate_default(left, right, rig(), ROD, Tuning(depth_m=(0.35, 0.42)))

    assert nearest(scene.offered, stick)[1] < 0.0015
    with pytest.raises(ValueError, match="depth range"):
        locate_default(left, right, rig(), ROD, Tuning())


def test_an_empty_table_gives_nothing() -> None:
    scene = look([])

    assert scene.candidates == ()
    assert scene.segments.start.shape == (0, 3)


def test_one_camera_covered_gives_nothing() -> None:
    left, _ = pair([lying(0, 0, 60)])
    _, empty = pair([])

    assert locate_default(left, empty, rig(), ROD, Tuning(), TABLE).offered == ()


def test_a_pile_is_found_and_nothing_false_is_offered() -> None:
    random = np.random.default_rng(5)
    sticks = [
        lying(
            random.uniform(-0.05, 0.05), random.uniform(-0.04, 0.04), 17 + 29 * k, height_m=0.002 + 0.004 * k
        )
        for k in range(6)
    ]

    scene = look(sticks)

    whole = tuple(c for c in scene.candidates if reasons(c) <= {Refusal.CROSSED})
    assert sum(nearest(whole, stick)[1] < 0.003 for stick in sticks) == 6
    assert all(min(nearest((c,), stick)[1] for stick in sticks) < 0.003 for c in scene.offered)
    assert nearest(scene.offered, sticks[-1])[1] < 0.003


def test_pictures_stay_as_they_were_and_stages_are_told_in_order() -> None:
    left, right = pair([lying(0, 0, 60)])
    before = left.copy(), right.copy()
    stages: list[str] = []

    scene = locate_default(
        left, right, rig(), ROD, Tuning(), TABLE, observe=lambda stage, _product: stages.append(stage)
    )

    assert np.array_equal(left, before[0])
    assert np.array_equal(right, before[1])
    # `first` comes before the rest is explained, where a part is certain already
    assert stages == [
        "binarize", "graph", "edges", "lines", "windows", "first", "explain", "rows", "polish", "retrieve",
    ]  # fmt: skip
    assert scene.method == "default"
    assert len(scene.left.graph.edges) >= 1


def test_a_band_is_the_mask_and_what_the_graph_is_made_from() -> None:
    scene = look([lying(0, 0, 60)], Tuning(band=(120, 255)))

    assert np.array_equal(scene.left.mask, scene.left.grey >= 120)
    assert scene.left.band == (120, 255)
    assert len(scene.left.graph.edges) >= 1
    assert len(look([lying(0, 0, 60)], Tuning(band=(250, 255))).left.graph.edges) == 0


def test_half_the_light_finds_the_same() -> None:
    stick = lying(0.01, 0.01, 35)
    left, right = pair([stick], table_grey=20, light=60)

    scene = locate_default(left, right, rig(), ROD, Tuning(), TABLE)

    assert nearest(scene.offered, stick)[1] < 0.002


def test_pictures_of_a_wrong_size_are_refused() -> None:
    with pytest.raises(ValueError, match="calibrated"):
        locate_default(
            np.zeros((10, 10), np.uint8), np.zeros((10, 10), np.uint8), rig(), ROD, Tuning(), TABLE
        )


def test_warming_up_needs_nothing() -> None:
    warm_up()


def bent(turn_deg: float) -> list[Stick]:
    """Short pieces on an arc of a decimetre that turns by this much."""
    turn = np.radians(np.linspace(-0.5 * turn_deg, 0.5 * turn_deg, 15))
    radius = 0.1 / np.radians(turn_deg)
    points = np.stack(
        [radius * np.sin(turn), radius * (np.cos(turn) - 1), np.full(15, DEPTH_M - 0.002)], axis=1
    )
    return [Stick(start=a, end=b) for a, b in pairwise(points)]


@pytest.mark.parametrize("turn_deg", [25, 60])
def test_a_bent_stick_is_not_offered(turn_deg: float) -> None:
    assert look(bent(turn_deg)).offered == ()


def test_a_thread_is_not_offered() -> None:
    stick = lying(0.0, 0.0, 50, height_m=0.0005)

    assert look([Stick(start=stick.start, end=stick.end, radius_m=0.0005)]).offered == ()


def test_a_stick_that_leaves_the_picture_is_not_offered() -> None:
    assert look([lying(-0.22, 0.0, 10)]).offered == ()


def test_a_colour_needs_a_colour_picture() -> None:
    left, right = pair([lying(0, 0, 60)])
    part = replace(ROD, colour=ColourRange(hue_deg=(340, 20), saturation=(0.5, 1.0)))

    with pytest.raises(ValueError, match="colour picture"):
        locate_default(left, right, rig(), part, Tuning(), TABLE)
    blue = np.stack([left, left // 5, left // 5], axis=-1)
    scene = locate_default(left, right, rig(), part, Tuning(), TABLE, colour_left=blue)
    assert [reasons(c) for c in scene.candidates] == [{Refusal.COLOUR}]


def test_what_no_part_explains_is_a_segment_all_the_same() -> None:
    thick = Stick(start=np.array([-0.05, 0.03, 0.39]), end=np.array([0.05, 0.03, 0.39]), radius_m=0.009)

    scene = look([thick, lying(0.0, -0.03, 60)])

    assert len(scene.offered) == 1
    lengths = np.linalg.norm(scene.segments.end - scene.segments.start, axis=1)
    assert len(lengths) > len(scene.candidates) or (lengths > 0.05).sum() >= 2


SCENES = ("A1", "B1", "C1", "H10-1", "T15", "N-empty", "N-cable")


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of ``mikado evaluate`` on a few rendered scenes."""
    from cell.evaluate import evaluate

    out = tmp_path_factory.mktemp("results")
    evaluate(SHARED, out, "default", SCENES)
    return out


@pytest.mark.shared_data
@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared scenes are not here")
@pytest.mark.parametrize("name", SCENES)
def test_rendered_scenes_are_found_whole_and_nothing_false_is(rendered: Path, name: str) -> None:
    score_scene = runpy.run_path(str(SHARED / "evaluate.py"))["score_scene"]
    truth = json.loads((SHARED / "scenes" / name / "gt.json").read_text(encoding="utf-8"))

    score = score_scene(truth, json.loads((rendered / f"{name}.json").read_text(encoding="utf-8")))

    assert score["hit_vis"] == score["n_vis"]
    assert score["fp"] == 0
    assert score["rank1"] in (True, None)
    assert score["n_det"] == 0 or not score["negative"]
