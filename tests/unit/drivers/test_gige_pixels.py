"""Pixel formats: depth, mosaic, size."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.camera.gige_pixels import FORMATS, decode


@pytest.mark.parametrize(("name", "white"), [("Mono10", 1023), ("Mono12", 4095), ("Mono16", 65535)])
def test_deeper_formats_keep_their_upper_8_bits(name: str, white: int) -> None:
    values = np.array([[0, white // 2 + 1, white]], dtype="<u2")
    assert decode(name, values.tobytes(), 3, 1).tolist() == [[0, 128, 255]]


def test_bits_above_those_that_count_do_not_wrap_round() -> None:
    assert decode("Mono12", np.array([[0xFFFF]], dtype="<u2").tobytes(), 1, 1).tolist() == [[255]]


@pytest.mark.parametrize(
    ("name", "first_two"), [("BayerRG8", "RG"), ("BayerBG8", "BG"), ("BayerGR8", "GR"), ("BayerGB8", "GB")]
)
def test_a_mosaic_of_one_colour_comes_back_as_that_colour(name: str, first_two: str) -> None:
    bgr = {"B": 200, "G": 90, "R": 30}
    second = {"RG": "GB", "BG": "GR", "GR": "BG", "GB": "RG"}[first_two]
    tile = np.array([[bgr[c] for c in first_two], [bgr[c] for c in second]], dtype=np.uint8)
    pixels = decode(name, np.tile(tile, (8, 8)).tobytes(), 16, 16)
    assert pixels.shape == (16, 16, 3)
    assert pixels[8, 8].tolist() == [200, 90, 30]


def test_rgb_becomes_bgr() -> None:
    assert decode("RGB8", bytes([1, 2, 3]), 1, 1).tolist() == [[[3, 2, 1]]]


@pytest.mark.parametrize("name", sorted(FORMATS))
def test_too_few_bytes_are_refused_and_pixels_cannot_be_written(name: str) -> None:
    with pytest.raises(ValueError, match="takes"):
        decode(name, bytes(3), 16, 16)
    assert not decode(name, bytes(16 * 16 * 3), 16, 16).flags.writeable
