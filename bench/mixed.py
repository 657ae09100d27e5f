"""Several products in one heap: does one look say which is which, and what does it cost beside one look each.

``python -m bench.mixed [--seed S] [--scenes 4] [--rig webcam] [--mixes lengths colours both widths]``

Every run has other scenes unless it is given the seed that an earlier one printed. "together" is one look
that knows all products, "each alone" one look for each, as for a cell that is not told what else lies there.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from bench import own, piles, rigs, tables
from bench.cases import truth_from
from bench.families import DIAMETER_M, Kind, Scenery, Wish, disc, dropped, look_of
from bench.machine import worked_ms
from bench.rigs import RIGS, Rig
from bench.scenes import grey_of
from bench.scoring import MIN_VISIBLE, TruePart, Truth, assign, found_of, share
from bench.shots import Shot, shoot
from cell.calibration import Calibration
from cell.colours import WORDS
from cell.evaluate import HEIGHT_M, STICK_TOLERANCE_M
from vision.default import warm_up
from vision.locate import locate
from vision.types import PartModel, Scene, Tuning

RADIUS_LENGTHS, THROWS = 0.62, 3
"""The disc on which all fall, in lengths of the rig's stick: as dense as heaps of 10 to 20."""

MIXES: dict[str, tuple[tuple[Kind, int], ...]] = {
    "lengths": (
        (Kind(length_m=0.10, diameter_m=DIAMETER_M), 5),
        (Kind(length_m=0.14, diameter_m=DIAMETER_M), 4),
        (Kind(length_m=0.07, diameter_m=DIAMETER_M), 4),
    ),
    "colours": (
        (Kind(length_m=0.10, diameter_m=DIAMETER_M), 4),
        (Kind(length_m=0.10, diameter_m=DIAMETER_M, colour="blue", gloss=0.15), 4),
        (Kind(length_m=0.10, diameter_m=DIAMETER_M, colour="red", gloss=0.15), 4),
    ),
    "both": (
        (Kind(length_m=0.09, diameter_m=DIAMETER_M), 3),
        (Kind(length_m=0.09, diameter_m=DIAMETER_M, colour="blue", gloss=0.15), 3),
        (Kind(length_m=0.13, diameter_m=DIAMETER_M), 3),
        (Kind(length_m=0.06, diameter_m=DIAMETER_M, colour="yellow", gloss=0.15), 3),
    ),
    "widths": (
        (Kind(length_m=0.10, diameter_m=DIAMETER_M), 4),
        (Kind(length_m=0.09, diameter_m=0.0064, colour="red", gloss=0.15), 3),
        (Kind(length_m=0.07, diameter_m=0.0024, colour="white"), 3),
    ),
}
"""Products, and how many of each; for the rig with sticks of 0.1 m. Grey cameras see the colours' light only,
so mixes of colours are for the others."""
TOLD_BY_COLOUR = ("colours", "both")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Heap:
    """One heap of several products, photographed. ``codes``: the product of every true part."""

    shot: Shot
    known: Calibration
    parts: tuple[PartModel, ...]
    codes: tuple[int, ...]
    truth: Truth


@dataclass(frozen=True, slots=True, kw_only=True)
class Count:
    """What looks at one product came to. ``mistaken``: of those found, really another product."""

    asked: int = 0
    hit: int = 0
    found: int = 0
    right: int = 0
    offered: int = 0
    offered_right: int = 0
    mistaken: int = 0

    def plus(self, other: Count) -> Count:
        """Both added up."""
        return Count(**{name: getattr(self, name) + getattr(other, name) for name in Count.__slots__})


def heaps(mix: str, rig: Rig, count: int, seed: int) -> Iterator[Heap]:
    """Fresh heaps of a mix; the order in which parts fall is by chance."""
    known = rigs.known(rig)
    scale = rig.stick_length_m / 0.1
    products = [replace(kind, length_m=round(kind.length_m * scale, 6)) for kind, _ in MIXES[mix]]
    colours = mix in TOLD_BY_COLOUR and not rig.mono
    parts = tuple(
        PartModel(
            code=code,
            name=f"{1000 * kind.length_m:.0f} x {1000 * kind.diameter_m:.1f} {kind.colour}",
            length_m=kind.length_m,
            length_tolerance_m=STICK_TOLERANCE_M["default"],
            diameter_m=kind.diameter_m,
            colour=WORDS[kind.colour] if colours else None,
        )
        for code, kind in enumerate(products, start=1)
    )
    lying = [code for code, (_, many) in enumerate(MIXES[mix], start=1) for _ in range(many)]
    for number in range(count):
        rng = piles.scene_rng(seed, f"mixed {mix}", rig, number)
        codes = tuple(int(code) for code in rng.permutation(lying))
        throws = disc(len(codes), RADIUS_LENGTHS * rig.stick_length_m, rng, THROWS)
        scenery = Scenery(
            rods=dropped(throws, tuple(products[code - 1] for code in codes), rng),
            look=look_of(rng),
            wish=Wish(length_m=products[0].length_m, diameter_m=products[0].diameter_m),
        )
        shot = shoot(scenery, rig, rng)
        told = json.loads(piles.truth_text(shot, mix, mix, seed))
        yield Heap(shot=shot, known=known, parts=parts, codes=codes, truth=truth_from(told, "stick"))


def see(heap: Heap, wanted: PartModel, among: tuple[PartModel, ...]) -> tuple[Scene, float]:
    """One look, and its processor time in ms."""
    left, right = (view.pixels for view in heap.shot.views)
    began_ms = worked_ms()
    scene = locate(
        grey_of(left),
        grey_of(right),
        heap.known.stereo,
        wanted,
        Tuning(height_m=HEIGHT_M),
        heap.known.table,
        colour_left=left if left.ndim == 3 else None,
        among=among,
    )
    return scene, worked_ms() - began_ms


def counted(heap: Heap, scene: Scene, part: PartModel) -> Count:
    """What a scene says of one product, against the truth."""
    own_truth = tuple(
        replace(true, target=code == part.code)
        for true, code in zip(heap.truth.parts, heap.codes, strict=True)
    )
    mine = [candidate for candidate in scene.recognised if candidate.part_code == part.code]
    found = tuple(found_of(candidate) for candidate in mine)
    right = assign(found, own_truth)
    others: tuple[TruePart, ...] = tuple(replace(true, target=not true.target) for true in own_truth)
    mistaken = [i for i in assign(found, others) if i not in right]
    asked = {i for i, true in enumerate(own_truth) if true.asked and true.visible >= MIN_VISIBLE}
    return Count(
        asked=len(asked),
        hit=len(asked & {j for j, _ in right.values()}),
        found=len(found),
        right=len(right),
        offered=sum(candidate.offered for candidate in mine),
        offered_right=sum(mine[i].offered for i in right),
        mistaken=len(mistaken),
    )


def measure(mix: str, rig: Rig, scenes: int, seed: int) -> list[tuple[str, ...]]:
    """Rows of the table: every product, together and alone."""
    counts: dict[tuple[str, int], Count] = {}
    spent: dict[str, list[float]] = {"together": [], "each alone": []}
    parts: tuple[PartModel, ...] = ()
    for heap in heaps(mix, rig, scenes, seed):
        parts = heap.parts
        whole, took_ms = see(heap, parts[0], parts[1:])
        spent["together"].append(took_ms)
        alone = [see(heap, part, ()) for part in parts]
        spent["each alone"].append(sum(took for _, took in alone))
        for part, (scene, _) in zip(parts, alone, strict=True):
            for way, seen in (("together", whole), ("each alone", scene)):
                key = way, part.code
                counts[key] = counts.get(key, Count()).plus(counted(heap, seen, part))
    rows: list[tuple[str, ...]] = []
    for part in parts:
        for way in spent:
            count = counts[way, part.code]
            rows.append(
                (
                    mix,
                    part.name,
                    way,
                    tables.percent(share(count.hit, count.asked)),
                    tables.percent(share(count.right, count.found)),
                    tables.percent(share(count.offered_right, count.offered)),
                    str(count.found - count.right),
                    str(count.mistaken),
                    tables.milliseconds(float(np.median(spent[way]))),
                )
            )
    return rows


def sheet(mixes: tuple[str, ...], rig: str, scenes: int, seed: int) -> tables.Sheet:
    """The table."""
    only = "" if mixes == tuple(MIXES) else f" --mixes {' '.join(mixes)}"
    return tables.Sheet(
        title=f"Several products in one heap, {RIGS[rig].name}, {scenes} heaps of each mix, seed {seed}",
        command=f"python -m bench.mixed --seed {seed} --scenes {scenes} --rig {rig}{only}",
        headings=(
            "mix",
            "product",
            "looked for",
            "rec.\n%",
            "prec.\n%",
            "offered\n%",
            "false",
            "other",
            "ms",
        ),
        rows=tuple(row for mix in mixes for row in measure(mix, RIGS[rig], scenes, seed)),
        notes=(
            "rec.: of parts of this product seen to at least a half in both pictures; prec.: right ones of "
            "all found as this product; offered: right ones of those offered; false: found and not right; "
            "other: of those, really a part of another product. ms: median of processor time for all "
            "products of a heap, one look together or one each.",
        ),
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=None)
    parser.add_argument("--scenes", type=int, default=4, help="of each mix")
    parser.add_argument("--mixes", nargs="+", choices=sorted(MIXES), default=list(MIXES))
    parser.add_argument("--rig", choices=sorted(RIGS), default="webcam")
    options = parser.parse_args()
    seed = own.fresh_seed() if options.seed is None else options.seed
    warm_up()
    tables.show(sheet(tuple(options.mixes), options.rig, options.scenes, seed))


if __name__ == "__main__":
    main()
