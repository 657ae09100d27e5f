"""Both methods over photorealistic scene folders with their ground truth, by family.

``python -m bench.photoreal SCENES [--only A1 B1] [--repeats 1]``

``SCENES`` is a set as `mikado evaluate` takes it, with a ``gt.json`` in every scene.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from bench import accuracy, goals, tables
from bench.cases import of_folder
from bench.looks import METHODS, Look, look
from vision.default import warm_up


def measure(folder: Path, only: tuple[str, ...] = (), repeats: int = 1) -> tuple[Look, ...]:
    """All looks at all scenes; the methods take turns."""
    warm_up()
    looks = []
    cases = of_folder(folder, only)
    for case in {case.stereo.left.width_px: case for case in cases}.values():
        for method in METHODS:
            look(case, method)  # the first one of a rig works its rectification out
    for case in cases:
        looks += [look(case, method, repeats) for method in METHODS]
    return tuple(looks)


def sheet(looks: tuple[Look, ...], command: str) -> tables.Sheet:
    """The table."""
    return tables.Sheet(
        title=f"Photorealistic scenes ({len({one.name for one in looks})})",
        command=command,
        headings=accuracy.HEADINGS,
        rows=tuple(accuracy.cells(one) for one in accuracy.rows(looks)),
        notes=(
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
    parser.add_argument("scenes", type=Path)
    parser.add_argument("--only", nargs="+", default=[])
    parser.add_argument("--repeats", type=int, default=1)
    options = parser.parse_args()
    looks = measure(options.scenes, tuple(options.only), options.repeats)
    tables.show(goals.sheet("Goals, photorealistic scenes:", looks, "python -m bench.photoreal SCENES"))
    tables.show(sheet(looks, "python -m bench.photoreal SCENES"))


if __name__ == "__main__":
    main()
