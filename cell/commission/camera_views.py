"""Views of a calibration board from a folder of pictures: which are used, which are refused and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from cell.errors import UsageError
from vision.board_faults import flaw, other_board, repeats, why_not
from vision.boards import Board, Corners, detect
from vision.calibrate import View
from vision.types import Grey

_ENDINGS: Final = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm")
_FINE: Final = 3
"""A set in which so many views were good may be judged by what is usual in it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Refused:
    """A view that is not used."""

    name: str
    why: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Collected:
    """Views to calibrate with, and those refused."""

    views: tuple[View, ...]
    refused: tuple[Refused, ...]


def from_folder(folder: Path, board: Board) -> Collected:
    """Views from ``left*`` and ``right*`` of a folder; what follows the word makes a pair.

    Raises
    ------
    UsageError
        No folder, or no pair in it.
    """
    if not folder.is_dir():
        raise UsageError(f"{folder}: no such folder")
    pictures = {
        eye: {
            path.stem[len(eye) :]: path
            for path in sorted(folder.iterdir())
            if path.suffix.lower() in _ENDINGS and path.stem.lower().startswith(eye)
        }
        for eye in ("left", "right")
    }
    rests = sorted(set(pictures["left"]) & set(pictures["right"]))
    if not rests:
        raise UsageError(
            f"{folder}: no pair of pictures called left... and right... ({len(pictures['left'])} left, "
            f"{len(pictures['right'])} right); the same must follow both words: left_01.png, right_01.png"
        )
    refused = [
        Refused(name=path.name, why=f"no picture of the other camera belongs to it ({other}{rest}...)")
        for eye, other in (("left", "right"), ("right", "left"))
        for rest, path in pictures[eye].items()
        if rest not in pictures[other]
    ]
    views: list[View] = []
    for rest in rests:
        seen: list[Corners | None] = []
        faults: list[str] = []
        for eye in ("left", "right"):
            path = pictures[eye][rest]
            corners, fault = look(_read(path), board)
            seen.append(corners)
            if fault is not None:
                faults.append(f"{path.name}: {fault}")
        name = rest.strip("_- .") or rest or "left/right"
        if faults:
            refused.append(Refused(name=name, why="; ".join(faults)))
        if seen[0] is not None or seen[1] is not None:
            views.append(View(name=name, left=seen[0], right=seen[1]))
    return screened(views, board, refused)


def look(grey: Grey | None, board: Board) -> tuple[Corners | None, str | None]:
    """The corners in a picture if it can be used; else, or besides, what is wrong with it."""
    if grey is None:
        return None, "not a picture OpenCV can read; is it cut off?"
    corners = detect(grey, board)
    if corners is None:
        return None, why_not(grey, board)
    fault = other_board(grey, corners, board) or flaw(corners, board)
    return (None, fault) if fault is not None else (corners, None)


def screened(views: Sequence[View], board: Board, refused: Sequence[Refused] = ()) -> Collected:
    """Leave out views that repeat another, and those much less sharp than the rest of the set."""
    edges = [c.edge_px for view in views for c in (view.left, view.right) if c is not None]
    usual = float(np.median(edges)) if len(edges) >= 2 * _FINE else None
    kept: list[View] = []
    out = list(refused)
    for view in views:
        faults = [flaw(c, board, usual) for c in (view.left, view.right) if c is not None]
        fault = next((f for f in faults if f is not None), None)
        if fault is None:
            again = repeats((view.left, view.right), [(k.left, k.right) for k in kept])
            if again is not None:
                fault = f"repeated: shows the board where view {kept[again].name} does"
        if fault is None:
            kept.append(view)
        else:
            out.append(Refused(name=view.name, why=fault))
    return Collected(views=tuple(kept), refused=tuple(out))


def _read(path: Path) -> Grey | None:
    content = np.frombuffer(path.read_bytes() or b"\0", dtype=np.uint8)
    picture = cv2.imdecode(content, cv2.IMREAD_GRAYSCALE)
    return None if picture is None else np.asarray(picture, dtype=np.uint8)
