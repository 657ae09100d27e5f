"""Cases of our own making, from fresh random numbers: those of `bench.piles`, and 200 parts in 5 MP."""

from __future__ import annotations

import json
import secrets
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np

from bench import piles, rigs
from bench.cases import Case, truth_from
from bench.families import Kind, Scenery, Wish, disc, dropped, look_of
from bench.meet import BLOCK_OWNER
from bench.rigs import RIGS, WEBCAM, Rig
from bench.scenes import grey_of
from bench.shots import Shot, shoot
from cell.calibration import Calibration
from cell.colours import WORDS
from drivers.sim.layout import CameraLayout
from vision.types import PartModel

FINER = 4
"""Pictures of 2560 x 1920: the webcams with sensors so many times finer."""
LARGE_COUNTS = (10, 50, 200)
LARGE_LENGTH_M = 0.030
LARGE_DIAMETER_M = 0.0012
"""Smaller sticks for it: 180 by 7 px, about as in the small pictures."""
LARGE_RADIUS_M = 0.11
"""Of the disc on which the most of them lie; fewer lie on a smaller one, as dense."""


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
    for number in range(count):
        shot = piles.draw(family, camera, seed, number)
        yield case_of(shot, known, family, f"{family}-{number + 1}", seed)


def case_of(shot: Shot, known: Calibration, family: str, name: str, seed: int) -> Case:
    if known.table is None:
        raise ValueError(f"{shot.rig.name}: its calibration has no table")
    told = json.loads(piles.truth_text(shot, name, family, seed))
    wish = shot.scenery.wish
    left, right = (grey_of(view.pixels) for view in shot.views)
    shows = [np.where(view.owner >= BLOCK_OWNER, 0, view.owner + 1).astype(np.int32) for view in shot.views]
    return Case(
        family=family,
        name=name,
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
            colour=None if told["request"].get("colour") is None else WORDS[told["request"]["colour"]],
        ),
        width_m=wish.diameter_m,
        truth=truth_from(told, "stick"),
        shows=(shows[0], shows[1]),
        colour_left=shot.views[0].pixels if shot.views[0].pixels.ndim == 3 else None,
    )


@lru_cache(maxsize=2)
def large(counts: tuple[int, ...], seed: int) -> tuple[Case, ...]:
    """One picture pair of 5 megapixels for each number of sticks, all as dense."""
    rig = _finer(WEBCAM)
    known = rigs.known(rig)
    found = []
    for count in counts:
        rng = np.random.default_rng([seed, count])
        kind = Kind(length_m=LARGE_LENGTH_M, diameter_m=LARGE_DIAMETER_M)
        radius_m = LARGE_RADIUS_M * float(np.sqrt(count / max(counts)))
        scenery = Scenery(
            rods=dropped(disc(count, radius_m, rng, 1), (kind,) * count, rng),
            look=look_of(rng),
            wish=Wish(length_m=LARGE_LENGTH_M, diameter_m=LARGE_DIAMETER_M),
        )
        name = f"5 MP, {count}"
        found.append(case_of(shoot(scenery, rig, rng), known, name, name, seed))
    rigs.rays.cache_clear()  # half a gigabyte
    return tuple(found)


def _finer(rig: Rig) -> Rig:
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

    cameras = rig.cameras
    cameras = cameras.model_copy(
        update={
            "width_px": FINER * cameras.width_px,
            "height_px": FINER * cameras.height_px,
            "left": camera(cameras.left),
            "right": camera(cameras.right),
        }
    )
    return replace(rig, name="own-large", mono=True, cameras=cameras, stick_length_m=LARGE_LENGTH_M)
