"""Mask to one-pixel skeleton, 64 pixels at a time.

Zhang-Suen and Guo-Hall delete, in alternating sub-iterations, every pixel that satisfies a rule on its eight
neighbours. The rules are Boolean, so one machine word holds 64 neighbouring pixels and the rule is
evaluated for all of them with a few dozen word operations. Words of a row whose neighbourhood has not
changed since the same sub-iteration looked at them are skipped. Lee's is scikit-image's, for comparison.

Neighbours are named as in both papers, clockwise from the north::

    p9 p2 p3
    p8 p1 p4
    p7 p6 p5

Outside the picture is background.

References
----------
T. Y. Zhang, C. Y. Suen: A fast parallel algorithm for thinning digital patterns, CACM 27 (1984).
Z. Guo, R. W. Hall: Parallel thinning with two-subiteration algorithms, CACM 32 (1989), algorithm A1.
T.-C. Lee, R. L. Kashyap, C.-N. Chu: Building skeleton models via 3-D medial surface/axis thinning
algorithms, CVGIP 56 (1994).
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from skimage.morphology import skeletonize

from vision.jit import compiled
from vision.types import Mask, Skeleton

Words: TypeAlias = npt.NDArray[np.uint64]

_WORD = 64


def zhang_suen(mask: Mask) -> Skeleton:
    """Thinning of Zhang and Suen (1984), pixel for pixel as published.

    The published method uses it. It is known to eat two-pixel-wide diagonals and to shorten
    sticks near 45 degrees; the default method uses `guo_hall`.

    Parameters
    ----------
    mask : (H, W) bool
        True = foreground; not changed.

    Returns
    -------
    (H, W) bool
        A new array.

    Raises
    ------
    ValueError
        If `mask` is not two-dimensional.
    """
    return _thin(mask, False)


def guo_hall(mask: Mask) -> Skeleton:
    """Thinning of Guo and Hall (1989), algorithm A1: keeps diagonals and nearly the whole length.

    Parameters
    ----------
    mask : (H, W) bool
        True = foreground; not changed.

    Returns
    -------
    (H, W) bool
        A new array.

    Raises
    ------
    ValueError
        If `mask` is not two-dimensional.
    """
    return _thin(mask, True)


def lee(mask: Mask) -> Skeleton:
    """Thinning of Lee, Kashyap and Chu (1994) as scikit-image has it: the slowest of the three.

    Parameters
    ----------
    mask : (H, W) bool
        True = foreground; not changed.

    Returns
    -------
    (H, W) bool
        A new array.

    Raises
    ------
    ValueError
        If `mask` is not two-dimensional.
    """
    if mask.ndim != 2:
        raise ValueError(f"a mask has two dimensions, not {mask.ndim}")
    thinned = skeletonize(mask, method="lee")  # type: ignore[no-untyped-call]  # has no types
    return np.ascontiguousarray(thinned != 0)


def _thin(mask: Mask, is_guo_hall: bool) -> Skeleton:
    if mask.ndim != 2:
        raise ValueError(f"a mask has two dimensions, not {mask.ndim}")
    words = _pack(mask)
    _thin_words(words, is_guo_hall)
    return _unpack(words, mask.shape[0], mask.shape[1])


def _pack(mask: Mask) -> Words:
    """Pixels to words, bit k of word j = column 64 (j - 1) + k, with a frame of empty words around."""
    rows, columns = mask.shape
    count = -(-columns // _WORD)
    octets = np.zeros((rows + 2, (count + 2) * 8), np.uint8)
    bits = np.packbits(mask, axis=1, bitorder="little")
    octets[1 : rows + 1, 8 : 8 + bits.shape[1]] = bits
    return np.ascontiguousarray(octets.view("<u8"), dtype=np.uint64)


def _unpack(words: Words, rows: int, columns: int) -> Skeleton:
    inner = np.ascontiguousarray(words[1:-1, 1:-1]).astype("<u8", copy=False)
    bits = np.unpackbits(inner.view(np.uint8), axis=1, count=columns, bitorder="little")
    return bits.reshape(rows, columns).view(np.bool_)


@compiled
def _thin_words(words: Words, is_guo_hall: bool) -> None:
    """Thins packed rows in place; the frame of empty words stays empty."""
    rows = words.shape[0]
    columns = words.shape[1]
    # Per sub-iteration and row: the words [first, last) whose neighbourhood has changed since they
    # were last looked at.
    first = np.full((2, rows), columns, np.int64)
    last = np.zeros((2, rows), np.int64)
    flat = words.reshape(-1)
    goes = np.zeros_like(flat)
    for y in range(1, rows - 1):
        for x in range(1, columns - 1):
            if words[y, x] != 0:
                first[:, y] = np.minimum(first[0, y], x)
                last[:, y] = x + 1
    step = 0
    quiet = 0
    while quiet < 2:
        changed = False
        kept_first = kept_last = 0  # what goes from the row above, once this one has seen it
        for y in range(1, rows):
            now_first = now_last = 0
            start = first[step, y]
            stop = last[step, y]
            if start < stop:
                first[step, y] = columns
                last[step, y] = 0
                row = y * columns
                if _doom(flat, goes, columns, row + start, row + stop, is_guo_hall, step):
                    now_first = start
                    now_last = stop
                    while goes[row + now_first] == 0:
                        now_first += 1
                    while goes[row + now_last - 1] == 0:
                        now_last -= 1
                    changed = True
            if kept_first < kept_last:
                for at in range((y - 1) * columns + kept_first, (y - 1) * columns + kept_last):
                    flat[at] &= ~goes[at]
                start = max(1, kept_first - 1)
                stop = min(columns - 1, kept_last + 1)
                for other in range(max(1, y - 2), min(y + 1, rows - 1)):
                    for both in range(2):
                        first[both, other] = min(first[both, other], start)
                        last[both, other] = max(last[both, other], stop)
            kept_first = now_first
            kept_last = now_last
        quiet = 0 if changed else quiet + 1
        step = 1 - step


@compiled
def _doom(
    words: Words, goes: Words, columns: int, start: int, stop: int, is_guo_hall: bool, step: int
) -> bool:
    """Marks in `goes` which pixels of the flat words [start, stop) of a row go; True if there are any.

    Without a branch, and with indices that cannot be negative, so that it is compiled to vector
    instructions.
    """
    one = np.uint64(1)
    end = np.uint64(_WORD - 1)
    row = np.uint64(columns)
    found = np.uint64(0)
    even = np.uint64(0) if step else ~np.uint64(0)
    for k in range(np.uint64(start), np.uint64(stop)):
        p1 = words[k]
        p2 = words[k - row]
        p6 = words[k + row]
        p3 = (p2 >> one) | (words[k - row + one] << end)
        p4 = (p1 >> one) | (words[k + one] << end)
        p5 = (p6 >> one) | (words[k + row + one] << end)
        p7 = (p6 << one) | (words[k + row - one] >> end)
        p8 = (p1 << one) | (words[k - one] >> end)
        p9 = (p2 << one) | (words[k - row - one] >> end)
        if is_guo_hall:
            rule = _guo_hall_rule(p2, p3, p4, p5, p6, p7, p8, p9, even)
        else:
            rule = _zhang_suen_rule(p2, p3, p4, p5, p6, p7, p8, p9, even)
        rule &= p1
        goes[k] = rule
        found |= rule
    return bool(found != 0)


@compiled
def _zhang_suen_rule(
    p2: np.uint64,
    p3: np.uint64,
    p4: np.uint64,
    p5: np.uint64,
    p6: np.uint64,
    p7: np.uint64,
    p8: np.uint64,
    p9: np.uint64,
    even: np.uint64,
) -> np.uint64:
    """Bits of the pixels that go: A = 1, 2 <= B <= 6 and the two products of the sub-iteration.

    With A = 1 the foreground neighbours form one run, so B >= 2 says that two neighbours in a row
    are foreground, and B <= 6 that two in a row are background.
    """
    once = ~p2 & p3
    twice = np.uint64(0)
    rise = ~p3 & p4
    twice |= once & rise
    once |= rise
    rise = ~p4 & p5
    twice |= once & rise
    once |= rise
    rise = ~p5 & p6
    twice |= once & rise
    once |= rise
    rise = ~p6 & p7
    twice |= once & rise
    once |= rise
    rise = ~p7 & p8
    twice |= once & rise
    once |= rise
    rise = ~p8 & p9
    twice |= once & rise
    once |= rise
    rise = ~p9 & p2
    twice |= once & rise
    once |= rise
    two = (p2 & p3) | (p3 & p4) | (p4 & p5) | (p5 & p6) | (p6 & p7) | (p7 & p8) | (p8 & p9) | (p9 & p2)
    seven = (p2 | p3) & (p3 | p4) & (p4 | p5) & (p5 | p6) & (p6 | p7) & (p7 | p8) & (p8 | p9) & (p9 | p2)
    blocked = (even & p4 & p6 & (p2 | p8)) | (~even & p2 & p8 & (p4 | p6))
    return once & ~twice & two & ~seven & ~blocked


@compiled
def _guo_hall_rule(
    p2: np.uint64,
    p3: np.uint64,
    p4: np.uint64,
    p5: np.uint64,
    p6: np.uint64,
    p7: np.uint64,
    p8: np.uint64,
    p9: np.uint64,
    even: np.uint64,
) -> np.uint64:
    """Bits of the pixels that go: C = 1, 2 <= min(N1, N2) <= 3 and the side of the sub-iteration."""
    once = ~p2 & (p3 | p4)
    rise = ~p4 & (p5 | p6)
    twice = once & rise
    once |= rise
    rise = ~p6 & (p7 | p8)
    twice |= once & rise
    once |= rise
    rise = ~p8 & (p9 | p2)
    twice |= once & rise
    once |= rise
    a1 = p9 | p2
    a2 = p3 | p4
    a3 = p5 | p6
    a4 = p7 | p8
    b1 = p2 | p3
    b2 = p4 | p5
    b3 = p6 | p7
    b4 = p8 | p9
    first_two = (a1 & a2) | (a1 & a3) | (a1 & a4) | (a2 & a3) | (a2 & a4) | (a3 & a4)
    second_two = (b1 & b2) | (b1 & b3) | (b1 & b4) | (b2 & b3) | (b2 & b4) | (b3 & b4)
    four = a1 & a2 & a3 & a4 & b1 & b2 & b3 & b4
    side = (even & (p2 | p3 | ~p5) & p4) | (~even & (p6 | p7 | ~p9) & p8)
    return once & ~twice & first_two & second_two & ~four & ~side
