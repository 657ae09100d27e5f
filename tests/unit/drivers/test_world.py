"""The simulated world: jaws grip what fits between them, collide with what does not, and lose what slips."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.sim.arm import find_joints
from drivers.sim.cell import BadWorldFile, load_world
from drivers.sim.geometry import Floats, tool_pose
from drivers.sim.layout import WorldLayout
from drivers.sim.piles import Stick, settle
from drivers.sim.world import World
from drivers.types import Grip, SafetyMode

WORLD = Path(__file__).parents[3] / "configs" / "demo" / "world.yaml"


@pytest.fixture(scope="module")
def layout() -> WorldLayout:
    return load_world(WORLD)


def over(point: Floats, heading_rad: float, up_m: float = 0.0) -> Floats:
    """base_from_tool with the hand straight down, y along the heading."""
    y = np.array([np.cos(heading_rad), np.sin(heading_rad), 0.0])
    z = np.array([0.0, 0.0, -1.0])
    matrix = np.eye(4)
    matrix[:3, :3] = np.column_stack([np.cross(y, z), y, z])
    matrix[:3, 3] = point - up_m * z
    return matrix


def put(world: World, base_from_tool: Floats) -> None:
    """Set the arm there without moving."""
    q = find_joints(base_from_tool, world.arm.q, world.arm.flange_from_tool)
    assert q is not None
    world.arm.q = q


def descend(world: World, point: Floats, heading_rad: float) -> None:
    """From 80 mm above straight down to a point."""
    put(world, over(point, heading_rad, 0.08))
    world.arm.start_line(tool_pose(over(point, heading_rad)), 0.2, 1.0)
    while world.arm.moving:
        world.step(0.01)


def rise(world: World) -> None:
    matrix = world.arm.base_from_tool()
    matrix[2, 3] += 0.1
    world.arm.start_line(tool_pose(matrix), 0.2, 1.0)
    while world.arm.moving:
        world.step(0.01)


def close(world: World) -> Grip:
    world.begin_grasp()
    assert world.grip is Grip.UNKNOWN
    world.step(1.0)
    return world.grip


def heading(stick: Stick) -> float:
    angle = float(np.arctan2(stick.axis[1], stick.axis[0]))
    return angle - np.pi if angle > np.pi / 2 else angle + np.pi if angle <= -np.pi / 2 else angle


def one_stick(layout: WorldLayout, seed: int = 3) -> tuple[World, Stick]:
    world = World(layout, seed=seed, count=1)
    return world, world.lying[0]


def test_a_stick_between_the_jaws_is_held_and_moves_with_the_tool(layout: WorldLayout) -> None:
    world, stick = one_stick(layout)
    descend(world, stick.centre, heading(stick))
    assert close(world) is Grip.HOLDING
    rise(world)
    held = world.snapshot().held
    assert world.lying == ()
    assert held is not None
    assert held.centre == pytest.approx(stick.centre + np.array([0.0, 0.0, 0.1]), abs=1e-4)
    assert world.counts["collisions"] == 0


@pytest.mark.parametrize(
    ("aside_m", "turn_rad", "up_m"),
    [(0.0085, 0.0, 0.0), (0.0, 0.5, 0.0), (0.0, 0.0, 0.004), (0.0, 0.0, -0.013)],
)
def test_a_stick_beside_across_below_or_above_the_jaws_is_missed(
    layout: WorldLayout, aside_m: float, turn_rad: float, up_m: float
) -> None:
    world, stick = one_stick(layout)
    sideways = np.array([-stick.axis[1], stick.axis[0], 0.0])
    put(world, over(stick.centre + aside_m * sideways, heading(stick) + turn_rad, up_m))
    assert close(world) is Grip.CLOSED_EMPTY
    assert world.counts["misses"] == 1
    assert len(world.lying) == 1


def test_jaws_that_come_down_on_another_stick_collide_once_and_get_nothing(layout: WorldLayout) -> None:
    world, stick = one_stick(layout)
    sideways = np.array([-stick.axis[1], stick.axis[0], 0.0])
    neighbour = stick.moved(stick.centre + 0.012 * sideways, stick.axis)
    neighbour = Stick(
        number=7,
        length_m=stick.length_m,
        diameter_m=stick.diameter_m,
        shade=1.0,
        centre=neighbour.centre,
        axis=neighbour.axis,
    )
    world._lying = (stick, settle(neighbour, (stick,), layout.tray, 0.0))
    descend(world, stick.centre, heading(stick))
    assert close(world) is Grip.CLOSED_EMPTY
    assert world.counts["collisions"] == 1
    assert "stick 7" in world.events[0]
    world.begin_release()
    world.step(1.0)
    rise(world)
    world._lying = (stick,)
    descend(world, stick.centre, heading(stick))
    assert close(world) is Grip.HOLDING


def test_pressing_the_sprung_tips_a_little_is_fine_but_too_far_is_a_protective_stop(
    layout: WorldLayout,
) -> None:
    world = World(layout, count=0)
    floor = np.array([0.05, -0.45, 0.02])
    modes = []
    for deeper_m in (0.0, 0.006):
        descend(world, floor - np.array([0.0, 0.0, deeper_m]), 0.0)
        modes.append(world.arm.safety)
    assert modes == [SafetyMode.NORMAL, SafetyMode.PROTECTIVE_STOP]
    assert world.counts["collisions"] == 1
    assert "floor" in world.events[0]


def test_a_wall_is_hard(layout: WorldLayout) -> None:
    world = World(layout, count=0)
    descend(world, np.array([0.12, -0.45, 0.03]), np.pi / 2)
    assert world.arm.safety is SafetyMode.PROTECTIVE_STOP
    assert "wall" in world.events[0]


def test_a_part_released_over_the_box_is_delivered(layout: WorldLayout) -> None:
    world, stick = one_stick(layout)
    put(world, over(stick.centre, heading(stick)))
    close(world)
    put(world, over(np.array(layout.drop_box.centre_m), 0.0, 0.12))
    world.begin_release()
    world.step(1.0)
    assert (world.counts["in_box"], world.grip, world.snapshot().held) == (1, Grip.OPEN, None)


def test_a_part_released_over_the_tray_lies_in_the_tray_again(layout: WorldLayout) -> None:
    world, stick = one_stick(layout)
    put(world, over(stick.centre, heading(stick)))
    close(world)
    put(world, over(np.array([0.10, -0.52, 0.02]), 0.4, 0.1))
    world.begin_release()
    world.step(1.0)
    (fallen,) = world.lying
    assert fallen.centre[2] == pytest.approx(0.02 + 0.0019, abs=1e-6)
    assert all(
        np.all(np.abs(end[:2] - layout.tray.centre_m[:2]) <= 0.5 * np.array(layout.tray.inner_m))
        for end in fallen.ends
    )


def test_a_part_released_elsewhere_is_lost(layout: WorldLayout) -> None:
    world, stick = one_stick(layout)
    put(world, over(stick.centre, heading(stick)))
    close(world)
    put(world, over(np.array([-0.35, -0.35, 0.1]), 0.0))
    world.begin_release()
    world.step(1.0)
    assert world.counts["lost"] == 1
    assert world.lying == ()


def test_a_part_told_to_slip_is_gone_from_the_jaws_after_a_while(layout: WorldLayout) -> None:
    world, stick = one_stick(layout)
    world.drop_next = True
    put(world, over(stick.centre, heading(stick)))
    assert close(world) is Grip.HOLDING or world.counts["dropped"] == 1
    world.step(2.0)
    assert world.grip is Grip.CLOSED_EMPTY
    assert world.counts["dropped"] == 1
    assert world.drop_next is False


def test_taking_a_stick_from_under_another_is_noticed_and_the_other_settles(layout: WorldLayout) -> None:
    world, below = one_stick(layout)
    across = np.array([-below.axis[1], below.axis[0], 0.0])
    upper = Stick(
        number=1,
        length_m=0.1,
        diameter_m=0.0038,
        shade=1.0,
        centre=below.centre + 0.03 * below.axis + 0.01 * across,
        axis=across,
    )
    upper = settle(upper, (below,), layout.tray, 0.0)
    world._lying = (below, upper)
    put(world, over(below.centre, heading(below)))
    assert close(world) is Grip.HOLDING
    assert world.counts["pulled_from_under"] == 1
    assert world.lying[0].centre[2] < upper.centre[2]


def test_the_same_seed_and_calls_give_the_same_world(layout: WorldLayout) -> None:
    worlds = [World(layout, seed=11, count=8) for _ in range(2)]
    for world in worlds:
        stick = world.lying[-1]
        descend(world, stick.centre, heading(stick))
        close(world)
        rise(world)
    a, b = (world.snapshot() for world in worlds)
    assert np.array_equal(a.q, b.q)
    assert all(np.array_equal(s.centre, t.centre) for s, t in zip(a.lying, b.lying, strict=True))


def test_more_sticks_can_be_thrown_in(layout: WorldLayout) -> None:
    world = World(layout, count=2)
    before = world.snapshot().pile_version
    world.add_sticks(3)
    assert len(world.lying) == 5
    assert world.snapshot().pile_version > before


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("version: 1\n", "tray: Field required"),
        ("[1, 2", "not YAML"),
        ("version: 1\ntray: {centre_m: [0, 0]}\n", "tray.centre_m"),
    ],
)
def test_a_wrong_world_file_is_told_with_file_and_key(tmp_path: Path, text: str, told: str) -> None:
    path = tmp_path / "world.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(BadWorldFile, match=r"world\.yaml") as caught:
        load_world(path)
    assert told in str(caught.value)


def test_a_world_file_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(BadWorldFile, match="No such file"):
        load_world(tmp_path / "none.yaml")
