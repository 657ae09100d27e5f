"""Pictures that carry their number, put together without decoding. Standard library only.

A folder holds ``<exposure>.jpg`` (what a camera sees at an exposure in units of 100 us; the nearest is
served), made with a restart marker after every block of 16x16 pixels, the same small in the folder
``small``, ``cells.jpg`` (one dark and one bright block, made alike) and ``raw.yuyv``. Into each picture its
number is written, by which a test tells whether it is a new one: 20 bits and their complement, dark and
bright blocks in as many of the last rows as they take (one at 640 pixels' width, four at 176).
"""

from __future__ import annotations

import struct
from pathlib import Path

WIDTH, HEIGHT = 640, 480
SMALL = (176, 144)
RAW_BYTES = WIDTH * HEIGHT * 2
BITS = 20


class Jpeg:
    """A picture cut at its restart markers, so that blocks of it can be exchanged."""

    def __init__(self, content: bytes) -> None:
        start = content.index(b"\xff\xda")
        start += 2 + struct.unpack(">H", content[start + 2 : start + 4])[0]
        self.head = content[:start]
        blocks = []
        at = start
        while True:
            mark = content.index(b"\xff", at)
            kind = content[mark + 1]
            if kind == 0:  # a stuffed byte
                at = mark + 2
                continue
            blocks.append(content[start:mark])
            start = at = mark + 2
            if not 0xD0 <= kind <= 0xD7:
                break
        self.blocks = blocks

    def joined(self, first: int, blocks: list[bytes]) -> bytes:
        """Blocks as they stand in the file from number ``first`` on, each after its marker."""
        return b"".join(
            (b"" if n == 0 else bytes((0xFF, 0xD0 | (n - 1) % 8))) + block
            for n, block in enumerate(blocks, first)
        )


class Pictures:
    """What one camera sees."""

    def __init__(self, folder: Path) -> None:
        self.cells = Jpeg((folder / "cells.jpg").read_bytes())
        self.large = self._by_exposure(folder, WIDTH)
        self.small = self._by_exposure(folder / "small", SMALL[0])
        self.raw = (folder / "raw.yuyv").read_bytes()

    def _by_exposure(self, folder: Path, width: int) -> dict[int, tuple[bytes, int, int]]:
        """Of each picture what comes before the number, how many blocks that are, and how many follow."""
        left = rows_of_number(width) * (width // 16)
        found = {}
        for file in folder.glob("[0-9]*.jpg"):
            picture = Jpeg(file.read_bytes())
            first = len(picture.blocks) - left
            before = picture.head + picture.joined(0, picture.blocks[:first])
            found[int(file.stem)] = before, first, left
        return found

    def jpeg(self, exposure: int, number: int, *, small: bool = False) -> bytes:
        """The picture at the nearest exposure, with its number."""
        pictures = self.small if small else self.large
        before, first, left = pictures[min(pictures, key=lambda one: abs(one - exposure))]
        dark, bright = self.cells.blocks
        blocks = [bright if bit else dark for bit in bits(number)]
        blocks += [dark] * (left - len(blocks))
        return before + self.cells.joined(first, blocks) + b"\xff\xd9"


def rows_of_number(width: int) -> int:
    """Of blocks, at the lower edge of a picture this wide."""
    return -(-2 * BITS // (width // 16))


def bits(number: int) -> list[int]:
    """The number, lowest bit first, then its complement."""
    plain = [number >> n & 1 for n in range(BITS)]
    return plain + [1 - bit for bit in plain]
