"""Write fresh scenes with full ground truth as scene folders.

``python -m bench.piles --out DIR [--family H10 H20 H40] [--count 5] [--rig webcam] [--seed 7]``

DIR gets ``rigs/<rig>.json`` and ``scenes/<scene>/`` with both pictures, the request, the truth and who is
seen at which pixel: what `mikado evaluate` reads and what a scoring program needs. Millimetres. Without a
seed every run makes scenes that never were before; the seed is printed.
"""

from __future__ import annotations

import argparse
import json
import secrets
import time
from pathlib import Path

import cv2
import numpy as np

from bench.families import FAMILIES, scenery
from bench.meet import BLOCK_OWNER
from bench.rigs import RIGS, TABLE_Z_M, Rig, rays, rig_text
from bench.shots import Shot, shoot
from drivers.sim.geometry import apply
from vision.types import Floats

MM = 1000.0
THRESHOLD_HINT = (186, 255)


def scene_rng(seed: int, family: str, rig: Rig, number: int) -> np.random.Generator:
    """The random numbers of one scene: the same for the same words, unlike those of every other one."""
    return np.random.default_rng([seed, *f"{family} {rig.name}".encode(), number])


def draw(family: str, rig: Rig, seed: int, number: int) -> Shot:
    """Scene ``number`` of a family, of a set with this seed."""
    rng = scene_rng(seed, family, rig, number)
    return shoot(scenery(family, rig, rng, number), rig, rng)


def _mm(points_m: Floats) -> list[float]:
    told: list[float] = np.round(MM * points_m, 4).tolist()
    return told


def request_of(shot: Shot) -> dict[str, object]:
    """The request as the scene's file says it."""
    wish = shot.scenery.wish
    request: dict[str, object] = {
        "cls": "stick",
        "length_mm": round(MM * wish.length_m, 3),
        "diameter_mm": round(MM * wish.diameter_m, 3),
        "threshold_hint": list(THRESHOLD_HINT),
    }
    if wish.colour is not None:
        request["colour"] = wish.colour
    return request


def objects_of(shot: Shot) -> list[dict[str, object]]:
    """The objects as the truth file says them."""
    truth, rods = shot.truth, shot.scenery.rods
    left, right = (view.ends_px for view in shot.views)
    base_from_left = rays(shot.rig)[0][0].base_from_camera
    found: list[dict[str, object]] = []
    for n, rod in enumerate(rods):
        ends_base = apply(base_from_left, truth.ends[n])
        way = left[n, 1] - left[n, 0]
        nodes = [
            {
                "type": "end",
                "cam": _mm(truth.ends[n, k]),
                "base": _mm(ends_base[k]),
                "px_left": np.round(left[n, k], 3).tolist(),
                "px_right": np.round(right[n, k], 3).tolist(),
                "visible_left": bool(truth.ends_visible[n, 0, k]),
                "visible_right": bool(truth.ends_visible[n, 1, k]),
            }
            for k in (0, 1)
        ]
        found.append(
            {
                "id": n,
                "cls": "stick",
                "target": bool(truth.target[n]),
                "length_mm": round(MM * rod.length_m, 3),
                "radius_mm": round(MM * rod.radius_m, 4),
                "dims": None,
                "colour_name": rod.colour_name,
                "colour_rgb_linear": np.round(rod.colour[::-1], 4).tolist(),
                "material": rod.material,
                "p0_cam": _mm(truth.ends[n, 0]),
                "p1_cam": _mm(truth.ends[n, 1]),
                "p0_base": _mm(ends_base[0]),
                "p1_base": _mm(ends_base[1]),
                "nodes": nodes,
                "edges": [[0, 1]],
                "visible": dict(zip(("left", "right"), np.round(truth.visible[n], 4).tolist(), strict=True)),
                "in_frame": dict(zip(("left", "right"), truth.in_frame[n].tolist(), strict=True)),
                "tilt_deg": round(float(np.degrees(np.arcsin(abs(rod.axis[2])))), 3),
                "height_mm": round(MM * float(rod.centre[2] - TABLE_Z_M), 3),
                "baseline_angle_deg": round(float(np.degrees(np.arctan2(abs(way[1]), abs(way[0])))), 2),
                "covered_by": list(truth.covered_by(n)),
                "pickable": bool(truth.pickable[n]),
                "free": bool(truth.free[n]),
            }
        )
    return found


def truth_text(shot: Shot, name: str, family: str, seed: int) -> str:
    """The truth file."""
    base_from_left = rays(shot.rig)[0][0].base_from_camera
    content = {
        "scene": name,
        "family": family,
        "split": "own",
        "rig": shot.rig.name,
        "note": shot.scenery.note,
        "request": request_of(shot),
        "objects": objects_of(shot),
        "crossings": [
            {
                "above": c.above,
                "below": c.below,
                "point_cam": _mm(c.point),
                "point_base": _mm(apply(base_from_left, c.point)),
                "gap_mm": round(MM * c.gap_m, 4),
            }
            for c in shot.truth.crossings
        ],
        "contacts": [list(pair) for pair in shot.truth.touching],
        "expected_picks": "some" if shot.scenery.picks else "none",
        "seed": seed,
    }
    return json.dumps(content, indent=1) + "\n"


def write_rig(out: Path, rig: Rig) -> None:
    """The rig's calibration."""
    (out / "rigs").mkdir(parents=True, exist_ok=True)
    (out / "rigs" / f"{rig.name}.json").write_text(rig_text(rig), encoding="utf-8")


def write_scene(out: Path, name: str, shot: Shot, family: str, seed: int) -> None:
    """One scene's folder."""
    folder = out / "scenes" / name
    folder.mkdir(parents=True, exist_ok=True)
    for side, view in zip(("left", "right"), shot.views, strict=True):
        cv2.imwrite(str(folder / f"{side}.png"), view.pixels)
        ids = np.where(view.owner >= BLOCK_OWNER, BLOCK_OWNER, view.owner + 1).astype(np.uint8)
        cv2.imwrite(str(folder / f"ids_{side}.png"), ids)
    request = {"scene": name, "rig": shot.rig.name, "request": request_of(shot)}
    (folder / "request.json").write_text(json.dumps(request, indent=1) + "\n", encoding="utf-8")
    (folder / "gt.json").write_text(truth_text(shot, name, family, seed), encoding="utf-8")


def main() -> None:
    """Write the scenes."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--family", nargs="+", choices=FAMILIES, default=list(FAMILIES))
    parser.add_argument("--count", type=int, default=5, help="scenes of each family")
    parser.add_argument("--rig", nargs="+", choices=sorted(RIGS), default=["webcam"])
    parser.add_argument("--seed", type=int, default=None)
    options = parser.parse_args()
    seed = secrets.randbelow(10**6) if options.seed is None else options.seed
    began = time.perf_counter()
    for word in options.rig:
        rig, ending = RIGS[word], "" if word == "webcam" else "-ind"
        write_rig(options.out, rig)
        for family in options.family:
            density = 0.0
            for number in range(options.count):
                shot = draw(family, rig, seed, number)
                kind = f"-{shot.scenery.note}" if shot.scenery.note else ""
                write_scene(options.out, f"{family}{kind}-{number + 1}{ending}", shot, family, seed)
                density += shot.truth.crossings_per_rod / options.count
            print(f"{rig.name} {family}: {options.count} scenes, {density:.1f} crossings per stick")
    print(f"seed {seed}, {time.perf_counter() - began:.1f} s, written to {options.out}")


if __name__ == "__main__":
    main()
