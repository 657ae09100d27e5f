"""Both methods on scenes of our own renderer from fresh seeds, by family: heaps of 5, 10, 20, 40 and others.

``python -m bench.detector [--seed S] [--scenes 3] [--families A B H10] [--rig webcam]``
``python -m bench.detector --families H20 --scenes 2000 --methods default`` for rare events

Every run has other scenes unless it is given the seed that an earlier one printed.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

from bench import accuracy, goals, own, tables
from bench.families import FAMILIES
from bench.looks import METHODS, Look, look
from bench.rigs import RIGS
from vision.default import warm_up
from vision.types import Method


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """How much of it."""

    seed: int
    scenes: int = 3
    families: tuple[str, ...] = FAMILIES
    rig: str = "webcam"
    repeats: int = 1
    methods: tuple[Method, ...] = METHODS


USUAL = Wish(seed=0)


def measure(wish: Wish) -> tuple[Look, ...]:
    """All looks; the methods take turns. Scenes are drawn one at a time: there may be thousands."""
    warm_up()
    looks = []
    for family in wish.families:
        for number, case in enumerate(own.stream(family, wish.scenes, wish.seed, wish.rig)):
            for method in wish.methods:
                if number == 0:
                    look(case, method)  # the first one of a rig works its rectification out
                looks.append(look(case, method, wish.repeats))
    return tuple(looks)


def sheet(looks: tuple[Look, ...], wish: Wish) -> tables.Sheet:
    """The table."""
    return tables.Sheet(
        title=f"Fresh scenes of our own renderer, {RIGS[wish.rig].name}, seed {wish.seed}",
        command=f"python -m bench.detector --seed {wish.seed} --scenes {wish.scenes} --rig {wish.rig}",
        headings=accuracy.HEADINGS,
        rows=tuple(accuracy.cells(one) for one in accuracy.rows(looks)),
        notes=(
            "A spread; B five over one another; H10, H20, H40: heaps of so many, as dense as physical ones; "
            "T tilted and near the baseline; F many kinds, one wanted; L lights; N nothing to be found.",
            *accuracy.false_picks(looks),
            accuracy.wrong_firsts(looks, "default"),
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
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--repeats", type=int, default=USUAL.repeats)
    options = parser.parse_args()
    wish = Wish(
        seed=own.fresh_seed() if options.seed is None else options.seed,
        scenes=options.scenes,
        families=tuple(options.families),
        rig=options.rig,
        repeats=options.repeats,
        methods=tuple(options.methods),
    )
    looks = measure(wish)
    tables.show(goals.sheet("Goals, own scenes:", looks, "python -m bench.detector"))
    tables.show(sheet(looks, wish))


if __name__ == "__main__":
    main()
