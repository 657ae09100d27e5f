"""Cases of our own making, from fresh random numbers: those of `bench.piles`, and 200 parts in 5 MP."""

from __future__ import annotations

import json
import secrets
import tempfile
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import numpy as np

from bench import piles, rigs
from bench.cases import Case, of_piles, truth_from
from bench.meet import BLOCK_OWNER
from bench.rigs import RIGS
from bench.scenes import WORLD, Pile, Piles, grey_of
from cell import calibration, frames
from drivers.sim.cell import load_world
from drivers.sim.layout import CameraLayout, WorldLayout
from drivers.sim.optics import calibration_text, eyes
from drivers.sim.render import Lighting, Renderer
from drivers.sim.world import World
from drivers.types import Frame
from vision import transforms
from vision.types import PartModel

FINER = 4
"""A picture of 2560 x 1920, seen by the demo's cameras with a sensor so many times finer."""
LARGE_COUNTS = (10, 50, 200)
LARGE_LENGTH_M = 0.030
LARGE_DIAMETER_M = 0.0012
"""Smaller sticks for it: 170 by 6.8 px, about as in the small pictures."""


def fresh_seed() -> int:
    """A seed nobody has chosen."""
    return secrets.randbelow(2**31)


@lru_cache(maxsize=64)
def cases(family: str, count: int, seed: int, rig: str = "webcam") -> tuple[Case, ...]:
    """The first ``count`` scenes of `stream`, kept for the next who asks."""
    return tuple(stream(family, count, seed, rig))


def stream(family: str, count: int, seed: int, rig: str = "webcam") -> Iterator[Case]:
    """``count`` scenes of a family (`bench.families`); every seed gives other ones."""
    camera = RIGS[rig]
    known = rigs.known(camera)
    if known.table is None:
        raise ValueError(f"{camera.name}: its calibration has no table")
    for number in range(count):
        scene = piles.draw(family, camera, seed, number)
        told = json.loads(piles.truth_text(scene, f"{family}-{number + 1}", family, seed))
        wish = scene.scenery.wish
        left, right = (grey_of(view.pixels) for view in scene.views)
        shows = [
            np.where(view.owner >= BLOCK_OWNER, 0, view.owner + 1).astype(np.int32) for view in scene.views
        ]
        yield Case(
            family=family,
            name=told["scene"],
            left=left,
            right=right,
            stereo=known.stereo,
            table=known.table,
            part=PartModel(
                code=1,
                name="stick",
                length_m=wish.length_m,
                length_tolerance_m=0.0,
                diameter_m=wish.diameter_m,
            ),
            width_m=wish.diameter_m,
            truth=truth_from(told, "stick"),
            shows=(shows[0], shows[1]),
            walled=False,
        )


@lru_cache(maxsize=2)
def large(counts: tuple[int, ...], seed: int) -> tuple[Case, ...]:
    """One picture pair of 5 megapixels for each number of sticks, thinly spread over the tray.

    Takes most of a minute: rays of 5 megapixels are traced.
    """
    layout = _finer(load_world(WORLD))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "calibration.json"
        file.write_text(calibration_text(layout.cameras), encoding="utf-8")
        known = calibration.load(file)
    if known.base_from_camera is None:
        raise ValueError("the simulated cell's calibration has no base_from_camera")
    camera_from_base = transforms.invert(known.base_from_camera)
    rng = np.random.default_rng([seed, 5])
    heaps = [World(layout, seed=int(rng.integers(2**31)), count=count).snapshot() for count in counts]
    pictures = []
    for eye in eyes(layout.cameras):
        renderer = Renderer(eye, layout, seed=1)  # 1 GB each: one after the other
        shots = [renderer.picture(heap, Lighting(layout).of(heap)) for heap in heaps]
        pictures.append(
            [
                frames.grey_of(Frame(camera="bench", pixels=shot, captured_at=0.0, sequence=0))
                for shot in shots
            ]
        )
    part = PartModel(
        code=1,
        name="small stick",
        length_m=layout.sticks.length_m,
        length_tolerance_m=0.1 * layout.sticks.length_m,
        diameter_m=layout.sticks.diameter_m,
    )
    table = calibration.table_of(known, layout.tray.centre_m[2])
    found: list[Case] = []
    for count, heap, left, right in zip(counts, heaps, *pictures, strict=True):
        ends = transforms.apply(camera_from_base, np.array([stick.ends for stick in heap.lying]))
        pile = Pile(left=left, right=right, ends=ends)
        found += of_piles(f"5 MP, {count}", Piles(piles=(pile,), known=known, table=table, part=part))
    return tuple(found)


def _finer(layout: WorldLayout) -> WorldLayout:
    def camera(one: CameraLayout) -> CameraLayout:
        fx, fy = one.focal_px
        cx, cy = one.centre_px
        # pixel centres at whole coordinates: the picture's corner is at -0.5
        return one.model_copy(
            update={
                "focal_px": (FINER * fx, FINER * fy),
                "centre_px": (FINER * (cx + 0.5) - 0.5, FINER * (cy + 0.5) - 0.5),
            }
        )

    cameras = layout.cameras
    cameras = cameras.model_copy(
        update={
            "width_px": FINER * cameras.width_px,
            "height_px": FINER * cameras.height_px,
            "left": camera(cameras.left),
            "right": camera(cameras.right),
        }
    )
    sticks = layout.sticks.model_copy(
        update={
            "length_m": LARGE_LENGTH_M,
            "diameter_m": LARGE_DIAMETER_M,
            "spread": 1.0,
            "wall_margin_m": 0.006,
        }
    )
    return layout.model_copy(update={"cameras": cameras, "sticks": sticks})
