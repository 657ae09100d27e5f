"""The disturbances of the robustness table: `bench.perturb`'s functions with sizes, on cases."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bench import perturb
from bench.cases import Case
from vision.types import Grey, read_only

OnPicture = Callable[[Grey, np.random.Generator], Grey]
Change = Callable[[Case, np.random.Generator], Case]


@dataclass(frozen=True, slots=True, kw_only=True)
class Disturbance:
    """One way of making it worse, in words."""

    name: str
    apply: Change


def _alike(name: str, change: OnPicture) -> Disturbance:
    """Both pictures changed the same way: what is random starts anew for the second."""

    def apply(case: Case, rng: np.random.Generator) -> Case:
        seed = int(rng.integers(2**31))
        left, right = (change(grey, np.random.default_rng(seed)) for grey in (case.left, case.right))
        return case.changed(left, right)

    return Disturbance(name=name, apply=apply)


def _apart(name: str, change: OnPicture) -> Disturbance:
    """Each picture changed by itself: nothing in it could be matched."""

    def apply(case: Case, rng: np.random.Generator) -> Case:
        return case.changed(change(case.left, rng), change(case.right, rng))

    return Disturbance(name=name, apply=apply)


def _rows(name: str, rows_px: float) -> Disturbance:
    def apply(case: Case, _: np.random.Generator) -> Case:
        return case.changed(case.left, case.right, perturb.rows_moved(case.stereo, rows_px))

    return Disturbance(name=name, apply=apply)


SHADOW = 0.5
SHADOW_WIDTH = 0.24
SHADOW_EDGE_PX = 2.0
"""What a shadow takes of the light, its width as a share of the picture's, and how soft its edge is."""


def shadowed(picture: Grey, rng: np.random.Generator) -> Grey:
    """A straight shadow across the middle of the picture, at any angle."""
    height, width = picture.shape
    turn = rng.uniform(0.0, np.pi)
    v, u = np.mgrid[:height, :width]
    across = (u - 0.5 * width) * np.cos(turn) + (v - 0.5 * height) * np.sin(turn)
    depth = (0.5 * SHADOW_WIDTH * width - np.abs(across)) / SHADOW_EDGE_PX
    light = 1.0 - SHADOW / (1.0 + np.exp(-np.clip(depth, -50.0, 50.0)))
    dark: Grey = np.rint(picture * light).astype(np.uint8)
    return read_only(dark)


DISTURBANCES = (
    Disturbance(name="as it is", apply=lambda case, _: case),
    _apart("noise, sigma 6", lambda grey, rng: perturb.noisy(grey, 6.0, rng)),
    _apart("noise, sigma 12", lambda grey, rng: perturb.noisy(grey, 12.0, rng)),
    _alike("blur 1 px", lambda grey, _: perturb.blurred(grey, 1.0)),
    _alike("blur 1.5 px", lambda grey, _: perturb.blurred(grey, 1.5)),
    _alike("40 grey levels darker", lambda grey, _: perturb.brighter(grey, -40.0)),
    _alike("40 grey levels brighter", lambda grey, _: perturb.brighter(grey, 40.0)),
    _alike("half the gain", lambda grey, _: perturb.gained(grey, 0.5)),
    _alike("1.4 times the gain", lambda grey, _: perturb.gained(grey, 1.4)),
    _apart("texture, sigma 8", lambda grey, rng: perturb.textured(grey, 8.0, rng)),
    _alike("gradient 0.5 to 1.5", lambda grey, rng: perturb.gradient(grey, 0.5, rng.uniform(0.0, np.pi))),
    _alike("hard shadow, half the light", shadowed),
    _alike("twelve highlights", lambda grey, rng: perturb.highlights(grey, 12, 200.0, 9.0, rng)),
    _rows("rows off by 1 px", 1.0),
    _rows("rows off by 2 px", 2.0),
)
