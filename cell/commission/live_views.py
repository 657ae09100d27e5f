"""Views of a board through the configured cameras, each kept by itself when the board stands still."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from rich.console import Console

from cell.commission.camera_views import Collected, Refused, look, screened
from cell.config import CamerasConfig
from cell.errors import UsageError
from cell.frames import grey_of
from drivers.errors import DeviceTimeout, DriverError
from drivers.factory import Factory
from drivers.interfaces import StereoRig
from drivers.timing import Clock, MonotonicClock
from drivers.types import FramePair
from vision.board_faults import moved, repeats
from vision.boards import Board, Corners, board_pose
from vision.calibrate import View
from vision.coverage import Coverage, coverage
from vision.types import CameraModel

STILL: Final = 0.02
"""Between two pairs the corners move by less than this share of a square: the board stands still."""
_STILL_PAIRS: Final = 2
"""So many pairs after another must show it still."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """When to stop, and where kept pictures go."""

    views: int
    save: Path | None
    deadline_s: float


def capture(cameras: CamerasConfig, board: Board, wish: Wish, console: Console) -> Collected:
    """Look through the cameras until there are enough good views, the time is over, or Ctrl-C.

    Raises
    ------
    DriverError
        A camera fails before there is anything to calibrate with.
    UsageError
        A picture cannot be kept.
    """
    clock = MonotonicClock()
    rig = Factory(clock).rig(cameras.left, cameras.right, cameras.max_skew_s)
    rig.open()
    try:
        console.print("Hold the board into both pictures, still for a moment each time; Ctrl-C when done.")
        return watch(
            rig, board, wish, clock, cameras.look_timeout_s, lambda said: console.print(said, markup=False)
        )
    finally:
        rig.close()


def watch(
    rig: StereoRig, board: Board, wish: Wish, clock: Clock, timeout_s: float, say: Callable[[str], None]
) -> Collected:
    """The loop of `capture`, on an open rig."""
    kept: list[View] = []
    before: tuple[Corners | None, Corners | None] = (None, None)
    still = 0
    last_said = ""
    until = clock.now() + wish.deadline_s
    try:
        while len(kept) < wish.views and clock.now() < until:
            try:
                pair = rig.grab_pair(newer_than=clock.now(), timeout_s=timeout_s)
            except DeviceTimeout as error:
                if not kept:
                    raise
                say(f"{error}; calibrating with {len(kept)} views")
                break
            left, left_fault = look(grey_of(pair.left), board)
            right, right_fault = look(grey_of(pair.right), board)
            now = (left, right)
            still = still + 1 if _stands(now, before) else 0
            before = now
            if left is None or right is None:
                said = f"left: {left_fault or 'good'}; right: {right_fault or 'good'}"
            elif still < _STILL_PAIRS:
                continue
            elif repeats(now, [(view.left, view.right) for view in kept]) is not None:
                said = "seen before: move the board"
            else:
                kept.append(View(name=f"{len(kept) + 1:02d}", left=left, right=right))
                if wish.save is not None:
                    _save(wish.save, kept[-1].name, pair)
                missing = _coverage(kept, board).missing
                said = f"view {kept[-1].name} kept; " + (
                    f"missing: {missing[0]}" if missing else "nothing is missing"
                )
            if said != last_said:
                say(said)
                last_said = said
    except KeyboardInterrupt:
        say(f"stopped; calibrating with {len(kept)} views")
    except DriverError as error:
        if not kept:
            raise
        say(f"{error}; calibrating with {len(kept)} views")
    none: tuple[Refused, ...] = ()
    return screened(kept, board, none)


def _stands(
    now: tuple[Corners | None, Corners | None], before: tuple[Corners | None, Corners | None]
) -> bool:
    """Whether the board is where it was, in both pictures."""
    ways = [
        moved(a, b) if a is not None and b is not None else np.inf for a, b in zip(now, before, strict=True)
    ]
    return max(ways) < STILL


def _coverage(views: list[View], board: Board) -> Coverage:
    """Coverage by a camera that is not known yet: one of a usual angle of view."""
    first = views[0].left
    assert first is not None
    width, height = first.width_px, first.height_px
    focal = 0.9 * width
    camera = CameraModel(
        matrix=np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]]),
        distortion=np.zeros(5),
        width_px=width,
        height_px=height,
    )
    wide, high = board.size_m
    lefts = [view.left for view in views if view.left is not None]
    return coverage(
        [corners.pixels for corners in lefts],
        [view.right.pixels for view in views if view.right is not None],
        [board_pose(corners, board, camera).camera_from_board for corners in lefts],
        np.array([wide / 2, high / 2, 0.0]),
        (width, height),
    )


def _save(folder: Path, name: str, pair: FramePair) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for eye, frame in (("left", pair.left), ("right", pair.right)):
            done, encoded = cv2.imencode(".png", frame.pixels)
            if not done:
                raise UsageError(f"{folder}: the picture could not be encoded")
            (folder / f"{eye}_{name}.png").write_bytes(encoded.tobytes())
    except OSError as error:
        raise UsageError(f"{folder}: cannot be written: {error.strerror}") from error
