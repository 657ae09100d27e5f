"""The same heaps under noise, blur, drifting light, texture, shadow, glare, and with a worse calibration.

``python -m bench.robustness [--seed S] [--scenes 2] [--family H20]``
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np

from bench import own, tables
from bench.disturb import DISTURBANCES
from bench.families import FAMILIES
from bench.looks import METHODS, look
from bench.scoring import Summary, share, summary
from vision.default import warm_up
from vision.types import Method


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """How much of it."""

    seed: int
    scenes: int = 2
    family: str = "H20"


USUAL = Wish(seed=0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One method under one disturbance; ``refused``: why pictures were not looked at, one reason a look."""

    name: str
    method: Method
    summary: Summary
    refused: tuple[str, ...]
    looks: int


def measure(wish: Wish) -> tuple[Row, ...]:
    """All disturbances of the same scenes."""
    warm_up()
    cases = own.cases(wish.family, wish.scenes, wish.seed)
    rows = []
    for number, disturbance in enumerate(DISTURBANCES):
        worse = [
            disturbance.apply(case, np.random.default_rng([wish.seed, number, i]))
            for i, case in enumerate(cases)
        ]
        for method in METHODS:
            looks = [look(case, method) for case in worse]
            seen = [one for one in looks if one.refused is None]
            rows.append(
                Row(
                    name=disturbance.name,
                    method=method,
                    summary=summary(one.score for one in seen),
                    refused=tuple(one.refused for one in looks if one.refused is not None),
                    looks=len(looks),
                )
            )
    return tuple(rows)


def sheet(rows: tuple[Row, ...], wish: Wish) -> tables.Sheet:
    """The table: a line a disturbance, the methods beside each other."""
    lines = []
    for name in dict.fromkeys(row.name for row in rows):
        line = [name]
        for method in reversed(METHODS):
            (row,) = (r for r in rows if r.name == name and r.method == method)
            total = row.summary
            line += [tables.percent(one) for one in (total.recall, total.precision, total.first)]
            if method == "default":
                line += [
                    tables.percent(total.free),
                    tables.spread(total.middle_mm),
                    tables.percent(share(len(row.refused), row.looks)),
                ]
        reasons = sorted({reason for row in rows if row.name == name for reason in row.refused})
        lines.append((*line, "; ".join(reasons)))
    some = any(line[-1] for line in lines)
    return tables.Sheet(
        title=f"Robustness: {wish.scenes} of {wish.family}, seed {wish.seed}",
        command=f"python -m bench.robustness --seed {wish.seed} --scenes {wish.scenes} "
        f"--family {wish.family}",
        headings=(
            *("the same scenes", "default\nrec. %", "default\nprec. %", "default\nfirst %"),
            *("default\nfree %", "default\nmiddle mm", "default\nrefused %"),
            *("publ.\nrec. %", "publ.\nprec. %", "publ.\nfirst %"),
            *(("why refused",) if some else ()),
        ),
        rows=tuple(tuple(line) if some else tuple(line[:-1]) for line in lines),
        notes=(
            "Recall and the rest are of the pictures that were not refused. Grey levels are of 255; light is "
            "changed after the camera's tone curve. Rows off: the right camera sits lower than its "
            "calibration says.",
        ),
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=None)
    parser.add_argument("--scenes", type=int, default=USUAL.scenes)
    parser.add_argument("--family", choices=FAMILIES, default=USUAL.family)
    options = parser.parse_args()
    seed = own.fresh_seed() if options.seed is None else options.seed
    wish = Wish(seed=seed, scenes=options.scenes, family=options.family)
    tables.show(sheet(measure(wish), wish))


if __name__ == "__main__":
    main()
