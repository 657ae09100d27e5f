"""Aravis through PyGObject: loaded when the first camera is opened, typed as far as we use it.

The library comes from the distribution (Debian: gir1.2-aravis-0.8), its Python side from the extra ``gige``.
"""

from __future__ import annotations

import ctypes
import importlib
import threading
from dataclasses import dataclass
from functools import cache
from typing import Any, Final, Literal, Protocol, cast

from drivers.errors import DeviceUnavailable

INSTALL: Final = (
    "sudo apt-get install gir1.2-aravis-0.8 libgirepository1.0-dev libcairo2-dev pkg-config gcc, then "
    "pip install 'mikado-cell[gige]' into the environment of mikado"
)


class AravisBuffer(Protocol):
    """One frame as it was received."""

    def get_frame_id(self) -> int: ...
    def get_timestamp(self) -> int: ...
    def get_system_timestamp(self) -> int: ...
    def get_image_data(self) -> bytes: ...


class AravisStream(Protocol):
    """What receives frames."""

    def push_buffer(self, buffer: AravisBuffer) -> None: ...
    def timeout_pop_buffer(self, timeout_us: int) -> AravisBuffer | None: ...
    def set_property(self, name: str, value: object) -> None: ...


class AravisDevice(Protocol):
    """The registers behind a camera."""

    def get_string_feature_value(self, feature: str) -> str: ...


class AravisCamera(Protocol):
    """A camera under our control. Every call raises `Aravis.Error`."""

    def get_device(self) -> AravisDevice: ...
    def is_gv_device(self) -> bool: ...
    def get_model_name(self) -> str: ...
    def clear_triggers(self) -> None: ...
    def set_trigger(self, source: str) -> None: ...
    def get_trigger_source(self) -> str: ...
    def software_trigger(self) -> None: ...
    def set_pixel_format_from_string(self, name: str) -> None: ...
    def get_pixel_format_as_string(self) -> str: ...
    def set_region(self, x: int, y: int, width: int, height: int) -> None: ...
    def get_region(self) -> tuple[int, int, int, int]: ...
    def set_exposure_time(self, exposure_us: float) -> None: ...
    def get_exposure_time(self) -> float: ...
    def get_exposure_time_bounds(self) -> tuple[float, float]: ...
    def set_gain(self, gain: float) -> None: ...
    def get_gain(self) -> float: ...
    def get_gain_bounds(self) -> tuple[float, float]: ...
    def set_frame_rate(self, rate_hz: float) -> None: ...
    def get_frame_rate(self) -> float: ...
    def get_frame_rate_bounds(self) -> tuple[float, float]: ...
    def gv_auto_packet_size(self) -> int: ...
    def gv_set_packet_size(self, size: int) -> None: ...
    def gv_get_packet_size(self) -> int: ...
    def get_payload(self) -> int: ...
    def start_acquisition(self) -> None: ...
    def stop_acquisition(self) -> None: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Answering:
    """A camera that answered. ``device`` is the library's name of it; empty what it does not tell."""

    device: str
    serial: str
    address: str
    vendor: str
    model: str


class Aravis:
    """The few calls of the library that are not a camera's or a stream's own."""

    def __init__(self, namespace: Any, error: type[Exception]) -> None:
        self._namespace = namespace
        # one list of what was found for the whole process: two owners must not read each other's
        self._discovering = threading.Lock()
        self.Error = error

    def camera(self, device: str) -> AravisCamera:
        """Open by id or address and take control."""
        return cast(AravisCamera, self._namespace.Camera.new(device))

    def discover(self) -> list[Answering]:
        """Every GigE Vision camera that answers on any network; takes a second."""
        space = self._namespace
        with self._discovering:
            for number in range(space.get_n_interfaces()):
                name = space.get_interface_id(number)
                if name != "GigEVision":
                    space.disable_interface(name)
            space.update_device_list()
            return [
                Answering(
                    device=space.get_device_id(i),
                    serial=space.get_device_serial_nbr(i) or "",
                    address=space.get_device_address(i) or "",
                    vendor=space.get_device_vendor(i) or "",
                    model=space.get_device_model(i) or "",
                )
                for i in range(space.get_n_devices())
            ]

    def is_controller(self, camera: AravisCamera) -> bool:
        """Whether it is under our control: nobody else holds it, and its heartbeat was answered.

        Asked instead of the signal ``control-lost``: a handler in Python runs in the library's heartbeat
        thread, may drop the last reference there, and the library aborts the process, waiting for itself.
        """
        device: Any = camera.get_device()
        return bool(device.is_controller())

    def leave(self, camera: AravisCamera) -> None:
        """Give control up."""
        device: Any = camera.get_device()
        if device.is_controller():
            device.leave_control()

    def check_ranges(self, camera: AravisCamera) -> None:
        """Without this, what a camera cannot do is written to it in silence."""
        checked: Any = camera
        checked.set_range_check_policy(self._namespace.RangeCheckPolicy.ENABLE)

    def settle(self, camera: AravisCamera) -> None:
        """Stop what an earlier owner, who died, left running: a streaming camera refuses most settings."""
        camera.stop_acquisition()
        free: Any = camera
        free.set_acquisition_mode(self._namespace.AcquisitionMode.CONTINUOUS)

    def manual(self, camera: AravisCamera) -> None:
        """Automatic exposure and gain off, where there are such."""
        able: Any = camera
        if able.is_exposure_auto_available():
            able.set_exposure_time_auto(self._namespace.Auto.OFF)
        if able.is_gain_auto_available():
            able.set_gain_auto(self._namespace.Auto.OFF)

    def stream(self, camera: AravisCamera) -> AravisStream:
        """Open the stream channel."""
        made: Any = camera
        return cast(AravisStream, made.create_stream(None, None))

    def size_socket(self, stream: AravisStream, size: int) -> None:
        """Ask the kernel for this much room for packets; it gives no more than net.core.rmem_max."""
        stream.set_property("socket-buffer", self._namespace.GvStreamSocketBuffer.FIXED)
        stream.set_property("socket-buffer-size", size)

    def resend(self, *, always: bool) -> object:
        """The stream's property for asking for lost packets again."""
        kinds = self._namespace.GvStreamPacketResend
        return kinds.ALWAYS if always else kinds.NEVER

    def buffer(self, size: int) -> AravisBuffer:
        """Memory for one frame."""
        return cast(AravisBuffer, self._namespace.Buffer.new_allocate(size))


def complete(buffer: AravisBuffer) -> bool:
    """Whether every packet of it came, and it is a picture."""
    told: Any = buffer
    return told.get_status().value_nick == "success" and told.get_payload_type().value_nick in (
        "image",
        "extended-chunk-data",
    )


def resent(stream: AravisStream | None) -> int:
    """Packets that came after they were asked for again, since the stream was made."""
    counting: Any = stream
    return int(counting.get_info_uint64_by_name("n_resent_packets"))


@cache
def _loaded() -> Aravis:
    gi: Any = importlib.import_module("gi")
    gi.require_version("Aravis", "0.8")
    namespace: Any = importlib.import_module("gi.repository.Aravis")
    error: type[Exception] = importlib.import_module("gi.repository.GLib").Error
    return Aravis(namespace, error)


def load(device: str) -> Aravis:
    """The library; `DeviceUnavailable` that says what to install where it is not there."""
    try:
        return _loaded()
    except (ImportError, ValueError, OSError) as error:
        raise DeviceUnavailable(device, f"GigE Vision needs Aravis ({error}): {INSTALL}") from error


def version(device: str) -> str:
    """Of the library itself."""
    load(device)
    library = ctypes.CDLL("libaravis-0.8.so.0")
    return ".".join(
        str(getattr(library, f"arv_get_{part}_version")()) for part in ("major", "minor", "micro")
    )


def text_of(error: Exception) -> str:
    """What a `GLib.Error` says, without its numbers."""
    told: Any = error
    return str(getattr(told, "message", error))


_DEVICE_ERRORS: Final[dict[int, Literal["absent", "timeout"]]] = {
    2: "absent",  # not connected
    4: "absent",  # transfer error
    5: "timeout",
    6: "absent",  # not found
    10: "absent",  # not controller
}
"""ArvDeviceError; the others mean that the camera was reached and said no."""


def kind_of(error: Exception) -> Literal["absent", "timeout", "refused"]:
    """What a `GLib.Error` of Aravis means for its user."""
    told: Any = error
    if str(getattr(told, "domain", "")) != "arv-device-error-quark":
        return "refused"
    return _DEVICE_ERRORS.get(int(told.code), "refused")
