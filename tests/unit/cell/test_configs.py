"""The configurations people start from: whole, valid, and sensible for their arms."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from cell import config, places, wiring
from drivers.factory import Factory
from drivers.settings import UrRobotSettings
from drivers.types import JointAngles
from tests.fakes.clock import FakeClock

ROOT = Path(__file__).parents[3]
CONFIGS = sorted((ROOT / "configs").glob("*/cell.yaml"))
ARMS = [path for path in CONFIGS if not path.parent.name.startswith("demo")]
NAMES = [path.parent.name for path in ARMS]


def test_there_is_one_for_each_kind_of_cell() -> None:
    assert [path.parent.name for path in CONFIGS] == ["demo", "demo-on-arm", "ur10e-gige", "ur5e-webcams"]


@pytest.mark.parametrize("path", CONFIGS, ids=lambda p: p.parent.name)
def test_it_is_checked_as_a_whole(path: Path) -> None:
    loaded = config.load(path)
    known = wiring.check(loaded, str(path))
    place = known.tool_from_camera if loaded.cameras.mount == "tool" else known.base_from_camera
    assert place is not None


@pytest.mark.parametrize("path", ARMS, ids=NAMES)
def test_its_places_suit_its_arm(path: Path) -> None:
    loaded = config.load(path)
    lines = places.checks(loaded, Factory(FakeClock()).kinematics(loaded.robot))
    assert [line.what for line in lines] == ["workspace.watch_q_rad", "workspace.drop_q_rad", "workspace"]
    assert all(line.ok for line in lines), [line.found for line in lines if not line.ok]


@pytest.mark.parametrize("path", ARMS, ids=NAMES)
def test_addresses_are_from_the_range_for_documentation(path: Path) -> None:
    """Nobody's own network: a file that was not adapted reaches nothing."""
    hosts = re.findall(r"host: *([0-9.]+)", path.read_text(encoding="utf-8"))
    assert hosts
    assert all(host.startswith("192.0.2.") for host in hosts)


@pytest.mark.parametrize("path", ARMS, ids=NAMES)
def test_a_bin_behind_the_arms_reach_is_told_with_its_number(path: Path) -> None:
    loaded = config.load(path)
    assert isinstance(loaded.robot, UrRobotSettings)
    space = loaded.workspace
    low, high = space.box_min_m, space.box_max_m
    far = space.model_copy(update={"box_min_m": (low[0], low[1] - 0.6, low[2]), "box_max_m": high})
    robot = loaded.robot.model_copy(update={"tool_box_min_m": (-1.0, -2.0, -0.1)})
    moved = loaded.model_copy(update={"workspace": far, "robot": robot})
    line = places.checks(moved, Factory(FakeClock()).kinematics(robot))[-1]
    assert not line.ok
    assert re.search(
        r"of 8 corners are out of reach; \[-?0\.\d+, -\d\.\d+, 0\.018\]: .*limit \d\.\d+ m", line.found
    )
    assert line.do


@pytest.mark.parametrize("path", ARMS, ids=NAMES)
def test_a_watch_position_with_a_straight_wrist_is_told(path: Path) -> None:
    loaded = config.load(path)
    q = loaded.workspace.watch_q_rad
    straight = loaded.workspace.model_copy(update={"watch_q_rad": (*q[:4], -0.02, q[5])})
    moved = loaded.model_copy(update={"workspace": straight})
    kinematics = Factory(FakeClock()).kinematics(loaded.robot)
    line = places.checks(moved, kinematics)[0]
    assert not line.ok
    against = kinematics.refused(JointAngles(q_rad=straight.watch_q_rad), ())
    assert against is not None
    assert places.why(against) == line.found
