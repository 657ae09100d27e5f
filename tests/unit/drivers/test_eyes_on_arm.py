"""Simulated eyes that ride on the arm: what they show is where the arm was when they opened."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from drivers.sim.board import BoardPlace
from drivers.sim.cell import load_world
from drivers.sim.controller import Controller
from drivers.sim.geometry import Floats, inverse
from drivers.sim.optics import calibration_text, eyes
from drivers.sim.piles import Stick
from drivers.sim.render import Lighting, Renderer
from drivers.sim.world import World
from drivers.types import JointAngles, Pixels, Six
from tests.fakes.clock import FakeClock

FOLDER = Path(__file__).parents[3] / "configs" / "demo-on-arm"
LAYOUT = load_world(FOLDER / "world.yaml")
TOLD: dict[str, Any] = json.loads((FOLDER / "calibration.json").read_text(encoding="utf-8"))
OVER_THE_TRAY: Six = (1.1801, -1.9779, 1.986, -1.5789, -1.5708, 2.7509)
BESIDE: Six = (1.2101, -1.9479, 1.986, -1.5989, -1.5508, 2.8009)
BRIGHTER = 40.0
"""Grey levels by which a stick differs from the floor."""


def axis_px(base_from_tool: Floats, stick: Stick, side: int) -> Floats:
    """(K, 2) px along the middle of a stick, by the calibration file and OpenCV's projection."""
    camera = inverse(base_from_tool @ np.array(TOLD["tool_from_camera"]))
    if side:
        right = np.eye(4)
        right[:3, :3], right[:3, 3] = TOLD["R"], TOLD["T"]
        camera = right @ camera
    along = np.linspace(-0.45, 0.45, 31)[:, None] * stick.length_m
    turn, _ = cv2.Rodrigues(camera[:3, :3])
    lens = np.array(TOLD["K2" if side else "K1"]), np.array(TOLD["D2" if side else "D1"])
    pixels, _ = cv2.projectPoints(stick.centre + along * stick.axis, turn, camera[:3, 3], *lens)
    return np.asarray(pixels[:, 0, :], dtype=np.float64)


def shown(picture: Pixels, middle_px: Floats) -> float:
    """By how many grey levels the line is brighter than 7 px to both sides of it."""
    way = middle_px[-1] - middle_px[0]
    aside = 7.0 * np.array([-way[1], way[0]]) / np.linalg.norm(way)
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)

    def mean(at: Floats) -> float:
        rounded = np.rint(at).astype(int)
        return float(grey[rounded[:, 1], rounded[:, 0]].mean())

    return mean(middle_px) - max(mean(middle_px + aside), mean(middle_px - aside))


def test_the_committed_calibration_belongs_to_the_committed_world() -> None:
    text = (FOLDER / "calibration.json").read_text(encoding="utf-8")
    assert text == calibration_text(LAYOUT.cameras, LAYOUT.arm)
    assert "base_from_camera" not in TOLD


@pytest.mark.parametrize("side", [0, 1])
def test_a_stick_is_where_the_calibration_and_the_arm_say_wherever_the_arm_looks_from(side: int) -> None:
    world = World(LAYOUT, seed=3, count=1)
    renderer = Renderer(eyes(LAYOUT.cameras)[side], LAYOUT, 1)
    places = []
    for q in (OVER_THE_TRAY, BESIDE):
        world.arm.q = np.array(q)
        snapshot = world.snapshot()
        picture = renderer.picture(snapshot, Lighting(LAYOUT).of(snapshot))
        places.append(axis_px(world.arm.base_from_tool(), snapshot.lying[0], side))
        assert shown(picture, places[-1]) > BRIGHTER
    assert np.abs(places[1] - places[0]).max() > 10.0, "the arm looked from elsewhere"
    assert shown(picture, places[0]) < BRIGHTER / 2


def test_both_eyes_show_the_arm_where_it_was_when_they_opened_though_it_moves_on() -> None:
    clock = FakeClock(100.0)
    world = World(LAYOUT, seed=3, count=1)
    world.arm.q = np.array(OVER_THE_TRAY)
    controller = Controller(world, clock, 1.0, eyes(LAYOUT.cameras), 1)
    controller.move_joints(1, JointAngles(q_rad=BESIDE), 0.1, 1.0)
    for _ in range(2):
        clock.turn(0.1)
        controller.poll(1)
    asked_at = clock.now() - 0.001
    left = controller.eyes.grab("left", asked_at, 1.0)
    opened, stick = world.arm.base_from_tool(), world.snapshot().lying[0]
    for _ in range(2):
        clock.turn(0.1)
        controller.poll(1)
    right = controller.eyes.grab("right", asked_at, 1.0)
    later = world.arm.base_from_tool()
    assert controller.robot_state().moving
    assert right.captured_at == left.captured_at
    for side, shot in enumerate((left, right)):
        assert shown(shot.pixels, axis_px(opened, stick, side)) > BRIGHTER
    assert np.abs(axis_px(later, stick, 1) - axis_px(opened, stick, 1)).max() > 7.0
    assert shown(right.pixels, axis_px(later, stick, 1)) < BRIGHTER


def test_a_board_is_waved_before_the_eyes_wherever_they_are() -> None:
    world = World(LAYOUT, count=0)
    world.arm.q = np.array(OVER_THE_TRAY)
    world.board = BoardPlace.WAVED
    snapshot = world.snapshot()
    assert snapshot.base_from_board is not None
    seen = inverse(snapshot.base_from_tool @ np.array(TOLD["tool_from_camera"])) @ snapshot.base_from_board
    assert 0.1 < seen[2, 3] < 0.6
    assert np.abs(seen[:2, 3]).max() < 0.6 * seen[2, 3]
