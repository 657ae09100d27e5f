"""Empty means that nothing was seen which could be a part; what cannot be told apart is not nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cell import calibration, config
from cell.emptiness import is_empty, on_plane
from tests.fakes.station import DATA, Point, scene, stick
from vision import transforms
from vision.stereo import project
from vision.types import Floats, Graph, Refusal, Refused, Scene

CELL = config.load(DATA / "cell.yaml")
KNOWN = calibration.load(DATA / "calibration.json")
FLOOR_Z = CELL.workspace.floor_z_m
TABLE = calibration.table_of(KNOWN, FLOOR_Z)
LENGTH_M = 0.080
BEYOND_Y = CELL.workspace.box_max_m[1] + 0.01
ONE_FLANK = Refused(reason=Refusal.FLANKS, value=0.0, limit=0.1, unit="1")
TOO_SHORT = Refused(reason=Refusal.LENGTH, value=0.03, limit=0.004, unit="m")


def empty(seen: Scene) -> bool:
    assert KNOWN.base_from_camera is not None
    return is_empty(seen, LENGTH_M, KNOWN.stereo, TABLE, KNOWN.base_from_camera, CELL.workspace)


def line(start: Point, end: Point) -> Floats:
    """Raw left pixels of a line on the floor, base frame."""
    assert KNOWN.base_from_camera is not None
    points = np.linspace(start, end, 60)
    camera = transforms.apply(transforms.invert(KNOWN.base_from_camera), points)
    return project(camera, KNOWN.stereo)[0]


def with_line(start: Point, end: Point) -> Scene:
    """A look in which the left skeleton shows one line and nothing came of it."""
    path = line(start, end)
    graph = Graph(
        points=path[[0, -1]],
        degree=np.array([1, 1]),
        component=np.array([0, 0]),
        edges=np.array([[0, 1]]),
        lengths_px=np.array([float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())]),
        paths=(path,),
    )
    seen = scene()
    return replace(seen, left=replace(seen.left, graph=graph))


@pytest.mark.parametrize(
    ("seen", "expected"),
    [
        (scene(), True),
        (scene(loose_m=[((0.0, -0.45, 0.02), (0.039, -0.45, 0.02))]), True),
        (scene(loose_m=[((0.0, -0.45, 0.02), (0.041, -0.45, 0.02))]), False),
        (scene(stick((-0.04, -0.52, 0.022), (0.0, -0.52, 0.022), refusals=(TOO_SHORT,))), False),
        (scene(stick((-0.04, -0.45, 0.022), (0.04, -0.45, 0.022))), False),
        (scene(stick((-0.04, -0.45, 0.022), (0.04, -0.45, 0.022), refusals=(ONE_FLANK,))), True),
        (scene(stick((-0.04, BEYOND_Y, 0.022), (0.04, BEYOND_Y, 0.022), refusals=(TOO_SHORT,))), True),
        (scene(loose_m=[((-0.04, BEYOND_Y, 0.02), (0.04, BEYOND_Y, 0.02))]), True),
    ],
    ids=[
        "nothing",
        "a short bit",
        "half a part",
        "a refused part",
        "a part",
        "an edge of something",
        "a refused part on the rim",
        "a line outside",
    ],
)
def test_what_was_found_in_space_counts_from_half_a_part_on(seen: Scene, expected: bool) -> None:
    assert empty(seen) is expected


@pytest.mark.parametrize(("length_m", "expected"), [(0.036, True), (0.044, False)])
def test_a_line_nobody_could_make_a_part_of_counts_from_half_a_part_on(
    length_m: float, expected: bool
) -> None:
    seen = with_line((0.0, -0.45, FLOOR_Z), (length_m, -0.45, FLOOR_Z))
    assert empty(seen) is expected


def test_a_line_along_the_rim_of_the_box_is_the_tray() -> None:
    edge = CELL.workspace.box_max_m[1]
    assert empty(with_line((-0.05, edge - 0.003, FLOOR_Z), (0.05, edge - 0.003, FLOOR_Z)))


def test_rays_meet_the_table_where_the_points_were() -> None:
    assert KNOWN.base_from_camera is not None
    met = on_plane(line((0.0, -0.45, FLOOR_Z), (0.05, -0.40, FLOOR_Z)), KNOWN.stereo.left, TABLE)
    base = transforms.apply(KNOWN.base_from_camera, met)
    np.testing.assert_allclose(base[[0, -1]], [[0.0, -0.45, FLOOR_Z], [0.05, -0.40, FLOOR_Z]], atol=1e-5)
