"""A grasp is on the part, across it, straight down, and has room; what has none is refused with a number."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cell import calibration, config, frames
from cell.missed import MissedParts
from cell.planning import Plan, PlanRefusal, plan_picks
from cell.reaching import anywhere
from cell.types import Pick
from tests.fakes.station import DATA, Point, scene, stick
from vision import transforms
from vision.types import Candidate, Floats, Refusal, Refused, Scene, Transform

CELL = config.load(DATA / "cell.yaml")
WORKSPACE, JAWS = CELL.workspace, CELL.jaws
BASE_FROM_CAMERA = calibration.load(DATA / "calibration.json").base_from_camera
assert BASE_FROM_CAMERA is not None
DIAMETER_M = 0.004
LYING_Z = WORKSPACE.floor_z_m + DIAMETER_M / 2
OFFSETS_M = [side * off for side in (-1, 1) for off in (0.006, 0.009, 0.012, 0.015, 0.018)]
TOOL_AT_REST = frames.transform_of(frames.tool_down(np.array([0.3, -0.3, 0.3]), 0.0))


def lying(
    x: float, y: float, heading: float, length: float = 0.08, z: float = LYING_Z
) -> tuple[Point, Point]:
    """Both ends of a level stick by its middle and heading, base frame."""
    dx, dy = length / 2 * math.cos(heading), length / 2 * math.sin(heading)
    return (x - dx, y - dy, z), (x + dx, y + dy, z)


def planned(seen: Scene, tool: Transform = TOOL_AT_REST) -> tuple[Plan, ...]:
    assert BASE_FROM_CAMERA is not None
    return plan_picks(seen, BASE_FROM_CAMERA, WORKSPACE, JAWS, DIAMETER_M, tool, MissedParts(), anywhere)


def only_pick(*candidates: Candidate, **others: list[tuple[Point, Point]]) -> Pick:
    pick = planned(scene(*candidates, loose_m=others.get("loose_m", [])))[0].pick
    assert pick is not None
    return pick


def closing(pick: Pick) -> Floats:
    """Direction in which the jaws close, base frame."""
    return np.asarray(frames.transform_of(pick.grasp).rotation[:, 0])


def refusal(plan: Plan) -> tuple[PlanRefusal, float, float]:
    assert plan.pick is None
    (why,) = plan.refused
    return why.reason, why.value, why.limit


# ------------------------------------------------------------------------------ one part alone


@pytest.mark.parametrize("heading", [0.0, 0.4, 1.5, 2.9, -1.0])
def test_the_jaws_close_across_the_middle_of_a_lone_part(heading: float) -> None:
    pick = only_pick(stick(*lying(0.03, -0.45, heading)))
    assert (pick.grasp.x, pick.grasp.y) == pytest.approx((0.03, -0.45), abs=1e-9)
    assert closing(pick) @ [math.cos(heading), math.sin(heading), 0.0] == pytest.approx(0.0, abs=1e-9)


def test_the_tool_looks_straight_down() -> None:
    pick = only_pick(stick(*lying(0.03, -0.45, 0.7)))
    for pose in (pick.approach, pick.grasp, pick.retreat):
        np.testing.assert_allclose(frames.transform_of(pose).rotation[:, 2], [0, 0, -1], atol=1e-9)


def test_the_tool_point_goes_a_little_below_the_axis_where_the_floor_leaves_room() -> None:
    pick = only_pick(stick(*lying(0.0, -0.45, 0.0, z=0.05)))
    assert pick.grasp.z == pytest.approx(0.05 - JAWS.below_axis_m)


def test_the_finger_tips_stay_above_the_floor() -> None:
    pick = only_pick(stick(*lying(0.0, -0.45, 0.0, z=WORKSPACE.floor_z_m + 0.001)))
    tips_z = pick.grasp.z - JAWS.tip_beyond_tool_m
    assert tips_z == pytest.approx(WORKSPACE.floor_z_m + WORKSPACE.floor_clearance_m)


def test_the_way_down_begins_straight_above_and_the_way_up_ends_at_travel_height() -> None:
    pick = only_pick(stick(*lying(0.02, -0.42, 0.3)))
    assert pick.approach == frames.raised(pick.grasp, pick.grasp.z + WORKSPACE.approach_height_m)
    assert pick.retreat == frames.raised(pick.grasp, WORKSPACE.travel_z_m)


@pytest.mark.parametrize("tool_yaw", [0.0, 1.0, 2.0, 3.0, -1.0, -2.0, -3.0])
def test_of_the_two_equal_jaw_directions_the_nearer_one_is_taken(tool_yaw: float) -> None:
    tool = frames.transform_of(frames.tool_down(np.array([0.3, -0.3, 0.3]), tool_yaw))
    pick = planned(scene(stick(*lying(0.0, -0.45, 0.6))), tool)[0].pick
    assert pick is not None
    turn = transforms.rotation_distance_rad(tool.rotation, frames.transform_of(pick.grasp).rotation)
    assert turn <= math.pi / 2 + 1e-9


def test_which_end_is_called_start_does_not_matter() -> None:
    start, end = lying(0.01, -0.44, 0.8)
    one, other = only_pick(stick(start, end)), only_pick(stick(end, start))
    np.testing.assert_allclose(one.grasp.six(), other.grasp.six(), atol=1e-12)


def test_a_tilted_part_is_gripped_at_the_height_of_its_middle() -> None:
    pick = only_pick(stick((-0.04, -0.45, 0.03), (0.04, -0.45, 0.05)))
    assert pick.grasp.z == pytest.approx(0.04 - JAWS.below_axis_m)


# ------------------------------------------------------------------------------ refusals


def test_a_part_that_is_too_steep_is_refused_with_its_tilt() -> None:
    tilt = 0.7
    x, z = 0.04 * math.cos(tilt), 0.04 * math.sin(tilt)
    plan = planned(scene(stick((-x, -0.45, 0.06 - z), (x, -0.45, 0.06 + z))))[0]
    reason, value, limit = refusal(plan)
    assert reason is PlanRefusal.TILT
    assert value == pytest.approx(tilt)
    assert limit == WORKSPACE.max_tilt_rad


@pytest.mark.parametrize(
    ("ends", "beyond_m"),
    [
        # a finger's outer face beyond x = 0.16, the hand standing 6 mm aside
        (lying(0.20, -0.45, math.pi / 2), 0.20 + 0.014 - 0.006 - 0.16),
        (lying(0.0, -0.30, 0.0), -0.30 + 0.014 - 0.006 + 0.32),
        (lying(0.0, -0.45, 0.0, z=0.15), 0.15 - 0.001 - 0.0015 - 0.10),
    ],
    ids=["x", "y", "z"],
)
def test_a_part_outside_the_box_is_refused_with_how_far(ends: tuple[Point, Point], beyond_m: float) -> None:
    reason, value, limit = refusal(planned(scene(stick(*ends)))[0])
    assert reason is PlanRefusal.WORKSPACE
    assert value == pytest.approx(beyond_m, abs=1e-9)
    assert limit == 0.0


def test_a_part_half_over_the_edge_of_the_box_is_gripped_where_the_box_allows() -> None:
    # its middle leaves no room for the fingers' width, 2 mm further in does
    edge = WORKSPACE.box_max_m[0] - JAWS.width_m / 2
    pick = only_pick(stick(*lying(edge + 0.001, -0.45, 0.0)))
    assert pick.grasp.x == pytest.approx(edge + 0.001 - 0.002)


def test_candidates_the_detector_refused_are_not_planned() -> None:
    bad = Refused(reason=Refusal.LENGTH, value=0.1, limit=0.004, unit="m")
    plans = planned(scene(stick(*lying(0.0, -0.45, 0.0)), stick(*lying(0.0, -0.38, 0.0), refusals=(bad,))))
    assert len(plans) == 1


def test_ranks_count_the_picks_in_the_detectors_order() -> None:
    first, outside, third = lying(0.0, -0.50, 0.0), lying(0.0, -0.28, 0.0), lying(0.0, -0.38, 0.0)
    plans = planned(scene(*(stick(*ends) for ends in (first, outside, third))))
    assert [plan.pick.rank if plan.pick else None for plan in plans] == [1, None, 2]


# ------------------------------------------------------------------------------ neighbours


def test_nothing_else_in_the_bin_is_all_the_room_there_is() -> None:
    assert only_pick(stick(*lying(0.0, -0.45, 0.0))).clearance_m == math.inf


def test_the_parts_own_segments_are_no_obstacles() -> None:
    (x0, y0, z0), (x1, y1, z1) = lying(0.0, -0.45, 0.0)
    pieces = [((x0, y0, z0), (0.0, y0, z0)), ((0.005, y0 + 0.001, z0), (x1, y1, z1 + 0.001))]
    pick = only_pick(stick((x0, y0, z0), (x1, y1, z1)), loose_m=pieces)
    assert pick.clearance_m == math.inf


def test_a_part_that_lies_against_another_is_not_mistaken_for_it() -> None:
    pick = only_pick(stick(*lying(0.0, -0.45, 0.0)), stick(*lying(0.0, -0.45 + DIAMETER_M, 0.0)))
    # the neighbour's surface is 6 mm from the tool axis, the finger's inner face 10 mm
    assert pick.clearance_m == pytest.approx(0.010 - 1.5 * DIAMETER_M, abs=1e-6)


def test_a_neighbour_beside_the_middle_moves_the_grip_along_the_part() -> None:
    beside = lying(0.0055, -0.45 + 0.012, math.pi / 2, length=0.010)  # in the way of one finger
    pick = only_pick(stick(*lying(0.0, -0.45, 0.0)), stick(*beside))
    assert (pick.grasp.x, pick.grasp.y) == pytest.approx((-0.002, -0.45))
    assert pick.clearance_m >= JAWS.min_clearance_m
    assert _room_at(0.0, -0.45, 0.0, [beside]) < JAWS.min_clearance_m


def test_too_many_neighbours_refuse_the_part_with_the_room_there_is() -> None:
    # wherever the hand stands, a finger would come down on one of them
    walls = [lying(0.0, -0.45 + off, 0.0, length=0.09) for off in OFFSETS_M]
    reason, value, limit = refusal(planned(scene(stick(*lying(0.0, -0.45, 0.0)), loose_m=walls))[0])
    assert reason is PlanRefusal.CLEARANCE
    assert limit == JAWS.min_clearance_m
    assert value < 0.0


def test_the_hand_stands_aside_where_a_finger_would_come_down_on_a_neighbour() -> None:
    wall = lying(0.0, -0.45 + 0.012, 0.0, length=0.09)
    pick = only_pick(stick(*lying(0.0, -0.45, 0.0)), loose_m=[wall])
    aside = pick.grasp.y - (-0.45)
    assert abs(aside) >= 0.002
    assert abs(aside) <= (JAWS.opening_m - DIAMETER_M) / 2
    assert pick.clearance_m >= JAWS.min_clearance_m


def test_after_a_miss_the_same_part_is_gripped_somewhere_else() -> None:
    missed = MissedParts()
    first = only_pick(stick(*lying(0.0, -0.45, 0.0)))
    missed.remember(first.grasp, np.array([0.0, -0.45, LYING_Z]))
    seen = scene(stick(*lying(0.0, -0.45, 0.0)))
    assert BASE_FROM_CAMERA is not None
    plans = plan_picks(seen, BASE_FROM_CAMERA, WORKSPACE, JAWS, DIAMETER_M, TOOL_AT_REST, missed, anywhere)
    again = plans[0].pick
    assert again is not None
    assert math.dist(again.grasp.six()[:2], first.grasp.six()[:2]) >= 0.010


def test_a_part_above_is_in_the_way_of_the_hand() -> None:
    over = lying(0.0, -0.45, math.pi / 2, z=LYING_Z + 0.05, length=0.012)
    pick = only_pick(stick(*lying(0.0, -0.45, 0.0)), stick(*over))
    assert abs(pick.grasp.x) >= JAWS.width_m / 2 + DIAMETER_M / 2


@pytest.mark.parametrize("z", [0.10, WORKSPACE.travel_z_m + 0.5 * JAWS.depth_m])
def test_a_part_higher_than_the_descent_is_still_in_the_way_of_the_fingers(z: float) -> None:
    # above where the finger tips begin to descend, but the fingers reach up from there
    above = lying(0.0, -0.45 + 0.012, math.pi / 2, z=z, length=0.004)
    pick = only_pick(stick(*lying(0.0, -0.45, 0.0)), stick(*above))
    assert abs(pick.grasp.x) >= JAWS.width_m / 2 + DIAMETER_M / 2


def test_refused_candidates_are_obstacles_too() -> None:
    bad = Refused(reason=Refusal.CROSSED, value=1.0, limit=0.0, unit="1")
    beside = lying(0.0055, -0.45 + 0.012, math.pi / 2, length=0.010)
    pick = only_pick(stick(*lying(0.0, -0.45, 0.0)), stick(*beside, refusals=(bad,)))
    assert pick.grasp.x == pytest.approx(-0.002)


# ------------------------------------------------------------------------------ against brute force


def _room_at(x: float, y: float, heading: float, others: list[tuple[Point, Point]]) -> float:
    """Room of a gripper over a level part's point (x, y), by moving it down in small steps."""
    tool_z = max(
        LYING_Z - JAWS.below_axis_m,
        WORKSPACE.floor_z_m + WORKSPACE.floor_clearance_m + JAWS.tip_beyond_tool_m,
    )
    return swept_room(np.array([x, y, tool_z - JAWS.tip_beyond_tool_m]), heading + math.pi / 2, others)


def swept_room(tips: Floats, yaw: float, others: list[tuple[Point, Point]]) -> float:
    points = np.concatenate(
        [np.linspace(np.array(first), np.array(last), 400) for first, last in others]
    ) - np.array([tips[0], tips[1], 0.0])
    across = points @ np.array([math.cos(yaw), math.sin(yaw), 0.0])
    along = points @ np.array([-math.sin(yaw), math.cos(yaw), 0.0])
    inner, outer = JAWS.opening_m / 2, JAWS.opening_m / 2 + JAWS.thickness_m
    least = math.inf
    for lift in np.arange(0.0, WORKSPACE.travel_z_m - tips[2], 0.001):
        low = tips[2] + lift
        for x_low, x_high, z_low, z_high in (
            (inner, outer, low, low + JAWS.depth_m),
            (-outer, -inner, low, low + JAWS.depth_m),
            (-outer, outer, low + JAWS.depth_m, low + JAWS.depth_m + 0.002),
        ):
            gap = np.stack(
                [
                    np.maximum(np.maximum(x_low - across, across - x_high), 0.0),
                    np.maximum(np.abs(along) - JAWS.width_m / 2, 0.0),
                    np.maximum(np.maximum(z_low - points[:, 2], points[:, 2] - z_high), 0.0),
                ]
            )
            least = min(least, float(np.linalg.norm(gap, axis=0).min()))
    return least - DIAMETER_M / 2


@pytest.mark.parametrize("seed", range(25))
def test_the_room_of_a_pick_is_what_sweeping_the_gripper_finds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    heading = float(rng.uniform(0, math.pi))
    others = []
    for _ in range(4):
        centre = np.array([0.0, -0.45, 0.0]) + rng.uniform(-0.05, 0.05, 3) * [1, 1, 0]
        turn, rise = rng.uniform(0, math.pi), rng.uniform(-0.3, 0.3)
        reach = 0.04 * np.array(
            [math.cos(turn) * math.cos(rise), math.sin(turn) * math.cos(rise), math.sin(rise)]
        )
        centre[2] = LYING_Z + rng.uniform(0.0, 0.02)
        first, last = centre - reach, centre + reach
        others.append(((first[0], first[1], first[2]), (last[0], last[1], last[2])))
    plan = planned(scene(stick(*lying(0.0, -0.45, heading)), loose_m=others))[0]

    if plan.pick is not None:
        grasp = plan.pick.grasp
        room = swept_room(
            np.array([grasp.x, grasp.y, grasp.z - JAWS.tip_beyond_tool_m]), heading + math.pi / 2, others
        )
        assert plan.pick.clearance_m == pytest.approx(room, abs=3e-4)
        assert room >= JAWS.min_clearance_m - 3e-4
    else:
        steps = range(-10, 11)  # a quarter of 80 mm to both sides, every 2 mm
        rooms = [
            _room_at(k * 0.002 * math.cos(heading), -0.45 + k * 0.002 * math.sin(heading), heading, others)
            for k in steps
        ]
        assert max(rooms) < JAWS.min_clearance_m + 3e-4


def test_both_answers_occur_among_the_random_neighbours() -> None:
    # else the comparison above would compare one thing only
    picks = 0
    for seed in range(25):
        rng = np.random.default_rng(seed)
        heading = float(rng.uniform(0, math.pi))
        walls = [lying(0.0, -0.45 + float(rng.uniform(-0.03, 0.03)), heading) for _ in range(2)]
        picks += planned(scene(stick(*lying(0.0, -0.45, heading)), loose_m=walls))[0].pick is not None
    assert 0 < picks < 25
