"""All benches in one run, and their tables as a page of documentation.

``python -m bench.report [--out docs/benchmarks.md] [--scenes SCENES] [--seed S] [--effort usual]``

Prints every table as soon as it is there. Without SCENES (photorealistic scene folders with ground truth,
which are not part of this project) those tables are left out, and the page says so.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from bench import (
    detector,
    goals,
    keypoints,
    machine,
    mixed,
    own,
    photoreal,
    robustness,
    skeletons,
    speed,
    tables,
)
from bench.families import FAMILIES
from drivers.timing import MonotonicClock


@dataclass(frozen=True, slots=True, kw_only=True)
class Effort:
    """How much is measured. ``dense``: the family for single comparisons; ``large``:
    pictures of 5 megapixels too."""

    families: tuple[str, ...]
    rigs: tuple[str, ...]
    scenes: int
    speed_families: tuple[str, ...]
    speed_scenes: int
    repeats: int
    starts: int
    robustness_scenes: int
    mixes: tuple[str, ...]
    mixed_scenes: int
    dense: str
    large: bool


EFFORTS = {
    "small": Effort(
        families=("A",),
        rigs=("webcam",),
        scenes=1,
        speed_families=("A",),
        speed_scenes=1,
        repeats=1,
        starts=1,
        robustness_scenes=1,
        mixes=("lengths",),
        mixed_scenes=1,
        dense="A",
        large=False,
    ),
    "usual": Effort(
        families=FAMILIES,
        rigs=("webcam",),
        scenes=3,
        speed_families=speed.SIZES,
        speed_scenes=2,
        repeats=3,
        starts=3,
        robustness_scenes=1,
        mixes=tuple(mixed.MIXES),
        mixed_scenes=4,
        dense="H20",
        large=False,
    ),
    "long": Effort(
        families=FAMILIES,
        rigs=("webcam", "industrial"),
        scenes=20,
        speed_families=speed.SIZES,
        speed_scenes=5,
        repeats=7,
        starts=5,
        robustness_scenes=5,
        mixes=tuple(mixed.MIXES),
        mixed_scenes=20,
        dense="H20",
        large=True,
    ),
}


def sheets(effort: Effort, seed: int, scenes: Path | None) -> Iterator[tables.Sheet]:
    """All tables, one after another."""
    if scenes is not None:
        command = "python -m bench.photoreal SCENES"
        seen = photoreal.measure(scenes)
        yield goals.sheet("Goals, photorealistic scenes:", seen, command)
        yield photoreal.sheet(seen, command)
    for rig in effort.rigs:
        wish = detector.Wish(seed=seed, scenes=effort.scenes, families=effort.families, rig=rig)
        looks = detector.measure(wish)
        made = detector.sheet(looks, wish)
        yield goals.sheet(f"Goals, own scenes ({rig}):", looks, made.command)
        yield made
    yield mixed.sheet(effort.mixes, "webcam", effort.mixed_scenes, seed)
    wanted = robustness.Wish(seed=seed, scenes=effort.robustness_scenes, family=effort.dense)
    yield robustness.sheet(robustness.measure(wanted), wanted)
    cases, left_out = keypoints.cases_of(scenes, seed)
    if scenes is None:
        cases = tuple(case for case in cases if case.family in effort.families)
    rows, missing = keypoints.measure(cases)
    given = f"--seed {seed}" if scenes is None else "--scenes SCENES"
    yield keypoints.sheet(rows, (*left_out, *missing), f"python -m bench.keypoints {given}")
    large = " --large" if effort.large else ""
    thinned, notes = skeletons.measure(seed, effort.dense, effort.large)
    yield skeletons.sheet(thinned, notes, f"python -m bench.skeletons --seed {seed}{large}")
    speeds = speed.measure(
        seed, effort.speed_scenes, effort.repeats, effort.large, effort.speed_families, effort.starts
    )
    yield from speed.sheets(speeds, f"python -m bench.speed --seed {seed}{large}")


def page(
    found: list[tables.Sheet], facts: tuple[tuple[str, str], ...], how: str, photorealistic: bool
) -> str:
    """The page. A note that several tables have is told once."""
    lines = [
        "# Benchmarks",
        "",
        f"Written by `{how}`, never by hand. *published* is the method of the paper, complete and as "
        "printed; *default* is ours. Seeds are fresh unless given: another run draws other scenes.",
        "",
    ]
    if not photorealistic:
        lines += ["**Not run: photorealistic scenes** (none were given: `make bench SCENES=FOLDER`).", ""]
    lines += ["| | |", "|---|---|", *(f"| {name} | {value} |" for name, value in facts), ""]
    told: set[str] = set()
    for sheet in found:
        lines.append(tables.page(sheet, told))
        told |= set(sheet.notes)
    return "\n".join(lines)


def main() -> None:
    """Measure, print, and write the page if asked to."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=None)
    parser.add_argument("--scenes", type=Path, default=None)
    parser.add_argument("--seed", type=int, default=None)
    parser.add_argument("--large", action="store_true", help="pictures of 5 megapixels too, minutes more")
    parser.add_argument("--effort", choices=sorted(EFFORTS), default="usual")
    options = parser.parse_args()
    seed = own.fresh_seed() if options.seed is None else options.seed
    clock = MonotonicClock()
    began_at, load_before = clock.now(), machine.load()
    print(f"seed {seed}\n")
    found = []
    effort = EFFORTS[options.effort]
    effort = replace(effort, large=effort.large or options.large)
    for sheet in sheets(effort, seed, options.scenes):
        tables.show(sheet)
        found.append(sheet)
    facts = (
        *machine.facts(load_before),
        ("seed", str(seed)),
        ("effort", f"{options.effort}, {clock.now() - began_at:.0f} s"),
    )
    for name, value in facts:
        print(f"{name}: {value}")
    if options.out is not None:
        how = "make bench" + (" SCENES=FOLDER" if options.scenes else "")
        options.out.write_text(page(found, facts, how, options.scenes is not None), encoding="utf-8")
        print(f"written to {options.out}")


if __name__ == "__main__":
    main()
