"""A part that others lie over is the last resort, and only where the cell allows it."""

from __future__ import annotations

import numpy as np
import pytest

from cell import calibration, config, frames
from cell.missed import MissedParts
from cell.planning import Plan, plan_picks
from cell.reaching import anywhere
from tests.fakes.station import DATA, scene, stick
from vision.types import Candidate, Refusal, Refused

CELL = config.load(DATA / "cell.yaml")
COVERED = Refused(reason=Refusal.CROSSED, value=1.0, limit=0.0, unit="1")
TOO_LONG = Refused(reason=Refusal.LENGTH, value=0.09, limit=0.084, unit="m")
ENDS = ((-0.04, -0.45, 0.022), (0.04, -0.45, 0.022))
APART = ((-0.04, -0.38, 0.022), (0.04, -0.38, 0.022))


def planned(*candidates: Candidate, take_covered: bool = True) -> tuple[Plan, ...]:
    base_from_camera = calibration.load(DATA / "calibration.json").base_from_camera
    assert base_from_camera is not None
    workspace = CELL.workspace.model_copy(update={"take_covered": take_covered})
    tool = frames.transform_of(frames.tool_down(np.array([0.3, -0.3, 0.3]), 0.0))
    return plan_picks(
        scene(*candidates), base_from_camera, workspace, CELL.jaws, 0.004, tool, MissedParts(), anywhere
    )


def test_a_covered_part_is_planned_when_nothing_free_is_there() -> None:
    (plan,) = planned(stick(*ENDS, refusals=(COVERED,)))
    assert plan.pick is not None
    assert plan.pick.rank == 1


def test_a_covered_part_waits_while_a_free_one_can_be_had() -> None:
    free = stick(*APART)
    plans = planned(free, stick(*ENDS, refusals=(COVERED,)))
    assert [plan.candidate for plan in plans] == [free]


@pytest.mark.parametrize("refusals", [(TOO_LONG,), (COVERED, TOO_LONG)])
def test_a_part_with_another_reason_against_it_is_never_planned(refusals: tuple[Refused, ...]) -> None:
    assert planned(stick(*ENDS, refusals=refusals)) == ()


def test_a_cell_that_forbids_it_leaves_covered_parts_alone() -> None:
    assert planned(stick(*ENDS, refusals=(COVERED,)), take_covered=False) == ()
