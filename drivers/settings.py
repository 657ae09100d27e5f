"""Settings of every driver, one tagged union per family. Imports no vendor library, so that a
configuration can be checked on any computer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, NonNegativeInt, PositiveFloat, PositiveInt, model_validator

Port = Annotated[int, Field(ge=1, le=65535)]
Six = tuple[float, float, float, float, float, float]


class Settings(BaseModel):
    """Base of all settings: unknown keys are errors, values cannot be changed, numbers are finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class SimCameraSettings(Settings):
    """One eye of the simulated cell (`drivers/sim`), a process of its own at ``host:port``."""

    driver: Literal["sim"]
    host: str = "127.0.0.1"
    port: Port
    eye: Literal["left", "right"]
    width_px: PositiveInt
    height_px: PositiveInt


class ReplayCameraSettings(Settings):
    """A folder of recorded pictures as a camera, in the order of their names."""

    driver: Literal["replay"]
    folder: Path
    pattern: str = Field(description='glob of this eye\'s pictures, e.g. "left*.png"')
    width_px: PositiveInt
    height_px: PositiveInt
    repeat: bool = Field(default=False, description="start again after the last picture")


CameraSettings = Annotated[SimCameraSettings | ReplayCameraSettings, Field(discriminator="driver")]


class SimRobotSettings(Settings):
    """The arm of the simulated cell."""

    driver: Literal["sim"]
    host: str = "127.0.0.1"
    port: Port


RobotSettings = SimRobotSettings


class SimGripperSettings(Settings):
    """The gripper of the simulated cell."""

    driver: Literal["sim"]
    host: str = "127.0.0.1"
    port: Port


GripperSettings = SimGripperSettings


class ModbusPlcSettings(Settings):
    """A PLC that is a Modbus TCP server; the cell polls it (map v1, role B)."""

    driver: Literal["modbus"]
    host: str
    port: Port = 502
    unit: Annotated[int, Field(ge=0, le=255)] = 1
    read_base: NonNegativeInt = Field(
        default=0, le=65536 - 24, description="holding register of the command block (24 words), 0-based"
    )
    write_base: NonNegativeInt = Field(
        default=100, le=65536 - 40, description="holding register of the status block (40 words), 0-based"
    )
    word_order: Literal["big", "little"] = Field(
        default="big", description="big: high word first (ABCD); little: low word first (CDAB)"
    )
    timeout_s: PositiveFloat = 0.3

    @model_validator(mode="after")
    def _blocks_are_apart(self) -> Self:
        # overlapping, the cell would write its status into its own orders
        if self.read_base - 40 < self.write_base < self.read_base + 24:
            raise ValueError(
                f"write_base {self.write_base} (40 words) overlaps read_base {self.read_base} (24 words)"
            )
        return self


PlcSettings = ModbusPlcSettings

__all__ = [
    "CameraSettings",
    "GripperSettings",
    "ModbusPlcSettings",
    "PlcSettings",
    "Port",
    "ReplayCameraSettings",
    "RobotSettings",
    "Settings",
    "SimCameraSettings",
    "SimGripperSettings",
    "SimRobotSettings",
    "Six",
]
