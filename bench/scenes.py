"""Rendered piles with known truth, in memory.

`render` shows the simulated cell: its world, its tray, its renderer. `dense` shows heaps as dense as physical
ones on an open table (`bench.families`), any number of them, one fresh heap per seed.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from bench.families import heap, scenery
from bench.rigs import RIGS, Rig, known
from bench.shots import Shot, shoot
from bench.truth import Truth
from cell import calibration, frames
from cell.calibration import Calibration
from drivers.sim.cell import load_world
from drivers.sim.optics import calibration_text, eyes
from drivers.sim.render import Lighting, Renderer
from drivers.sim.world import World
from drivers.types import Frame
from vision import transforms
from vision.types import Floats, Grey, PartModel, Plane, read_only

WORLD = Path(__file__).resolve().parent.parent / "configs" / "demo" / "world.yaml"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pile:
    """One pile: both pictures, and the true axis ends (N, 2, 3) m, left camera frame.

    ``truth`` also says what is seen, free, pickable, and who lies on whom; None where it was not worked out.
    """

    left: Grey
    right: Grey
    ends: Floats
    truth: Truth | None = None


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
        file.write_text(calibration_text(layout.cameras, layout.arm), encoding="utf-8")
        json.loads(file.read_text(encoding="utf-8"))
        found = calibration.load(file)
    assert found.base_from_camera is not None
    camera_from_base = transforms.invert(found.base_from_camera)
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
        known=found,
        table=calibration.table_of(found, layout.tray.centre_m[2]),
        part=PartModel(
            code=1,
            name="stick",
            length_m=layout.sticks.length_m,
            length_tolerance_m=0.004,
            diameter_m=layout.sticks.diameter_m,
        ),
    )


def dense(sticks: int, seeds: Iterable[int], rig: str = "webcam", spread: float = 1.0) -> Piles:
    """Heaps as dense as physical ones, one per seed, with their whole truth.

    Parameters
    ----------
    sticks
        Parts in each heap; 5, 10, 20 and 40 cross 2.7, 3.5, 6 and 13 others on average.
    rig
        A word of `bench.rigs.RIGS`: ``webcam`` or ``industrial``.
    spread
        1: that dense; more: looser (`bench.families.heap`).
    """
    setting = RIGS[rig]
    shots = []
    for seed in seeds:
        rng = np.random.default_rng([seed, sticks])
        shots.append(shoot(heap(sticks, setting, rng, spread), setting, rng))
    return _piles(setting, shots)


def family(name: str, seeds: Iterable[int], rig: str = "webcam") -> Piles:
    """Scenes of a family of `bench.families`, one per seed; kinds of scenes take turns.

    The part is that of the first scene's request: all scenes of a family ask for the same one.
    """
    setting = RIGS[rig]
    shots = []
    for seed in seeds:
        rng = np.random.default_rng([seed, *name.encode()])
        shots.append(shoot(scenery(name, setting, rng, seed), setting, rng))
    return _piles(setting, shots)


def _piles(rig: Rig, shots: list[Shot]) -> Piles:
    calibration_of_rig = known(rig)
    if calibration_of_rig.table is None:
        raise ValueError(f"the calibration of {rig.name} has no table")
    piles = [
        Pile(
            left=grey_of(shot.views[0].pixels),
            right=grey_of(shot.views[1].pixels),
            ends=shot.truth.ends,
            truth=shot.truth,
        )
        for shot in shots
    ]
    wish = shots[0].scenery.wish
    return Piles(
        piles=tuple(piles),
        known=calibration_of_rig,
        table=calibration_of_rig.table,
        part=PartModel(
            code=1,
            name="stick",
            length_m=wish.length_m,
            length_tolerance_m=round(0.04 * wish.length_m, 6),
            diameter_m=wish.diameter_m,
        ),
    )


def grey_of(pixels: npt.NDArray[np.uint8]) -> Grey:
    """A view as the detector gets it: (H, W) grey."""
    grey = pixels if pixels.ndim == 2 else np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY), np.uint8)
    return read_only(grey)
