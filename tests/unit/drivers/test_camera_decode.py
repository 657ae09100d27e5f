"""Bytes of a webcam to pixels, and what is not a whole picture."""

from __future__ import annotations

import struct

import cv2
import numpy as np
import pytest

from drivers.camera.decode import Spoilt, pixels
from drivers.types import Pixels


def scene() -> Pixels:
    """A smooth picture, 64x48 BGR: what JPEG keeps well."""
    v, u = np.mgrid[0:48, 0:64]
    return np.dstack([u * 3, v * 4, 255 - u * 3]).astype(np.uint8)


def jpeg() -> bytes:
    done, content = cv2.imencode(".jpg", scene(), [cv2.IMWRITE_JPEG_QUALITY, 95])
    assert done
    return content.tobytes()


def without_tables(content: bytes) -> bytes:
    """As many webcams send it: the usual Huffman tables are left out."""
    at, kept = 2, content[:2]
    while content[at + 1] != 0xDA:
        length = 2 + int(struct.unpack(">H", content[at + 2 : at + 4])[0])
        kept += b"" if content[at + 1] == 0xC4 else content[at : at + length]
        at += length
    assert b"\xff\xc4" not in kept
    return kept + content[at:]


def yuyv(row_bytes: int = 128) -> bytes:
    raw = np.asarray(cv2.cvtColor(scene(), cv2.COLOR_BGR2YUV_YUY2), np.uint8).reshape(48, 128)
    padded = np.full((48, row_bytes), 77, np.uint8)
    padded[:, :128] = raw
    return padded.tobytes()


@pytest.mark.parametrize("content", [jpeg(), without_tables(jpeg()), jpeg() + bytes(300)])
def test_mjpg_is_decoded_as_webcams_send_it(content: bytes) -> None:
    got = pixels(content, "MJPG", 64, 48, 0)
    assert np.abs(got.astype(int) - scene()).mean() < 4.0
    assert not got.flags.writeable


@pytest.mark.parametrize("row_bytes", [128, 160])
def test_yuyv_is_decoded_with_and_without_padding(row_bytes: int) -> None:
    got = pixels(yuyv(row_bytes), "YUYV", 64, 48, row_bytes)
    assert np.abs(got.astype(int) - scene()).mean() < 6.0
    assert not got.flags.writeable


def test_grey_stays_grey() -> None:
    grey = np.arange(64 * 48, dtype=np.uint32).astype(np.uint8).reshape(48, 64)
    got = pixels(grey.tobytes(), "GREY", 64, 48, 64)
    assert np.array_equal(got, grey)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (jpeg()[:-400], "cut short"),
        (b"", "does not begin"),
        (jpeg()[10:], "does not begin"),
        (b"\xff\xd8 nothing of a picture \xff\xd9", "cannot be decoded"),
    ],
)
def test_what_is_not_a_whole_jpeg_picture_is_spoilt(content: bytes, says: str) -> None:
    with pytest.raises(Spoilt, match=says):
        pixels(content, "MJPG", 64, 48, 0)


def test_a_picture_of_another_size_is_spoilt() -> None:
    with pytest.raises(Spoilt, match="64x48, 640x480 is set"):
        pixels(jpeg(), "MJPG", 640, 480, 0)


def test_raw_pictures_that_end_early_are_spoilt() -> None:
    with pytest.raises(Spoilt, match="6143 bytes, 6144 expected"):
        pixels(yuyv()[:-1], "YUYV", 64, 48, 128)
