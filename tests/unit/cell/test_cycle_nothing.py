"""Orders that end without a part: an empty bin, nothing that fits, no room for the jaws, out of reach."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from cell import frames
from cell.types import Outcome, Pick
from drivers.types import (
    NotReachable,
    PlcCommand,
    ReachLimit,
    ResultCode,
    ToolPose,
)
from tests.fakes.station import Point, bench, order, scene
from tests.unit.cell.scripted import FREE, REFUSED, SECOND, Eyes, lines, ran
from vision import transforms
from vision.types import Candidate


def test_an_empty_bin_is_an_outcome_of_its_own(see: Callable[..., Eyes]) -> None:
    see(scene())
    result = ran(bench().open(), order())
    assert (result.code, result.outcome) == (ResultCode.NO_PART_FOUND, Outcome.BIN_EMPTY)
    assert result.detail == int(Outcome.BIN_EMPTY)


def test_parts_that_do_not_fit_are_not_an_empty_bin(see: Callable[..., Eyes]) -> None:
    see(scene(REFUSED))
    result = ran(bench().open(), order())
    assert (result.code, result.outcome) == (ResultCode.NO_PART_FOUND, Outcome.NOTHING_GRASPABLE)
    assert result.refused == {"LENGTH": 1}
    assert result.seen == 1


def test_no_room_for_the_jaws_is_told_apart(see: Callable[..., Eyes]) -> None:
    walls: list[tuple[Point, Point]] = [
        ((-0.05, -0.45 + off, 0.025), (0.05, -0.45 + off, 0.025))
        for off in (-0.018, -0.015, -0.012, -0.009, -0.006, 0.006, 0.009, 0.012, 0.015, 0.018)
    ]
    see(scene(FREE, loose_m=walls))
    result = ran(bench().open(), order())
    assert (result.code, result.outcome) == (ResultCode.COLLISION, Outcome.NOTHING_GRASPABLE)
    assert result.refused == {"CLEARANCE": 1}


def test_out_of_the_arms_reach_is_told_apart(see: Callable[..., Eyes]) -> None:
    see(scene(FREE))
    cell = bench().open()
    cell.robot.reachable = lambda target: False  # type: ignore[method-assign]  # an arm that is too short
    result = ran(cell, order())
    assert (result.code, result.outcome) == (ResultCode.UNREACHABLE, Outcome.NOTHING_GRASPABLE)
    assert result.refused == {"REACH": 1}
    assert lines(cell) == []


def test_the_next_best_is_taken_when_the_arm_cannot_reach_the_best(see: Callable[..., Eyes]) -> None:
    see(scene(FREE, SECOND))
    cell = bench().open()
    probe = bench().open()
    ran(probe, order(command=PlcCommand.VISION_ONLY))
    best = probe.looks[0].plans[0].pick
    assert best is not None
    cell.robot.unreachable = frozenset({best.approach})
    result = ran(cell, order())
    assert result.outcome is Outcome.PICKED
    assert result.pose is not None
    assert result.pose.y == pytest.approx(-0.38)
    assert result.refused == {"REACH": 1}


FAR = NotReachable(limit=ReachLimit.TOO_FAR, value=0.9, bound=0.81, unit="m", leg=0)


def planned_best(see: Callable[..., Eyes], *parts: Candidate) -> Pick:
    """What would be picked if nothing were known against it."""
    see(scene(*parts))
    probe = bench().open()
    ran(probe, order(command=PlcCommand.VISION_ONLY))
    best = probe.looks[0].plans[0].pick
    assert best is not None
    return best


def turned(pose: ToolPose) -> ToolPose:
    """With the hand turned by half a turn about itself."""
    half = transforms.make(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))
    return frames.pose_of(transforms.compose(frames.transform_of(pose), half))


@pytest.mark.parametrize("place", ["approach", "grasp", "retreat"])
@pytest.mark.parametrize(
    ("limit", "reason"),
    [
        (ReachLimit.TOO_FAR, "REACH"),
        (ReachLimit.JOINT, "JOINT"),
        (ReachLimit.ELBOW, "SINGULARITY"),
        (ReachLimit.SWING, "POSTURE"),
    ],
)
def test_a_place_known_to_be_out_of_reach_is_refused_before_the_arm_is_asked(
    see: Callable[..., Eyes], place: str, limit: ReachLimit, reason: str
) -> None:
    best = planned_best(see, FREE)
    cell = bench().open()
    told = replace(FAR, limit=limit)
    pose: ToolPose = getattr(best, place)
    cell.kinematics.against = {pose: told, turned(pose): told}
    cell.robot.reachable = lambda target: pytest.fail("the arm was asked")  # type: ignore[method-assign]
    result = ran(cell, order())
    assert (result.code, result.outcome) == (ResultCode.UNREACHABLE, Outcome.NOTHING_GRASPABLE)
    assert result.refused == {reason: 1}
    assert lines(cell) == []
    why = cell.looks[0].plans[0].refused[0]
    assert (why.value, why.limit, why.unit) == (0.9, 0.81, "m")


def test_a_hand_turned_the_other_way_round_may_still_get_there(see: Callable[..., Eyes]) -> None:
    best = planned_best(see, FREE)
    cell = bench().open()
    cell.kinematics.against = {best.grasp: replace(FAR, limit=ReachLimit.JOINT)}
    result = ran(cell, order())
    assert result.outcome is Outcome.PICKED
    assert result.refused == {}
    assert result.pose is not None
    assert result.pose.six() == pytest.approx(turned(best.grasp).six())


def test_the_way_is_judged_from_where_the_arm_stands(see: Callable[..., Eyes]) -> None:
    see(scene(FREE))
    cell = bench().open()
    ran(cell, order())
    start, way = cell.kinematics.asked[0]
    assert start.q_rad == cell.station.workspace.watch_q_rad
    pick = cell.looks[0].plans[0].pick
    assert pick is not None
    assert way == (pick.retreat, pick.approach, pick.grasp)
