"""How often the first pick is right, and nothing lies on it, over many fresh dense heaps.

``python -m bench.first [--heaps 2000] [--seed S] [--workers 2] [--families H10 H20 H40] [--rig webcam]``

Every run has other heaps unless it is given the seed that an earlier one printed. Each wrong one is named, so
that it can be drawn again: its family, its number in the stream, and what was wrong with it.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

import cv2

from bench import own, piles, rigs
from bench.looks import look, median_of
from bench.machine import code, load
from bench.rigs import RIGS
from bench.tables import Sheet, show
from vision.default import warm_up

FAMILIES = ("H10", "H20", "H40")


@dataclass(frozen=True, slots=True, kw_only=True)
class Answered:
    """One heap: ``first`` the first pick is right and pickable, ``free`` it is right and nothing lies on it;
    None where there was no such part to be had, or the pictures were ``refused``. ``early``: told before the
    rest was explained."""

    family: str
    number: int
    first: bool | None
    free: bool | None
    early: bool
    first_ms: float
    whole_ms: float
    refused: str | None = None

    @property
    def wrong(self) -> str:
        """What is wrong with its answer; empty where nothing is."""
        if self.first is not False and self.free is not False:
            return ""
        what = "not right, or not to be picked" if self.first is False else "something lies on it"
        return f"{self.family} number {self.number + 1}: {what}"


def answered(family: str, rig: str, seed: int, number: int) -> Answered:
    """Look at one heap."""
    camera = RIGS[rig]
    shot = piles.draw(family, camera, seed, number)
    case = own.case_of(shot, rigs.known(camera), family, f"{family}-{number + 1}", seed)
    seen = look(case, "default")
    return Answered(
        family=family,
        number=number,
        first=seen.score.first if seen.refused is None else None,
        free=seen.score.free if seen.refused is None else None,
        early=seen.first_ms < seen.whole_ms,
        first_ms=seen.first_ms,
        whole_ms=seen.whole_ms,
        refused=seen.refused,
    )


def run(families: tuple[str, ...], rig: str, seed: int, heaps: int, workers: int) -> Iterator[Answered]:
    """Heaps of the families in turn, as they are done, in order."""
    told = [(families[n % len(families)], rig, seed, n // len(families)) for n in range(heaps)]
    # a fork would take over locks of threads that do not come along
    with ProcessPoolExecutor(workers, get_context("spawn"), initializer=_begin) as pool:
        yield from pool.map(answered, *zip(*told, strict=True), chunksize=4)


def _begin() -> None:
    cv2.setNumThreads(1)
    warm_up()


def percent(yes: int, of: int) -> str:
    return f"{100.0 * yes / of:.2f} ({of - yes} of {of})" if of else "-"


def sheet(every: list[Answered], command: str) -> Sheet:
    """By family and altogether."""
    rows = []
    for family in (*dict.fromkeys(one.family for one in every), "all"):
        some = [one for one in every if family in (one.family, "all")]
        firsts = [one.first for one in some if one.first is not None]
        frees = [one.free for one in some if one.free is not None]
        rows.append(
            (
                family,
                str(len(some)),
                percent(sum(firsts), len(firsts)),
                percent(sum(frees), len(frees)),
                str(sum(one.refused is not None for one in some)),
                f"{100.0 * sum(one.early for one in some) / len(some):.0f}",
                f"{median_of([one.first_ms for one in some]):.0f}",
                f"{median_of([one.whole_ms for one in some]):.0f}",
            )
        )
    return Sheet(
        title="First pick in fresh dense heaps",
        command=command,
        headings=(
            "heaps",
            "n",
            "right, pickable %",
            "right, nothing on it %",
            "refused",
            "told early %",
            "first ms",
            "whole ms",
        ),
        rows=tuple(rows),
        notes=(
            *(one.wrong for one in every if one.wrong),
            f"processor time, medians; load {load()}; {code()}",
        ),
    )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.first", description=__doc__)
    parser.add_argument("--heaps", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=None)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--families", nargs="+", choices=FAMILIES, default=list(FAMILIES))
    parser.add_argument("--rig", choices=tuple(RIGS), default="webcam")
    asked = parser.parse_args()
    seed = own.fresh_seed() if asked.seed is None else asked.seed
    warm_up()  # compiled once, for all workers
    command = f"python -m bench.first --heaps {asked.heaps} --seed {seed} --rig {asked.rig}"
    print(command, file=sys.stderr)
    every: list[Answered] = []
    for one in run(tuple(asked.families), asked.rig, seed, asked.heaps, asked.workers):
        every.append(one)
        what = one.wrong or (one.refused and f"{one.family} number {one.number + 1}: refused, {one.refused}")
        if what:
            print(f"after {len(every)} heaps {what}", file=sys.stderr)
    show(sheet(every, command))


if __name__ == "__main__":
    main()
