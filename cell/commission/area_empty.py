"""``mikado area empty``: pictures of the empty tray, and what differs from them now.

The pictures are taken with the arm where it stands when the cell looks: it and its shadow are in them.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from rich.console import Console

from cell import calibration, empty_tray, frames, wiring
from cell import config as configuration
from cell.commission import area, changed
from cell.commission.arm import SlowArm, halted_by_ctrl_c
from cell.config import CellConfig
from cell.empty_tray import Foreign
from cell.errors import UsageError
from cell.faults import PictureUnusable
from cell.pictures import refuse_flawed
from drivers.factory import Factory
from drivers.timing import Clock, StopRequested
from drivers.types import FramePair, JointAngles
from vision import transforms
from vision.empty import Change, change
from vision.locate import locate
from vision.types import EmptyTray, Grey

FOLDER: Final = Path("empty-tray")
_TOLD: Final = 5
_THERE_RAD: Final = 0.01
_LEAST_M2: Final = 10e-6
"""Smaller spots are not told."""


def out_of_view(config: CellConfig, clock: Clock, ask: Callable[[str], bool]) -> None:
    """Bring the arm to ``workspace.watch_q_rad``, slowly and after a question, unless it stands there.

    Raises
    ------
    UsageError
        The person does not want that, or has halted it.
    DriverError
    """
    watch = JointAngles(q_rad=config.workspace.watch_q_rad)
    robot = Factory(clock).robot("robot", config.robot)
    robot.open()
    try:
        off = np.abs(np.array(robot.state().joints.q_rad) - np.array(watch.q_rad))
        if off.max() < _THERE_RAD:
            return
        if not ask("The arm goes to workspace.watch_q_rad, slowly. Is its way free?"):
            raise UsageError("the pictures are taken with the arm at workspace.watch_q_rad; bring it there")
        with halted_by_ctrl_c(clock) as stop:
            arm = SlowArm(robot=robot, stop=stop)
            arm.joints(watch)
            arm.settled()
    except StopRequested as error:
        raise UsageError(str(error)) from error
    finally:
        robot.close()


def take(path: Path, config: CellConfig, clock: Clock, *, sure: bool, console: Console) -> int:
    """A pair of pictures of the empty tray beside the configuration, and named in it; exit code 0. The arm
    stands where it looks from.

    Raises
    ------
    UsageError
        A picture is no use, parts seem to lie in the tray and nobody is ``sure`` that they belong there, or
        a file cannot be written.
    ConfigError, CalibrationError, DriverError
    """
    left, right = _greys(area.look(config, clock))
    seen = _parts_seen(path, config, left, right)
    if seen and not sure:
        raise UsageError(
            f"the tray does not look empty: {', '.join(seen)}. A part in these pictures would not be picked "
            "as long as it lies there; take it out, or give --sure where it belongs to the tray"
        )
    folder = config.files.empty_tray or path.resolve().parent / FOLDER
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, grey in zip(empty_tray.NAMES, (left, right), strict=True):
            _write(folder / name, grey)
    except OSError as error:
        raise UsageError(f"{folder}: cannot be written: {error.strerror}") from error
    if config.files.empty_tray is None:
        changed.put(path, "files", {"empty_tray": str(FOLDER)}, configuration.load)
    console.print(
        f"{folder}: pictures of the empty tray; {path} names them. What looks as there is no part from the "
        "next start of the daemon on, and in nobody's way: what stands up from the floor belongs outside "
        "of the workspace box",
        markup=False,
    )
    return 0


def compare(path: Path, config: CellConfig, clock: Clock, console: Console) -> int:
    """Say how the tray differs from its reference now: 0 as empty as then, 1 something lies there, or the
    reference does not suit any more.

    Raises
    ------
    UsageError
        There is no reference.
    ConfigError, CalibrationError, DriverError
    """
    empty = empty_tray.load(config)
    if empty is None:
        raise UsageError(f"{path} has no reference (files.empty_tray); {empty_tray.TAKE}")
    greys = _greys(area.look(config, clock))
    suits = True
    for name, grey, reference in zip(("left", "right"), greys, (empty.left, empty.right), strict=True):
        here = change(grey, reference)
        console.print(f"{name}: {_light(here)}")
        suits &= here.usable
    if not suits:
        console.print(
            f"the reference does not suit any more and is left out: the camera was moved, the light "
            f"changed, or the tray is full; {empty_tray.TAKE}"
        )
        return 1
    spots = [spot for spot in _spots(path, config, greys[0], empty) if spot.area_m2 >= _LEAST_M2]
    for spot in spots[:_TOLD]:
        console.print(
            f"something lies at {1e3 * spot.x_m:.0f}, {1e3 * spot.y_m:.0f} mm (base): "
            f"{1e6 * spot.area_m2:.0f} mm²"
        )
    if len(spots) > _TOLD:
        console.print(f"... and {len(spots) - _TOLD} smaller spots")
    if spots:
        console.print("(the arm, if it does not stand at workspace.watch_q_rad, and its shadow count too)")
    if not spots:
        console.print("the tray is as empty as in its pictures")
    return 1 if spots else 0


def _greys(pair: FramePair) -> tuple[Grey, Grey]:
    left, right = frames.grey_of(pair.left), frames.grey_of(pair.right)
    try:
        refuse_flawed(left, pair.left.camera)
        refuse_flawed(right, pair.right.camera)
    except PictureUnusable as error:
        raise UsageError(str(error)) from error
    return left, right


def _parts_seen(path: Path, config: CellConfig, left: Grey, right: Grey) -> list[str]:
    """Products of which something is recognised, in words. Colour is not asked: the doubt is enough."""
    known = wiring.check(config.model_copy(update={"files": _without(config)}), str(path))
    table = calibration.table_of(known, config.workspace.floor_z_m)
    words = []
    for part in config.parts:
        model = part.model_copy(update={"colour": None})
        found = locate(left, right, known.stereo, model.model(), part.tuned(config.tuning.tuning()), table)
        if found.recognised:
            words.append(f"{len(found.recognised)} of {part.name} recognised")
    return words


def _without(config: CellConfig) -> configuration.FilesConfig:
    return config.files.model_copy(update={"empty_tray": None})


def _spots(path: Path, config: CellConfig, left: Grey, empty: EmptyTray) -> tuple[Foreign, ...]:
    known = wiring.check(config, str(path))
    view = wiring.mounting_of(config, known).view(transforms.identity())
    return empty_tray.foreign(
        left, empty, known.stereo.left, view.table, view.base_from_camera, config.workspace
    )


def _light(here: Change) -> str:
    if here.light is None:
        return "too dark or too bright to compare"
    return (
        f"{here.light.factor:.2f} times as bright as then, by {here.light.share:.0%} of the picture; "
        f"{float(np.mean(here.mask)):.1%} changed"
    )


def _write(path: Path, grey: Grey) -> None:
    done, encoded = cv2.imencode(".png", grey)
    if not done:
        raise UsageError(f"{path}: the picture could not be encoded")
    beside = path.with_name(path.name + ".new")
    with beside.open("wb") as file:
        file.write(encoded.tobytes())
        file.flush()
        os.fsync(file.fileno())
    beside.replace(path)
