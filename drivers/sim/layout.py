"""The world file of the simulated cell as a checked record: what stands where, and how big it is.

Metres, radians, seconds; everything in the robot's base frame unless a field says otherwise. Reading the file
itself is `drivers.sim.cell`'s business.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt

from drivers.settings import Settings, Six

Two = tuple[float, float]
Three = tuple[float, float, float]
Share = Annotated[float, Field(ge=0.0, le=1.0)]


class TrayLayout(Settings):
    """A flat tray with upright walls; its sides lie along the base's x and y."""

    centre_m: Three = Field(description="middle of the floor's upper face")
    inner_m: Two = Field(description="clear size in x and y")
    wall_height_m: PositiveFloat
    wall_thickness_m: PositiveFloat


class SticksLayout(Settings):
    """What lies in the tray at the start."""

    count: NonNegativeInt
    length_m: PositiveFloat
    diameter_m: PositiveFloat
    shade: PositiveFloat = Field(default=1.0, description="brightness of the wood, 1 = pale beech")
    spread: Share = Field(description="1: anywhere in the tray; 0: all thrown on one heap in the middle")
    wall_margin_m: NonNegativeFloat = Field(description="no end comes nearer to a wall than this")


class DropBoxLayout(Settings):
    """Where parts are delivered; open at the top, sides along the base's x and y."""

    centre_m: Three
    size_m: Two


class ArmLayout(Settings):
    """The arm stands in the base frame's origin."""

    start_q_rad: Six
    tcp_m_rad: Six = Field(description="flange to tool: metres, rotation vector")
    turn_speed_rad_s: PositiveFloat = Field(default=2.0, description="limit of rotation along a line")
    stop_decel_s: PositiveFloat = Field(default=0.15, description="time from full speed to rest on a halt")


class GripperLayout(Settings):
    """Two jaws. Tool frame: z out of the hand, x the direction they close in, y along the part."""

    opening_m: PositiveFloat
    jaw_width_m: PositiveFloat = Field(description="along y")
    jaw_thickness_m: PositiveFloat = Field(description="along x")
    jaw_length_m: PositiveFloat = Field(description="along z, from the tip up to the hand")
    jaw_depth_m: PositiveFloat = Field(description="how high above the tool point a part may sit")
    tip_beyond_tool_m: NonNegativeFloat = Field(description="how far the tips reach beyond the tool point")
    spring_m: NonNegativeFloat = Field(description="how far the sprung tips may be pressed onto the floor")
    max_angle_rad: PositiveFloat = Field(description="largest angle in plan of a part to the y axis")
    touch_m: NonNegativeFloat = Field(description="a part brushed by no more than this is pushed aside")
    release_s: PositiveFloat
    grasp_s: PositiveFloat
    drop_probability: Share = 0.0


class CameraLayout(Settings):
    """One eye: pinhole with OpenCV's distortion (k1, k2, p1, p2, k3). Its place is in the frame of what
    carries it."""

    position_m: Three
    look_at_m: Three
    roll_rad: float
    focal_px: Two
    centre_px: Two
    distortion: tuple[float, float, float, float, float]


class CamerasLayout(Settings):
    """Both eyes and what they share."""

    mount: Literal["fixed", "tool"] = Field(
        default="fixed",
        description="fixed: beside the arm, in the base frame; tool: on the arm, in the flange's frame",
    )
    width_px: PositiveInt
    height_px: PositiveInt
    blur_px: NonNegativeFloat
    noise: NonNegativeFloat = Field(description="standard deviation in grey levels")
    left: CameraLayout
    right: CameraLayout


class LightLayout(Settings):
    """A round lamp and the light of the room."""

    position_m: Three
    radius_m: PositiveFloat
    strength: PositiveFloat
    ambient: NonNegativeFloat


class BoardLayout(Settings):
    """A ChArUco board for the calibration, where one is shown. Frame: the outer top-left corner of the
    printed squares, x along the columns, y down the rows, z into the board."""

    squares: tuple[PositiveInt, PositiveInt] = (9, 7)
    square_m: PositiveFloat = 0.020
    marker_m: PositiveFloat = 0.015
    dictionary: str = "DICT_4X4_50"
    margin_m: NonNegativeFloat = 0.008
    in_hand_m_rad: Six = Field(
        default=(-0.09, 0.045, 0.0, 0.0, 0.0, 0.0), description="tool_from_board: metres, rotation vector"
    )
    in_tray_m_rad: Six = Field(
        default=(-0.088, 0.068, 0.002, 3.14159265, 0.0, 0.0),
        description="from the middle of the tray's floor: metres, rotation vector",
    )


class WorldLayout(Settings):
    """The whole world file."""

    version: Literal[1]
    seed: NonNegativeInt
    tray: TrayLayout
    sticks: SticksLayout
    drop_box: DropBoxLayout
    arm: ArmLayout
    gripper: GripperLayout
    cameras: CamerasLayout
    light: LightLayout
    board: BoardLayout = BoardLayout()
