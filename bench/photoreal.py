"""Both methods over photorealistic scene folders with their ground truth, by family.

``python -m bench.photoreal SCENES [--only A1 B1] [--repeats 1]``

``SCENES`` is a set as `mikado evaluate` takes it, with a ``gt.json`` in every scene.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from bench import accuracy, tables
from bench.cases import of_folder
from bench.looks import METHODS, Look, look
from vision.default import warm_up


def measure(folder: Path, only: tuple[str, ...] = (), repeats: int = 1) -> dict[str, list[Look]]:
    """All looks at all scenes, by method; both methods take turns."""
    warm_up()
    looks: dict[str, list[Look]] = {method: [] for method in METHODS}
    cases = of_folder(folder, only)
    for method in METHODS:
        look(cases[0], method)  # the first one of a rig works its rectification out
    for case in cases:
        for method in METHODS:
            looks[method].append(look(case, method, repeats))
    return looks


def rows(looks: dict[str, list[Look]]) -> tuple[accuracy.Row, ...]:
    """One row a family and method, then one for all that have something to pick."""
    found = []
    for family in sorted({one.family for one in looks["default"]}, key=accuracy.by_size):
        for method in METHODS:
            here = [one for one in looks[method] if one.family == family]
            if not all(one.score.negative for one in here):
                found.append(accuracy.row(family, method, here))
    for method in METHODS:
        positive = [one for one in looks[method] if not one.score.negative]
        found.append(accuracy.row("all", method, positive))
    return tuple(found)


def sheet(looks: dict[str, list[Look]], command: str) -> tables.Sheet:
    """The table."""
    negatives = []
    for method in METHODS:
        empty = [one for one in looks[method] if one.score.negative]
        false = sum(one.score.found for one in empty)
        where = ", ".join(f"{one.name} {one.score.found}" for one in empty if one.score.found)
        negatives.append(f"{method} {false}" + (f" ({where})" if where else ""))
    count = sum(one.score.negative for one in looks["default"])
    return tables.Sheet(
        title=f"Photorealistic scenes ({len(looks['default'])})",
        command=command,
        headings=accuracy.HEADINGS,
        rows=tuple(accuracy.cells(one) for one in rows(looks)),
        notes=(
            f"False picks in the {count} scenes with nothing to pick: {', '.join(negatives)}.",
            *accuracy.NOTES,
        ),
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", type=Path)
    parser.add_argument("--only", nargs="+", default=[])
    parser.add_argument("--repeats", type=int, default=1)
    options = parser.parse_args()
    looks = measure(options.scenes, tuple(options.only), options.repeats)
    tables.show(sheet(looks, "python -m bench.photoreal SCENES"))


if __name__ == "__main__":
    main()
