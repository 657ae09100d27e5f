"""Strands through crossings on labelled photographs of bent rods.

``python -m bench.crossings [FOLDER ...]``

A folder holds ``images/*.jpg`` and ``labels/*.png`` (0 background, k = rod k), as the photographs of the
mBEST set do; without one, S1 of that set beside the repository is taken. The mask is that set's own: its
colour bands, closed and opened by 3x3, since its labels follow them.

A picture is **exact** when there are as many strands as labels and, assigned one to one, each strand has
a Dice overlap of at least 0.9 with its label. In S1 each picture shows one rod that crosses itself, so
there a wrong turn mostly shows as a second strand or a ring; folders with two and three rods judge the
labels too. Dice is the mean over labels, a missing or surplus strand counting 0. Times are from mask to
curves (thinning, graph, pruning, strands), of each picture the least of ``--repeats``, because others may
be at work on the machine; labelling pixels is apart.
"""

from __future__ import annotations

import argparse
import re
import statistics
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table
from scipy.optimize import linear_sum_assignment

from drivers.timing import MonotonicClock
from vision.graph import prune, trace
from vision.thin import guo_hall
from vision.tracing import Curves, label, trace_curves
from vision.types import Floats, Grey, Mask

S1 = Path(__file__).resolve().parents[2] / "shared" / "data" / "real" / "mbest_S1"
EXACT_DICE = 0.9
SPUR_PX = 4.0
Labels: TypeAlias = npt.NDArray[np.int32]
BANDS = (
    ((0, 20, 75), (20, 255, 255)),
    ((160, 20, 75), (180, 255, 255)),
    ((25, 20, 75), (50, 255, 255)),
    ((50, 20, 20), (120, 255, 255)),
)
"""Hue, saturation, value of the set's rods, lowest and highest (OpenCV's scales)."""


@dataclass(slots=True)
class Score:
    """What came of the pictures of one half."""

    pictures: int = 0
    exact: int = 0
    dice: list[float] = field(default_factory=list)
    took_ms: list[float] = field(default_factory=list)
    label_ms: list[float] = field(default_factory=list)


def colour_mask(picture: Grey) -> Mask:
    """Foreground of a BGR photograph (H, W, 3)."""
    hsv = cv2.cvtColor(picture, cv2.COLOR_BGR2HSV)
    mask = np.zeros(picture.shape[:2], np.uint8)
    for low, high in BANDS:
        mask |= cv2.inRange(hsv, np.array(low), np.array(high)).astype(np.uint8)
    square = np.ones((3, 3), np.uint8)
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, square).astype(np.uint8)
    return np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, square) > 0)


def curves_of(mask: Mask) -> Curves:
    """What is timed: mask to strands."""
    return trace_curves(mask, prune(trace(guo_hall(mask)), SPUR_PX, mask))


def overlaps(found: Labels, strands: int, truth: Grey) -> Floats:
    """(S, T) Dice of every strand with every label."""
    labels = int(truth.max())
    together = np.zeros((strands + 1, labels + 1))
    np.add.at(together, (found + 1, truth), 1)
    sizes = together.sum(axis=1)[1:, None] + together.sum(axis=0)[None, 1:]
    return np.asarray(2 * together[1:, 1:] / np.maximum(sizes, 1))


def judge(found: Labels, strands: int, truth: Grey) -> tuple[bool, float]:
    """Whether a picture is exact, and its mean Dice."""
    dice = overlaps(found, strands, truth)
    if not dice.size:
        return not sum(dice.shape), float(not sum(dice.shape))
    best = dice[linear_sum_assignment(-dice)]
    exact = dice.shape[0] == dice.shape[1] and bool((best >= EXACT_DICE).all())
    return exact, float(best.sum() / max(dice.shape))


def photographs(folder: Path) -> list[tuple[int, Grey, Grey]]:
    """Number, picture (H, W, 3) BGR and labels (H, W) of all that have labels."""
    found = []
    for path in (folder / "images").iterdir():
        number = re.search(r"(\d+)$", path.stem)
        labels = folder / "labels" / f"{path.stem}.png"
        if number is not None and labels.exists():
            picture, truth = cv2.imread(str(path)), cv2.imread(str(labels), cv2.IMREAD_GRAYSCALE)
            assert picture is not None
            assert truth is not None
            found.append((int(number[1]), np.asarray(picture, np.uint8), np.asarray(truth, np.uint8)))
    return sorted(found, key=lambda one: one[0])


def peers() -> dict[str, Callable[[Mask], object]]:
    """Others' steps on the same mask; skan and sknw where they are installed."""
    skeletonize = import_module("skimage.morphology").skeletonize
    found: dict[str, Callable[[Mask], object]] = {
        "scikit-image skeletonize (thinning alone)": skeletonize,
        "own thinning": guo_hall,
        "own thinning, graph, pruning": lambda mask: prune(trace(guo_hall(mask)), SPUR_PX, mask),
    }
    for name, attribute in (("skan", "Skeleton"), ("sknw", "build_sknw")):
        try:
            build = getattr(import_module(name), attribute)
        except ModuleNotFoundError:
            continue
        found[f"scikit-image and {name} (no strands)"] = partial(_after, skeletonize, build)
    found["own, whole strands"] = curves_of
    return found


def _after(thin: Callable[[Mask], Mask], build: Callable[[Mask], object], mask: Mask) -> object:
    return build(thin(mask))


def timed_ms(call: Callable[[Mask], object], mask: Mask, repeats: int) -> float:
    """Least time of some calls."""
    clock, took = MonotonicClock(), []
    for _ in range(repeats):
        began_at = clock.now()
        call(mask)
        took.append(1000 * (clock.now() - began_at))
    return min(took)


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="*", default=[S1])
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    console = Console(width=110)
    table = Table(title="Strands through crossings, one process")
    for heading in ("photographs", "exact", "Dice %", "worst Dice %", "ms", "slowest ms", "label ms"):
        table.add_column(heading, justify="right")
    steps: dict[str, list[float]] = {}
    for folder in options.folders:
        halves = {"even": Score(), "odd": Score()}
        pictures = photographs(folder)
        if not pictures:
            parser.error(f"{folder}: no images/*.jpg with labels/*.png")
        label(colour_mask(pictures[0][1]), curves_of(colour_mask(pictures[0][1])))  # compiles
        for number, picture, truth in pictures:
            mask = colour_mask(picture)
            score = halves["odd" if number % 2 else "even"]
            curves = curves_of(mask)
            exact, dice = judge(label(mask, curves), len(curves), truth)
            score.pictures += 1
            score.exact += exact
            score.dice.append(dice)
            score.took_ms.append(timed_ms(curves_of, mask, options.repeats))
            score.label_ms.append(timed_ms(partial(label, curves=curves), mask, options.repeats))
            if not exact:
                console.print(f"{folder.name} {number}: {len(curves)} strands for {truth.max()} rods")
        for name, score in halves.items():
            if score.pictures:
                table.add_row(
                    f"{folder.name}, {name}",
                    f"{score.exact} of {score.pictures}",
                    f"{100 * statistics.mean(score.dice):.1f}",
                    f"{100 * min(score.dice):.1f}",
                    f"{statistics.median(score.took_ms):.2f}",
                    f"{max(score.took_ms):.2f}",
                    f"{statistics.median(score.label_ms):.2f}",
                )
        for name, call in peers().items():
            call(colour_mask(pictures[0][1]))
            for _, picture, _ in pictures[::5]:
                steps.setdefault(name, []).append(timed_ms(call, colour_mask(picture), options.repeats))
    console.print(table)
    table = Table(title="Every fifth picture, medians of the same process")
    for heading in ("step", "ms", "of scikit-image's thinning"):
        table.add_column(heading, justify="left" if heading == "step" else "right")
    unit = statistics.median(next(iter(steps.values())))
    for name, took in steps.items():
        table.add_row(name, f"{statistics.median(took):.2f}", f"{statistics.median(took) / unit:.2f}")
    console.print(table)


if __name__ == "__main__":
    main()
