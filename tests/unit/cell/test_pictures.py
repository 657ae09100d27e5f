"""A picture that shows nothing, or nothing new, is refused before anybody looks for parts in it."""

from __future__ import annotations

import re

import cv2
import numpy as np
import pytest

from cell.faults import PictureUnusable
from cell.pictures import PictureCheck, refuse_flawed
from drivers.types import Frame, FramePair, Pixels
from tests.fakes.station import drawn


def pair(left: Pixels, right: Pixels, sequence: int = 1) -> FramePair:
    return FramePair(
        left=Frame(camera="camera.left", pixels=left, captured_at=1.0, sequence=sequence),
        right=Frame(camera="camera.right", pixels=right, captured_at=1.0, sequence=sequence),
    )


LEFT, RIGHT = drawn("left", 3), drawn("right", 3)


def test_a_good_pair_comes_back_in_grey() -> None:
    colour = np.repeat(LEFT[0][:, :, None], 3, axis=2)
    left, right = PictureCheck().check(pair(colour, RIGHT[0]))
    assert left.shape == LEFT[0].shape
    assert np.array_equal(left, LEFT[0])
    assert np.array_equal(right, RIGHT[0])


@pytest.mark.parametrize(
    ("picture", "said"),
    [
        (np.full((360, 480), 3, dtype=np.uint8), "camera.right: picture is black (3, limit 16)"),
        (np.full((360, 480), 255, dtype=np.uint8), "camera.right: picture is saturated (1, limit 0.5)"),
        (np.full((360, 480), 90, dtype=np.uint8), "camera.right: picture is without contrast (0, limit 12)"),
    ],
    ids=["black", "saturated", "flat"],
)
def test_a_flawed_picture_names_camera_flaw_and_number(picture: Pixels, said: str) -> None:
    with pytest.raises(PictureUnusable) as caught:
        PictureCheck().check(pair(LEFT[0], picture))
    assert str(caught.value) == said


def test_a_camera_that_serves_the_same_picture_again_is_frozen() -> None:
    check = PictureCheck()
    check.check(pair(LEFT[0], RIGHT[0], sequence=7))
    with pytest.raises(PictureUnusable, match=r"camera\.right: picture 8 is bit for bit the same as the one"):
        check.check(pair(LEFT[1], RIGHT[0], sequence=8))


def test_noise_in_one_pixel_shows_that_a_camera_lives() -> None:
    check = PictureCheck()
    check.check(pair(LEFT[0], RIGHT[0]))
    other = RIGHT[0].copy()
    other[0, 0] ^= 1
    check.check(pair(LEFT[1], other))


def test_a_frozen_camera_stays_refused() -> None:
    check = PictureCheck()
    check.check(pair(LEFT[0], RIGHT[0]))
    for number in (1, 2):
        with pytest.raises(PictureUnusable, match="frozen"):
            check.check(pair(LEFT[number], RIGHT[0]))


def test_cameras_that_were_opened_anew_are_compared_with_nothing() -> None:
    check = PictureCheck()
    check.check(pair(LEFT[0], RIGHT[0]))
    check.forget()
    check.check(pair(LEFT[0], RIGHT[0]))


def test_a_file_is_named_in_the_same_words() -> None:
    with pytest.raises(PictureUnusable, match=r"left\.png: picture is black"):
        refuse_flawed(np.zeros((10, 10), dtype=np.uint8), "left.png")


def blurred(pixels: Pixels, sigma_px: float) -> Pixels:
    return np.asarray(cv2.GaussianBlur(pixels, (0, 0), sigma_px), np.uint8)


def test_a_blurred_picture_is_refused_with_its_blur_in_pixels() -> None:
    with pytest.raises(PictureUnusable, match=r"camera\.left: picture is blurred \(\d.*, limit 2.2\)"):
        PictureCheck().check(pair(blurred(LEFT[0], 4.0), RIGHT[0]))
    PictureCheck().check(pair(blurred(LEFT[0], 1.0), RIGHT[0]))


def test_another_exposure_is_remarked_once_and_is_no_reason_to_refuse() -> None:
    check = PictureCheck()
    check.check(pair(LEFT[0], RIGHT[0]))
    brighter = [np.asarray(cv2.convertScaleAbs(one, alpha=1.6), np.uint8) for one in LEFT]
    check.check(pair(brighter[1], RIGHT[1]))
    assert len(check.remarks) == 1
    assert re.match(
        r"camera\.left: exposure or light changed: .* is 1\.[56]\d times as bright", check.remarks[0]
    )
    check.check(pair(brighter[2], RIGHT[2]))
    assert list(check.remarks) == []
