"""The published Table 1 again: SIFT, ORB and SURF beside the published method and ours, with its score.

``python -m bench.keypoints [--scenes SCENES] [--seed S]``

The paper's score is the share of segments belonging to the sticks that are right. A keypoint method makes
no segments, so for it two honest neighbours are counted: of its matches that begin on a part, the share that
also end on the same point of it in the other picture; and the share of parts with at least two right
matches, from which a segment could be had. For both graph methods: of the segments along a part the right
ones, and the share of parts found as a whole.
"""

from __future__ import annotations

import argparse
import importlib
import statistics
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from bench import own, tables
from bench.accuracy import by_size
from bench.cases import Case, of_folder
from bench.families import FAMILIES as OWN_FAMILIES
from bench.looks import METHODS, look
from bench.machine import worked_ms
from bench.scoring import share
from vision.default import warm_up
from vision.types import CameraModel, Floats, Grey

FAMILIES = ("A", "B", "C", "D", "E")
"""Side by side, overlapping, transparent, and two kinds of plates, as in the paper."""
OWN_SCENES = 3
RATIO = 0.8
"""A match counts when its best is at least this much nearer than its second (Lowe 2004)."""
NEAR_PX = 3.0
"""How far from the true place a match may end: 8 mm of depth are 2 to 4 px on these rigs."""
REACH_PX = 3
"""A keypoint so near to a part belongs to it: it may sit on its rim."""
LEAST_MATCHES = 2

Descriptors = npt.NDArray[Any]  # float32 or uint8, as the method likes
Extract = Callable[[Grey], tuple[Floats, Descriptors]]
"""A picture to keypoints (K, 2) px and their descriptors (K, D)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One method on one family: both shares, how many things the first is of, and ms a pair."""

    family: str
    method: str
    right: float
    of: int
    parts: float
    took_ms: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Peer:
    """A keypoint method by name; ``norm`` by which its descriptors are compared."""

    name: str
    norm: int
    extract: Extract


def sift(grey: Grey) -> tuple[Floats, Descriptors]:
    """OpenCV's SIFT as it comes."""
    return _opencv(cv2.SIFT.create(), grey, 128)


def orb(grey: Grey) -> tuple[Floats, Descriptors]:
    """OpenCV's ORB, up to 2000 points (the usual 500 would be spent on the brightest part)."""
    return _opencv(cv2.ORB.create(nfeatures=2000), grey, 32)


def _opencv(detector: cv2.Feature2D, grey: Grey, width: int) -> tuple[Floats, Descriptors]:
    points, described = detector.detectAndCompute(grey, None)
    if not points:
        return np.zeros((0, 2)), np.zeros((0, width), np.float32)
    return np.array([point.pt for point in points], np.float64), np.asarray(described)


def peers() -> tuple[tuple[Peer, ...], tuple[str, ...]]:
    """The keypoint methods that can run here, and what is missing, in words."""
    found = [
        Peer(name="SIFT", norm=cv2.NORM_L2, extract=sift),
        Peer(name="ORB", norm=cv2.NORM_HAMMING, extract=orb),
    ]
    try:
        library = importlib.import_module("mahotas.features.surf")
    except ImportError:
        return tuple(found), ("SURF NOT RUN: mahotas is not installed (pip install mahotas, or make bench).",)

    def surf(grey: Grey) -> tuple[Floats, Descriptors]:
        rows = np.asarray(library.surf(grey, threshold=0.1, max_points=4096))
        # row, column, scale, score, sign, direction, then 64 numbers
        return rows[:, 1::-1].astype(np.float64), np.ascontiguousarray(rows[:, 6:], np.float32)

    return (*found, Peer(name="SURF", norm=cv2.NORM_L2, extract=surf)), ()


def matched(left: Descriptors, right: Descriptors, norm: int) -> npt.NDArray[np.int64]:
    """(M, 2) pairs that are each other's best and clearly better than the second."""
    if len(left) < 2 or len(right) < 2:
        return np.zeros((0, 2), np.int64)
    matcher = cv2.BFMatcher(norm)
    back = {m.queryIdx: m.trainIdx for m in matcher.match(right, left)}
    pairs = [
        (best.queryIdx, best.trainIdx)
        for best, second in matcher.knnMatch(left, right, k=2)
        if best.distance < RATIO * second.distance and back.get(best.trainIdx) == best.queryIdx
    ]
    return np.array(pairs, np.int64).reshape(-1, 2)


def part_at(points: Floats, case: Case) -> npt.NDArray[np.int64]:
    """(K,) which true part, counted from 1, each point of the left picture is on or beside; 0: none."""
    shows = case.shows[0]
    found = np.zeros(len(points), np.int64)
    near = [(u, v) for u in range(-REACH_PX, REACH_PX + 1) for v in range(-REACH_PX, REACH_PX + 1)]
    for u, v in sorted(near, key=lambda step: -(step[0] ** 2 + step[1] ** 2)):  # the nearest last: it stays
        column = np.clip(np.rint(points[:, 0]).astype(int) + u, 0, shows.shape[1] - 1)
        row = np.clip(np.rint(points[:, 1]).astype(int) + v, 0, shows.shape[0] - 1)
        here = shows[row, column]
        found[here > 0] = here[here > 0]
    return found


def true_places(points: Floats, part: npt.NDArray[np.int64], case: Case) -> Floats:
    """(K, 2) px where points of the left picture that lie on ``part`` (K,) are in the right picture.

    A point's depth is that of the place on its part's edges that it is nearest to in the picture.
    """
    camera, along = case.stereo.left, np.linspace(0.0, 1.0, 201)[:, None]
    rays = cv2.undistortPoints(points.reshape(-1, 1, 2), camera.matrix, camera.distortion).reshape(-1, 2)
    places = np.empty((len(points), 3))
    for number in np.unique(part):
        at = np.concatenate([a + along * (b - a) for a, b in case.truth.parts[number - 1].edges])
        for k in np.flatnonzero(part == number):
            off = np.linalg.norm(at[:, :2] / at[:, 2:] - rays[k], axis=1)
            places[k] = at[int(np.argmin(off)), 2] * np.array([rays[k, 0], rays[k, 1], 1.0])
    moved = places @ case.stereo.right_from_left.rotation.T + case.stereo.right_from_left.translation
    return project(moved, case.stereo.right)


def project(points: Floats, camera: CameraModel) -> Floats:
    """(N, 3) m in a camera's own frame to (N, 2) px of its raw picture."""
    seen, _ = cv2.projectPoints(
        points.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), camera.matrix, camera.distortion
    )
    return np.asarray(seen, np.float64).reshape(-1, 2)


def judge(left: Floats, right: Floats, case: Case) -> tuple[int, int, set[int]]:
    """Of matches (M, 2) px each: those that begin on a target, the right ones of them, parts with enough."""
    part = part_at(left, case)
    wanted = np.array([False, *(one.target for one in case.truth.parts)])
    on = wanted[part]
    left, right, part = left[on], right[on], part[on]
    if not len(left):
        return 0, 0, set()
    good = np.linalg.norm(true_places(left, part, case) - right, axis=1) <= NEAR_PX
    count = np.bincount(part[good], minlength=len(wanted))
    return len(left), int(good.sum()), set(np.flatnonzero(count >= LEAST_MATCHES).tolist())


def keypoint_row(family: str, peer: Peer, cases: list[Case]) -> Row:
    """A keypoint method on one family."""
    took = []
    begun = right = had = asked = 0
    for case in cases:
        began_ms = worked_ms()
        left_points, left_described = peer.extract(case.left)
        right_points, right_described = peer.extract(case.right)
        pairs = matched(left_described, right_described, peer.norm)
        took.append(worked_ms() - began_ms)
        some, good, parts = judge(left_points[pairs[:, 0]], right_points[pairs[:, 1]], case)
        begun, right = begun + some, right + good
        targets = {j for j, one in enumerate(case.truth.parts, start=1) if one.asked}
        had, asked = had + len(parts & targets), asked + len(targets)
    return Row(
        family=family,
        method=peer.name,
        right=share(right, begun),
        of=begun,
        parts=share(had, asked),
        took_ms=statistics.median(took),
    )


def measure(cases: tuple[Case, ...]) -> tuple[tuple[Row, ...], tuple[str, ...]]:
    """All methods on all families of Table 1 among the cases; and what could not be run."""
    warm_up()
    runnable, missing = peers()
    rows: list[Row] = []
    for family in sorted({case.family for case in cases}, key=by_size):
        here = [case for case in cases if case.family == family]
        for peer in runnable:
            peer.extract(here[0].left)  # the first call of a library loads more than it works
            rows.append(keypoint_row(family, peer, here))
        for method in METHODS:
            look(here[0], method)
            looks = [look(case, method).score for case in here]
            ms = [look(case, method).whole_ms for case in here]
            rows.append(
                Row(
                    family=family,
                    method=method,
                    right=share(sum(s.segments_right for s in looks), sum(s.segments for s in looks)),
                    of=sum(s.segments for s in looks),
                    parts=share(sum(s.asked_hit for s in looks), sum(s.asked for s in looks)),
                    took_ms=statistics.median(ms),
                )
            )
    return tuple(rows), missing


def cases_of(scenes: Path | None, seed: int) -> tuple[tuple[Case, ...], tuple[str, ...]]:
    """Scenes A to E of a set; without one those our own renderer has, and what that leaves out."""
    if scenes is not None:
        return tuple(case for case in of_folder(scenes) if case.family in FAMILIES), ()
    here = [family for family in FAMILIES if family in OWN_FAMILIES]
    away = [family for family in FAMILIES if family not in OWN_FAMILIES]
    return tuple(case for family in here for case in own.cases(family, OWN_SCENES, seed)), (
        f"{', '.join(away)} NOT RUN: our renderer does not make them. Own scenes, seed "
        f"{seed}; with photorealistic ones: --scenes SCENES.",
    )


def sheet(rows: tuple[Row, ...], notes: tuple[str, ...], command: str) -> tables.Sheet:
    """The table."""
    return tables.Sheet(
        title="Table 1 of the paper again",
        command=command,
        headings=("family", "method", "right\n%", "of", "parts had\n%", "ms"),
        rows=tuple(
            (
                row.family,
                row.method,
                tables.percent(row.right),
                str(row.of),
                tables.percent(row.parts),
                tables.milliseconds(row.took_ms),
            )
            for row in rows
        ),
        notes=(
            "right: published, default: of the segments along a part those truly on it (3 mm across, 8 mm "
            "deep), the paper's score. SIFT, ORB, SURF make no segments: of the matches that begin on a "
            f"part those that end within {NEAR_PX:g} px of the same point in the other picture. parts had: "
            f"found as a whole; for keypoints those with at least {LEAST_MATCHES} right matches, from which "
            f"a segment could be had. Matches are each other's best, ratio {RATIO:g}. ms: of "
            "processor time, both pictures and the matching.",
            *notes,
        ),
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", type=Path, default=None)
    parser.add_argument("--seed", type=int, default=None)
    options = parser.parse_args()
    seed = own.fresh_seed() if options.seed is None else options.seed
    cases, left_out = cases_of(options.scenes, seed)
    rows, missing = measure(cases)
    tables.show(sheet(rows, (*left_out, *missing), "python -m bench.keypoints --scenes SCENES"))


if __name__ == "__main__":
    main()
