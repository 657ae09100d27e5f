"""What the robustness table does to a scene is what it says."""

from __future__ import annotations

import numpy as np
import pytest

from bench.cases import Case
from bench.disturb import DISTURBANCES, SHADOW, Disturbance, shadowed
from bench.scoring import Truth
from vision.types import CameraModel, PartModel, Plane, StereoModel, Transform, read_only

CAMERA = CameraModel(
    matrix=read_only(np.array([[500.0, 0.0, 80.0], [0.0, 500.0, 60.0], [0.0, 0.0, 1.0]])),
    distortion=read_only(np.zeros(5)),
    width_px=160,
    height_px=120,
)
BY_NAME = {one.name: one for one in DISTURBANCES}


def case() -> Case:
    stereo = StereoModel(
        left=CAMERA,
        right=CAMERA,
        right_from_left=Transform(rotation=np.eye(3), translation=np.array([-0.02, 0.0, 0.0])),
    )
    table = Plane(normal=np.array([0.0, 0.0, -1.0]), offset_m=0.4)
    shows = np.zeros((120, 160), np.int32)
    shows[58:63, 55:105] = 1
    grey = read_only(np.where(shows > 0, 200, 60).astype(np.uint8))
    return Case(
        family="A",
        name="A-1",
        left=grey,
        right=grey,
        stereo=stereo,
        table=table,
        part=PartModel(code=1, name="stick", length_m=0.04, length_tolerance_m=0.004, diameter_m=0.004),
        width_m=0.004,
        truth=Truth(parts=()),
        shows=(shows, shows),
    )


@pytest.mark.parametrize("disturbance", DISTURBANCES[1:], ids=lambda one: one.name)
def test_every_disturbance_changes_something_and_leaves_the_original_and_the_truth(
    disturbance: Disturbance,
) -> None:
    before = case()
    after = disturbance.apply(before, np.random.default_rng(3))

    moved = not np.array_equal(after.stereo.right.matrix, before.stereo.right.matrix)
    assert moved or not np.array_equal(after.left, before.left)
    assert np.array_equal(before.left, case().left)
    assert after.truth is before.truth


@pytest.mark.parametrize(
    ("name", "alike"),
    [("hard shadow, half the light", True), ("noise, sigma 6", False), ("texture, sigma 8", False)],
)
def test_light_falls_on_both_pictures_and_noise_on_each(name: str, alike: bool) -> None:
    after = BY_NAME[name].apply(case(), np.random.default_rng(4))
    assert np.array_equal(after.left, after.right) is alike


def test_a_shadow_takes_its_share_in_a_band_and_nothing_beyond() -> None:
    flat = np.full((120, 160), 200, np.uint8)
    dark = shadowed(flat, np.random.default_rng(5))
    assert dark.max() == 200
    assert dark[60, 80] == pytest.approx(200 * (1 - SHADOW), abs=1)
    assert 0.1 < np.mean(dark < 150) < 0.5
