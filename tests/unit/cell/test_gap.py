"""Two parts between the jaws are worse than one: such a grip waits."""

from __future__ import annotations

import numpy as np

from cell import calibration, config, frames
from cell.missed import MissedParts
from cell.planning import Plan, plan_picks
from cell.reaching import anywhere
from tests.fakes.station import DATA, scene, stick
from vision.types import Candidate

CELL = config.load(DATA / "cell.yaml")
ALONE = stick((-0.04, -0.38, 0.022), (0.04, -0.38, 0.022))
# two parallel ones, 6 mm apart: the jaws are 20 mm open and would close over both
FIRST = stick((-0.04, -0.450, 0.022), (0.04, -0.450, 0.022))
SECOND = stick((-0.04, -0.456, 0.022), (0.04, -0.456, 0.022))


def planned(*candidates: Candidate) -> tuple[Plan, ...]:
    base_from_camera = calibration.load(DATA / "calibration.json").base_from_camera
    assert base_from_camera is not None
    tool = frames.transform_of(frames.tool_down(np.array([0.3, -0.3, 0.3]), 0.0))
    return plan_picks(
        scene(*candidates), base_from_camera, CELL.workspace, CELL.jaws, 0.004, tool, MissedParts(), anywhere
    )


def test_a_part_alone_between_the_jaws_comes_first() -> None:
    plans = planned(FIRST, SECOND, ALONE)
    assert [plan.candidate for plan in plans] == [ALONE, FIRST, SECOND]
    picks = [plan.pick for plan in plans]
    assert [None if p is None else (p.rank, p.gap_free) for p in picks] == [(1, True), (2, False), (3, False)]


def test_the_grip_moves_along_to_where_nothing_else_is_between_the_jaws() -> None:
    short = stick((-0.04, -0.456, 0.022), (0.004, -0.456, 0.022))
    pick = planned(FIRST, short)[0].pick
    assert pick is not None
    assert pick.gap_free
    assert pick.grasp.x > 0.004 + CELL.jaws.width_m / 2
