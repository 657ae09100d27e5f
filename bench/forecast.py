"""What `mikado forecast` promises beside what the detector does, at several distances.

``python -m bench.forecast [--scenes 12] [--seed N]``

The bench's webcams look at spread sticks from the stated heights above the table; the same cameras, the same
baseline, other distances. The error is that of the middle of each found stick, along the left camera's axis,
what all sticks of a distance share taken off (light shifts them alike: see the accuracy tables). Sticks
flatter than 30 degrees to the baseline are a row of their own.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, replace

import numpy as np

from bench import piles, rigs
from bench.looks import see
from bench.own import case_of, fresh_seed
from bench.rigs import TABLE_Z_M, WEBCAM, Rig
from bench.scoring import answer_of, assign
from bench.tables import Sheet, show
from vision.forecast import Pair, depth_sigma_m, disparity_sigma_px
from vision.types import Floats

DISTANCES_M = (0.40, 0.55)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measured:
    """Errors of the found sticks at one distance: ``depth_m`` and ``angle_rad`` (N,), to the baseline."""

    pair: Pair
    distance_m: float
    depth_m: Floats
    angle_rad: Floats


def lifted(rig: Rig, distance_m: float) -> Rig:
    """The rig with both cameras so far above the table."""
    cameras = rig.cameras
    eyes = {}
    for eye, layout in (("left", cameras.left), ("right", cameras.right)):
        x, y, z = layout.position_m
        mean = 0.5 * (cameras.left.position_m[2] + cameras.right.position_m[2])
        eyes[eye] = layout.model_copy(update={"position_m": (x, y, z - mean + TABLE_Z_M + distance_m)})
    return replace(rig, name=f"{rig.name}-{1e3 * distance_m:.0f}", cameras=cameras.model_copy(update=eyes))


def measure(distance_m: float, scenes: int, seed: int) -> Measured:
    """Look at fresh scenes of spread sticks from a distance."""
    rig = lifted(WEBCAM, distance_m)
    known = rigs.known(rig)
    depth, angle = [], []
    for number in range(scenes):
        case = case_of(piles.draw("A", rig, seed, number), known, "A", f"A-{number + 1}", seed)
        found = answer_of(see(case, "default").scene).found
        for i, (j, _) in assign(found, case.truth.parts).items():
            off = found[i].ends.mean(axis=0) - case.truth.parts[j].ends.mean(axis=0)
            way = case.truth.parts[j].ends[1] - case.truth.parts[j].ends[0]
            depth.append(float(off[2]))
            angle.append(math.atan2(abs(way[1]), abs(way[0])))
    stereo = known.stereo
    pair = Pair(
        focal_px=float(stereo.left.matrix[0, 0]),
        baseline_m=float(np.linalg.norm(stereo.right_from_left.translation)),
        width_px=stereo.left.width_px,
        height_px=stereo.left.height_px,
    )
    return Measured(pair=pair, distance_m=distance_m, depth_m=np.array(depth), angle_rad=np.array(angle))


def row(measured: Measured, flat: bool) -> tuple[str, ...]:
    """Measured spread beside the forecast of the same sticks."""
    chosen = (measured.angle_rad < math.radians(30.0)) == flat
    off = measured.depth_m[chosen]
    expected = [
        depth_sigma_m(measured.pair, measured.distance_m, disparity_sigma_px(float(a)))
        for a in measured.angle_rad[chosen]
    ]
    shared = float(np.median(measured.depth_m))
    # half of normal errors are within 0.674 sigma
    spread = float(np.median(np.abs(off - shared))) / 0.674 if len(off) else float("nan")
    foretold = float(np.sqrt(np.mean(np.square(expected)))) if len(off) else float("nan")
    return (
        f"{1e3 * measured.distance_m:.0f}",
        "under 30°" if flat else "over 30°",
        f"{len(off)}",
        f"{1e3 * shared:+.3f}",
        f"{1e3 * spread:.3f}",
        f"{1e3 * foretold:.3f}",
        f"{spread / foretold:.2f}",
    )


def sheet(scenes: int, seed: int) -> Sheet:
    """The table."""
    measured = [measure(distance, scenes, seed) for distance in DISTANCES_M]
    return Sheet(
        title="depth: forecast and measured",
        command=f"python -m bench.forecast --scenes {scenes} --seed {seed}",
        headings=(
            "distance mm",
            "to the baseline",
            "sticks",
            "shared mm",
            "spread mm",
            "forecast mm",
            "ratio",
        ),
        rows=tuple(row(one, flat) for one in measured for flat in (False, True)),
        notes=(
            "Spread: median distance from what all sticks of a distance share, as one standard deviation.",
        ),
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="depth: forecast and measured")
    parser.add_argument("--scenes", type=int, default=12)
    parser.add_argument("--seed", type=int)
    arguments = parser.parse_args()
    show(sheet(arguments.scenes, fresh_seed() if arguments.seed is None else arguments.seed))


if __name__ == "__main__":
    main()
