"""Thinning and skeleton graphs: ours beside the libraries that do a part of the work.

``python -m bench.skeletons [--seed S] [--family H20] [--large]``

A thinning is right when it keeps every piece and every hole of the mask: pixels of the skeleton have the
mask's Euler number. A graph is right when its nodes less its edges are that number too. Times are of one
picture.
"""

from __future__ import annotations

import argparse
import importlib
import statistics
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from skimage.measure import euler_number
from skimage.morphology import skeletonize

from bench import own, tables
from bench.cases import Case
from bench.families import FAMILIES
from bench.machine import worked_ms
from vision import graph, thin
from vision.foreground import stands_out
from vision.types import Mask, Skeleton

REPEATS = 5
SLOW_S = 1.0
"""What takes longer than this is timed once."""

Work = Callable[[Mask], int]
"""A mask or a skeleton in; the Euler number of what came of it out."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Peer:
    """One library's way. ``thins``: mask to skeleton; otherwise skeleton to graph."""

    name: str
    thins: bool
    run: Callable[[Mask], Any]  # each library has its own kind of result
    euler: Callable[[Any], int]


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One peer on one size of picture: ms, ms over scikit-image's thinning, and V - E beside the truth."""

    size: str
    name: str
    thins: bool
    took_ms: float
    ratio: float
    euler: int
    expected: int


def pixels_euler(skeleton: Mask) -> int:
    """Pieces less holes of a set of pixels, neighbours across corners included."""
    return int(euler_number(skeleton, connectivity=2))  # type: ignore[no-untyped-call]  # no types there


def peers() -> tuple[tuple[Peer, ...], tuple[str, ...]]:
    """What can run here, and what is missing, in words."""
    found = [
        Peer(name="ours, Guo-Hall", thins=True, run=thin.guo_hall, euler=pixels_euler),
        Peer(name="ours, Zhang-Suen", thins=True, run=thin.zhang_suen, euler=pixels_euler),
        Peer(name="scikit-image, Zhang", thins=True, run=skeletonize, euler=pixels_euler),
        Peer(name="scikit-image, Lee", thins=True, run=_lee, euler=pixels_euler),
        Peer(name="ours, graph", thins=False, run=graph.trace, euler=_ours),
    ]
    missing = []
    if hasattr(cv2, "ximgproc"):
        contributed = importlib.import_module("cv2.ximgproc")
        for name, way in (("Zhang-Suen", "THINNING_ZHANGSUEN"), ("Guo-Hall", "THINNING_GUOHALL")):
            found.append(_ximgproc(contributed, name, getattr(contributed, way)))
    else:
        missing.append("cv2.ximgproc (in opencv-contrib-python, which replaces the OpenCV we use)")
    for name, make in (("mahotas", _mahotas), ("skan", _skan), ("sknw", _sknw)):
        try:
            found.append(make(importlib.import_module(name)))
        except ImportError:
            missing.append(name)
    notes = (f"NOT RUN, not installed: {', '.join(missing)}.",) if missing else ()
    return tuple(sorted(found, key=lambda peer: not peer.thins)), notes


def _lee(mask: Mask) -> Skeleton:
    return np.asarray(skeletonize(mask, method="lee"), np.bool_)  # type: ignore[no-untyped-call]


def _ours(found: Any) -> int:
    return len(found.points) - len(found.edges)


def _ximgproc(library: Any, name: str, way: int) -> Peer:
    def run(mask: Mask) -> Mask:
        return np.asarray(library.thinning(mask.astype(np.uint8) * 255, thinningType=way), np.bool_)

    return Peer(name=f"OpenCV ximgproc, {name}", thins=True, run=run, euler=pixels_euler)


def _mahotas(library: Any) -> Peer:
    return Peer(name="mahotas.thin", thins=True, run=library.thin, euler=pixels_euler)


def _skan(library: Any) -> Peer:
    def run(skeleton: Mask) -> Any:
        return library.summarize(library.Skeleton(skeleton), separator="-")

    def euler(branches: Any) -> int:
        ends = np.concatenate([branches["node-id-src"], branches["node-id-dst"]])
        return len(np.unique(ends)) - len(branches)

    return Peer(name="skan", thins=False, run=run, euler=euler)


def _sknw(library: Any) -> Peer:
    def run(skeleton: Mask) -> Any:
        return library.build_sknw(skeleton.astype(np.uint16), multi=True)

    def euler(found: Any) -> int:
        return int(found.number_of_nodes() - found.number_of_edges())

    return Peer(name="sknw (multi)", thins=False, run=run, euler=euler)


def compare(size: str, case: Case, runnable: tuple[Peer, ...]) -> list[Row]:
    """All peers on the left mask of a case, taking turns; graphs are built from our skeleton."""
    distance_m = -case.table.offset_m / float(case.table.normal[2])
    width_px = case.width_m * float(case.stereo.left.matrix[0, 0]) / distance_m
    mask = stands_out(case.left, width_px).mask.copy()
    skeleton = thin.guo_hall(mask).copy()
    expected = pixels_euler(mask)
    took: dict[str, list[float]] = {peer.name: [] for peer in runnable}
    euler: dict[str, int] = {}
    for turn in range(1 + REPEATS):
        for peer in runnable:
            if turn > 1 and took[peer.name][0] > 1000.0 * SLOW_S:
                continue
            began_ms = worked_ms()
            came = peer.run(mask if peer.thins else skeleton)
            if turn:  # the first one compiles
                took[peer.name].append(worked_ms() - began_ms)
            euler[peer.name] = peer.euler(came)
    base = statistics.median(took["scikit-image, Zhang"])
    return [
        Row(
            size=size,
            name=peer.name,
            thins=peer.thins,
            took_ms=statistics.median(took[peer.name]),
            ratio=statistics.median(took[peer.name]) / base,
            euler=euler[peer.name],
            expected=expected,
        )
        for peer in runnable
    ]


def measure(seed: int, family: str, with_large: bool) -> tuple[tuple[Row, ...], tuple[str, ...]]:
    """Rows of the small picture, and of the large one if wanted."""
    runnable, notes = peers()
    (small,) = own.cases(family, 1, seed)
    rows = compare("640x480", small, runnable)
    if with_large:
        rows += compare("2560x1920", own.large(own.LARGE_COUNTS, seed)[-1], runnable)
        return tuple(rows), notes
    return tuple(rows), (*notes, "5 MP NOT RUN: not asked for (--large).")


def sheet(rows: tuple[Row, ...], notes: tuple[str, ...], command: str) -> tables.Sheet:
    """The table."""
    lines = []
    for row in rows:
        kept = "yes" if row.euler == row.expected else f"off by {row.euler - row.expected:+d}"
        lines.append(
            (
                row.size,
                "thinning" if row.thins else "graph",
                row.name,
                tables.milliseconds(row.took_ms),
                tables.number(row.ratio),
                str(row.euler),
                str(row.expected),
                kept,
            )
        )
    return tables.Sheet(
        title="Thinning and skeleton graphs",
        command=command,
        headings=(
            *("picture", "step", "library", "ms", "of scikit-image's\nthinning"),
            *("pieces - holes,\nV - E", "the mask's", "kept"),
        ),
        rows=tuple(lines),
        notes=(
            "One picture, median of processor time; all take turns in one process. Graphs are built from "
            "our Guo-Hall skeleton. A library that leaves out closed rings or single pixels, or splits a "
            "junction into several nodes with cycles between them, is off.",
            *notes,
        ),
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=None)
    parser.add_argument("--family", choices=FAMILIES, default="H20")
    parser.add_argument("--large", action="store_true", help="5 megapixels too")
    options = parser.parse_args()
    seed = own.fresh_seed() if options.seed is None else options.seed
    rows, notes = measure(seed, options.family, options.large)
    tables.show(sheet(rows, notes, f"python -m bench.skeletons --seed {seed}"))


if __name__ == "__main__":
    main()
