"""A camera that was knocked is named, by the parts or by the pictures; nothing is gripped by what it saw."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from cell import cycle
from cell.faults import CameraMoved, FaultCode, fault_of
from cell.moved import SILENT_LOOKS, MovedCheck, Standing
from drivers.timing import StopToken
from tests.fakes.station import Bench, bench, drawn, order, scene
from vision.default import locate_default
from vision.transforms import identity
from vision.types import Grey, Scene

MADE = bench()
CAMERAS = "camera.left, camera.right"


def pictures(rows: int = 0) -> tuple[Grey, Grey]:
    """The drawn pair, the right camera tilted by so many rows."""
    return drawn("left", 1)[0], np.roll(drawn("right", 1)[0], rows, axis=0)


def standing() -> Standing:
    mounting = MADE.station.mounting
    return mounting.standing(mounting.view(identity()))


def never() -> Standing:
    raise AssertionError("the pictures were asked though the detector had its say")


def seen(left: Grey, right: Grey) -> Scene:
    """What the detector finds in a pair."""
    station = MADE.station
    part = station.parts[0]
    table = station.mounting.view(identity()).table
    return locate_default(left, right, station.stereo, part.model(), part.tuned(station.tuning), table)


def test_cameras_that_stand_are_left_alone_and_the_pictures_are_not_asked() -> None:
    pair = pictures()
    found = seen(*pair)
    assert abs(found.rows_seen_px) < 0.25
    MovedCheck().check(found, pair, CAMERAS, never)


@pytest.mark.parametrize("rows", [-3, 2, 3])
def test_a_knock_that_leaves_parts_to_be_found_is_told_by_their_ends(rows: int) -> None:
    pair = pictures(rows)
    with pytest.raises(
        CameraMoved, match=rf"{CAMERAS}: rows are off by [-+]\d\.\d px .*by the ends of parts"
    ) as caught:
        MovedCheck().check(seen(*pair), pair, CAMERAS, never)
    assert fault_of(caught.value).code is FaultCode.CALIBRATION_MISMATCH


@pytest.mark.parametrize("rows", [-8, 6, 9])
def test_a_knock_that_blinds_the_detector_is_told_by_the_pictures(rows: int) -> None:
    pair = pictures(rows)
    found = seen(*pair)
    assert np.isnan(found.rows_seen_px)
    with pytest.raises(CameraMoved, match=r"rows are off by [-+]\d\.\d px .*places agree"):
        MovedCheck().check(found, pair, CAMERAS, standing)


def test_while_the_detector_is_silent_the_pictures_are_asked_now_and_then() -> None:
    check, asked = MovedCheck(), []

    def told(look: int) -> Standing:
        asked.append(look)
        return standing()

    for look in range(2 * SILENT_LOOKS + 1):
        check.check(scene(), pictures(), CAMERAS, partial(told, look))
    assert asked == [0, SILENT_LOOKS, 2 * SILENT_LOOKS]
    found = seen(*pictures())
    check.check(found, pictures(), CAMERAS, never)
    check.check(scene(), pictures(), CAMERAS, partial(told, -1))
    assert asked[-1] == -1, "the first silent look after one in which the detector had its say"


def test_where_something_would_be_picked_the_pictures_are_asked_every_time() -> None:
    check, asked = MovedCheck(), []

    def told() -> Standing:
        asked.append(True)
        return standing()

    found = replace(seen(*pictures()), rows_seen_px=float("nan"))
    assert found.offered
    for _ in range(3):
        check.check(found, pictures(), CAMERAS, told)
    assert len(asked) == 3


def knocked(rows: int) -> Bench:
    """A cell whose right camera was tilted since the calibration."""
    made = bench(pictures=1)
    made.right.answers[:] = [np.roll(picture, rows, axis=0) for picture in drawn("right", 1)]
    return made.open()


@pytest.mark.parametrize("rows", [3, 8])
def test_nothing_is_gripped_by_what_a_knocked_camera_saw(rows: int) -> None:
    made = knocked(rows)
    with pytest.raises(CameraMoved, match="a camera was moved since the calibration"):
        cycle.run_order(made.station, order(), StopToken(made.clock))
    assert "grasp" not in made.gripper.calls
