"""The simulated board is where it is said to be: OpenCV's detector finds its corners there."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from drivers.sim.board import BoardPlace
from drivers.sim.cell import load_world
from drivers.sim.geometry import apply
from drivers.sim.optics import eyes
from drivers.sim.render import Lighting, Renderer
from drivers.sim.world import World
from tests.fakes.boardrig import BOARD
from tests.fakes.simcell import WORLD
from vision.boards import corner_points, detect


@pytest.mark.parametrize("place", [BoardPlace.TRAY, BoardPlace.WAVED])
def test_corners_are_found_where_the_board_is(place: BoardPlace) -> None:
    layout = load_world(WORLD)
    world = World(layout, count=0)
    world.board = place
    snapshot = world.snapshot()
    assert snapshot.base_from_board is not None
    light = Lighting(layout).of(snapshot)
    for eye in eyes(layout.cameras):
        picture = Renderer(eye, layout, 1).picture(snapshot, light)
        corners = detect(np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), dtype=np.uint8), BOARD)
        assert corners is not None
        assert len(corners.ids) > 30
        true = eye.project(apply(snapshot.base_from_board, corner_points(BOARD, corners.ids)))
        off = np.linalg.norm(corners.pixels - true, axis=1)
        assert np.median(off) < 0.15


def test_a_board_that_is_held_moves_on_after_pairs() -> None:
    world = World(load_world(WORLD), count=0)
    world.board = BoardPlace.WAVED
    first = world.snapshot().base_from_board
    world.exposures = 2
    again = world.snapshot().base_from_board
    world.exposures = 40
    later = world.snapshot().base_from_board
    assert first is not None
    assert again is not None
    assert later is not None
    assert np.array_equal(first, again)
    assert not np.allclose(first, later)
