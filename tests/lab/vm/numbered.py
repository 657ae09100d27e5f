"""Pictures that carry their number, put together without decoding. Standard library only.

A folder holds ``<exposure>.jpg`` (what a camera sees at an exposure in units of 100 us; the nearest is
served), made with a restart marker after every block of 16x16 pixels, ``cells.jpg`` (one dark and one bright
block, made alike) and ``raw.yuyv``. Into each picture its number is written, by which a test tells whether it
is a new one: 20 bits and their complement, dark and bright blocks in the last row.
"""

from __future__ import annotations

import struct
from pathlib import Path

WIDTH, HEIGHT = 640, 480
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
        cells = Jpeg((folder / "cells.jpg").read_bytes())
        self.dark, self.bright = cells.blocks[0], cells.blocks[1]
        self.by_exposure: dict[int, bytes] = {}
        for file in folder.glob("[0-9]*.jpg"):
            picture = Jpeg(file.read_bytes())
            last = len(picture.blocks) - WIDTH // 16
            before = picture.head + picture.joined(0, picture.blocks[:last])
            self.last = last
            self.by_exposure[int(file.stem)] = before
        self.raw = (folder / "raw.yuyv").read_bytes()
        self.join = cells.joined

    def jpeg(self, exposure: int, number: int) -> bytes:
        """The picture at the nearest exposure, with its number."""
        nearest = min(self.by_exposure, key=lambda one: abs(one - exposure))
        cells = [self.bright if bit else self.dark for bit in bits(number)]
        return self.by_exposure[nearest] + self.join(self.last, cells) + b"\xff\xd9"


def bits(number: int) -> list[int]:
    """The number, lowest bit first, then its complement."""
    plain = [number >> n & 1 for n in range(BITS)]
    return plain + [1 - bit for bit in plain]
