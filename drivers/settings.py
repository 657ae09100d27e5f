"""Settings of arms, grippers and PLCs, one tagged union per family; of cameras, in `camera_settings`.
Imports no vendor library, so that a configuration can be checked on any computer."""

from __future__ import annotations

import ipaddress
import math
from typing import Annotated, Final, Literal, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    field_validator,
    model_validator,
)

Port = Annotated[int, Field(ge=1, le=65535)]
IPv4 = Annotated[str, Field(pattern=r"^(\d{1,3}\.){3}\d{1,3}$")]
Three = tuple[float, float, float]
Six = tuple[float, float, float, float, float, float]


class Settings(BaseModel):
    """Base of all settings: unknown keys are errors, values cannot be changed, numbers are finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class SimRobotSettings(Settings):
    """The arm of the simulated cell."""

    driver: Literal["sim"]
    host: str = "127.0.0.1"
    port: Port


_UR_PAYLOAD_KG: Final = {"UR3e": 3.0, "UR5e": 5.0, "UR10e": 12.5}
_UR_REACH_M: Final = {"UR3e": 0.5, "UR5e": 0.85, "UR10e": 1.3}
"""Base to wrist, as the maker states it."""


class UrReachSettings(Settings):
    """How far from its limits an arm stays where places are judged before it is asked."""

    joint_limits_rad: Six | None = Field(
        default=None,
        description="largest angle of each joint, either way, where the safety configuration is narrower "
        "than the maker's (one turn, the elbow half)",
    )
    joint_margin_rad: NonNegativeFloat = Field(default=0.05, description="from a joint's limit")
    wrist_margin_rad: NonNegativeFloat = Field(
        default=0.1, le=1.5, description="from a straight wrist (joint 5)"
    )
    elbow_margin_rad: NonNegativeFloat = Field(
        default=0.1, le=1.5, description="from a straight elbow (joint 3)"
    )
    shoulder_margin_m: NonNegativeFloat = Field(
        default=0.03, le=0.5, description="of the hand's joints from the plane over the base's axis"
    )
    calibration_m: NonNegativeFloat = Field(
        default=0.003,
        le=0.05,
        description="how far the real arm may stand beside the nominal one: the reach counts as this much "
        "shorter",
    )


class UrRobotSettings(Settings):
    """A UR e-Series arm over RTDE. Everything is checked against the controller before the arm may move."""

    driver: Literal["ur"]
    host: str = Field(min_length=1, description="the controller's address; its ports are fixed")
    model: Literal["UR3e", "UR5e", "UR10e"]
    tcp_m_rad: Six = Field(description="tool centre point on the flange: metres, rotation vector in radians")
    payload_kg: Annotated[float, Field(ge=0)] = Field(description="gripper and what it is fixed with")
    payload_cog_m: Three = Field(description="centre of gravity of the payload, from the flange")
    tool_from: Literal["installation", "configuration"] = Field(
        default="installation",
        description="installation: tool and payload set on the pendant must be the ones given here; "
        "configuration: the driver sets them each time it connects",
    )
    tool_box_min_m: Three = Field(description="the tool is sent nowhere outside this box, base frame")
    tool_box_max_m: Three
    registers: Literal["lower", "upper"] = Field(
        default="lower",
        description="RTDE registers 0-23 or 24-47; upper where a fieldbus holds the lower ones "
        "(PolyScope below 5.23)",
    )
    stop_line_m_s2: Annotated[float, Field(gt=0, le=20)] = Field(
        default=4.0, description="deceleration with which a line is broken off"
    )
    stop_joint_rad_s2: Annotated[float, Field(gt=0, le=20)] = Field(
        default=8.0, description="deceleration with which a motion through joint space is broken off"
    )
    first_speed_fraction: Annotated[float, Field(gt=0, le=1)] = Field(
        default=0.25, description="speed of the first motion after a protective or emergency stop"
    )
    reach: UrReachSettings = UrReachSettings()

    @model_validator(mode="after")
    def _plausible(self) -> Self:
        if max(abs(v) for v in self.tcp_m_rad[:3]) > 1.0:
            raise ValueError(f"tcp_m_rad {list(self.tcp_m_rad)}: over 1 m from the flange; give metres")
        if max(abs(v) for v in self.tcp_m_rad[3:]) > 6.2832:
            raise ValueError(f"tcp_m_rad {list(self.tcp_m_rad)}: rotation over 2 pi; give radians")
        if self.payload_kg > _UR_PAYLOAD_KG[self.model]:
            raise ValueError(
                f"payload_kg {self.payload_kg:g}: a {self.model} carries {_UR_PAYLOAD_KG[self.model]:g} kg"
            )
        if max(abs(v) for v in self.payload_cog_m) > 1.0:
            raise ValueError(f"payload_cog_m {list(self.payload_cog_m)}: over 1 m; give metres")
        tool_m = math.dist((0.0, 0.0, 0.0), self.tcp_m_rad[:3])
        reach_m = _UR_REACH_M[self.model] + tool_m + 0.3  # flange and wrist
        for axis, low, high in zip("xyz", self.tool_box_min_m, self.tool_box_max_m, strict=True):
            if low >= high:
                raise ValueError(f"tool box is empty along {axis}: min {low:g} is not below max {high:g}")
            if max(abs(low), abs(high)) > reach_m:
                raise ValueError(
                    f"tool box along {axis}: {low:g} to {high:g} m is beyond what a {self.model} with this "
                    f"tool can reach ({reach_m:.2f} m); metres are expected"
                )
        return self


RobotSettings = Annotated[SimRobotSettings | UrRobotSettings, Field(discriminator="driver")]


class SimGripperSettings(Settings):
    """The gripper of the simulated cell."""

    driver: Literal["sim"]
    host: str = "127.0.0.1"
    port: Port


Pin = Annotated[int, Field(ge=0, le=17)]
Byte = Annotated[int, Field(ge=0, le=255)]


class RobotIoGripperSettings(Settings):
    """A gripper that is wired to the arm: outputs move the jaws, an input says that a part is held.

    Pins are numbered as in the controller's own words of bits: 0-7 standard, 8-15 configurable, 16-17 tool.
    """

    driver: Literal["robot_io"]
    close_output: Pin = Field(description="on: the jaws close; off: they open, by spring or by open_output")
    open_output: Pin | None = Field(
        default=None, description="second coil of a double-acting valve: on opens the jaws"
    )
    holding_input: Pin = Field(description="says that a part is between the closed jaws")
    holding_level: bool = Field(default=True, description="level of holding_input that means held")
    open_input: Pin | None = Field(
        default=None, description="says that the jaws are open, where there is one"
    )
    closing_s: PositiveFloat = Field(
        description="the jaws are closed this long after the order; nothing held by then is an empty grip"
    )
    opening_s: PositiveFloat = Field(description="the jaws are open this long after the order")
    settle_s: PositiveFloat = Field(
        default=0.05, description="holding_input counts once it has been on for this long at a stretch"
    )

    @model_validator(mode="after")
    def _pins_apart(self) -> Self:
        if self.open_output == self.close_output:
            raise ValueError(f"open_output and close_output are both {self.close_output}")
        if self.open_input == self.holding_input:
            raise ValueError(f"open_input and holding_input are both {self.holding_input}")
        if self.settle_s >= self.closing_s:
            raise ValueError(f"settle_s {self.settle_s} is not below closing_s {self.closing_s}")
        return self


class RobotiqGripperSettings(Settings):
    """A Robotiq 2F gripper over the socket its URCap opens on the UR controller.

    Positions, speed and force are the gripper's own counts, 0..255; position 0 is fully open. Whether a
    part is held is decided by where the fingers stand: the gripper's own detection may overlook thin
    parts (its manual says so).
    """

    driver: Literal["robotiq"]
    host: str = Field(description="the UR controller the gripper is connected to")
    port: Port = 63352
    open_position: Byte = Field(description="where the fingers wait for a part")
    close_position: Byte = Field(default=255, description="where they are sent to grip")
    empty_from: Byte = Field(
        description="closed this far or further they have nothing between them: close on nothing, read POS, "
        "take 3 off"
    )
    speed: Byte = 255
    force: Byte = Field(description="0 is the gentlest")
    activate: bool = Field(
        default=False,
        description="may activate a gripper that is not: the fingers then close and open once, all the way",
    )
    timeout_s: PositiveFloat = Field(default=0.5, description="for each answer")
    jaws_timeout_s: PositiveFloat = Field(default=5.0, description="for one closing or opening")

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if not self.open_position + 4 < self.empty_from <= self.close_position:
            raise ValueError(
                "positions must rise from open_position by more than 4 counts to empty_from, and "
                f"close_position must not stop short of it: {self.open_position}, {self.empty_from}, "
                f"{self.close_position}"
            )
        return self


GripperSettings = Annotated[
    SimGripperSettings | RobotIoGripperSettings | RobotiqGripperSettings, Field(discriminator="driver")
]


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
    test_base: NonNegativeInt | None = Field(
        default=None,
        le=65536 - 8,
        description="holding register where the cell writes the test registers (8 words) each time it "
        "connects; left out: it does not",
    )
    timeout_s: PositiveFloat = 0.3

    @model_validator(mode="after")
    def _blocks_are_apart(self) -> Self:
        # overlapping, the cell would write its status into its own orders
        if self.read_base - 40 < self.write_base < self.read_base + 24:
            raise ValueError(
                f"write_base {self.write_base} (40 words) overlaps read_base {self.read_base} (24 words)"
            )
        if self.test_base is not None:
            for name, base, words in (("read", self.read_base, 24), ("write", self.write_base, 40)):
                if base - 8 < self.test_base < base + words:
                    raise ValueError(
                        f"test_base {self.test_base} (8 words) overlaps {name}_base {base} ({words} words)"
                    )
        return self


class ModbusServerPlcSettings(Settings):
    """The cell is the Modbus TCP server; a PLC polls it (map v1, role A)."""

    driver: Literal["modbus_server"]
    bind: str = Field(
        description="address of this computer on which to listen, as numbers; 0.0.0.0 is every one of them"
    )
    port: Port = Field(
        default=502, description="below 1024 only with a capability, which the service unit has"
    )
    peers: tuple[str, ...] = Field(
        min_length=1,
        description="who may connect: addresses or networks as numbers, e.g. [192.0.2.20, 192.0.2.64/28]",
    )
    max_connections: Annotated[int, Field(ge=1, le=64)] = Field(
        default=4, description="at a time; when all are taken, one that has been silent for 2 s gives way"
    )
    word_order: Literal["big", "little"] = Field(
        default="big", description="big: high word first (ABCD); little: low word first (CDAB)"
    )
    timeout_s: PositiveFloat = Field(
        default=0.3, description="the PLC reads the status word at least this often while all is well"
    )

    @field_validator("bind")
    @classmethod
    def _address(cls, bind: str) -> str:
        try:
            ipaddress.ip_address(bind)
        except ValueError as error:
            raise ValueError(f"{bind!r} is not an address in numbers, such as 192.0.2.5") from error
        return bind

    @field_validator("peers")
    @classmethod
    def _networks(cls, peers: tuple[str, ...]) -> tuple[str, ...]:
        for peer in peers:
            try:
                ipaddress.ip_network(peer, strict=False)
            except ValueError as error:
                raise ValueError(
                    f"{peer!r} is neither an address nor a network in numbers, such as 192.0.2.20 or "
                    "192.0.2.64/28"
                ) from error
        return peers


PlcSettings = Annotated[ModbusPlcSettings | ModbusServerPlcSettings, Field(discriminator="driver")]

__all__ = [
    "GripperSettings",
    "ModbusPlcSettings",
    "ModbusServerPlcSettings",
    "PlcSettings",
    "Port",
    "RobotIoGripperSettings",
    "RobotSettings",
    "RobotiqGripperSettings",
    "Settings",
    "SimGripperSettings",
    "SimRobotSettings",
    "Six",
    "Three",
    "UrReachSettings",
    "UrRobotSettings",
]
