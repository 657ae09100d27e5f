"""How fast: first pick and whole scene by size, by stage, on one core; and the first look after a start.

``python -m bench.speed [--seed S] [--scenes 2] [--repeats 3] [--large]``

The process is held on one core, with one thread in OpenCV. Between any two looks scikit-image thins the two
masks of the scene: as a ratio to that, figures of different machines and hours can be compared.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import cv2

from bench import own, tables
from bench.cases import Case
from bench.looks import METHODS, look, median_of, see, tuning_for
from bench.machine import ProcessorClock
from cell.evaluate import STICK_TOLERANCE_M
from cell.stopwatch import StageTimes
from drivers.timing import MonotonicClock
from vision.default import warm_up
from vision.locate import locate
from vision.types import Method

SIZES = ("B", "H20", "H40")
GOALS_MS = {"B": (5, 6), "H20": (15, 25), "H40": (25, 80), "5 MP, 200": (120, 500)}
"""First pick and whole scene, milliseconds."""
LONGEST_REPEATED_MS = 2000.0
"""Looks that take longer are not repeated."""
LATER_LOOKS = 6
FIRST_LOOK_GOAL = 3.0
"""The first look after the warm-up should take at most so many times the median of later ones."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One method on piles of one size."""

    size: str
    parts: int
    method: Method
    first_ms: float
    whole_ms: float
    wall_ms: float
    thin_ms: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Stage:
    """A stage of the default method: median ms by size."""

    name: str
    took_ms: tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """A fresh process: importing, warming up, its first look and the median of later ones, ms."""

    import_ms: float
    warm_up_ms: float
    first_ms: float
    later_ms: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Speeds:
    """All of it. ``sizes`` are the columns of ``stages``."""

    rows: tuple[Row, ...]
    sizes: tuple[str, ...]
    stages: tuple[Stage, ...]
    starts: tuple[Start, ...]


@contextmanager
def one_core() -> Iterator[int]:
    """All threads of this process, and its children, on one of its cores; OpenCV with one thread."""
    allowed = os.sched_getaffinity(0)
    core = max(allowed)
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    _hold({core})
    try:
        yield core
    finally:
        _hold(allowed)
        cv2.setNumThreads(threads)


def _hold(cores: set[int]) -> None:
    for thread in os.listdir("/proc/self/task"):
        os.sched_setaffinity(int(thread), cores)


def row(cases: tuple[Case, ...], method: Method, repeats: int) -> Row:
    """One method on cases of one size."""
    looks = []
    for case in cases:
        once = look(case, method)
        slow = once.whole_ms > LONGEST_REPEATED_MS
        looks.append(once if slow else look(case, method, repeats))
    return Row(
        size=cases[0].family,
        parts=len(cases[0].truth.parts),
        method=method,
        first_ms=median_of([one.first_ms for one in looks]),
        whole_ms=median_of([one.whole_ms for one in looks]),
        wall_ms=median_of([one.wall_ms for one in looks]),
        thin_ms=median_of([one.skeletonize_ms for one in looks]),
    )


def stage_times(case: Case, repeats: int) -> dict[str, float]:
    """Median milliseconds of each stage of the default method, in order."""
    part = replace(case.part, length_tolerance_m=STICK_TOLERANCE_M["default"])
    tuning = tuning_for(case, "default")
    clock, took = ProcessorClock(), []
    for _ in range(repeats):
        times = StageTimes(clock)
        locate(case.left, case.right, case.stereo, part, tuning, case.table, times, case.colour_left)
        took.append(times.durations_s)
        if 1000.0 * sum(times.durations_s.values()) > LONGEST_REPEATED_MS:
            break
    return {name: 1000.0 * statistics.median(one[name] for one in took) for name in took[0]}


def first_look(seed: int) -> Start:
    """A fresh process that warms up and looks, as the daemon does."""
    came = subprocess.run(
        [sys.executable, "-m", "bench.speed", "--seed", str(seed), "--one-start"],
        check=True,
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[1],
    )
    told = json.loads(came.stdout)
    return Start(
        import_ms=told["import_ms"],
        warm_up_ms=told["warm_up_ms"],
        first_ms=told["first_ms"],
        later_ms=told["later_ms"],
    )


def one_start(seed: int) -> str:
    """What the fresh process does; it tells in JSON."""
    clock = MonotonicClock()
    began_at = clock.now()
    warm_up()
    warm_up_ms = 1000.0 * (clock.now() - began_at)
    (case,) = own.cases("H20", 1, seed)
    took = [see(case, "default").wall_ms for _ in range(1 + LATER_LOOKS)]
    with open("/proc/self/stat", encoding="utf-8") as stat, open("/proc/uptime", encoding="utf-8") as uptime:
        ticks = int(stat.read().rsplit(")", 1)[1].split()[19])
        age_s = float(uptime.read().split()[0]) - ticks / os.sysconf("SC_CLK_TCK")
    import_ms = 1000.0 * (age_s - (clock.now() - began_at))
    return json.dumps(
        {
            "import_ms": import_ms,
            "warm_up_ms": warm_up_ms,
            "first_ms": took[0],
            "later_ms": statistics.median(took[1:]),
        }
    )


def measure(
    seed: int, scenes: int, repeats: int, with_large: bool, families: tuple[str, ...] = SIZES, starts: int = 3
) -> Speeds:
    """All of it; rendering is done before the process is held on one core."""
    warm_up()
    groups = [own.cases(family, scenes, seed) for family in families]
    if with_large:
        groups += [(case,) for case in own.large(own.LARGE_COUNTS, seed)]
    with one_core():
        rows = [row(cases, method, repeats) for cases in groups for method in METHODS]
        stages = [stage_times(cases[0], repeats) for cases in groups]
        begun = tuple(first_look(seed) for _ in range(starts))
    names = list(dict.fromkeys(name for one in stages for name in one))
    return Speeds(
        rows=tuple(rows),
        sizes=tuple(cases[0].family for cases in groups),
        stages=tuple(
            Stage(name=name, took_ms=tuple(one.get(name, float("nan")) for one in stages)) for name in names
        ),
        starts=begun,
    )


def sheets(speeds: Speeds, command: str) -> tuple[tables.Sheet, ...]:
    """Three tables: sizes, stages, starts."""
    ms, number = tables.milliseconds, tables.number
    lines = []
    for one in speeds.rows:
        goal = GOALS_MS.get(one.size) if one.method == "default" else None
        lines.append(
            (
                one.size,
                str(one.parts),
                one.method,
                ms(one.first_ms),
                ms(one.whole_ms),
                ms(one.wall_ms),
                "-" if goal is None else f"{goal[0]}/{goal[1]}",
                ms(one.thin_ms),
                number(one.first_ms / one.thin_ms, 1),
                number(one.whole_ms / one.thin_ms, 1),
                number(one.whole_ms / one.parts, 1),
            )
        )
    sizes = tables.Sheet(
        title="Speed on one core, grey pair in, parts out",
        command=command,
        headings=(
            *("pictures", "parts", "method", "first pick\nms", "whole\nms", "by the\nwall", "goal\nms"),
            *("scikit-image's\nthinning ms", "first\n/ thin", "whole\n/ thin", "ms a\npart"),
        ),
        rows=tuple(lines),
        notes=(
            "Medians of processor time, and of the whole by the wall clock. B, H: 640x480, 5 MP: 2560x1920. "
            "Where a method does not tell its first pick before the rest, both times are the same. The "
            "thinning is that of both masks, in between the looks.",
        ),
    )
    totals = [
        sum(t for t in times if t == t) for times in zip(*(s.took_ms for s in speeds.stages), strict=True)
    ]
    stages = tables.Sheet(
        title="Stages of the default method",
        command=command,
        headings=("stage", *(f"{size}\nms" for size in speeds.sizes)),
        rows=(
            *((one.name, *(ms(took) for took in one.took_ms)) for one in speeds.stages),
            ("sum", *(ms(total) for total in totals)),
        ),
        notes=("Both pictures; one pile of each size, medians of processor time.",),
    )
    starts = tables.Sheet(
        title="First look after a start",
        command=command,
        headings=(
            "process",
            "start and\nimports ms",
            "warm-up\nms",
            "first look\nms",
            "later looks\nms",
            "ratio",
        ),
        rows=tuple(
            (
                str(i),
                ms(one.import_ms),
                ms(one.warm_up_ms),
                ms(one.first_ms),
                ms(one.later_ms),
                number(one.first_ms / one.later_ms),
            )
            for i, one in enumerate(speeds.starts, start=1)
        ),
        notes=(
            "By the wall clock; fresh processes with compiled code on disk; H20, default method. Goal: the "
            f"first look takes at most {FIRST_LOOK_GOAL:g} times the median of later ones.",
        ),
    )
    return sizes, stages, starts


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=None)
    parser.add_argument("--scenes", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--large", action="store_true", help="5 megapixels too")
    parser.add_argument("--one-start", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    seed = own.fresh_seed() if options.seed is None else options.seed
    if options.one_start:
        print(one_start(seed))
        return
    speeds = measure(seed, options.scenes, options.repeats, options.large)
    for one in sheets(speeds, f"python -m bench.speed --seed {seed}"):
        tables.show(one)


if __name__ == "__main__":
    main()
