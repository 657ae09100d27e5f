"""Rendered piles with known truth, from the simulated cell's own world and renderer."""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cell import calibration, frames
from cell.calibration import Calibration
from drivers.sim.cell import load_world
from drivers.sim.optics import calibration_text, eyes
from drivers.sim.render import Lighting, Renderer
from drivers.sim.world import World
from drivers.types import Frame
from vision import transforms
from vision.types import Floats, Grey, PartModel, Plane

WORLD = Path(__file__).resolve().parent.parent / "configs" / "demo" / "world.yaml"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pile:
    """One pile: both pictures, and the true axis ends (N, 2, 3) m, left camera frame."""

    left: Grey
    right: Grey
    ends: Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Piles:
    """Piles of one size with what a detector may know of them."""

    piles: tuple[Pile, ...]
    known: Calibration
    table: Plane
    part: PartModel


def render(sticks: int, seeds: range, spread: float) -> Piles:
    """Render one pile per seed.

    Parameters
    ----------
    sticks
        Parts in each pile.
    spread
        1: anywhere in the tray, 0: one heap.
    """
    layout = load_world(WORLD)
    layout = layout.model_copy(update={"sticks": layout.sticks.model_copy(update={"spread": spread})})
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "calibration.json"
        file.write_text(calibration_text(layout.cameras), encoding="utf-8")
        json.loads(file.read_text(encoding="utf-8"))
        known = calibration.load(file)
    assert known.base_from_camera is not None
    camera_from_base = transforms.invert(known.base_from_camera)
    renderers = [Renderer(eye, layout, seed=1) for eye in eyes(layout.cameras)]
    piles = []
    for seed in seeds:
        snapshot = World(layout, seed=seed, count=sticks).snapshot()
        light = Lighting(layout).of(snapshot)
        left, right = (
            frames.grey_of(
                Frame(camera="bench", pixels=r.picture(snapshot, light), captured_at=0.0, sequence=0)
            )
            for r in renderers
        )
        ends = np.array([stick.ends for stick in snapshot.lying])
        piles.append(Pile(left=left, right=right, ends=transforms.apply(camera_from_base, ends)))
    return Piles(
        piles=tuple(piles),
        known=known,
        table=calibration.table_of(known, layout.tray.centre_m[2]),
        part=PartModel(
            code=1,
            name="stick",
            length_m=layout.sticks.length_m,
            length_tolerance_m=0.004,
            diameter_m=layout.sticks.diameter_m,
        ),
    )
