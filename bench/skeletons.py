"""Thinning, graph and pruning of drawn sticks, beside scikit-image's thinnings in the same process.

``python -m bench.skeletons [--seed 1] [--repeats 20]``

The least time of the repeats, because others may be at work on the machine. The seed is printed.
"""

from __future__ import annotations

import argparse
import secrets
from collections.abc import Callable
from functools import partial
from importlib import import_module

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from drivers.timing import MonotonicClock
from vision.graph import prune, trace
from vision.thin import guo_hall, lee, zhang_suen
from vision.types import Mask

SPUR_PX = 4.0
PICTURES = (
    ("VGA, 15 sticks", (480, 640), 15, 150, 5),
    ("VGA, 40 sticks", (480, 640), 40, 150, 5),
    ("5 MP, 200 sticks", (2048, 2448), 200, 400, 9),
)
"""Name, rows and columns, sticks, their length and width in px."""


def sticks(size: tuple[int, int], count: int, length: float, width: int, seed: int) -> Mask:
    """Straight strokes of random place and direction."""
    random = np.random.default_rng(seed)
    canvas = np.zeros(size, np.uint8)
    for _ in range(count):
        middle = random.uniform((60, 60), (size[1] - 60, size[0] - 60))
        turn = random.uniform(0, np.pi)
        half = 0.5 * length * np.array([np.cos(turn), np.sin(turn)])
        ends = np.rint([middle - half, middle + half]).astype(int).tolist()
        cv2.line(canvas, ends[0], ends[1], 255, width, cv2.LINE_AA)
    return canvas > 127


def least_ms(call: Callable[[], object], repeats: int) -> float:
    """Least time of some calls after a first one."""
    call()
    clock, took = MonotonicClock(), []
    for _ in range(repeats):
        began_at = clock.now()
        call()
        took.append(1000 * (clock.now() - began_at))
    return min(took)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=None)
    parser.add_argument("--repeats", type=int, default=20)
    options = parser.parse_args()
    seed = secrets.randbelow(10**6) if options.seed is None else options.seed
    skeletonize = import_module("skimage.morphology").skeletonize
    table = Table(title=f"ms, seed {seed}")
    for heading in ("step", *(name for name, *_ in PICTURES)):
        table.add_column(heading, justify="left" if heading == "step" else "right")
    rows: dict[str, list[str]] = {}
    for _, size, count, length, width in PICTURES:
        mask = sticks(size, count, length, width, seed)
        thinned = guo_hall(mask)
        graph = trace(thinned)
        steps: dict[str, Callable[[], object]] = {
            "scikit-image, Zhang-Suen as it has it": partial(skeletonize, mask),
            "scikit-image, Lee (`lee`)": partial(lee, mask),
            "`zhang_suen`": partial(zhang_suen, mask),
            "`guo_hall`": partial(guo_hall, mask),
            "`trace`": partial(trace, thinned),
            "`prune`, one length": partial(prune, graph, SPUR_PX),
            "`prune`, by width": partial(prune, graph, SPUR_PX, mask),
        }
        for name, call in steps.items():
            repeats = max(1, options.repeats // 5) if name.startswith("scikit") else options.repeats
            rows.setdefault(name, []).append(f"{least_ms(call, repeats):.2f}")
    for name, row in rows.items():
        table.add_row(name, *row)
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
