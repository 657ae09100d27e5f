"""A part that was missed is tried last for a few looks."""

import numpy as np
import pytest

from cell import cycle
from cell.missed import MissedParts
from cell.types import Outcome
from drivers.timing import StopToken
from drivers.types import Grip, ToolPose
from tests.fakes.station import bench, order, scene, stick

MIDDLE = np.array([0.07, -0.45, 0.02])


def at(x: float) -> ToolPose:
    return ToolPose(x=x, y=-0.45, z=0.02, rx=0.0, ry=3.14, rz=0.0)


def test_a_grip_within_a_centimetre_of_a_failed_one_is_remembered() -> None:
    missed = MissedParts()
    missed.remember(at(0.100), MIDDLE)
    assert missed.grip(at(0.108))
    assert not missed.grip(at(0.112))


def test_the_part_is_remembered_too_wherever_it_was_gripped() -> None:
    missed = MissedParts()
    missed.remember(at(0.100), MIDDLE)
    assert missed.part(MIDDLE + np.array([0.0, 0.009, 0.0]))
    assert not missed.part(MIDDLE + np.array([0.0, 0.011, 0.0]))


def test_a_failed_grip_is_forgotten_after_five_looks() -> None:
    missed = MissedParts()
    missed.remember(at(0.1), MIDDLE)
    for _ in range(4):
        missed.new_look()
    assert missed.grip(at(0.1))
    missed.new_look()
    assert not missed.grip(at(0.1))


def test_after_a_miss_another_part_is_tried_before_the_same_one(monkeypatch: pytest.MonkeyPatch) -> None:
    first = stick((-0.04, -0.45, 0.022), (0.04, -0.45, 0.022))
    second = stick((-0.04, -0.38, 0.022), (0.04, -0.38, 0.022))
    seen = scene(first, second)
    monkeypatch.setattr(cycle, "locate", lambda *_, **__: seen)
    cell = bench(pictures=2).open()
    cell.gripper.grasps = [Grip.CLOSED_EMPTY, Grip.HOLDING]
    result = cycle.run_order(cell.station, order(max_attempts=2), StopToken(cell.clock))
    assert result.outcome is Outcome.PICKED
    missed, taken = (look.plans[k].pick for look, k in zip(cell.looks, (0, 1), strict=True))
    assert missed is not None
    assert taken is not None
    assert result.pose == taken.grasp
    assert [t for t in cell.robot.targets if t in (missed.grasp, taken.grasp)] == [missed.grasp, taken.grasp]
