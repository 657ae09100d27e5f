"""The published method and the default one on the same rendered piles, in one run.

``python -m bench.detector [--piles 6] [--sticks 4 12 20 40]``

A found part is right when its middle is within 5 mm, its axis within 5 degrees and its length within 10 % of
a true part not yet taken. Parts that are covered count
as found; "first right": the first candidate is right. The published method has the band of its paper, by
hand as there; the default one sets its own.
"""

from __future__ import annotations

import argparse
import statistics
from dataclasses import dataclass, field, replace
from typing import get_args

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.optimize import linear_sum_assignment

from bench.scenes import Pile, Piles, render
from drivers.timing import MonotonicClock
from vision.default import warm_up
from vision.locate import locate
from vision.types import Candidate, Floats, Method, Tuning

# Its paper's band for sticks (table 1); the proposal from the histogram takes the tray's bright walls too.
BAND: dict[Method, tuple[int, int] | None] = {"published": (186, 255), "default": None}
# The published method measures whole pixels of disparity; a narrow gate would cost it recall.
TOLERANCE_M = {"published": 0.012, "default": 0.004}


@dataclass(slots=True)
class Score:
    """What one method came to on piles of one size."""

    true: int = 0
    offered: int = 0
    right: int = 0
    first_right: int = 0
    looks: int = 0
    middle_mm: list[float] = field(default_factory=list)
    axis_deg: list[float] = field(default_factory=list)
    took_ms: list[float] = field(default_factory=list)


def errors(candidate: Candidate, ends: Floats) -> tuple[float, float, float]:
    """Middle m, axis rad and relative length error of a candidate against true ends (2, 3) m."""
    axis = ends[1] - ends[0]
    length = float(np.linalg.norm(axis))
    middle = float(np.linalg.norm(candidate.centre - ends.mean(axis=0)))
    turn = float(np.arccos(min(1.0, abs(float(candidate.axis @ axis)) / length)))
    return middle, turn, abs(candidate.length_m / length - 1)


def score(total: Score, offered: tuple[Candidate, ...], pile: Pile) -> None:
    """Count one look: one to one, best total."""
    found = [[errors(c, ends) for ends in pile.ends] for c in offered]
    good = [[m < 0.005 and a < np.radians(5) and n < 0.10 for m, a, n in row] for row in found]
    total.true += len(pile.ends)
    total.offered += len(offered)
    total.looks += 1
    if not offered:
        return
    cost = np.array(
        [
            [m if g else 1e3 for (m, _, _), g in zip(r, q, strict=True)]
            for r, q in zip(found, good, strict=True)
        ]
    )
    for i, j in zip(*linear_sum_assignment(cost), strict=True):
        if good[i][j]:
            total.right += 1
            total.first_right += int(i == 0)
            total.middle_mm.append(1000 * found[i][j][0])
            total.axis_deg.append(float(np.degrees(found[i][j][1])))


def run(piles: Piles, method: Method, repeats: int) -> Score:
    """One method over all piles; the time of a look is the median of ``repeats``."""
    clock, total = MonotonicClock(), Score()
    part = replace(piles.part, length_tolerance_m=TOLERANCE_M[method])
    tuning = Tuning(method=method, band=BAND[method], height_m=(-0.003, 0.045))
    for pile in piles.piles:
        took = []
        for _ in range(repeats):
            began_at = clock.now()
            scene = locate(pile.left, pile.right, piles.known.stereo, part, tuning, piles.table)
            took.append(1000 * (clock.now() - began_at))
        total.took_ms.append(statistics.median(took))
        score(total, scene.recognised, pile)
    return total


def _median(values: list[float]) -> str:
    return f"{statistics.median(values):.2f}" if values else "-"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--piles", type=int, default=6)
    parser.add_argument("--sticks", type=int, nargs="+", default=[4, 12, 20, 40])
    parser.add_argument("--spread", type=float, default=0.8)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    warm_up()
    table = Table(
        title=f"{options.piles} rendered piles each, 640x480, tray 260x200 mm, spread {options.spread}"
    )
    for heading in (
        *("sticks", "method", "recall %", "precision %", "first right %"),
        *("middle mm", "axis deg", "ms", "time / published"),
    ):
        table.add_column(heading, justify="right")
    for sticks in options.sticks:
        piles = render(sticks, range(1000, 1000 + options.piles), options.spread)
        base_ms = float("nan")
        for method in sorted(get_args(Method), reverse=True):
            total = run(piles, method, options.repeats)
            took_ms = statistics.median(total.took_ms)
            base_ms = took_ms if method == "published" else base_ms
            table.add_row(
                str(sticks),
                method,
                f"{100 * total.right / total.true:.0f}",
                f"{100 * total.right / max(1, total.offered):.0f}",
                f"{100 * total.first_right / total.looks:.0f}",
                _median(total.middle_mm),
                _median(total.axis_deg),
                f"{took_ms:.1f}",
                f"{took_ms / base_ms:.2f}",
            )
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
