"""Both methods on dense piles from fresh seeds of our own renderer, by number of sticks.

``python -m bench.detector [--seed S] [--piles 3] [--sticks 5 10 20 40]``

Every run has other piles unless it is given the seed that an earlier one printed.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

from bench import accuracy, own, tables
from bench.looks import METHODS, Look, look
from vision.default import warm_up


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """How much of it."""

    seed: int
    piles: int = 3
    sticks: tuple[int, ...] = (5, 10, 20, 40)
    repeats: int = 1


USUAL = Wish(seed=0)


def measure(wish: Wish) -> tuple[accuracy.Row, ...]:
    """One row a number of sticks and method; the methods take turns."""
    warm_up()
    rows = []
    for sticks in wish.sticks:
        cases = own.dense(sticks, wish.piles, wish.seed)
        looks: dict[str, list[Look]] = {method: [] for method in METHODS}
        for method in METHODS:
            look(cases[0], method)
        for case in cases:
            for method in METHODS:
                looks[method].append(look(case, method, wish.repeats))
        rows += [accuracy.row(f"N={sticks}", method, looks[method]) for method in METHODS]
    return tuple(rows)


def sheet(rows: tuple[accuracy.Row, ...], wish: Wish) -> tables.Sheet:
    """The table."""
    return tables.Sheet(
        title=f"Dense piles of our own renderer, 640 x 480, seed {wish.seed}",
        command=f"python -m bench.detector --seed {wish.seed} --piles {wish.piles}",
        headings=accuracy.HEADINGS,
        rows=tuple(accuracy.cells(one) for one in rows),
        notes=accuracy.NOTES,
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=None)
    parser.add_argument("--piles", type=int, default=USUAL.piles)
    parser.add_argument("--sticks", type=int, nargs="+", default=list(USUAL.sticks))
    parser.add_argument("--repeats", type=int, default=USUAL.repeats)
    options = parser.parse_args()
    seed = own.fresh_seed() if options.seed is None else options.seed
    wish = Wish(seed=seed, piles=options.piles, sticks=tuple(options.sticks), repeats=options.repeats)
    tables.show(sheet(measure(wish), wish))


if __name__ == "__main__":
    main()
