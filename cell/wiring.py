"""Configuration to a ready cell: the only place that builds things."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import assert_never

import cv2
import numpy as np

from cell import calibration, empty_tray, frames
from cell.calibration import Calibration
from cell.colours import in_colour
from cell.config import CellConfig, PartConfig
from cell.errors import ConfigError
from cell.identity import identities
from cell.missed import MissedParts
from cell.mounting import Mounting
from cell.moved import Standing
from cell.pattern import Places
from cell.pictures import PictureCheck
from cell.station import Look, Stage, Station
from drivers.camera_settings import (
    CameraSettings,
    GigeCameraSettings,
    ReplayCameraSettings,
    SimCameraSettings,
    V4l2CameraSettings,
)
from drivers.factory import Factory
from drivers.interfaces import Device, Plc
from drivers.timing import Clock
from vision.transforms import identity


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Parts:
    """A station with its devices in the order in which they are opened, and the PLC."""

    station: Station
    devices: tuple[Device, ...]
    plc: Plc
    calibration: Calibration


def check(config: CellConfig, config_path: str) -> Calibration:
    """Everything that can be known without a device; the calibration when all is well.

    Raises
    ------
    CalibrationError, ConfigError
        The calibration is missing or belongs to other cameras; a part does not fit the view, or has a colour
        that the left camera cannot tell.
    """
    known = calibration.load(config.files.calibration)
    size = (config.cameras.left.width_px, config.cameras.left.height_px)
    calibration.fit(known, *size, f"the cameras of {config_path}")
    calibration.belong(known, identities(config.cameras), config_path)
    empty_tray.load(config)
    mounting = mounting_of(config, known)
    for part in config.parts:
        _refuse_too_long(config, config_path, mounting, part)
        if part.colour is not None and not _has_colour(config.cameras.left):
            raise ConfigError(
                Path(config_path),
                None,
                f"part {part.name}: it is told by its colour, but cameras.left gives grey pictures; "
                "use a colour camera on the left or leave out the part's colour",
            )
    return known


def mounting_of(config: CellConfig, known: Calibration) -> Mounting:
    """Where the cameras are; `CalibrationError` where the calibration does not say."""
    cameras, workspace = config.cameras, config.workspace
    return Mounting.of(known, cameras.mount, workspace.floor_z_m, config.tuning.height_m)


def standing_now(config: CellConfig, known: Calibration, factory: Factory) -> Standing:
    """Over the table, as cameras beside the arm always stand; of cameras on it, the arm is asked."""
    mounting = mounting_of(config, known)
    if not mounting.on_arm:
        return mounting.standing(mounting.view(identity()))
    robot = factory.robot("robot", config.robot)
    robot.open()
    try:
        tool = frames.transform_of(robot.state().tool)
    finally:
        robot.close()
    return mounting.standing(mounting.view(tool))


def _has_colour(camera: CameraSettings) -> bool:
    """False for a camera that is known to give grey pictures only."""
    match camera:
        case SimCameraSettings():
            return True
        case V4l2CameraSettings():
            return camera.format != "GREY"
        case ReplayCameraSettings():
            try:
                first = min(camera.folder.glob(camera.pattern), default=None)
                content = np.frombuffer(b"" if first is None else first.read_bytes(), dtype=np.uint8)
            except (OSError, ValueError, NotImplementedError):
                return True  # the camera says so itself when it is opened
            picture = cv2.imdecode(content, cv2.IMREAD_COLOR) if content.size else None
            return picture is None or in_colour(np.asarray(picture, dtype=np.uint8)) is not None
        case GigeCameraSettings():
            return camera.colours
        case _:
            assert_never(camera)


def _refuse_too_long(config: CellConfig, config_path: str, mounting: Mounting, part: PartConfig) -> None:
    """Raise `ConfigError` for a product that no picture of this cell can show whole."""
    known, depth = mounting.known, config.tuning.depth_m
    if depth is None:
        if mounting.on_arm:
            return  # how far off they are depends on where the arm stands
        table = mounting.view(identity()).table
        depth = calibration.depth_bounds_m(known, table, config.tuning.height_m)
    seen = calibration.widest_view_m(known.stereo, depth[1])
    if part.length_m > seen:
        raise ConfigError(
            Path(config_path),
            None,
            f"part {part.name}: length_m {part.length_m:.3f} is longer than the field of view "
            f"({seen:.3f} m along the diagonal at {depth[1]:.3f} m, by {config.files.calibration}); "
            "use a wider lens, a greater distance, or correct length_m",
        )


def build(
    config: CellConfig,
    config_path: str,
    clock: Clock,
    cell_clock: Clock,
    progress: Callable[[Stage], None],
    looked: Callable[[Look], None],
) -> Parts:
    """Build the cell; opens nothing. ``cell_clock`` is the cell thread's, whose waits count as progress."""
    known = check(config, config_path)
    factory = Factory(cell_clock)
    rig = factory.rig(config.cameras.left, config.cameras.right, config.cameras.max_skew_s)
    robot = factory.robot("robot", config.robot)
    gripper = factory.gripper("gripper", config.gripper, robot)
    mounting = mounting_of(config, known)
    tuning = empty_tray.tuning_of(config)
    station = Station(
        rig=rig,
        robot=robot,
        kinematics=factory.kinematics(config.robot),
        gripper=gripper,
        stereo=known.stereo,
        mounting=mounting,
        tuning=tuning,
        parts=config.parts,
        heaps=config.heaps,
        cameras=config.cameras,
        workspace=config.workspace,
        jaws=config.jaws,
        motion=config.motion,
        clock=cell_clock,
        pictures=PictureCheck(tuning.empty),
        missed=MissedParts(config.operation.strategy.avoid_looks, config.operation.strategy.avoid_radius_m),
        progress=progress,
        looked=looked,
        operation=config.operation,
        places=Places(config.operation.grid),
    )
    return Parts(
        station=station,
        devices=(rig, robot, gripper),
        plc=Factory(clock).plc("plc", config.plc),
        calibration=known,
    )
