"""The configuration: one YAML file, read once, checked whole before anything is opened.

Metres, radians, seconds. No defaults for what differs between cells; relative paths are relative to
the file they stand in.
"""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from cell import yamlfile
from cell.commissioning import CommissioningConfig
from cell.errors import ConfigError
from cell.operation import OperationConfig
from cell.products import TOLD_BY_WIDTH, ColourConfig, PartConfig
from drivers.camera_settings import CameraSettings, ReplayCameraSettings, runs_freely
from drivers.settings import GripperSettings, PlcSettings, RobotSettings, Settings, Six, UrRobotSettings
from vision.types import EmptyTray, Tuning

Three = tuple[float, float, float]
Grey = Annotated[int, Field(ge=0, le=255)]
Code = Annotated[int, Field(ge=1, le=65535)]


class CamerasConfig(Settings):
    """The stereo rig."""

    left: CameraSettings
    right: CameraSettings
    max_skew_s: PositiveFloat = Field(description="largest time between the two exposures of a pair")
    mount: Literal["fixed", "tool"] = Field(description="fixed: stands beside the robot; tool: on the arm")
    look_timeout_s: PositiveFloat = 2.0
    standing_parts: bool = Field(
        default=False,
        description="parts lie still while they are looked at; must be said where cameras run freely, "
        "as webcams do and GigE with trigger: free",
    )

    @model_validator(mode="after")
    def _same_size(self) -> Self:
        left = (self.left.width_px, self.left.height_px)
        right = (self.right.width_px, self.right.height_px)
        if left != right:
            raise ValueError(f"left is {left[0]}x{left[1]} px, right {right[0]}x{right[1]}: must be the same")
        free = [eye for eye, camera in (("left", self.left), ("right", self.right)) if runs_freely(camera)]
        if free and not self.standing_parts:
            raise ValueError(
                f"{' and '.join(free)} run freely, so that the two pictures show different instants; set "
                "standing_parts: true where parts lie still while they are looked at, or trigger both cameras"
            )
        return self


class JawsConfig(Settings):
    """The two fingers, for clearance. Each is a box; the tool centre point lies between them, near the tips.

    ``opening_m`` between the open fingers, ``width_m`` along the part, ``thickness_m`` across it,
    ``depth_m`` from the tips up to the gripper's body.
    """

    opening_m: PositiveFloat
    width_m: PositiveFloat
    thickness_m: PositiveFloat
    depth_m: PositiveFloat
    min_clearance_m: NonNegativeFloat = Field(description="free space a finger needs around it")
    tip_beyond_tool_m: NonNegativeFloat = Field(
        description="how far the tips reach beyond the tool centre point"
    )
    below_axis_m: NonNegativeFloat = Field(
        description="the tool centre point goes this far below the part's axis"
    )


class WorkspaceConfig(Settings):
    """Where the arm may grasp, robot base frame."""

    box_min_m: Three
    box_max_m: Three
    floor_z_m: float = Field(description="height of the surface the parts lie on")
    floor_clearance_m: NonNegativeFloat = Field(description="the finger tips stay this far above it")
    approach_height_m: PositiveFloat = Field(description="height above the grasp where descent begins")
    travel_z_m: float = Field(description="the tool travels at or above this height")
    max_tilt_rad: PositiveFloat
    take_covered: bool = Field(
        default=True, description="where nothing free can be had, take a part that others lie over"
    )
    watch_q_rad: Six = Field(
        description="joints out of the cameras' view, or, of cameras on the arm, from where they see the "
        "parts; also home"
    )
    drop_q_rad: Six = Field(description="joints above the place where parts are released")

    @model_validator(mode="after")
    def _box(self) -> Self:
        for axis, low, high in zip("xyz", self.box_min_m, self.box_max_m, strict=True):
            if low >= high:
                raise ValueError(f"box is empty along {axis}: min {low} is not below max {high}")
        if self.travel_z_m < self.box_max_m[2]:
            raise ValueError(f"travel_z_m {self.travel_z_m} lies inside the box (top {self.box_max_m[2]})")
        return self


class LineConfig(Settings):
    """A straight motion of the tool."""

    speed_m_s: PositiveFloat
    accel_m_s2: PositiveFloat
    timeout_s: PositiveFloat


class JointConfig(Settings):
    """A motion through joint space."""

    speed_rad_s: PositiveFloat
    accel_rad_s2: PositiveFloat
    timeout_s: PositiveFloat


class MotionConfig(Settings):
    """Speeds: through joint space, along lines in free space, near parts."""

    joints: JointConfig
    travel: LineConfig
    approach: LineConfig


class TuningConfig(Settings):
    """Gates of the detector; every key may be left out. See `vision.types.Tuning`."""

    method: Literal["default", "published"] = "default"
    band: tuple[Grey, Grey] | None = None
    spur_px: PositiveFloat = 8.0
    depth_m: tuple[PositiveFloat, PositiveFloat] | None = None
    height_m: tuple[float, float] = (-0.005, 0.060)
    epipolar_px: PositiveFloat = 2.0
    angle_rad: PositiveFloat | None = None
    max_tilt_rad: PositiveFloat = 0.7
    min_score: Annotated[float, Field(ge=0, le=1)] = 0.3
    length_2d: bool = False

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for key in ("band", "depth_m", "height_m"):
            pair = getattr(self, key)
            if pair is not None and pair[0] >= pair[1]:
                raise ValueError(f"{key} is empty: min {pair[0]} is not below max {pair[1]}")
        return self

    def tuning(self, empty: EmptyTray | None = None) -> Tuning:
        """The gates as the detector takes them, with the reference of the empty tray where there is one."""
        return Tuning(**self.model_dump(), empty=empty)


class FilesConfig(Settings):
    """Files beside the configuration."""

    calibration: Path = Field(description="written by the calibration tools, never by hand")
    journal: Path = Field(description="SQLite; its folder must be writable and kept")
    overlays: Path | None = Field(default=None, description="folder for one overlay picture per look")
    empty_tray: Path | None = Field(
        default=None,
        description="folder with left.png and right.png of the empty tray (`mikado area empty --take`): what "
        "looks as there is no part and in nobody's way; fixed cameras only",
    )
    state: Path | None = Field(
        default=None, description="folder for state.json (figures, alarms); default: the journal's folder"
    )

    @property
    def state_folder(self) -> Path:
        """Where figures and alarms are kept."""
        return self.journal.parent if self.state is None else self.state


class CellConfig(Settings):
    """The whole cell."""

    version: Literal[1]
    name: str
    cameras: CamerasConfig
    robot: RobotSettings
    gripper: GripperSettings
    jaws: JawsConfig
    plc: PlcSettings
    workspace: WorkspaceConfig
    motion: MotionConfig
    parts: tuple[PartConfig, ...] = Field(min_length=1)
    heaps: tuple[tuple[Code, ...], ...] = Field(
        default=(),
        description="codes of parts that lie mixed in one heap: one look tells them apart; a part that is in "
        "none is looked for as if nothing else lay there",
    )
    tuning: TuningConfig = TuningConfig()
    operation: OperationConfig = OperationConfig()
    files: FilesConfig
    commissioning: CommissioningConfig = CommissioningConfig()
    allow_mixed: bool = Field(default=False, description="simulated and real devices in one cell")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        codes = [part.code for part in self.parts]
        for code in codes:
            if codes.count(code) > 1:
                raise ValueError(f"parts: code {code} is given twice")
        drivers = {
            "cameras.left": self.cameras.left.driver,
            "cameras.right": self.cameras.right.driver,
            "robot": self.robot.driver,
            "gripper": self.gripper.driver,
        }
        real = [name for name, driver in drivers.items() if driver != "sim"]
        if 0 < len(real) < len(drivers) and not self.allow_mixed:
            raise ValueError(
                f"{', '.join(real)} not simulated but the other devices are; "
                "set allow_mixed: true if that is meant"
            )
        if self.files.empty_tray is not None and self.cameras.mount != "fixed":
            raise ValueError(
                "files.empty_tray: cameras on the arm see the tray from elsewhere at each look; leave it out"
            )
        for part in self.parts:
            if part.colour is not None and self.tuning.method == "published":
                raise ValueError(
                    f"part {part.code} ({part.name}): the published method does not look at colour; "
                    "leave out tuning.method or the part's colour"
                )
            if self.workspace.floor_clearance_m >= part.diameter_m / 2:
                raise ValueError(
                    f"part {part.code} ({part.name}): workspace.floor_clearance_m "
                    f"{self.workspace.floor_clearance_m} keeps the fingers above the middle of a part on "
                    f"the floor (diameter_m {part.diameter_m})"
                )
            if part.diameter_m >= self.jaws.opening_m:
                raise ValueError(
                    f"part {part.code} ({part.name}): diameter_m {part.diameter_m} does not fit "
                    f"jaws.opening_m {self.jaws.opening_m}"
                )
        self._tell_heaps_apart()
        if isinstance(self.robot, UrRobotSettings):
            self._within_tool_box(self.robot)
        reach = 1.75  # no arm of this size class reaches further; catches millimetres
        for corner in (self.workspace.box_min_m, self.workspace.box_max_m):
            if max(abs(v) for v in corner) > reach:
                raise ValueError(f"workspace: corner {corner} is out of any arm's reach; metres are expected")
        return self

    def _tell_heaps_apart(self) -> None:
        """Raise `ValueError` for heaps that cannot be meant, or whose parts cannot be told apart."""
        everywhere = [code for heap in self.heaps for code in heap]
        for heap in self.heaps:
            if len(heap) < 2:
                raise ValueError(f"heaps: {list(heap)} is no heap of several parts; leave it out")
            for code in heap:
                if self.part(code) is None:
                    known = ", ".join(str(part.code) for part in self.parts)
                    raise ValueError(f"heaps: there is no part with code {code}; parts has {known}")
                if everywhere.count(code) > 1:
                    raise ValueError(f"heaps: code {code} is given twice; a part lies in one heap")
            if self.tuning.method == "published":
                raise ValueError(
                    f"heaps: {list(heap)} lie together, but the published method knows one product a look; "
                    "leave out tuning.method or heaps"
                )
            parts = [part for part in self.parts if part.code in heap]
            for one, other in combinations(parts, 2):
                if not one.apart_from(other):
                    raise ValueError(
                        f"heaps: parts {one.code} ({one.name}) and {other.code} ({other.name}) cannot be "
                        "told apart: their lengths differ by no more than both length_tolerance_m, neither "
                        f"is {TOLD_BY_WIDTH:g} times as thick, and their colours are not given or overlap"
                    )

    def _within_tool_box(self, robot: UrRobotSettings) -> None:
        """The arm would refuse every grasp beyond its tool box."""
        space = self.workspace
        for axis, low, high, least, most in zip(
            "xyz", space.box_min_m, space.box_max_m, robot.tool_box_min_m, robot.tool_box_max_m, strict=True
        ):
            top = max(high, space.travel_z_m) if axis == "z" else high
            if low < least or top > most:
                raise ValueError(
                    f"workspace: {low:g} to {top:g} m along {axis} (travel height included) goes beyond "
                    f"robot.tool_box_min_m and tool_box_max_m ({least:g} to {most:g} m)"
                )

    def part(self, code: int) -> PartConfig | None:
        """The product of a code, None when there is none."""
        return next((part for part in self.parts if part.code == code), None)

    def among(self, part: PartConfig) -> tuple[PartConfig, ...]:
        """The other products of a product's heap."""
        return heap_of(part, self.parts, self.heaps)


def heap_of(
    part: PartConfig, parts: tuple[PartConfig, ...], heaps: tuple[tuple[int, ...], ...]
) -> tuple[PartConfig, ...]:
    """The other products of a product's heap; none for one that lies alone."""
    codes = next((heap for heap in heaps if part.code in heap), ())
    return tuple(other for other in parts if other.code in codes and other.code != part.code)


def load(path: Path, home: Path | None = None) -> CellConfig:
    """Read and check a configuration; its relative paths come back absolute.

    ``home`` is what they are relative to, where that is not the file's own folder.

    Raises
    ------
    ConfigError
        With file, line and key.
    """
    config = yamlfile.load(path, CellConfig)
    home = home or path.resolve().parent
    files = config.files
    resolved = files.model_copy(
        update={
            "calibration": home / files.calibration,
            "journal": home / files.journal,
            "state": None if files.state is None else home / files.state,
            "overlays": None if files.overlays is None else home / files.overlays,
            "empty_tray": None if files.empty_tray is None else home / files.empty_tray,
        }
    )
    cameras = config.cameras.model_copy(
        update={
            eye: settings.model_copy(update={"folder": home / settings.folder})
            for eye, settings in (("left", config.cameras.left), ("right", config.cameras.right))
            if isinstance(settings, ReplayCameraSettings)
        }
    )
    kept, folder = config.commissioning, resolved.journal.parent
    commissioning = kept.model_copy(
        update={
            "touch_history": folder / kept.touch_history,
            "drift_file": folder / kept.drift_file,
        }
    )
    return config.model_copy(update={"files": resolved, "cameras": cameras, "commissioning": commissioning})


def load_part(path: Path) -> PartConfig:
    """Read a product file: the keys of one entry of ``parts``. Raises `ConfigError`."""
    return yamlfile.load(path, PartConfig)


__all__ = ["CellConfig", "ColourConfig", "ConfigError", "PartConfig", "load", "load_part"]
