"""Parts with a topology: found where they lie, as what they are, with honest doubt; others are not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.reference.shapes import (
    BRACKET,
    ELL,
    KEY,
    PLATE_TEE,
    SPANNER,
    TEE,
    WYE,
    Laid,
    flat_pair,
    laid,
    sticks_of,
)
from tests.reference.sticks import TABLE, lying, pair, rig
from vision import shapes
from vision.default import locate_default
from vision.shapes import locate_shapes
from vision.types import Candidate, NodeKind, PartModel, Refusal, Scene, Topology, Tuning

SHARED = Path(__file__).parents[4] / "shared" / "data" / "scenes-dev"
RODS = {"T": TEE, "Y": WYE, "L": ELL, "key": KEY}
PLATES = {"bracket": BRACKET, "tee": PLATE_TEE, "spanner": SPANNER}


def look(parts: list[Laid], wanted: PartModel, seed: int = 0) -> Scene:
    left, right = pair([stick for one in parts for stick in sticks_of(one)], seed=seed)
    return locate_shapes(left, right, rig(), wanted, Tuning(), TABLE)


def off_m(candidate: Candidate, truth: Laid) -> float:
    """Distance of the worst node from the nearest true node of its kind."""
    topology = truth.part.topology
    assert topology is not None
    gaps = np.linalg.norm(candidate.nodes[:, None] - truth.nodes[None], axis=2)
    same = np.array([[a is b for b in topology.kinds] for a in topology.kinds])
    return float(np.where(same, gaps, np.inf).min(axis=1).max())


def reasons(candidate: Candidate) -> set[Refusal]:
    return {refused.reason for refused in candidate.refusals}


@pytest.mark.parametrize("cls", sorted(RODS))
@pytest.mark.parametrize("over", [False, True])
@pytest.mark.parametrize("yaw_deg", [0, 37, 122, 250])
def test_a_rod_part_in_the_open_is_measured_to_a_millimetre(cls: str, over: bool, yaw_deg: int) -> None:
    # along the baseline only end faces and the short arm tell depth
    limit_m = 0.002 if yaw_deg == 0 else 0.0012
    truth = laid(RODS[cls], 0.02, -0.01, yaw_deg, over=over)

    scene = look([truth], RODS[cls])

    (found,) = scene.offered
    assert off_m(found, truth) < limit_m
    assert found.length_m == pytest.approx(RODS[cls].length_m, rel=1e-6)
    assert found.score > 0.8


@pytest.mark.parametrize("cls", sorted(PLATES))
@pytest.mark.parametrize("over", [False, True])
@pytest.mark.parametrize("yaw_deg", [15, 200])
def test_flat_parts_are_measured_on_either_face(cls: str, over: bool, yaw_deg: int) -> None:
    truth = laid(PLATES[cls], 0.02, -0.01, yaw_deg, over=over)
    left, right = flat_pair([truth])

    scene = locate_shapes(left, right, rig(), PLATES[cls], Tuning(), TABLE)

    (found,) = scene.offered
    assert off_m(found, truth) < 0.001
    assert found.sigma_m < 0.002


@pytest.mark.parametrize("seed", range(12))
def test_any_pose_of_any_rod_part_is_recovered_within_three_sigma(seed: int) -> None:
    random = np.random.default_rng(seed)
    part = RODS[sorted(RODS)[seed % 4]]
    truth = laid(
        part,
        float(random.uniform(-0.03, 0.08)),
        float(random.uniform(-0.06, 0.06)),
        float(random.uniform(0, 360)),
        over=bool(random.integers(2)),
        height_m=float(random.uniform(0.006, 0.012)),
        tilt_deg=float(random.uniform(-5, 5)),
    )

    (found,) = look([truth], part, seed).offered

    assert part.topology is not None
    first, last = (truth.nodes[n] for n in part.topology.axis)
    assert np.linalg.norm(found.centre - 0.5 * (first + last)) < 3 * found.sigma_m < 0.004
    axis = (last - first) / np.linalg.norm(last - first)
    assert np.arccos(min(1.0, abs(float(found.axis @ axis)))) < 3 * found.sigma_rad < 0.08


@pytest.mark.parametrize("lies", sorted(RODS))
@pytest.mark.parametrize("wanted", sorted(RODS))
def test_other_parts_are_not_taken_for_the_product(lies: str, wanted: str) -> None:
    scene = look([laid(RODS[lies], 0.02, -0.01, 70)], RODS[wanted])

    assert len(scene.recognised) == (1 if lies == wanted else 0)


def test_an_l_is_not_found_in_the_arms_of_a_t_even_where_its_legs_would_fit() -> None:
    short = Topology(
        points=np.array([[0.03, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.03, 0.0]]),
        kinds=(NodeKind.END, NodeKind.CORNER, NodeKind.END),
        edges=np.array([[0, 1], [1, 2]]),
        axis=(0, 1),
    )
    part = PartModel(
        code=1, name="L", length_m=0.03, length_tolerance_m=0.008, diameter_m=0.004, topology=short
    )

    scene = look([laid(TEE, 0.02, -0.01, 20)], part)

    assert scene.recognised == ()


def test_two_crossed_sticks_are_no_t() -> None:
    bar, stem = lying(0.02, 0.0, 0, length_m=0.06), lying(0.02, 0.02, 90, length_m=0.06, height_m=0.006)
    left, right = pair([bar, stem])

    assert locate_shapes(left, right, rig(), TEE, Tuning(), TABLE).recognised == ()


def test_parts_of_one_kind_over_each_other_are_each_found_once() -> None:
    lower, upper = laid(TEE, 0.0, 0.0, 10), laid(TEE, 0.02, 0.02, 140, height_m=0.006)

    scene = look([lower, upper], TEE)

    assert len(scene.recognised) == 2
    for truth in (lower, upper):
        assert min(off_m(found, truth) for found in scene.recognised) < 0.002


def test_what_lies_over_the_middle_of_the_axis_keeps_a_part_from_being_offered() -> None:
    truth = laid(KEY, 0.0, 0.0, 0)
    middle = 0.5 * (truth.nodes[0] + truth.nodes[1])
    left, right = pair([*sticks_of(truth), lying(middle[0], middle[1], 75, length_m=0.08, height_m=0.006)])

    scene = locate_shapes(left, right, rig(), KEY, Tuning(), TABLE)

    (found,) = scene.recognised
    assert off_m(found, truth) < 0.002
    assert reasons(found) == {Refusal.CROSSED}
    (refused,) = found.refusals
    assert refused.value > refused.limit


def test_the_part_on_top_is_ranked_before_the_part_below() -> None:
    lower, upper = laid(KEY, 0.0, 0.0, 0), laid(KEY, 0.025, -0.03, 95, height_m=0.006)

    scene = look([lower, upper], KEY)

    assert off_m(scene.recognised[0], upper) < 0.002


def test_a_part_cut_by_the_border_is_not_offered() -> None:
    scene = look([laid(TEE, 0.21, 0.0, 0)], TEE)

    assert scene.offered == ()


def test_an_empty_table_has_nothing_on_it() -> None:
    left, right = pair([])

    assert locate_shapes(left, right, rig(), TEE, Tuning(), TABLE).candidates == ()


def test_a_depth_range_does_without_a_table() -> None:
    truth = laid(WYE, 0.02, -0.01, 30)
    left, right = pair(sticks_of(truth))

    scene = locate_shapes(left, right, rig(), WYE, Tuning(depth_m=(0.34, 0.4)), None)

    (found,) = scene.offered
    assert off_m(found, truth) < 0.0012


def test_neither_table_nor_depths_is_refused() -> None:
    left, right = pair([])
    with pytest.raises(ValueError, match="depth range"):
        locate_shapes(left, right, rig(), TEE, Tuning(), None)


def test_a_stick_has_no_topology_to_look_for() -> None:
    left, right = pair([])
    stick = PartModel(code=1, name="stick", length_m=0.1, length_tolerance_m=0.004, diameter_m=0.004)
    with pytest.raises(ValueError, match="no topology"):
        locate_shapes(left, right, rig(), stick, Tuning(), TABLE)


def test_the_segments_of_a_scene_are_the_arms_of_what_was_found() -> None:
    truth = laid(TEE, 0.02, -0.01, 30)

    scene = look([truth], TEE)

    assert len(scene.segments.start) == 3
    lengths = np.linalg.norm(scene.segments.end - scene.segments.start, axis=1)
    np.testing.assert_allclose(np.sort(lengths), [0.030, 0.030, 0.044], atol=1e-6)


def test_the_default_method_sends_parts_with_a_topology_here() -> None:
    truth = laid(ELL, 0.0, 0.0, 300)
    left, right = pair(sticks_of(truth))

    scene = locate_default(left, right, rig(), ELL, Tuning(), TABLE)

    assert scene.method == "default"
    assert off_m(scene.offered[0], truth) < 0.0012


def test_warming_up_runs_every_stage_on_a_part_that_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    found: list[Scene] = []

    def looked(*given: Any) -> Scene:
        found.append(locate_shapes(*given))
        return found[-1]

    monkeypatch.setattr(shapes, "locate_shapes", looked)

    shapes.warm_up()

    assert len(found) == 1
    assert len(found[0].offered) == 2


@pytest.mark.shared_data
@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared scenes are not here")
@pytest.mark.parametrize(
    ("name", "least", "offered"),
    [("D1", 2, 2), ("D2", 2, 2), ("E1", 1, 1), ("G1", 1, 1), ("G2", 1, 0), ("G3", 2, 2)],
)
def test_rendered_parts_are_all_found_and_nothing_else(name: str, least: int, offered: int) -> None:
    from cell import scenes

    folder = scenes.find(SHARED, (name,))[0]
    calibration = scenes.rig(folder)
    wanted = scenes.request(folder, 0.008)

    scene = locate_shapes(
        scenes.grey(folder, "left"),
        scenes.grey(folder, "right"),
        calibration.stereo,
        wanted.part,
        Tuning(),
        calibration.table,
    )

    assert len(scene.recognised) == least
    assert len(scene.offered) == offered
