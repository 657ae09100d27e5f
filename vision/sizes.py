"""The products of one look: lengths that are proposed side by side, and which product a measured part is.

Parts of every known length compete for the edges of both pictures in one explanation (`explain`), so that a
long part keeps its own from the windows of shorter ones. Products of one length are told apart by colour.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vision import claims
from vision.canvas import in_space
from vision.explain import Explanation, Frame
from vision.proposals import Lines
from vision.refine import KIND
from vision.strays import strays
from vision.types import Floats, PartModel
from vision.windows import windows

SAME_LENGTH = 0.01
"""Products whose lengths differ by less are proposed as one: the fit itself leaves half of that."""
SAME_WIDTH = 1.1
"""Products up to this many times as thick are looked for as one width; edges tell width to a tenth."""
LONGER = 1.6
"""Evidence is weighed by the longest product, unless it is more than this many times the shortest."""
LONGEST = 2.5
"""Nothing is longer than this many times the length that evidence is weighed by."""
SEEN_END = 0.1
LEAST_LEAD = 0.1
"""A part with an end that neither picture shows so strongly, and that explains less than this more than one
of another known length, in lengths and view, may be either. In mixed heaps 16 of 581 parts are such, and
among them all five that were of another length."""
OTHER_LENGTH = 0.08
"""What is nearer to a known length, as a share of it, is no stray."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Size:
    """Products of one length; ``frame`` as for the first of them alone."""

    parts: tuple[PartModel, ...]
    frame: Frame


def of_one_width(part: PartModel, among: tuple[PartModel, ...]) -> bool:
    """Whether all are straight and, as edges tell it, as thick as the first."""
    return all(
        other.topology is None
        and max(other.diameter_m, part.diameter_m) <= SAME_WIDTH * min(other.diameter_m, part.diameter_m)
        for other in (part, *among)
    )


def weighing_length_m(parts: tuple[PartModel, ...]) -> float:
    """The length by which all evidence of a look is weighed: for one product its own."""
    lengths = [part.length_m for part in parts]
    return max(min(max(lengths), LONGER * min(lengths)), max(lengths) / LONGEST)


def sizes_of(parts: tuple[PartModel, ...], frame: Frame) -> tuple[Size, ...]:
    """Products by length, in the order in which they are given; ``frame`` is of the whole look."""
    groups: list[list[PartModel]] = []
    for part in parts:
        for group in groups:
            if abs(part.length_m - group[0].length_m) < SAME_LENGTH * group[0].length_m:
                group.append(part)
                break
        else:
            groups.append([part])
    found = []
    for group in groups:
        share = group[0].length_m / frame.part.length_m
        found.append(
            Size(
                parts=tuple(group),
                frame=replace(frame, part=group[0], length_px=share * frame.length_px),
            )
        )
    return tuple(found)


def pool(left: Lines, right: Lines, planes: Floats, sizes: tuple[Size, ...]) -> Floats:
    """Hypotheses (N, `COLUMNS`) of every length, their kind the place in ``sizes``; then those of no product.

    Parameters
    ----------
    planes : (2, 3)
        Disparity of the lowest and the highest place an axis may be.
    """
    found = []
    for kind, size in enumerate(sizes):
        of = size.frame
        rows = windows(left, right, of.on, planes, of.part.length_m, of.width_px, of.length_px, of.unit)
        rows[:, KIND] = kind
        found.append(rows)
    longest = max(sizes, key=lambda size: size.frame.part.length_m).frame
    others = strays(left, right, longest.on, planes, longest.part.length_m, longest.length_px, longest.unit)
    if len(sizes) > 1 and len(others):
        ends = in_space(others[:, 1:7].reshape(-1, 2, 3), longest.on).reshape(-1, 2, 3)
        long_m = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        known_m = np.array([size.frame.part.length_m for size in sizes if size.frame is not longest])
        others = others[(np.abs(long_m[:, None] / known_m - 1) > OTHER_LENGTH).all(axis=1)]
    return np.concatenate([*found, others])


def lead(found: Explanation, sizes: tuple[Size, ...]) -> Floats:
    """(C,) by how much each chosen part explains more than a part of another known length in its place.

    In lengths of the chosen part and view; infinite where both ends are seen or no other length was thought
    of. Other parts stay as they are. One whose end is hidden may be longer or shorter than it seems: then
    this is small.
    """
    now, nobody = found.state, np.zeros(len(found.hypotheses), np.bool_)
    ahead = np.full(len(found.chosen), np.inf)
    if len(sizes) == 1:
        return ahead
    for place, k in enumerate(found.chosen):
        kind = found.hypotheses[k, KIND]
        if kind < 0 or (now.tip_value[k].mean(axis=2).max(axis=0) >= SEEN_END).all():
            continue
        near = range(int(now.near_at[k]), int(now.near_at[k + 1]))
        rivals = [
            int(now.near[at])
            for at in near
            if found.hypotheses[now.near[at], KIND] not in (kind, -1.0)
            and now.pair[at, 0] < claims.THROUGH * now.diameter
            and now.pair[at, 1] > claims.PARALLEL
        ]
        if not rivals:
            continue
        claims.give_back(now, k)
        own = claims.gain_of(k, now)
        best = max(claims.gain_of(h, now) for h in rivals)
        claims.take(now, k, nobody)
        ahead[place] = (own - best) / (2 * sizes[int(kind)].frame.length_px)
    return ahead


def size_of(kind: float, length_m: float, sizes: tuple[Size, ...]) -> Size:
    """The size a hypothesis is of; for one of none the size that is nearest to its length."""
    if kind >= 0:
        return sizes[int(kind)]
    return min(sizes, key=lambda size: abs(np.log(length_m / size.frame.part.length_m)))
