"""One open V4L2 device: what it offers, its format and controls, its stream of buffers.

Every method raises `OSError` as the kernel gave it; the caller knows what it was doing and explains it.
Nothing here waits without a limit.
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import mmap
import os
import select
from dataclasses import dataclass
from pathlib import Path

from drivers.camera import v4l2_abi as abi


@dataclass(frozen=True, slots=True, kw_only=True)
class Identity:
    """Who the device is. ``captures`` is False for a node that carries no pictures (metadata)."""

    driver: str
    model: str
    bus: str
    captures: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureFormat:
    """What the device delivers. ``row_bytes`` is 0 where rows mean nothing (MJPG)."""

    width_px: int
    height_px: int
    letters: str
    row_bytes: int


@dataclass(frozen=True, slots=True, kw_only=True)
class OfferedSize:
    """A size in one pixel format and the rates it comes at; none where any is possible."""

    letters: str
    width_px: int
    height_px: int
    rates_hz: tuple[float, ...]

    def text(self) -> str:
        """As a person reads it: ``MJPG 640x480 at 30, 15 Hz``."""
        rates = f" at {', '.join(f'{rate:g}' for rate in self.rates_hz)} Hz" if self.rates_hz else ""
        return f"{self.letters} {self.width_px}x{self.height_px}{rates}"


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlRange:
    """A control and the values it takes. ``inactive``: an automatic of the camera has it now."""

    id: int
    label: str
    minimum: int
    maximum: int
    step: int
    default: int
    inactive: bool
    read_only: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Filled:
    """A buffer that came: its content, and what the kernel says of it. ``at`` on the monotonic clock."""

    content: bytes
    at: float
    sequence: int
    spoilt: bool


class VideoDevice:
    """Opens at once; `close` may come twice."""

    def __init__(self, path: Path) -> None:
        self._fd = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        self._maps: list[mmap.mmap] = []
        self._streaming = False

    def close(self) -> None:
        """End the stream and let go; what the device answers to that does not matter any more."""
        if self._fd < 0:
            return
        if self._streaming:
            try:
                self._ask(abi.STREAMOFF, ctypes.c_int(abi.CAPTURE))
            except OSError as error:
                # closing the file ends the stream as well; a device that is gone has none
                del error
            self._streaming = False
        for mapped in self._maps:
            mapped.close()
        self._maps = []
        os.close(self._fd)
        self._fd = -1

    def identity(self) -> Identity:
        """Name, bus, and whether this node delivers pictures."""
        answer = abi.Capability()
        self._ask(abi.QUERYCAP, answer)
        has_own = answer.capabilities & abi.CAP_DEVICE_CAPS
        able = answer.device_caps if has_own else answer.capabilities
        wanted = abi.CAP_VIDEO_CAPTURE | abi.CAP_STREAMING
        return Identity(
            driver=_text(answer.driver),
            model=_text(answer.card),
            bus=_text(answer.bus_info),
            captures=able & wanted == wanted,
        )

    def set_format(self, width_px: int, height_px: int, letters: str) -> PictureFormat:
        """Ask for a format; what the device makes of it may differ and is returned."""
        request = abi.Format()
        request.type = abi.CAPTURE
        pix = request.fmt.pix
        pix.width, pix.height, pix.pixelformat = width_px, height_px, abi.fourcc(letters)
        pix.field = abi.FIELD_NONE
        self._ask(abi.S_FMT, request)
        return self.format()

    def format(self) -> PictureFormat:
        """The format that is set."""
        answer = abi.Format()
        answer.type = abi.CAPTURE
        self._ask(abi.G_FMT, answer)
        pix = answer.fmt.pix
        return PictureFormat(
            width_px=pix.width,
            height_px=pix.height,
            letters=abi.letters(pix.pixelformat),
            row_bytes=pix.bytesperline,
        )

    def set_rate(self, rate_hz: float) -> float:
        """Ask for a frame rate; the one that is set, 0 where the device names none."""
        request = abi.Parameters()
        request.type = abi.CAPTURE
        request.parm.capture.numerator, request.parm.capture.denominator = 1000, round(rate_hz * 1000)
        self._ask(abi.S_PARM, request)
        answer = abi.Parameters()
        answer.type = abi.CAPTURE
        self._ask(abi.G_PARM, answer)
        interval = answer.parm.capture
        return interval.denominator / interval.numerator if interval.numerator else 0.0

    def offered(self) -> tuple[OfferedSize, ...]:
        """Every size of every pixel format; of a stepwise range its smallest."""
        sizes = []
        for letters in self._formats():
            index = 0
            while True:
                size = abi.FrameSize()
                size.index, size.pixel_format = index, abi.fourcc(letters.ljust(4))
                if not self._listed(abi.ENUM_FRAMESIZES, size):
                    break
                discrete = size.type == abi.FRAME_DISCRETE
                # of a range: min width, max width, step, min height, ...
                width, height = size.width, size.height if discrete else int(size.rest[1])
                rates = self._rates(letters, width, height) if discrete else ()
                sizes.append(OfferedSize(letters=letters, width_px=width, height_px=height, rates_hz=rates))
                if not discrete:
                    break
                index += 1
        return tuple(sizes)

    def controls(self) -> tuple[ControlRange, ...]:
        """Every control that is not disabled, in the order of their numbers."""
        found: list[ControlRange] = []
        number = 0
        while True:
            query = abi.QueryControl()
            query.id = number | abi.NEXT_CONTROL
            if not self._listed(abi.QUERYCTRL, query):
                return tuple(found)
            number = query.id
            # classes have a number and a name too; they end in 1 and hold no value
            if not query.flags & abi.CONTROL_DISABLED and query.type != 6:
                found.append(_range(query))

    def control(self, number: int) -> ControlRange | None:
        """One control; None where the device has none of this number."""
        query = abi.QueryControl()
        query.id = number
        if not self._listed(abi.QUERYCTRL, query) or query.flags & abi.CONTROL_DISABLED:
            return None
        return _range(query)

    def get(self, number: int) -> int:
        """The value of a control."""
        answer = abi.Control()
        answer.id = number
        self._ask(abi.G_CTRL, answer)
        return answer.value

    def set(self, number: int, value: int) -> None:
        """Set a control; what came of it is told by `get`: drivers bend values into the range in silence."""
        request = abi.Control()
        request.id, request.value = number, value
        self._ask(abi.S_CTRL, request)

    def stream(self, buffers: int) -> bool:
        """Map and hand in the buffers and begin; whether pictures are timed by the monotonic clock."""
        request = abi.RequestBuffers()
        request.count, request.type, request.memory = buffers, abi.CAPTURE, abi.MEMORY_MAPPED
        self._ask(abi.REQBUFS, request)
        monotonic = True
        for index in range(request.count):
            buffer = self._buffer()
            buffer.index = index
            self._ask(abi.QUERYBUF, buffer)
            monotonic = monotonic and buffer.flags & abi.TIMESTAMP_MASK == abi.TIMESTAMP_MONOTONIC
            self._maps.append(mmap.mmap(self._fd, buffer.length, offset=buffer.m.offset))
            self._ask(abi.QBUF, buffer)
        self._ask(abi.STREAMON, ctypes.c_int(abi.CAPTURE))
        self._streaming = True
        return monotonic

    def wait(self, timeout_s: float) -> bool:
        """Wait for a picture; True when `take` is worth a try."""
        poll = select.poll()
        poll.register(self._fd, select.POLLIN)
        # rounded up: with 0 ms for the last fraction the caller would spin
        return bool(poll.poll(int(max(0.0, timeout_s) * 1000.0) + 1))

    def take(self) -> Filled | None:
        """The oldest picture that is ready, its buffer handed in again; None when there is none."""
        buffer = self._buffer()
        try:
            self._ask(abi.DQBUF, buffer)
        except BlockingIOError:
            return None
        content = self._maps[buffer.index][: buffer.bytesused]
        filled = Filled(
            content=content,
            at=buffer.timestamp.seconds + buffer.timestamp.microseconds * 1e-6,
            sequence=buffer.sequence,
            spoilt=bool(buffer.flags & abi.BUFFER_ERROR) or not content,
        )
        self._ask(abi.QBUF, buffer)
        return filled

    def _formats(self) -> list[str]:
        found: list[str] = []
        while True:
            description = abi.FormatDescription()
            description.index, description.type = len(found), abi.CAPTURE
            if not self._listed(abi.ENUM_FMT, description):
                return found
            found.append(abi.letters(description.pixelformat))

    def _rates(self, letters: str, width_px: int, height_px: int) -> tuple[float, ...]:
        rates: list[float] = []
        while True:
            interval = abi.FrameInterval()
            interval.index, interval.pixel_format = len(rates), abi.fourcc(letters.ljust(4))
            interval.width, interval.height = width_px, height_px
            if not self._listed(abi.ENUM_FRAMEINTERVALS, interval):
                return tuple(rates)
            if interval.type != abi.FRAME_DISCRETE or interval.numerator == 0:
                return ()
            rates.append(interval.denominator / interval.numerator)

    def _buffer(self) -> abi.Buffer:
        buffer = abi.Buffer()
        buffer.type, buffer.memory = abi.CAPTURE, abi.MEMORY_MAPPED
        return buffer

    def _listed(self, request: int, structure: ctypes.Structure) -> bool:
        """Ask for an entry of a list: False at its end, or where the device keeps no such list."""
        try:
            self._ask(request, structure)
        except OSError as error:
            if error.errno in (errno.EINVAL, errno.ENOTTY):
                return False
            raise
        return True

    def _ask(self, request: int, structure: ctypes.Structure | ctypes.c_int) -> None:
        if self._fd < 0:
            raise OSError(errno.ENODEV, "closed")
        fcntl.ioctl(self._fd, request, structure)


def _text(raw: bytes) -> str:
    return raw.decode("utf-8", errors="replace")


def _range(query: abi.QueryControl) -> ControlRange:
    return ControlRange(
        id=query.id,
        label=_text(query.name),
        minimum=query.minimum,
        maximum=query.maximum,
        step=query.step,
        default=query.default_value,
        inactive=bool(query.flags & abi.CONTROL_INACTIVE),
        read_only=bool(query.flags & abi.CONTROL_READ_ONLY),
    )
