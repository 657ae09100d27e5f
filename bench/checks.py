"""What the checks of a pair of pictures cost, before and beside the detector.

``python -m bench.checks [--seed S] [--repeats 15]``

Processor time on one core, with one thread in OpenCV: medians over repeats, sum of both cameras. The detector
looks at the same pair for comparison.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Callable, Iterator
from typing import Final

import numpy as np

from bench import machine, own, tables
from bench.cases import Case
from bench.looks import tuning_for
from bench.machine import ProcessorClock
from bench.speed import one_core
from cell.pictures import PictureCheck
from drivers.types import Frame, FramePair
from vision import epipolar, light, quality, sharpness
from vision.default import warm_up
from vision.locate import locate
from vision.stereo import rectification
from vision.types import Grey

COMMAND: Final = "python -m bench.checks"
FAMILY: Final = "H20"
DEPTH_SHARES: Final = (0.8, 1.1)
"""Of the distance of the table: what may lie there."""


def median_ms(work: Callable[[], object], repeats: int) -> float:
    """Of the processor time one call takes."""
    clock, took = ProcessorClock(), []
    for _ in range(repeats):
        began_at = clock.now()
        work()
        took.append(1e3 * (clock.now() - began_at))
    return statistics.median(took)


def costs(case: Case, repeats: int) -> dict[str, float]:
    """ms of each check of one pair, in the order in which they are made."""
    pairs = list(_living(case, repeats + 1))
    both = [(case.left, pairs[0].left.pixels), (case.right, pairs[0].right.pixels)]
    rect = rectification(case.stereo)
    depth_m = case.table.offset_m * DEPTH_SHARES[0], case.table.offset_m * DEPTH_SHARES[1]
    part, tuning = case.part, tuning_for(case, "default")
    check, queue = PictureCheck(), iter(pairs)
    check.check(next(queue))
    return {
        "all checks of a look": median_ms(lambda: check.check(next(queue)), repeats),
        "black, saturated, flat": median_ms(lambda: [quality.assess(one) for one, _ in both], repeats),
        "blur": median_ms(lambda: [sharpness.blur_px(one) for one, _ in both], repeats),
        "unchanging": median_ms(lambda: [quality.unchanged(*one) for one in both], repeats),
        "light": median_ms(lambda: [light.light_change(*one) for one in both], repeats),
        "rows by the pictures": median_ms(
            lambda: epipolar.row_residual(case.left, case.right, rect, depth_m), repeats
        ),
        "the detector": median_ms(
            lambda: locate(case.left, case.right, case.stereo, part, tuning, case.table), max(1, repeats // 3)
        ),
    }


def _living(case: Case, count: int) -> Iterator[FramePair]:
    """The same pair with the noise of a living camera."""
    rng = np.random.default_rng(1)
    for number in range(count):
        left, right = (_noisy(grey, rng) for grey in (case.left, case.right))
        yield FramePair(
            left=Frame(camera="camera.left", pixels=left, captured_at=0.0, sequence=number),
            right=Frame(camera="camera.right", pixels=right, captured_at=0.0, sequence=number),
        )


def _noisy(grey: Grey, rng: np.random.Generator) -> Grey:
    noisy = grey.astype(np.int16) + rng.integers(-1, 2, grey.shape)
    return np.asarray(np.clip(noisy, 0, 255), np.uint8)


def sheet(seed: int, repeats: int) -> tables.Sheet:
    """One heap of 20 sticks in webcam pictures."""
    (case,) = own.cases(FAMILY, 1, seed)
    warm_up()
    with one_core():
        told = costs(case, repeats)
    height, width = case.left.shape
    return tables.Sheet(
        title=f"Checks of a pair of {width}x{height}",
        command=f"{COMMAND} --seed {seed}",
        headings=("check", "ms"),
        rows=tuple((name, tables.milliseconds(ms)) for name, ms in told.items()),
        notes=(
            "ms of processor time, both pictures together; the rows by the pictures are looked at only where "
            "the detector could not tell them by the ends of parts.",
            f"host: {machine.processor()}, load {machine.load()}.",
        ),
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog=COMMAND)
    parser.add_argument("--seed", type=int, default=None)
    parser.add_argument("--repeats", type=int, default=15)
    arguments = parser.parse_args()
    seed = own.fresh_seed() if arguments.seed is None else arguments.seed
    tables.show(sheet(seed, arguments.repeats))


if __name__ == "__main__":
    main()
