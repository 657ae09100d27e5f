"""One heap as a picture: how its parts lie, and how they were found.

``python -m bench.show FAMILY NUMBER --seed S --out FILE [--part P] [--zoom 6] [--rig webcam]``
``python -m bench.show SCENE --scenes FOLDER --out FILE [--part P] [--zoom 6]``

For heaps that `bench.first` or `bench.detector` name, or a scene of a folder. Above the pictures of both
cameras, below the same with lines: green how parts lie that were not found or were found wrong, red what was
found wrong, blue what was found right. With a part, only what is about it is drawn.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from bench import own, piles, rigs
from bench.cases import Case, of_folder
from bench.looks import see
from bench.rigs import RIGS
from bench.scoring import answer_of, assign
from vision.types import CameraModel, Floats, Grey, StereoModel

GREEN, RED, BLUE = (60, 200, 60), (50, 50, 255), (255, 150, 40)
MARGIN_PX = 25
Lines = list[tuple[Floats, tuple[int, int, int]]]
Picture = npt.NDArray[np.uint8]


def lines_of(case: Case) -> Lines:
    """Ends (2, 3) m and colours of what is drawn."""
    found = answer_of(see(case, "default").scene).found
    right = assign(found, case.truth.parts)
    had = {part for part, _ in right.values()}
    drawn: Lines = [(one.ends, BLUE if row in right else RED) for row, one in enumerate(found)]
    drawn += [(one.ends, GREEN) for row, one in enumerate(case.truth.parts) if one.asked and row not in had]
    return drawn


def pixels(ends: Floats, stereo: StereoModel, right: bool) -> Floats:
    """(2, 2) px of points (2, 3) m of the left camera's frame in one of the raw pictures."""
    camera: CameraModel = stereo.right if right else stereo.left
    seen = ends
    if right:
        seen = ends @ stereo.right_from_left.rotation.T + stereo.right_from_left.translation
    at, _ = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), camera.matrix, camera.distortion)
    return np.asarray(at, np.float64).reshape(-1, 2)


def enlarged(grey: Grey, corner: tuple[int, int], far: tuple[int, int], zoom: int) -> Picture:
    """A piece of a picture, in colours to draw on."""
    piece = grey[corner[1] : far[1], corner[0] : far[0]]
    large = cv2.resize(piece, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC)
    return np.asarray(cv2.cvtColor(large, cv2.COLOR_GRAY2BGR), np.uint8)


def picture(case: Case, part: int | None, zoom: int) -> Picture:
    """Both cameras beside each other, plain above and with lines below."""
    drawn = lines_of(case)
    columns: list[Picture] = []
    for right, grey in ((False, case.left), (True, case.right)):
        low, high = np.zeros(2), np.array([grey.shape[1], grey.shape[0]])
        if part is not None:
            about = pixels(case.truth.parts[part].ends, case.stereo, right)
            low = np.maximum(about.min(axis=0) - MARGIN_PX, low)
            high = np.minimum(about.max(axis=0) + MARGIN_PX, high)
        corner, far = (int(low[0]), int(low[1])), (int(high[0]), int(high[1]))
        plain = enlarged(grey, corner, far, zoom)
        lined = plain.copy()
        for ends, colour in drawn:
            if part is not None and not _near(ends, case.truth.parts[part].ends):
                continue
            at = ((pixels(ends, case.stereo, right) - corner + 0.5) * zoom).round().astype(int)
            cv2.line(lined, at[0].tolist(), at[1].tolist(), colour, 2, cv2.LINE_AA)
            for end in at:
                cv2.circle(lined, end.tolist(), zoom, colour, 2, cv2.LINE_AA)
        columns.append(np.concatenate([plain, np.full((4, plain.shape[1], 3), 255, np.uint8), lined]))
    height = max(len(one) for one in columns)
    filled = [
        cv2.copyMakeBorder(one, 0, height - len(one), 0, 6, cv2.BORDER_CONSTANT, value=(255, 255, 255))
        for one in columns
    ]
    return np.asarray(np.concatenate(filled, axis=1), np.uint8)


def _near(ends: Floats, other: Floats) -> bool:
    """Whether both ends of a line are near another's, whichever way round."""
    limit = 0.35 * float(np.linalg.norm(other[1] - other[0]))
    return any(np.linalg.norm(one - other, axis=1).max() < limit for one in (ends, ends[::-1]))


def heap(family: str, number: int, seed: int, rig: str) -> Case:
    """A heap of our own renderer; ``number`` from 1."""
    camera = RIGS[rig]
    shot = piles.draw(family, camera, seed, number - 1)
    return own.case_of(shot, rigs.known(camera), family, f"{family}-{number}", seed)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.show", description=__doc__)
    parser.add_argument("what", help="a family, or with --scenes the name of a scene")
    parser.add_argument("number", type=int, nargs="?", help="of a heap, as bench.first prints it, from 1")
    parser.add_argument("--seed", type=int, default=None)
    parser.add_argument("--scenes", type=Path, default=None)
    parser.add_argument("--part", type=int, default=None, help="only what is about this true part, from 0")
    parser.add_argument("--zoom", type=int, default=6)
    parser.add_argument("--rig", choices=tuple(RIGS), default="webcam")
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    if asked.scenes is not None:
        found = of_folder(asked.scenes, (asked.what,))
        if not found:
            parser.error(f"{asked.scenes} has no scene {asked.what}")
        case = found[0]
    elif asked.number is None or asked.seed is None:
        parser.error("a heap needs its number and --seed; a scene needs --scenes")
    else:
        case = heap(asked.what, asked.number, asked.seed, asked.rig)
    if asked.part is not None and not 0 <= asked.part < len(case.truth.parts):
        parser.error(f"--part {asked.part}: {case.name} has parts 0 to {len(case.truth.parts) - 1}")
    if not cv2.imwrite(str(asked.out), picture(case, asked.part, asked.zoom)):
        parser.error(f"--out {asked.out}: cannot be written")


if __name__ == "__main__":
    main()
