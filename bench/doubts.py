"""How often what the detector doubts is wrong: what stands behind the weights of its doubts.

``python -m bench.doubts [--heaps 180] [--seed S] [--families H10 H20 H40] [--rig webcam]``

Fresh dense heaps, as in `bench.first`. The order of picks, and the doubt that is stated, rest on signs: an
end that is not seen, a neighbour that is a little higher, a profile that no round rod explains. Here each
sign is held against the truth.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise

import cv2
import numpy as np

from bench import own
from bench.cases import Case
from bench.looks import tuning_for
from bench.rigs import RIGS
from bench.scoring import Found, assign
from bench.tables import Sheet, show
from cell.evaluate import STICK_TOLERANCE_M
from vision.canvas import in_space, on_canvas
from vision.crossings import BESIDE_HIGHER, Crossed, crossed, laid, meet, nearest
from vision.default import frame_of, warm_up
from vision.explain import Explanation, Frame, along_baseline
from vision.ghosts import below_ghosts
from vision.locate import locate
from vision.offer import how_seen
from vision.polish import Measured, sigmas
from vision.types import Floats

FAMILIES = ("H10", "H20", "H40")
SURE = (0.0, 0.5, 1.0, 1.5, 2.0, np.inf)
MISSED = (0.0, 0.002, 0.004, 0.006, 0.008, 0.012, 0.03)
STRAINS = (1.0, 1.5, 3.0, 5.0, np.inf)
NEAR_DIAMETERS = 1.7
"""Axes of parts beside each other are nearer than this, seen from above."""


@dataclass(slots=True)
class Told:
    """What was counted: of each sign how many there were and how many of them were wrong; the errors of views
    across, px, by how much their profile was missed; how many errors were inside two sigma."""

    signs: dict[str, list[int]] = field(default_factory=lambda: defaultdict(lambda: [0, 0]))
    orders: dict[str, list[int]] = field(default_factory=lambda: defaultdict(lambda: [0, 0]))
    beside: dict[str, list[int]] = field(default_factory=lambda: defaultdict(lambda: [0, 0]))
    missed: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    inside: list[int] = field(default_factory=lambda: [0, 0])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Look:
    """One look at one heap, as far as doubts go. ``true`` (C,) which true part each is, -1 none."""

    case: Case
    frame: Frame
    found: Explanation
    measured: Measured
    over: Crossed
    true: list[int]


def look(case: Case) -> Look:
    """Look once; the crossings are worked out as the detector has them."""
    tuning = tuning_for(case, "default")
    part = replace(case.part, length_tolerance_m=STICK_TOLERANCE_M["default"])
    kept: dict[str, object] = {}
    locate(case.left, case.right, case.stereo, part, tuning, case.table, kept.__setitem__)
    found, measured = kept["explain"], kept["polish"]
    assert isinstance(found, Explanation)
    assert isinstance(measured, Measured)
    frame = frame_of(case.stereo, part, tuning, case.table)
    ends = in_space(measured.parts[:, 1:7].reshape(-1, 2, 3), frame.on).reshape(-1, 2, 3)
    right = assign(tuple(Found(ends=one) for one in ends), case.truth.parts)
    return Look(
        case=case,
        frame=frame,
        found=found,
        measured=measured,
        over=crossed(measured.parts, measured.covariance, found.chosen, found.state, frame),
        true=[right[row][0] if row in right else -1 for row in range(len(ends))],
    )


def count(one: Look, told: Told) -> None:
    """Add one look to what was counted."""
    _signs(one, told)
    _orders(one, told)
    _errors(one, told)


def _between(value: float, bounds: tuple[float, ...], unit: str = "") -> str:
    for low, high in pairwise(bounds):
        if low <= value < high:
            return f"{low:g} and more{unit}" if np.isinf(high) else f"{low:g} to {high:g}{unit}"
    return f"beyond {bounds[-1]:g}{unit}"


def _signs(one: Look, told: Told) -> None:
    """Parts over which nothing seems to lie: wrong if they are no part, or something lies on them."""
    seen, parts = how_seen(one.found), one.case.truth.parts
    flat = along_baseline(one.measured.parts)
    haunted = below_ghosts(one.found, one.measured.parts, one.frame)
    for row, true in enumerate(one.true):
        if (one.over.above[:, row] > 0).any():
            continue
        strain = float(one.measured.strain[row])
        signs = {
            "all of them": True,
            "an end seen in each picture, at most one of four not": not (
                seen.blind[row] or seen.lacking[row]
            ),
            "two or more of four ends not seen": seen.lacking[row] and not seen.blind[row],
            "one picture shows no end at all": seen.blind[row],
            "both flanks on less than half of it": seen.half_seen[row],
            "along the baseline": flat[row],
            "along the baseline, not all ends seen clearly": seen.flat[row],
            "something not chosen would lie on it": haunted[row],
        } | {
            f"flanks contradict each other, times {stretch}": _between(strain, STRAINS) == stretch
            for stretch in (_between(low, STRAINS) for low in STRAINS[:-1])
        }
        for sign, there in signs.items():
            counted = told.signs[sign]
            if there:
                counted[0] += 1
                counted[1] += true < 0 or not parts[true].free


def _orders(one: Look, told: Told) -> None:
    """Crossings of two right ones: wrong if the truth has them the other way round. And parts beside each
    other: how many of them lie on the other after all."""
    upon = {(crossing.above, crossing.below) for crossing in one.case.truth.crossings}
    lying, diameter_m = laid(one.measured.parts, one.frame), one.frame.part.diameter_m
    for i, above in enumerate(one.true):
        for k, below in enumerate(one.true):
            if i == k or above < 0 or below < 0:
                continue
            if one.over.above[i, k] > 0:
                if (above, below) in upon or (below, above) in upon:
                    row = told.orders[_between(one.over.sure[i, k], SURE)]
                    row[0] += 1
                    row[1] += (below, above) in upon
            elif one.over.above[k, i] == 0 and meet(
                lying[i], lying[k], 0.0, 1.0, 0.0, (NEAR_DIAMETERS - 1.0) * diameter_m
            ):
                higher = _higher(lying[i], lying[k]) / diameter_m
                if higher >= 0:
                    name = f"higher by up to {BESIDE_HIGHER:g} diameters"
                    row = told.beside[name if higher < BESIDE_HIGHER else "higher still"]
                else:
                    row = told.beside["lower"]
                row[0] += 1
                row[1] += (above, below) in upon


def _higher(own: Floats, other: Floats) -> float:
    s, t = nearest(own, other)
    return float((1 - s) * own[0, 2] + s * own[1, 2] - (1 - t) * other[0, 2] - t * other[1, 2])


def _errors(one: Look, told: Told) -> None:
    """How far the middle of right ones is off across in each view, and in space against twice its sigma."""
    parts = one.measured.parts
    sigma_m, _ = sigmas(parts, one.measured.covariance * one.measured.strain[:, None, None], one.frame)
    ends_m = in_space(parts[:, 1:7].reshape(-1, 2, 3), one.frame.on).reshape(-1, 2, 3)
    for row, true in enumerate(one.true):
        if true < 0:
            continue
        ends = one.case.truth.parts[true].ends
        off_m = float(np.linalg.norm(ends_m[row].mean(axis=0) - ends.mean(axis=0)))
        told.inside[0] += 1
        told.inside[1] += off_m < 2 * sigma_m[row]
        at = on_canvas(ends, one.frame.on).reshape(2, 3)
        for view, missed in enumerate(one.measured.missed[row]):
            if np.isnan(missed):
                continue
            pixel = at[:, :2] - view * at[:, 2:] * [1.0, 0.0]
            mine = parts[row, 1:7].reshape(2, 3)
            mine = mine[:, :2] - view * mine[:, 2:] * [1.0, 0.0]
            way = (pixel[1] - pixel[0]) / np.linalg.norm(pixel[1] - pixel[0])
            off = mine.mean(axis=0) - pixel.mean(axis=0)
            told.missed[_between(float(missed), MISSED)].append(float(off @ [-way[1], way[0]]))


def run(families: tuple[str, ...], rig: str, seed: int, heaps: int) -> Iterator[Look]:
    """Look after look; families take turns."""
    each = [own.stream(family, -(-heaps // len(families)), seed, rig) for family in families]
    for number in range(heaps):
        yield look(next(each[number % len(families)]))


def _counts(of: dict[str, list[int]]) -> tuple[tuple[str, ...], ...]:
    return tuple(
        (name, str(number), str(wrong), f"{100 * wrong / number:.1f}" if number else "-")
        for name, (number, wrong) in of.items()
    )


def sheets(told: Told, heaps: int, command: str) -> tuple[Sheet, ...]:
    """The tables."""
    number, inside = told.inside
    return (
        Sheet(
            title=f"Parts over which nothing seems to lie, {heaps} heaps",
            command=command,
            headings=("sign", "parts", "wrong", "%"),
            rows=_counts(told.signs),
            notes=(
                "Wrong: it is no part, or something lies on it.",
                f"Middle within two sigma: {100 * inside / max(number, 1):.1f} % of {number} parts.",
            ),
        ),
        Sheet(
            title="Who lies on whom",
            command=command,
            headings=("standard deviations", "crossings", "wrong", "%"),
            rows=_counts(dict(sorted(told.orders.items()))),
        ),
        Sheet(
            title="Parts beside one, no order stated",
            command=command,
            headings=("measured", "pairs", "lie on it", "%"),
            rows=_counts(dict(sorted(told.beside.items()))),
        ),
        Sheet(
            title="Profiles that no round rod explains",
            command=command,
            headings=("missed by, share of contrast", "views", "off by, rms px", "median px"),
            rows=tuple(
                (
                    name,
                    str(len(off)),
                    f"{np.sqrt(np.mean(np.square(off))):.3f}",
                    f"{np.median(np.abs(off)):.3f}",
                )
                for name, off in sorted(told.missed.items())
            ),
        ),
    )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.doubts", description=__doc__)
    parser.add_argument("--heaps", type=int, default=180)
    parser.add_argument("--seed", type=int, default=None)
    parser.add_argument("--families", nargs="+", choices=FAMILIES, default=list(FAMILIES))
    parser.add_argument("--rig", choices=tuple(RIGS), default="webcam")
    asked = parser.parse_args()
    seed = own.fresh_seed() if asked.seed is None else asked.seed
    cv2.setNumThreads(1)
    warm_up()
    command = f"python -m bench.doubts --heaps {asked.heaps} --seed {seed} --rig {asked.rig}"
    print(command, file=sys.stderr)
    told = Told()
    for done, one in enumerate(run(tuple(asked.families), asked.rig, seed, asked.heaps), 1):
        count(one, told)
        if done % 30 == 0:
            print(f"{done} heaps", file=sys.stderr)
    for sheet in sheets(told, asked.heaps, command):
        show(sheet)


if __name__ == "__main__":
    main()
