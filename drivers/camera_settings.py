"""Settings of every camera driver, as one tagged union. Imports no vendor library."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self, assert_never

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt, model_validator

from drivers.settings import IPv4, Port, Settings


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


class V4l2CameraSettings(Settings):
    """A webcam (V4L2). Everything that is set is read back; a camera that has it otherwise is refused."""

    driver: Literal["v4l2"]
    device: Path = Field(
        description="a name that stays: /dev/v4l/by-path/...-video-index0 (the socket it is plugged into) or "
        "/dev/v4l/by-id/... (its serial number)"
    )
    capture: Literal["ioctl", "opencv"] = Field(
        default="ioctl",
        description="opencv: through OpenCV's VideoCapture, where a camera does not get on with our own; "
        "without numbers and error flags of pictures, and power_line_hz cannot be verified",
    )
    width_px: PositiveInt
    height_px: PositiveInt
    format: Literal["MJPG", "YUYV", "GREY"] = Field(
        default="MJPG", description="YUYV has no compression and takes many times the USB bandwidth"
    )
    rate_hz: Annotated[float, Field(gt=0, le=1000)] = 30.0
    exposure_us: PositiveInt = Field(description="exposure time, by hand; in steps of 100")
    gain: int | None = Field(default=None, description="in the camera's own counts; none: as it is")
    white_balance_k: PositiveInt | None = Field(default=None, description="kelvin; none: as it is")
    focus: NonNegativeInt | None = Field(
        default=None, description="in the camera's own counts; none: as it is"
    )
    power_line_hz: Literal[0, 50, 60] | None = Field(
        default=None, description="against flicker of lamps; 0 switches it off, none: as it is"
    )
    buffers: Annotated[int, Field(ge=2, le=32)] = 4
    lost_s: Annotated[float, Field(ge=0.1, le=30)] = Field(
        default=1.0, description="silent for this long it counts as lost and is opened anew"
    )
    delay_s: NonNegativeFloat | None = Field(
        default=None,
        le=2,
        description="longest time from the end of an exposure to its first bytes on the bus; none: the time "
        "between two pictures",
    )

    @property
    def worst_delay_s(self) -> float:
        """How long before its first bytes a picture's exposure may have begun."""
        delay_s = 1.0 / self.rate_hz if self.delay_s is None else self.delay_s
        return self.exposure_us * 1e-6 + delay_s

    @model_validator(mode="after")
    def _plausible(self) -> Self:
        if not self.device.is_absolute():
            raise ValueError(f"device {self.device}: give the whole path, /dev/v4l/by-path/...")
        if self.device.parent == Path("/dev") and self.device.name.startswith("video"):
            raise ValueError(
                f"device {self.device}: this number changes when cameras are plugged in; take the camera's "
                "name under /dev/v4l/by-path or /dev/v4l/by-id (`mikado camera list` shows them)"
            )
        if self.exposure_us % 100:
            raise ValueError(f"exposure_us {self.exposure_us}: webcams count in steps of 100 us")
        if self.exposure_us * 1e-6 > 1.0 / self.rate_hz:
            raise ValueError(
                f"exposure_us {self.exposure_us}: longer than the {1e6 / self.rate_hz:.0f} us between "
                f"pictures at {self.rate_hz:g} Hz"
            )
        return self


class GigeCameraSettings(Settings):
    """A GigE Vision camera, through Aravis (extra ``gige`` and Debian packages: docs/recipes/gige.md)."""

    driver: Literal["gige"]
    serial: str | None = Field(
        default=None,
        min_length=1,
        description="as printed on it; found by asking all networks, which takes 1 s",
    )
    address: IPv4 | None = Field(
        default=None, description="instead of serial: its fixed address, without asking"
    )
    width_px: PositiveInt
    height_px: PositiveInt
    offset_x_px: NonNegativeInt = Field(
        default=0, description="left edge of the part of the sensor that is read"
    )
    offset_y_px: NonNegativeInt = 0
    pixel_format: Literal[
        "Mono8", "Mono10", "Mono12", "Mono16", "BayerRG8", "BayerBG8", "BayerGR8", "BayerGB8", "RGB8"
    ] = Field(default="Mono8", description="GenICam's name; of deeper formats the upper 8 bits are used")
    exposure_us: PositiveFloat
    gain: NonNegativeFloat = Field(default=0.0, description="in the camera's own unit, mostly dB")
    trigger: str = Field(
        pattern=r"^(free|software|Line\d+)$",
        description="free: at rate_hz by itself; software: both cameras on the cell's word; "
        "Line0, Line1, ...: on an electric signal, which must come at least every lost_s",
    )
    rate_hz: PositiveFloat = Field(
        default=20.0, description="of trigger free; with the others the most that is expected"
    )
    packet_size: Literal["auto"] | Annotated[int, Field(ge=576, le=9000)] = Field(
        default="auto",
        description="bytes; auto is negotiated. Large ones need an MTU of 9000 on the way, lose fewer frames",
    )
    socket_buffer_bytes: Annotated[int, Field(ge=65536)] = Field(
        default=4 * 1024 * 1024,
        description="room for packets not read yet; at most net.core.rmem_max is given",
    )
    resend: bool = Field(default=True, description="ask for lost packets again")
    lag_s: NonNegativeFloat = Field(
        default=0.010,
        description="longest time from the end of an exposure to its first packet; taken off its time",
    )
    lost_s: Annotated[float, Field(ge=0.2)] = Field(
        default=1.0, description="without a frame for this long, the camera counts as lost"
    )

    @model_validator(mode="after")
    def _one_name(self) -> Self:
        if (self.serial is None) == (self.address is None):
            raise ValueError("one of serial and address is needed, and only one")
        if self.exposure_us * 1e-6 >= self.lost_s:
            raise ValueError(
                f"exposure_us {self.exposure_us:g} is as long as lost_s {self.lost_s:g} or longer"
            )
        if self.trigger == "free" and self.exposure_us * 1e-6 > 1.0 / self.rate_hz:
            raise ValueError(
                f"exposure_us {self.exposure_us:g} does not fit into a frame at rate_hz {self.rate_hz:g}"
            )
        return self

    @property
    def colours(self) -> bool:
        """Whether its pictures have colours."""
        return not self.pixel_format.startswith("Mono")


CameraSettings = Annotated[
    SimCameraSettings | ReplayCameraSettings | V4l2CameraSettings | GigeCameraSettings,
    Field(discriminator="driver"),
]


def runs_freely(camera: CameraSettings) -> bool:
    """Whether it exposes when it likes, so that two of them are never in step."""
    match camera:
        case V4l2CameraSettings():
            return True
        case GigeCameraSettings():
            return camera.trigger == "free"
        case SimCameraSettings() | ReplayCameraSettings():
            return False
        case _:
            assert_never(camera)
