"""Worse pictures and a worse calibration of the same scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from bench.cases import Case
from vision.types import Floats, Grey, read_only

Change = Callable[[Case, np.random.Generator], Case]


@dataclass(frozen=True, slots=True, kw_only=True)
class Disturbance:
    """One way of making it worse, in words."""

    name: str
    apply: Change


def _pictures(change: Callable[[Floats, np.random.Generator], Floats]) -> Change:
    """Both pictures changed alike: the generator starts anew for the second, except for what is noise."""

    def apply(case: Case, rng: np.random.Generator) -> Case:
        seed = int(rng.integers(2**31))
        left, right = (
            _grey(change(grey.astype(np.float64), np.random.default_rng(seed)))
            for grey in (case.left, case.right)
        )
        return case.changed(left, right)

    return apply


def _grey(values: Floats) -> Grey:
    grey: Grey = np.clip(np.rint(values), 0, 255).astype(np.uint8)
    return read_only(grey)


def _noise(sigma: float) -> Change:
    def apply(case: Case, rng: np.random.Generator) -> Case:
        left, right = (_grey(grey + rng.normal(0.0, sigma, grey.shape)) for grey in (case.left, case.right))
        return case.changed(left, right)

    return apply


def _blur(sigma_px: float) -> Change:
    return _pictures(lambda grey, _: np.asarray(cv2.GaussianBlur(grey, (0, 0), sigma_px), np.float64))


def _offset(levels: float) -> Change:
    return _pictures(lambda grey, _: grey + levels)


def _gain(factor: float) -> Change:
    return _pictures(lambda grey, _: grey * factor)


def _texture(levels: float) -> Change:
    def apply(case: Case, rng: np.random.Generator) -> Case:
        # blotches a few part widths wide, others in each view: nothing that could be matched
        left, right = (
            _grey(grey + levels * _blotches(grey.shape, 6.0, rng)) for grey in (case.left, case.right)
        )
        return case.changed(left, right)

    return apply


def _blotches(shape: tuple[int, ...], size_px: float, rng: np.random.Generator) -> Floats:
    field = cv2.GaussianBlur(rng.normal(0.0, 1.0, shape), (0, 0), size_px)
    return np.asarray(field / field.std(), np.float64)


def _gradient(grey: Floats, rng: np.random.Generator) -> Floats:
    """A third of the light on one side, a third more on the other."""
    height, width = grey.shape
    turn = rng.uniform(0.0, 2.0 * np.pi)
    v, u = np.mgrid[:height, :width]
    along = (u / width - 0.5) * np.cos(turn) + (v / height - 0.5) * np.sin(turn)
    return np.asarray(grey * (0.83 + along * 1.0))


def _shadow(grey: Floats, rng: np.random.Generator) -> Floats:
    """Half of the light is taken from a band across the middle, with an edge of four pixels."""
    height, width = grey.shape
    turn = rng.uniform(0.0, np.pi)
    v, u = np.mgrid[:height, :width]
    across = (u - 0.5 * width) * np.cos(turn) + (v - 0.5 * height) * np.sin(turn)
    inside = 1.0 / (1.0 + np.exp(-(0.12 * width - np.abs(across)) / 2.0))
    return np.asarray(grey * (1.0 - 0.5 * inside))


def _highlights(grey: Floats, rng: np.random.Generator) -> Floats:
    """Six spots of glare that saturate the middle half of the picture here and there."""
    height, width = grey.shape
    v, u = np.mgrid[:height, :width]
    lit = grey.copy()
    for _ in range(6):
        at_u, at_v = rng.uniform(0.25, 0.75) * width, rng.uniform(0.25, 0.75) * height
        lit += 260.0 * np.exp(-0.5 * ((u - at_u) ** 2 + (v - at_v) ** 2) / 9.0**2)
    return np.asarray(lit)


def _rows(offset_px: float) -> Change:
    """The right camera sits that many rows lower than its calibration says."""

    def apply(case: Case, _: np.random.Generator) -> Case:
        camera = case.stereo.right
        matrix = camera.matrix.copy()
        matrix[1, 2] += offset_px
        right = replace(camera, matrix=read_only(matrix))
        return case.changed(case.left, case.right, replace(case.stereo, right=right))

    return apply


DISTURBANCES = (
    Disturbance(name="as it is", apply=lambda case, _: case),
    Disturbance(name="noise, sigma 6", apply=_noise(6.0)),
    Disturbance(name="noise, sigma 12", apply=_noise(12.0)),
    Disturbance(name="blur 1 px", apply=_blur(1.0)),
    Disturbance(name="blur 1.5 px", apply=_blur(1.5)),
    Disturbance(name="40 grey levels darker", apply=_offset(-40.0)),
    Disturbance(name="40 grey levels brighter", apply=_offset(40.0)),
    Disturbance(name="half the light", apply=_gain(0.5)),
    Disturbance(name="texture, sigma 8", apply=_texture(8.0)),
    Disturbance(name="gradient 0.33 to 1.33", apply=_pictures(_gradient)),
    Disturbance(name="hard shadow, half the light", apply=_pictures(_shadow)),
    Disturbance(name="six highlights", apply=_pictures(_highlights)),
    Disturbance(name="rows off by 1 px", apply=_rows(1.0)),
    Disturbance(name="rows off by 2 px", apply=_rows(2.0)),
)
