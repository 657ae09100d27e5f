"""Hand-eye on rendered poses with truth: our fit beside every closed form, both mountings.

``python -m bench.hand_eye [--draws 10]`` draws fifteen poses of each set again and again, and prints the
error of points of the pick area, 400 mm before the left camera. With ``kinhec`` installed (PyPI, no part of
the project's locks) its reference solvers run on the same draws, from the same board poses.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from cell.commission.hand_eye import area_points
from tests.fakes.boardrig import SHARED, Session, errors_mm, rendered
from vision import transforms
from vision.handeye import HandEye, closed_forms, mount_from_held
from vision.handeye_checks import calibrate
from vision.handeye_fit import Noise, board_pose, fit
from vision.types import Floats, Transform

KINHEC: Final = importlib.util.find_spec("kinhec") is not None
POSES: Final = 15
DISTANCE_M: Final = 0.4


@dataclass(slots=True)
class Row:
    """Errors of one method, mm, over draws and points."""

    name: str
    errors_mm: list[Floats]

    def text(self) -> str:
        """Median, 95th percentile, largest."""
        each = np.concatenate(self.errors_mm)
        each = each[np.isfinite(each)]
        if not len(each):
            return f"{self.name:28s} gave up"
        return f"{self.name:28s} {np.median(each):8.3f} {np.percentile(each, 95):8.3f} {each.max():8.3f}"


def _peers(helds: list[Transform], boards: list[Transform]) -> dict[str, HandEye]:
    """What KinHEC's solvers say, where it is installed; its poses are (N, 4, 4), its motions A X = X B."""
    if not KINHEC:
        return {}
    solvers: Any = importlib.import_module("kinhec.solvers")
    arms = np.stack([_matrix(transforms.invert(held)) for held in helds])
    seen = np.stack([_matrix(board) for board in boards])
    pairs = [(i, j) for i in range(len(arms)) for j in range(i + 1, len(arms))]
    a = np.stack([np.linalg.inv(arms[j]) @ arms[i] for i, j in pairs])
    b = np.stack([seen[j] @ np.linalg.inv(seen[i]) for i, j in pairs])
    found: dict[str, Floats] = {}
    for name, solver in solvers.AXXB_SOLVERS.items():
        found[f"KinHEC {name}"] = np.asarray(solver(a, b), dtype=np.float64)
    best = found.get("KinHEC daniilidis", next(iter(found.values())))
    found["KinHEC refine_lm"] = np.asarray(solvers.refine_lm(a, b, best), dtype=np.float64)
    for name, solver in solvers.AXYB_SOLVERS.items():
        found[f"KinHEC {name}"] = np.asarray(solver(arms, np.linalg.inv(seen))[0], dtype=np.float64)
    return {
        name: HandEye(
            mount_from_camera=transforms.make(transforms.nearest_rotation(m[:3, :3]), m[:3, 3]),
            held_from_board=transforms.identity(),
        )
        for name, m in found.items()
    }


def _matrix(pose: Transform) -> Floats:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = pose.rotation, pose.translation
    return matrix


def run(session: Session, draws: int) -> list[Row]:
    """All methods over the draws."""
    area = area_points(session.stereo, DISTANCE_M)
    rng = np.random.default_rng(1)
    boards = [board_pose(s, session.stereo) for s in session.sightings]
    rows: dict[str, Row] = {}

    def add(name: str, found: HandEye | None) -> None:
        rows.setdefault(name, Row(name=name, errors_mm=[])).errors_mm.append(
            errors_mm(found, session.truth, area)
        )

    for _ in range(draws):
        chosen = sorted(rng.choice(len(session.sightings), POSES, replace=False).tolist())
        sightings = [session.sightings[k] for k in chosen]
        helds = [mount_from_held(s, session.mount) for s in sightings]
        seen = [board for k in chosen if (board := boards[k]) is not None]
        for form in closed_forms(helds, seen):
            add(form.name, form.found)
        for name, found in _peers(helds, seen).items():
            add(name, found)
        start = next(form.found for form in closed_forms(helds, seen) if form.found is not None)
        plain = Noise(arm_m=0.0, arm_rad=0.0)
        add("joint fit, arm believed", fit(sightings, session.stereo, session.mount, start, plain).found)
        add("joint fit", fit(sightings, session.stereo, session.mount, start, Noise()).found)
    first = calibrate(session.sightings[:POSES], session.stereo, session.mount, area)
    print(
        f"foretold by leaving out each of the first {POSES} poses: "
        f"{1e3 * float(np.median(first.area_m)):.3f} mm median, {1e3 * float(first.area_m.max()):.3f} "
        f"at worst"
    )
    return list(rows.values())


def main() -> int:
    """Print one table per mounting."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=10)
    options = parser.parse_args()
    if not SHARED.exists():
        print(f"no data at {SHARED}")
        return 1
    if not KINHEC:
        print("without the rows of KinHEC, which is not installed: pip install kinhec")
    for mode, words in (("eye_to_hand", "scene-mounted"), ("eye_in_hand", "robot-mounted")):
        print(
            f"\n{words}, {POSES} poses, {options.draws} draws; error of points {1e3 * DISTANCE_M:.0f} "
            f"mm away, mm"
        )
        rows = run(rendered(mode), options.draws)
        print(f"{'':28s} {'median':>8s} {'95 %':>8s} {'largest':>8s}")
        for row in rows:
            print(row.text())
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
