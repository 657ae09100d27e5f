"""A picture that shows nothing, or nothing new, is refused before anybody looks for parts in it."""

from __future__ import annotations

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
