"""GigE Vision cameras through Aravis: one `Source` per camera, used by the one thread that owns it.

Aravis has a receive thread of its own in C; frames that miss packets are asked for again and, where that does
not help, thrown away here. A camera that was lost is never used again through the same handle: it would
answer and not stream.
"""

from __future__ import annotations

import time
from collections import deque
from contextlib import ExitStack
from typing import Final

import structlog

from drivers.camera import aravis
from drivers.camera.aravis import Aravis, AravisBuffer, AravisCamera, AravisStream
from drivers.camera.device_clock import DeviceClock, missed
from drivers.camera.gige_pixels import decode
from drivers.camera.source import Counters
from drivers.camera_settings import GigeCameraSettings
from drivers.errors import CommandRejected, DeviceTimeout, DeviceUnavailable, DriverError
from drivers.timing import Clock
from drivers.types import Frame

log = structlog.get_logger()

BUFFERS: Final = 8
_MOST_ASKED: Final = 32
"""Words not answered yet; a camera that takes none is lost long before."""
_NEAR: Final = 0.02
"""A camera may round exposure, gain and rate by this share: it has steps."""


class GigeSource:
    """One GigE Vision camera."""

    def __init__(self, name: str, settings: GigeCameraSettings, clock: Clock) -> None:
        self._name = name
        self._settings = settings
        self._clock = clock
        self._camera: AravisCamera | None = None
        self._stream: AravisStream | None = None
        self._payload = 0
        self._dead: tuple[AravisCamera, AravisStream | None] | None = None
        self._device_clock = DeviceClock()
        self._answer_clock = DeviceClock()  # the other way round: the device's clock from our words
        self._frame_id: int | None = None
        self._asked_at: deque[float] = deque(maxlen=_MOST_ASKED)
        self._sequence = 0
        self._counters = Counters()
        self._resent_before = 0

    @property
    def name(self) -> str:
        """How logs and faults call it."""
        return self._name

    def counters(self) -> Counters:
        """What became of the frames so far."""
        return self._counters

    # ------------------------------------------------------------------ start

    def start(self) -> None:
        """Find, take control, configure, read back, stream; all or nothing."""
        self.stop()
        self._dead = None
        library = aravis.load(self._name)
        with ExitStack() as undo:
            undo.callback(self.stop)
            try:
                self._start(library)
            except library.Error as error:
                raise self._told(error) from error
            undo.pop_all()

    def _start(self, library: Aravis) -> None:
        camera = library.camera(self._device_id(library))
        self._camera = camera
        if not camera.is_gv_device():
            raise DeviceUnavailable(self._name, f"{self._where} is no GigE Vision camera")
        if not library.is_controller(camera):
            raise DeviceUnavailable(
                self._name, f"{self._where} is held by another program; end that, or wait for its heartbeat"
            )
        library.check_ranges(camera)
        self._configure(library, camera)
        stream = library.stream(camera)
        self._stream = stream
        library.size_socket(stream, self._settings.socket_buffer_bytes)
        stream.set_property("packet-resend", library.resend(always=self._settings.resend))
        self._payload = camera.get_payload()
        for _ in range(BUFFERS):
            stream.push_buffer(library.buffer(self._payload))
        self._device_clock, self._answer_clock = DeviceClock(), DeviceClock()
        self._frame_id, self._resent_before = None, 0
        self._asked_at.clear()
        camera.start_acquisition()
        log.info(
            "gige_camera_started",
            camera=self._name,
            model=camera.get_model_name(),
            packet_size=camera.gv_get_packet_size(),
        )

    @property
    def _where(self) -> str:
        wanted = self._settings
        return f"serial {wanted.serial}" if wanted.address is None else wanted.address

    def _device_id(self, library: Aravis) -> str:
        """By address at once; by serial number after asking all networks, which takes a second."""
        wanted = self._settings
        if wanted.address is not None:
            return wanted.address
        found = library.discover()
        for one in found:
            if one.serial == wanted.serial:
                return one.device
        there = ", ".join(one.serial for one in found) or "none"
        raise DeviceUnavailable(
            self._name,
            f"no camera of serial {wanted.serial} answers on any network; there are: {there}. Check power, "
            "cable and that its address is in the network of this machine's port, or give its address",
        )

    def _configure(self, library: Aravis, camera: AravisCamera) -> None:
        wanted = self._settings
        device = camera.get_device()
        library.settle(camera)
        camera.clear_triggers()
        camera.set_pixel_format_from_string(wanted.pixel_format)
        self._same("PixelFormat", wanted.pixel_format, camera.get_pixel_format_as_string())
        region = (wanted.offset_x_px, wanted.offset_y_px, wanted.width_px, wanted.height_px)
        camera.set_region(*region)
        self._same("region x y width height", list(region), [int(v) for v in camera.get_region()])
        self._expose(library, camera)
        if wanted.trigger == "free":
            camera.set_frame_rate(wanted.rate_hz)
            self._near(
                "frame rate Hz", wanted.rate_hz, camera.get_frame_rate(), camera.get_frame_rate_bounds()
            )
        else:
            source = "Software" if wanted.trigger == "software" else wanted.trigger
            camera.set_trigger(source)
            self._same("TriggerSource", source, camera.get_trigger_source())
            self._same("TriggerMode", "On", device.get_string_feature_value("TriggerMode"))
        if wanted.packet_size == "auto":
            camera.gv_auto_packet_size()
        else:
            camera.gv_set_packet_size(wanted.packet_size)
            self._same("packet size", wanted.packet_size, camera.gv_get_packet_size())

    def _expose(self, library: Aravis, camera: AravisCamera) -> None:
        wanted = self._settings
        library.manual(camera)
        camera.set_exposure_time(wanted.exposure_us)
        self._near(
            "exposure us", wanted.exposure_us, camera.get_exposure_time(), camera.get_exposure_time_bounds()
        )
        camera.set_gain(wanted.gain)
        self._near("gain", wanted.gain, camera.get_gain(), camera.get_gain_bounds())

    def _same(self, what: str, wanted: object, found: object) -> None:
        if wanted != found:
            raise CommandRejected(self._name, f"{what}: {wanted} was asked for, the camera has {found}")

    def _near(self, what: str, wanted: float, found: float, bounds: tuple[float, float]) -> None:
        if abs(found - wanted) > max(_NEAR * abs(wanted), 1e-3):
            raise CommandRejected(
                self._name,
                f"{what}: {wanted:g} was asked for, the camera has {found:g}; it takes {bounds[0]:g} to "
                f"{bounds[1]:g}",
            )

    # ------------------------------------------------------------------ frames

    def trigger(self) -> None:
        """Expose now (trigger: software)."""
        if self._camera is None:
            raise DeviceUnavailable(self._name, "not started")
        library = aravis.load(self._name)
        self._refuse_gone()
        sent_at = self._clock.now()
        try:
            self._camera.software_trigger()
        except library.Error as error:
            raise self._told(error) from error
        self._asked_at.append(sent_at)

    def next(self, timeout_s: float) -> Frame | None:
        """The next complete frame, in the order of exposure; None when none came in time."""
        if self._stream is None:
            raise DeviceUnavailable(self._name, "not started")
        until = self._clock.now() + timeout_s
        while True:
            self._refuse_gone()
            left_s = until - self._clock.now()
            buffer = self._stream.timeout_pop_buffer(max(1, int(left_s * 1e6)))
            if buffer is None:
                return None
            try:
                frame = self._frame(buffer)
            finally:
                self._stream.push_buffer(buffer)
            if frame is not None:
                return frame

    def _refuse_gone(self) -> None:
        if self._camera is not None and not aravis.load(self._name).is_controller(self._camera):
            raise DeviceUnavailable(self._name, f"{self._where}: control lost, its heartbeat is not answered")

    def _frame(self, buffer: AravisBuffer) -> Frame | None:
        """The frame of a buffer; None, and counted, when anything of it is missing."""
        came_at = self._came_at(buffer)
        number = buffer.get_frame_id()
        lost = 0 if self._frame_id is None else missed(self._frame_id, number)
        self._frame_id = number
        for _ in range(min(lost, len(self._asked_at))):
            self._asked_at.popleft()  # answered, by a frame that never came
        resent = aravis.resent(self._stream)
        before = self._counters
        good = aravis.complete(buffer)
        self._counters = Counters(
            frames=before.frames + good,
            dropped=before.dropped + lost,
            incomplete=before.incomplete + (not good),
            resent=before.resent + max(0, resent - self._resent_before),
        )
        self._resent_before = resent
        if not good:
            if self._asked_at:
                self._asked_at.popleft()
            return None
        wanted = self._settings
        try:
            pixels = decode(wanted.pixel_format, buffer.get_image_data(), wanted.width_px, wanted.height_px)
        except ValueError as error:
            raise CommandRejected(self._name, f"frame {number}: {error}") from error
        self._sequence += 1 + lost
        return Frame(
            camera=self._name,
            pixels=pixels,
            captured_at=self._captured_at(buffer.get_timestamp(), came_at),
            sequence=self._sequence,
        )

    def _came_at(self, buffer: AravisBuffer) -> float:
        """When its first packet came, on our clock."""
        now, age_s = self._clock.now(), (time.time_ns() - buffer.get_system_timestamp()) * 1e-9
        # the wall clock may have been set meanwhile; then the time we saw the frame has to do
        return now - age_s if 0.0 <= age_s < 1.0 else now

    def _captured_at(self, device_ns: int, came_at: float) -> float:
        """Never later than the exposure: from its end to its first packet a camera takes up to ``lag_s``."""
        wanted = self._settings
        earliest, device_s = came_at, device_ns * 1e-9
        if device_ns > 0:
            earliest = min(came_at, self._device_clock.add(device_s, came_at).ours(device_s))
        if self._asked_at:
            # it answers one of our words, in their order, and cannot be older than the first of them; what it
            # took longer than the quickest answer is told by the device's clock
            sent_at = self._asked_at.popleft()
            if device_ns <= 0:
                return sent_at
            return sent_at + max(0.0, device_s - self._answer_clock.add(sent_at, device_s).ours(sent_at))
        return earliest - wanted.exposure_us * 1e-6 - wanted.lag_s

    # ------------------------------------------------------------------ stop

    def stop(self) -> None:
        """End the stream and let go of the device; never raises."""
        camera, stream, self._camera, self._stream = self._camera, self._stream, None, None
        if camera is None:
            return
        library = aravis.load(self._name)
        if not library.is_controller(camera):
            # each register of a dead camera takes 2.5 s to be given up; and its heartbeat thread may be about
            # to tell of the loss, which must not be the last to hold it: it would wait for its own end
            self._dead = camera, stream
        else:
            try:
                if stream is not None:
                    camera.stop_acquisition()
                library.leave(camera)  # somebody may still hold a reference: a traceback is enough
            except library.Error as error:
                log.info("gige_camera_did_not_stop", camera=self._name, detail=str(error))
                self._dead = camera, stream
        del stream, camera
        # their last references: Aravis ends its threads and gives up control here

    def _told(self, error: Exception) -> DriverError:
        text = aravis.text_of(error)
        match aravis.kind_of(error):
            case "absent":
                return DeviceUnavailable(self._name, f"{self._where}: {text}")
            case "timeout":
                return DeviceTimeout(self._name, f"{self._where}: {text}")
            case _:
                return CommandRejected(self._name, f"{self._where}: {text}")
