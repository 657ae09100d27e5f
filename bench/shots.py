"""One scene: what lies there, both pictures of it, and the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.families import Scenery
from bench.rigs import Rig, rays
from bench.truth import Truth, truth_of
from bench.views import View, photograph


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shot:
    """A scene, photographed by a rig."""

    rig: Rig
    scenery: Scenery
    views: tuple[View, View]
    truth: Truth


def shoot(scenery: Scenery, rig: Rig, rng: np.random.Generator) -> Shot:
    """Photograph a scene and say what is true of it; ``rng`` for grain and noise."""
    views = photograph(scenery.rods, scenery.blocks, rig, scenery.look, rng)
    left = rays(rig)[0][0]
    return Shot(
        rig=rig,
        scenery=scenery,
        views=views,
        truth=truth_of(scenery.rods, views, left.base_from_camera),
    )
