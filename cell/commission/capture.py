"""A hand-eye session taken live: the arm goes, or is led, from stop to stop; pictures when all stands
still."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from cell.commission import session
from cell.commission.arm import LedArm, SlowArm
from cell.commission.session import Stop
from cell.errors import UsageError
from cell.frames import grey_of, pose_of, tool_down, transform_of
from drivers.errors import CommandRejected
from drivers.interfaces import StereoRig
from drivers.types import FramePair, JointAngles, RobotState, ToolPose
from vision import transforms
from vision.boards import Board, Corners, detect
from vision.types import Floats, Transform

STILL_PX: Final = 0.5
"""Median way of a corner between two pairs when the board stands still."""
STILL_TRIES: Final = 6
NEW_RAD, NEW_M = 0.12, 0.02
"""A led arm has to turn or go so far before the next pictures are taken."""

Ask = Callable[[str], bool]
Say = Callable[[str], None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Taking:
    """What a session is taken with. ``ask`` is a question that may be answered no."""

    arm: LedArm
    rig: StereoRig
    board: Board
    folder: Path
    look_timeout_s: float
    ask: Ask
    say: Say

    @property
    def moved(self) -> SlowArm:
        """The arm where the program moves it."""
        assert isinstance(self.arm, SlowArm), "opened to be moved"
        return self.arm


def begin(taking: Taking, point_m: Floats) -> None:
    """Bring the tool over the place where the dome stands, (3,) m in the base frame, straight down.

    Raises
    ------
    UsageError
        The arm cannot get there, or the person said no.
    """
    target = tool_down(point_m, 0.0)
    if not taking.moved.robot.reachable(target):
        raise UsageError(f"--start-mm: the arm does not reach {', '.join(f'{1e3 * v:.0f}' for v in point_m)}")
    pose = transform_of(target)
    if not taking.ask(f"start: {_way(taking, pose)}. Move there?"):
        raise UsageError("the start was refused; bring the arm there by hand and leave out --start-mm")
    taking.moved.line(pose)


def generated(taking: Taking, poses: Sequence[Transform]) -> tuple[Stop, ...]:
    """Go through generated poses, each previewed and confirmed; the arm ends where it began."""
    kept: list[tuple[str, ToolPose, JointAngles]] = []
    start = transform_of(taking.arm.robot.state().tool)
    for number, pose in enumerate(poses):
        name = f"{number + 1:02d}"
        if not taking.moved.robot.reachable(pose_of(pose)):
            taking.say(f"pose {name}: out of the arm's reach, left out")
            continue
        if not taking.ask(f"pose {name} of {len(poses)}: {_way(taking, pose)}. Move there?"):
            continue
        try:
            taking.moved.line(pose)
        except CommandRejected as error:
            taking.say(f"pose {name}: {error}; left out")
            continue
        _take(taking, name, kept)
    if kept:
        taking.moved.line(start)
    return _written(taking, kept)


def again(taking: Taking, routine: Sequence[Stop]) -> tuple[Stop, ...]:
    """Run a saved session once more."""
    kept: list[tuple[str, ToolPose, JointAngles]] = []
    for stop in routine:
        if stop.joints is None:
            raise UsageError(
                f"pose {stop.name} has no joints; a routine is a poses file of an earlier session"
            )
        if not taking.ask(f"pose {stop.name}: {_way(taking, stop.base_from_tool)}. Move there?"):
            continue
        taking.moved.joints(stop.joints)
        _take(taking, stop.name, kept)
    return _written(taking, kept)


def led(taking: Taking, count: int) -> tuple[Stop, ...]:
    """A person leads the arm; pictures are taken wherever it rests in a new pose. Ends at ``count`` or when
    asked to stop."""
    kept: list[tuple[str, ToolPose, JointAngles]] = []
    taking.say(f"Lead the arm to {count} poses, at least 30 degrees apart about two axes; rest at each.")
    while len(kept) < count:
        state = taking.arm.settled()
        now = transform_of(state.tool)
        if all(_new(now, transform_of(tool)) for _, tool, _ in kept):
            _take(taking, f"{len(kept) + 1:02d}", kept)
        taking.arm.stop.wait(0.3)
    return _written(taking, kept)


def _new(now: Transform, before: Transform) -> bool:
    return (
        transforms.rotation_distance_rad(now.rotation, before.rotation) > NEW_RAD
        or float(np.linalg.norm(now.translation - before.translation)) > NEW_M
    )


def _way(taking: Taking, pose: Transform) -> str:
    here = transform_of(taking.arm.robot.state().tool)
    far = float(np.linalg.norm(pose.translation - here.translation))
    turn = np.rad2deg(transforms.rotation_distance_rad(here.rotation, pose.rotation))
    x, y, z = 1e3 * pose.translation
    return f"tool to x {x:.0f}, y {y:.0f}, z {z:.0f} mm ({1e3 * far:.0f} mm and {turn:.0f} degrees from here)"


def _take(taking: Taking, name: str, kept: list[tuple[str, ToolPose, JointAngles]]) -> None:
    """One stop: wait until arm and board rest, keep the pictures if both or one shows the board."""
    before: FramePair | None = None
    for _ in range(STILL_TRIES):
        state = taking.arm.settled()
        pair = taking.rig.grab_pair(newer_than=taking.arm.stop.clock.now(), timeout_s=taking.look_timeout_s)
        seen = [detect(grey_of(frame), taking.board) for frame in (pair.left, pair.right)]
        if before is not None and _still(taking, before, seen):
            _keep(taking, name, state, pair, seen, kept)
            return
        before = pair
    taking.say(f"pose {name}: the board does not stand still; left out")


def _still(taking: Taking, before: FramePair, seen: list[Corners | None]) -> bool:
    for frame, now in zip((before.left, before.right), seen, strict=True):
        then = detect(grey_of(frame), taking.board)
        if now is None or then is None:
            continue
        _, a, b = np.intersect1d(now.ids, then.ids, return_indices=True)
        way = np.linalg.norm(now.pixels[a] - then.pixels[b], axis=1)
        if len(way) and float(np.median(way)) > STILL_PX:
            return False
    return True


def _keep(
    taking: Taking,
    name: str,
    state: RobotState,
    pair: FramePair,
    seen: list[Corners | None],
    kept: list[tuple[str, ToolPose, JointAngles]],
) -> None:
    counts = [0 if corners is None else len(corners.ids) for corners in seen]
    if max(counts) < session.LEAST_CORNERS:
        taking.say(f"pose {name}: no picture shows the board; left out")
        return
    session.keep(taking.folder, name, pair)
    kept.append((name, state.tool, state.joints))
    taking.say(f"pose {name}: kept, {counts[0]} and {counts[1]} corners")


def _written(taking: Taking, kept: list[tuple[str, ToolPose, JointAngles]]) -> tuple[Stop, ...]:
    if not kept:
        raise UsageError("no pose was kept: the board must be seen; nothing was written")
    path = session.write(taking.folder, kept)
    taking.say(f"{len(kept)} poses kept in {path}")
    return session.read(path)
