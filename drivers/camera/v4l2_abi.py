"""The kernel's words for video devices: structures, request numbers, flags.

After Linux' ``include/uapi/linux/videodev2.h``, for 64-bit machines; sizes are checked where they are used,
for the size is part of a request's number. Only what the driver uses.
"""

from __future__ import annotations

import ctypes
from typing import Final

CAPTURE: Final = 1
"""V4L2_BUF_TYPE_VIDEO_CAPTURE."""
MEMORY_MAPPED: Final = 1
FIELD_NONE: Final = 1
CAP_VIDEO_CAPTURE: Final = 0x1
CAP_STREAMING: Final = 0x04000000
CAP_DEVICE_CAPS: Final = 0x80000000
BUFFER_ERROR: Final = 0x40
TIMESTAMP_MASK: Final = 0xE000
TIMESTAMP_MONOTONIC: Final = 0x2000
CONTROL_DISABLED: Final = 0x1
CONTROL_READ_ONLY: Final = 0x4
CONTROL_INACTIVE: Final = 0x10
NEXT_CONTROL: Final = 0x80000000
FRAME_DISCRETE: Final = 1

_BYTE, _WORD, _INT = ctypes.c_uint8, ctypes.c_uint32, ctypes.c_int32


class Capability(ctypes.Structure):
    """struct v4l2_capability."""

    driver: bytes
    card: bytes
    bus_info: bytes
    capabilities: int
    device_caps: int
    _fields_ = (
        ("driver", ctypes.c_char * 16),
        ("card", ctypes.c_char * 32),
        ("bus_info", ctypes.c_char * 32),
        ("version", _WORD),
        ("capabilities", _WORD),
        ("device_caps", _WORD),
        ("reserved", _WORD * 3),
    )


class FormatDescription(ctypes.Structure):
    """struct v4l2_fmtdesc."""

    index: int
    type: int
    pixelformat: int
    _fields_ = (
        ("index", _WORD),
        ("type", _WORD),
        ("flags", _WORD),
        ("description", ctypes.c_char * 32),
        ("pixelformat", _WORD),
        ("mbus_code", _WORD),
        ("reserved", _WORD * 3),
    )


class FrameSize(ctypes.Structure):
    """struct v4l2_frmsizeenum; of a stepwise one the first two words are the smallest and largest width."""

    index: int
    pixel_format: int
    type: int
    width: int
    height: int
    _fields_ = (
        ("index", _WORD),
        ("pixel_format", _WORD),
        ("type", _WORD),
        ("width", _WORD),
        ("height", _WORD),
        ("rest", _WORD * 6),
    )


class FrameInterval(ctypes.Structure):
    """struct v4l2_frmivalenum, discrete."""

    index: int
    pixel_format: int
    width: int
    height: int
    type: int
    numerator: int
    denominator: int
    _fields_ = (
        ("index", _WORD),
        ("pixel_format", _WORD),
        ("width", _WORD),
        ("height", _WORD),
        ("type", _WORD),
        ("numerator", _WORD),
        ("denominator", _WORD),
        ("rest", _WORD * 6),
    )


class PixelFormat(ctypes.Structure):
    """struct v4l2_pix_format, within struct v4l2_format."""

    width: int
    height: int
    pixelformat: int
    field: int
    bytesperline: int
    sizeimage: int
    _fields_ = tuple(
        (name, _WORD)
        for name in (
            *("width", "height", "pixelformat", "field", "bytesperline", "sizeimage", "colorspace"),
            *("priv", "flags", "encoding", "quantization", "transfer"),
        )
    )


class _FormatUnion(ctypes.Union):
    pix: PixelFormat
    _fields_ = (("pix", PixelFormat), ("raw", _BYTE * 200), ("aligned", ctypes.c_uint64))


class Format(ctypes.Structure):
    """struct v4l2_format."""

    type: int
    fmt: _FormatUnion
    _fields_ = (("type", _WORD), ("fmt", _FormatUnion))


class _CaptureParameters(ctypes.Structure):
    capability: int
    numerator: int
    denominator: int
    _fields_ = (
        ("capability", _WORD),
        ("mode", _WORD),
        ("numerator", _WORD),
        ("denominator", _WORD),
        ("extended", _WORD),
        ("readbuffers", _WORD),
        ("reserved", _WORD * 4),
    )


class _ParametersUnion(ctypes.Union):
    capture: _CaptureParameters
    _fields_ = (("capture", _CaptureParameters), ("raw", _BYTE * 200))


class Parameters(ctypes.Structure):
    """struct v4l2_streamparm."""

    type: int
    parm: _ParametersUnion
    _fields_ = (("type", _WORD), ("parm", _ParametersUnion))


class RequestBuffers(ctypes.Structure):
    """struct v4l2_requestbuffers."""

    count: int
    type: int
    memory: int
    _fields_ = (
        ("count", _WORD),
        ("type", _WORD),
        ("memory", _WORD),
        ("capabilities", _WORD),
        ("flags", _BYTE),
        ("reserved", _BYTE * 3),
    )


class _Time(ctypes.Structure):
    seconds: int
    microseconds: int
    _fields_ = (("seconds", ctypes.c_int64), ("microseconds", ctypes.c_int64))


class _Place(ctypes.Union):
    offset: int
    _fields_ = (("offset", _WORD), ("userptr", ctypes.c_uint64))


class Buffer(ctypes.Structure):
    """struct v4l2_buffer."""

    index: int
    type: int
    bytesused: int
    flags: int
    timestamp: _Time
    sequence: int
    memory: int
    m: _Place
    length: int
    _fields_ = (
        ("index", _WORD),
        ("type", _WORD),
        ("bytesused", _WORD),
        ("flags", _WORD),
        ("field", _WORD),
        ("timestamp", _Time),
        ("timecode", _BYTE * 16),
        ("sequence", _WORD),
        ("memory", _WORD),
        ("m", _Place),
        ("length", _WORD),
        ("reserved", _WORD),
        ("request_fd", _INT),
    )


class QueryControl(ctypes.Structure):
    """struct v4l2_queryctrl."""

    id: int
    type: int
    name: bytes
    minimum: int
    maximum: int
    step: int
    default_value: int
    flags: int
    _fields_ = (
        ("id", _WORD),
        ("type", _WORD),
        ("name", ctypes.c_char * 32),
        ("minimum", _INT),
        ("maximum", _INT),
        ("step", _INT),
        ("default_value", _INT),
        ("flags", _WORD),
        ("reserved", _WORD * 2),
    )


class Control(ctypes.Structure):
    """struct v4l2_control."""

    id: int
    value: int
    _fields_ = (("id", _WORD), ("value", _INT))


def _request(direction: int, number: int, structure: type[ctypes.Structure] | type[ctypes.c_int]) -> int:
    """As the macros _IOR (2), _IOW (1) and _IOWR (3) of ``asm-generic/ioctl.h`` make it, letter ``V``."""
    return (direction << 30) | (ctypes.sizeof(structure) << 16) | (ord("V") << 8) | number


QUERYCAP: Final = _request(2, 0, Capability)
ENUM_FMT: Final = _request(3, 2, FormatDescription)
G_FMT: Final = _request(3, 4, Format)
S_FMT: Final = _request(3, 5, Format)
REQBUFS: Final = _request(3, 8, RequestBuffers)
QUERYBUF: Final = _request(3, 9, Buffer)
QBUF: Final = _request(3, 15, Buffer)
DQBUF: Final = _request(3, 17, Buffer)
STREAMON: Final = _request(1, 18, ctypes.c_int)
STREAMOFF: Final = _request(1, 19, ctypes.c_int)
G_PARM: Final = _request(3, 21, Parameters)
S_PARM: Final = _request(3, 22, Parameters)
G_CTRL: Final = _request(3, 27, Control)
S_CTRL: Final = _request(3, 28, Control)
QUERYCTRL: Final = _request(3, 36, QueryControl)
ENUM_FRAMESIZES: Final = _request(3, 74, FrameSize)
ENUM_FRAMEINTERVALS: Final = _request(3, 75, FrameInterval)


def fourcc(name: str) -> int:
    """The number of a pixel format's four letters.

    >>> hex(fourcc("MJPG"))
    '0x47504a4d'
    """
    return int.from_bytes(name.encode("ascii"), "little")


def letters(number: int) -> str:
    """The four letters of a pixel format's number."""
    return (number & 0x7FFFFFFF).to_bytes(4, "little").decode("ascii", errors="replace").rstrip()
