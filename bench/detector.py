"""Both methods on scenes of our own renderer from fresh seeds, by family: heaps of 5, 10, 20, 40 and others.

``python -m bench.detector [--seed S] [--scenes 3] [--families A B H10 H20 H40] [--rig webcam]``

Every run has other scenes unless it is given the seed that an earlier one printed.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

from bench import accuracy, own, tables
from bench.families import FAMILIES
from bench.looks import METHODS, Look, look
from bench.rigs import RIGS
from vision.default import warm_up


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """How much of it."""

    seed: int
    scenes: int = 3
    families: tuple[str, ...] = FAMILIES
    rig: str = "webcam"
    repeats: int = 1


USUAL = Wish(seed=0)


def measure(wish: Wish) -> tuple[accuracy.Row, ...]:
    """One row a family and method; the methods take turns."""
    warm_up()
    rows = []
    for family in wish.families:
        cases = own.cases(family, wish.scenes, wish.seed, wish.rig)
        looks: dict[str, list[Look]] = {method: [] for method in METHODS}
        for method in METHODS:
            look(cases[0], method)
        for case in cases:
            for method in METHODS:
                looks[method].append(look(case, method, wish.repeats))
        rows += [accuracy.row(family, method, looks[method]) for method in METHODS]
    return tuple(rows)


def sheet(rows: tuple[accuracy.Row, ...], wish: Wish) -> tables.Sheet:
    """The table."""
    return tables.Sheet(
        title=f"Fresh scenes of our own renderer, {RIGS[wish.rig].name}, seed {wish.seed}",
        command=f"python -m bench.detector --seed {wish.seed} --scenes {wish.scenes} --rig {wish.rig}",
        headings=accuracy.HEADINGS,
        rows=tuple(accuracy.cells(one) for one in rows),
        notes=(
            "A spread; B five over one another; H10, H20, H40: heaps of so many, as dense as physical ones.",
            *accuracy.NOTES,
        ),
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=None)
    parser.add_argument("--scenes", type=int, default=USUAL.scenes, help="of each family")
    parser.add_argument("--families", nargs="+", choices=FAMILIES, default=list(FAMILIES))
    parser.add_argument("--rig", choices=sorted(RIGS), default=USUAL.rig)
    parser.add_argument("--repeats", type=int, default=USUAL.repeats)
    options = parser.parse_args()
    wish = Wish(
        seed=own.fresh_seed() if options.seed is None else options.seed,
        scenes=options.scenes,
        families=tuple(options.families),
        rig=options.rig,
        repeats=options.repeats,
    )
    tables.show(sheet(measure(wish), wish))


if __name__ == "__main__":
    main()
