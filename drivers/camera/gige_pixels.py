"""What a GigE Vision camera sends, as pixels: the GenICam pixel formats we take."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from drivers.types import Pixels


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """``bits`` of one pixel that count, in ``bytes_each`` bytes, low byte first; ``bayer``: OpenCV's code."""

    bits: int
    bytes_each: int = 1
    bayer: int | None = None
    colours: bool = False


# GenICam names a mosaic by the colours of its first two pixels, OpenCV by those of the second row and column
FORMATS: Final[dict[str, Format]] = {
    "Mono8": Format(bits=8),
    "Mono10": Format(bits=10, bytes_each=2),
    "Mono12": Format(bits=12, bytes_each=2),
    "Mono16": Format(bits=16, bytes_each=2),
    "BayerRG8": Format(bits=8, bayer=cv2.COLOR_BayerRGGB2BGR),
    "BayerBG8": Format(bits=8, bayer=cv2.COLOR_BayerBGGR2BGR),
    "BayerGR8": Format(bits=8, bayer=cv2.COLOR_BayerGRBG2BGR),
    "BayerGB8": Format(bits=8, bayer=cv2.COLOR_BayerGBRG2BGR),
    "RGB8": Format(bits=8, bytes_each=3, colours=True),
}


def decode(name: str, data: bytes, width_px: int, height_px: int) -> Pixels:
    """(H, W) grey or (H, W, 3) BGR uint8, read-only; the upper 8 bits of deeper formats.

    Raises
    ------
    ValueError
        The data are not of this size.
    """
    form = FORMATS[name]
    wanted = width_px * height_px * form.bytes_each
    if len(data) < wanted:
        raise ValueError(f"{len(data)} bytes, but {width_px}x{height_px} {name} takes {wanted}")
    raw = np.frombuffer(data, dtype=np.uint8, count=wanted)
    if form.colours:
        pixels = raw.reshape(height_px, width_px, 3)[:, :, ::-1].copy()
    elif form.bytes_each == 2:
        deep = raw.view("<u2").reshape(height_px, width_px)
        # bits above those that count are 0 by the standard; a camera that sets them must not wrap round
        pixels = np.minimum(deep >> (form.bits - 8), 255).astype(np.uint8)
    else:
        pixels = raw.reshape(height_px, width_px)
        if form.bayer is not None:
            pixels = np.asarray(cv2.cvtColor(pixels, form.bayer), dtype=np.uint8)
    pixels.setflags(write=False)
    return pixels
