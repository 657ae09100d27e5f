"""A change of exposure is told from a change of what lies there."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.fakes.station import DATA
from vision.light import light_change
from vision.types import Grey

_read = cv2.imread(str(DATA / "left.png"), cv2.IMREAD_GRAYSCALE)
assert _read is not None
PICTURE: Grey = np.asarray(_read, np.uint8)


def exposed(factor: float) -> Grey:
    return np.asarray(cv2.convertScaleAbs(PICTURE, alpha=factor), np.uint8)


@pytest.mark.parametrize("factor", [0.4, 0.6, 0.75, 1.4, 2.0])
def test_another_exposure_is_told_by_its_factor(factor: float) -> None:
    change = light_change(PICTURE, exposed(factor))
    assert change is not None
    assert change.changed
    assert change.factor == pytest.approx(factor, rel=0.05)


@pytest.mark.parametrize("factor", [0.9, 1.0, 1.1])
def test_the_flicker_of_a_lamp_is_no_change(factor: float) -> None:
    change = light_change(PICTURE, exposed(factor))
    assert change is not None
    assert not change.changed


def test_parts_that_come_and_go_are_no_change_of_light() -> None:
    other = PICTURE.copy()
    other[60:200, 100:300] = 200  # a bright box over a quarter of the picture
    change = light_change(PICTURE, other)
    assert change is not None
    assert not change.changed


def test_pictures_that_cannot_be_compared_say_nothing() -> None:
    assert light_change(PICTURE, PICTURE[:100]) is None
    assert light_change(PICTURE, np.zeros_like(PICTURE)) is None
