"""A number and an instant written into a picture's pixels, and read back: what a frame says of itself may be
wrong, what is drawn in it is not.

A row of square blocks along the lower edge, black or white, one bit each, most significant first: 24 bits of
the picture's number, 40 bits of the monotonic clock in microseconds (12 days), 8 bits of check.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

BLOCK_PX: Final = 6
_NUMBER_BITS: Final = 24
_TIME_BITS: Final = 40
_CHECK_BITS: Final = 8
BITS: Final = _NUMBER_BITS + _TIME_BITS + _CHECK_BITS


@dataclass(frozen=True, slots=True, kw_only=True)
class Stamp:
    """``number`` of the picture since its camera began; ``exposed_at`` monotonic seconds, modulo 12 days."""

    number: int
    exposed_at: float


def _check_of(value: int) -> int:
    rest = 0
    while value:
        rest = (rest * 31 + (value & 0xFF)) & 0xFF
        value >>= 8
    return rest ^ 0xA5


def write(pixels: npt.NDArray[np.uint8], number: int, exposed_at: float) -> None:
    """Draw a stamp into (H, W) or (H, W, 3) pixels at least 432 wide."""
    value = (number % (1 << _NUMBER_BITS)) << _TIME_BITS | int(exposed_at * 1e6) % (1 << _TIME_BITS)
    value = value << _CHECK_BITS | _check_of(value)
    bits = np.array([value >> (BITS - 1 - i) & 1 for i in range(BITS)], dtype=np.uint8)
    row = np.repeat(np.where(bits, 235, 20).astype(np.uint8), BLOCK_PX)
    strip = pixels[-BLOCK_PX:, : BITS * BLOCK_PX]
    strip[...] = row[None, :, None] if pixels.ndim == 3 else row[None, :]


def read(pixels: npt.NDArray[np.uint8]) -> Stamp | None:
    """The stamp of a picture; None where there is none or a bit of it is spoilt."""
    strip = pixels[-BLOCK_PX:, : BITS * BLOCK_PX]
    if strip.ndim == 3:
        strip = strip.mean(axis=2)
    # the middle of each block: edges may be blurred by demosaicing
    inner = strip.reshape(BLOCK_PX, BITS, BLOCK_PX)[2:4, :, 2:4].mean(axis=(0, 2))
    value = 0
    for bright in inner > 128:
        value = value << 1 | int(bright)
    known, check = value >> _CHECK_BITS, value & ((1 << _CHECK_BITS) - 1)
    if check != _check_of(known):
        return None
    return Stamp(number=known >> _TIME_BITS, exposed_at=(known & ((1 << _TIME_BITS) - 1)) * 1e-6)
