"""Bytes of a webcam to pixels."""

from __future__ import annotations

from typing import Final, Literal

import cv2
import numpy as np

from drivers.types import Pixels

PixelFormatName = Literal["MJPG", "YUYV", "GREY"]
_JPEG_BEGIN: Final = b"\xff\xd8"
_JPEG_END: Final = b"\xff\xd9"
_BYTES_PER_PIXEL: Final = {"YUYV": 2, "GREY": 1}


class Spoilt(Exception):
    """Not a whole picture; says what is wrong with it."""


def pixels(content: bytes, letters: PixelFormatName, width_px: int, height_px: int, row_bytes: int) -> Pixels:
    """(H, W, 3) BGR of MJPG and YUYV, (H, W) of GREY; read-only.

    Raises
    ------
    Spoilt
        Cut short, of another size, or not decodable.

    Notes
    -----
    libjpeg fills what is missing of a picture with grey and says so on a stream nobody reads; therefore the
    end marker is looked for. It cannot occur inside a picture: there, 0xff is followed by 0x00 or a restart.
    """
    if letters == "MJPG":
        return _frozen(_jpeg(content, width_px, height_px))
    used = width_px * _BYTES_PER_PIXEL[letters]
    stride = row_bytes or used
    # the last row may come without its padding
    if len(content) < stride * (height_px - 1) + used:
        raise Spoilt(f"{len(content)} bytes, {stride * height_px} expected")
    rows = np.zeros((height_px, stride), np.uint8)
    rows.reshape(-1)[: len(content)] = np.frombuffer(content, np.uint8)[: rows.size]
    rows = rows[:, :used]
    if letters == "GREY":
        return _frozen(np.ascontiguousarray(rows))
    yuyv = np.ascontiguousarray(rows).reshape(height_px, width_px, 2)
    return _frozen(np.asarray(cv2.cvtColor(yuyv, cv2.COLOR_YUV2BGR_YUY2), np.uint8))


def _jpeg(content: bytes, width_px: int, height_px: int) -> Pixels:
    if not content.startswith(_JPEG_BEGIN):
        raise Spoilt("does not begin as a JPEG picture")
    if content.rfind(_JPEG_END) < 0:
        raise Spoilt(f"JPEG picture cut short after {len(content)} bytes")
    try:
        decoded = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error as error:
        raise Spoilt(f"JPEG picture cannot be decoded: {error}") from error
    if decoded is None:
        raise Spoilt("JPEG picture cannot be decoded")
    if decoded.shape[:2] != (height_px, width_px):
        raise Spoilt(f"JPEG picture of {decoded.shape[1]}x{decoded.shape[0]}, {width_px}x{height_px} is set")
    return np.asarray(decoded, np.uint8)


def _frozen(decoded: Pixels) -> Pixels:
    decoded.setflags(write=False)
    return decoded
