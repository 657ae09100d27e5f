"""The renderer against an independent projection: where sticks are drawn, what hides them, what is noise."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.sim.arm import find_joints
from drivers.sim.cell import load_world
from drivers.sim.geometry import Floats
from drivers.sim.layout import WorldLayout
from drivers.sim.light import light_map
from drivers.sim.optics import Eye, calibration_text, eyes
from drivers.sim.render import Lighting, Renderer
from drivers.sim.world import Snapshot, World
from drivers.types import Pixels

DEMO = Path(__file__).parents[3] / "configs" / "demo"


@pytest.fixture(scope="module")
def layout() -> WorldLayout:
    return load_world(DEMO / "world.yaml")


@pytest.fixture(scope="module")
def sharp(layout: WorldLayout) -> WorldLayout:
    cameras = layout.cameras.model_copy(update={"noise": 0.0})
    return layout.model_copy(update={"cameras": cameras})


@pytest.fixture(scope="module")
def renderers(sharp: WorldLayout) -> tuple[Renderer, Renderer]:
    left, right = (Renderer(eye, sharp, 1) for eye in eyes(sharp.cameras))
    return left, right


def by_opencv(eye: Eye, layout: WorldLayout, side: str, points: Floats) -> Floats:
    """The same points through OpenCV's own projection."""
    camera = layout.cameras.left if side == "left" else layout.cameras.right
    rvec, _ = cv2.Rodrigues(eye.camera_from_base[:3, :3])
    pixels, _ = cv2.projectPoints(
        points, rvec, eye.camera_from_base[:3, 3], eye.matrix(), np.array(camera.distortion)
    )
    return np.asarray(pixels[:, 0, :], dtype=np.float64)


@pytest.mark.parametrize("side", ["left", "right"])
def test_projection_agrees_with_opencv(layout: WorldLayout, side: str) -> None:
    eye = eyes(layout.cameras)[0 if side == "left" else 1]
    points = np.random.default_rng(1).uniform((-0.2, -0.6, 0.0), (0.2, -0.3, 0.1), (300, 3))
    assert np.abs(eye.project(points) - by_opencv(eye, layout, side, points)).max() < 0.01


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_ray_goes_through_the_point_that_was_projected(layout: WorldLayout, side: str) -> None:
    eye = eyes(layout.cameras)[0 if side == "left" else 1]
    points = np.random.default_rng(2).uniform((-0.2, -0.6, 0.0), (0.2, -0.3, 0.1), (300, 3))
    slopes = eye.slopes(eye.project(points))
    seen = (points - eye.base_from_camera[:3, 3]) @ eye.base_from_camera[:3, :3]
    assert np.abs(slopes - seen[:, :2] / seen[:, 2:]).max() * eye.focal_px < 1e-4


def test_the_committed_calibration_belongs_to_the_committed_world(layout: WorldLayout) -> None:
    assert (DEMO / "calibration.json").read_text(encoding="utf-8") == calibration_text(
        layout.cameras, layout.arm
    )


def test_the_calibration_takes_a_point_from_the_left_eye_to_the_right_and_to_the_base(
    layout: WorldLayout,
) -> None:
    told = json.loads(calibration_text(layout.cameras, layout.arm))
    left, right = eyes(layout.cameras)
    point = np.array([[0.03, -0.47, 0.025]])
    in_left = np.linalg.inv(np.array(told["base_from_camera"])) @ np.append(point[0], 1.0)
    in_right = np.array(told["R"]) @ in_left[:3] + np.array(told["T"])
    pixel, _ = cv2.projectPoints(
        in_right[None], np.zeros(3), np.zeros(3), np.array(told["K2"]), np.array(told["D2"])
    )
    assert np.asarray(pixel).ravel() == pytest.approx(right.project(point)[0], abs=0.01)
    assert 0.06 < np.linalg.norm(told["T"]) < 0.09
    assert left.width_px == told["image_width"]


def scene(layout: WorldLayout, seed: int) -> tuple[World, Snapshot]:
    world = World(layout, seed=seed, count=1)
    return world, world.snapshot()


def drawn(renderer: Renderer, layout: WorldLayout, snapshot: Snapshot) -> Pixels:
    light = light_map(snapshot.lying, layout.tray, layout.light)
    return renderer.picture(snapshot, light)


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
@pytest.mark.parametrize("side", [0, 1])
def test_a_stick_is_drawn_where_its_axis_projects_and_as_wide_as_it_is(
    renderers: tuple[Renderer, Renderer], sharp: WorldLayout, seed: int, side: int
) -> None:
    _, snapshot = scene(sharp, seed)
    stick, renderer = snapshot.lying[0], renderers[side]
    picture = drawn(renderer, sharp, snapshot).astype(np.float64)[:, :, 2]
    along = np.linspace(-0.4, 0.4, 41)[:, None] * stick.length_m
    axis_px = by_opencv(renderer.eye, sharp, ("left", "right")[side], stick.centre + along * stick.axis)
    way = axis_px[-1] - axis_px[0]
    across = np.array([-way[1], way[0]]) / np.linalg.norm(way)
    steps = np.arange(-7.0, 7.01, 0.25)
    places = axis_px[:, None, :] + steps[:, None] * across
    profile = cv2.remap(
        picture, places[..., 0].astype(np.float32), places[..., 1].astype(np.float32), cv2.INTER_LINEAR
    )
    middle, widths = [], []
    for row in profile:
        low, high = np.median(row[:8]), row.max()
        inside = np.flatnonzero(row > 0.5 * (low + high))
        middle.append(0.5 * (steps[inside[0]] + steps[inside[-1]]))
        widths.append(steps[inside[-1]] - steps[inside[0]])
    depth = (stick.centre - renderer.eye.base_from_camera[:3, 3]) @ renderer.eye.base_from_camera[:3, 2]
    # one side is darker than the other, which shifts the half-way crossings a little, never by half a pixel
    assert abs(float(np.mean(middle))) < 0.45
    assert float(np.mean(widths)) == pytest.approx(stick.diameter_m * renderer.eye.focal_px / depth, abs=0.9)
    assert float(np.mean(widths)) > 4.5


@pytest.mark.parametrize("seed", [1, 5])
def test_the_outline_covers_the_axis_and_ends_with_it(
    renderers: tuple[Renderer, Renderer], sharp: WorldLayout, seed: int
) -> None:
    world, snapshot = scene(sharp, seed)
    stick, renderer = snapshot.lying[0], renderers[0]
    empty = World(sharp, seed=seed, count=0).snapshot()
    with_stick = drawn(renderer, sharp, snapshot).astype(np.int64)
    without = drawn(renderer, sharp, empty).astype(np.int64)
    brighter = (with_stick - without).max(axis=2) > 25
    inside = by_opencv(
        renderer.eye,
        sharp,
        "left",
        stick.centre + np.linspace(-0.48, 0.48, 60)[:, None] * stick.length_m * stick.axis,
    )
    at = np.round(inside).astype(int)
    assert brighter[at[:, 1], at[:, 0]].all()
    beyond = by_opencv(
        renderer.eye, sharp, "left", stick.centre + np.array([[-0.54], [0.54]]) * stick.length_m * stick.axis
    )
    at = np.round(beyond).astype(int)
    assert not brighter[at[:, 1], at[:, 0]].any()
    assert world.lying[0] is stick


def test_the_whole_tray_is_in_both_pictures(layout: WorldLayout) -> None:
    tray = layout.tray
    half = 0.5 * np.array(tray.inner_m) + tray.wall_thickness_m
    corners = np.array([[sx * half[0], sy * half[1], 0.0] for sx in (-1, 1) for sy in (-1, 1)])
    corners = np.concatenate([corners, corners + np.array([0.0, 0.0, tray.wall_height_m])]) + np.array(
        tray.centre_m
    )
    for eye in eyes(layout.cameras):
        pixels = eye.project(corners)
        assert np.all((pixels > 5.0) & (pixels < [eye.width_px - 6.0, eye.height_px - 6.0]))


def test_an_arm_over_the_tray_hides_the_parts(
    renderers: tuple[Renderer, Renderer], sharp: WorldLayout
) -> None:
    world, before = scene(sharp, 2)
    stick = world.lying[0]
    goal = np.eye(4)
    goal[:3, :3] = np.diag([1.0, -1.0, -1.0])
    goal[:3, 3] = stick.centre + np.array([0.0, 0.0, 0.06])
    q = find_joints(goal, world.arm.q, world.arm.flange_from_tool)
    assert q is not None
    world.arm.q = q
    after = world.snapshot()
    hidden = 0
    for side, renderer in enumerate(renderers):
        clear, covered = drawn(renderer, sharp, before), drawn(renderer, sharp, after)
        changed = np.abs(clear.astype(int) - covered.astype(int)).max(axis=2) > 20
        assert changed.mean() > 0.05
        points = stick.centre + np.linspace(-0.45, 0.45, 50)[:, None] * stick.length_m * stick.axis
        at = np.round(by_opencv(renderer.eye, sharp, ("left", "right")[side], points)).astype(int)
        hidden += int(changed[at[:, 1], at[:, 0]].sum())
    assert hidden > 20


def test_the_arm_at_rest_is_out_of_both_pictures(
    renderers: tuple[Renderer, Renderer], sharp: WorldLayout
) -> None:
    world = World(sharp, count=0)
    at_rest = world.snapshot()
    world.arm.q = np.array([np.pi / 2, -1.9, 1.9, -1.5, -1.5708, 0.0])  # turned away, behind the base
    turned = world.snapshot()
    for renderer in renderers:
        assert np.array_equal(drawn(renderer, sharp, at_rest), drawn(renderer, sharp, turned))


def test_noise_is_new_for_every_picture_and_as_strong_as_configured(layout: WorldLayout) -> None:
    left, _ = eyes(layout.cameras)
    renderer = Renderer(left, layout, 1)
    snapshot = World(layout, count=2).snapshot()
    light = Lighting(layout).of(snapshot)
    first, second = (renderer.picture(snapshot, light).astype(np.float64) for _ in range(2))
    deviation = float((first - second).std() / np.sqrt(2.0))
    assert deviation == pytest.approx(layout.cameras.noise, rel=0.1)


def test_a_stick_throws_a_shadow_away_from_the_lamp(layout: WorldLayout) -> None:
    snapshot = World(layout, seed=2, count=1).snapshot()
    light = light_map(snapshot.lying, layout.tray, layout.light)
    assert light.floor_lamp.min() < 0.3
    row, column = np.unravel_index(int(np.argmin(light.floor_lamp)), light.floor_lamp.shape)
    place = np.array(light.origin_m) + 0.001 * np.array([column, row])
    assert np.linalg.norm(place - snapshot.lying[0].centre[:2]) < 0.06
    assert (light.floor_lamp > 0.999).mean() > 0.9


def test_parts_are_bright_and_the_floor_is_dark(
    renderers: tuple[Renderer, Renderer], sharp: WorldLayout
) -> None:
    world = World(sharp, seed=4, count=8)
    snapshot = world.snapshot()
    grey = cv2.cvtColor(np.array(drawn(renderers[0], sharp, snapshot)), cv2.COLOR_BGR2GRAY)
    top = snapshot.lying[-1]
    points = top.centre + np.linspace(-0.4, 0.4, 30)[:, None] * top.length_m * top.axis
    at = np.round(by_opencv(renderers[0].eye, sharp, "left", points)).astype(int)
    assert np.median(grey[at[:, 1], at[:, 0]]) > 150
    corner = renderers[0].eye.project(np.array([[0.115, -0.36, 0.02]]))[0].astype(int)
    assert grey[corner[1], corner[0]] < 80
