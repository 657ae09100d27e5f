"""A hand-eye session on disk: a folder of pictures and one file that says where the arm was for each.

Mikado's own file is JSON in metres with the six numbers of the tool, and the joints, so that the same file
is a routine to run again. Read besides: ``T_base_flange`` matrices (4, 4) in millimetres, as calibration
data sets have them.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from cell.calibration_file import Json
from cell.errors import UsageError
from cell.frames import transform_of
from drivers.types import FramePair, JointAngles, ToolPose
from vision import transforms
from vision.boards import Board, corner_points, detect
from vision.handeye import Sighting
from vision.types import Grey, Transform

POSES: Final = "poses.json"
LEAST_CORNERS: Final = 6
_ENDINGS: Final = (".png", ".bmp", ".tif", ".jpg")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stop:
    """Where the arm was for one pair of pictures; ``joints`` None in files of others."""

    name: str
    base_from_tool: Transform
    joints: JointAngles | None


def read(path: Path) -> tuple[Stop, ...]:
    """The stops of a poses file, in its order.

    Raises
    ------
    UsageError
        Missing, no such file, or a pose that is none.
    """
    try:
        data: Json = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(f"{path}: not readable as JSON: {error}") from error
    poses = data.get("poses") if isinstance(data, dict) else None
    if not isinstance(poses, list) or not poses:
        raise UsageError(f"{path}: a list 'poses' is expected")
    return tuple(_stop(path, k, pose) for k, pose in enumerate(poses))


def _stop(path: Path, number: int, pose: Json) -> Stop:
    where = f"{path}: pose {number}"
    if not isinstance(pose, dict):
        raise UsageError(f"{where}: an object is expected")
    name = pose.get("name")
    name = name if isinstance(name, str) else f"{number:02d}"
    try:
        if "tool" in pose:
            six = np.asarray(pose["tool"], dtype=np.float64).reshape(6)
            x, y, z, rx, ry, rz = (float(v) for v in six)
            place = transform_of(ToolPose(x=x, y=y, z=z, rx=rx, ry=ry, rz=rz))
        else:
            matrix = np.asarray(pose["T_base_flange"], dtype=np.float64).reshape(4, 4)
            turn = matrix[:3, :3]
            if np.abs(turn @ turn.T - np.eye(3)).max() > 1e-3 or np.linalg.det(turn) < 0:
                raise ValueError("T_base_flange does not rotate (is it left-handed or transposed?)")
            place = transforms.make(transforms.nearest_rotation(turn), matrix[:3, 3] * 1e-3)
        joints = None
        if pose.get("joints") is not None:
            a, b, c, d, e, f = (float(v) for v in np.asarray(pose["joints"], dtype=np.float64).reshape(6))
            joints = JointAngles(q_rad=(a, b, c, d, e, f))
    except (KeyError, TypeError, ValueError) as error:
        raise UsageError(
            f"{where}: {error}; 'tool' (x, y, z m, rotation vector rad) or 'T_base_flange' (4x4, mm) is "
            f"expected"
        ) from error
    if float(np.linalg.norm(place.translation)) > 5.0:
        raise UsageError(
            f"{where}: the tool is {np.linalg.norm(place.translation):.4g} m from the base; metres?"
        )
    return Stop(name=name, base_from_tool=place, joints=joints)


def write(folder: Path, stops: Sequence[tuple[str, ToolPose, JointAngles]]) -> Path:
    """Write the poses file of a session; its pictures were written by `keep`."""
    document: dict[str, Json] = {
        "version": 1,
        "units": "m, rad",
        "poses": [
            {"name": name, "tool": list(tool.six()), "joints": list(joints.q_rad)}
            for name, tool, joints in stops
        ],
    }
    path = folder / POSES
    try:
        path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from error
    return path


def keep(folder: Path, name: str, pair: FramePair) -> None:
    """Write the two pictures of a stop."""
    folder.mkdir(parents=True, exist_ok=True)
    for eye, frame in (("left", pair.left), ("right", pair.right)):
        path = folder / f"{eye}_{name}.png"
        if not cv2.imwrite(str(path), frame.pixels):
            raise UsageError(f"{path}: cannot be written")


def sighting(stop: Stop, left: Grey | None, right: Grey | None, board: Board) -> Sighting:
    """What two pictures show of the board at one stop; a picture that is not there shows nothing."""
    found = []
    for grey in (left, right):
        corners = None if grey is None else detect(grey, board)
        if corners is None or len(corners.ids) < LEAST_CORNERS:
            found += [np.zeros((0, 3)), np.zeros((0, 2))]
        else:
            found += [corner_points(board, corners.ids), corners.pixels]
    return Sighting(
        name=stop.name,
        base_from_tool=stop.base_from_tool,
        board_left_m=found[0],
        left_px=found[1],
        board_right_m=found[2],
        right_px=found[3],
    )


def seen_in(
    folder: Path, stops: Sequence[Stop], board: Board
) -> tuple[tuple[Sighting, ...], tuple[str, ...]]:
    """What the pictures of a folder show at each stop, and the names of stops that show no board.

    Raises
    ------
    UsageError
        No picture belongs to a stop, or none shows the board; told apart: shown mirrored.
    """
    sightings, blind, mirrored = [], [], 0
    for stop in stops:
        pictures = [_picture(folder, f"{eye}_{stop.name}") for eye in ("left", "right")]
        if pictures[0] is None and pictures[1] is None:
            raise UsageError(f"{folder}: no picture left_{stop.name} or right_{stop.name} (.png, .jpg, ...)")
        seen = sighting(stop, pictures[0], pictures[1], board)
        if seen.corners:
            sightings.append(seen)
            continue
        blind.append(stop.name)
        flipped = [None if p is None else np.ascontiguousarray(p[:, ::-1]) for p in pictures]
        mirrored += bool(sighting(stop, flipped[0], flipped[1], board).corners)
    if mirrored > len(stops) // 2:
        raise UsageError(
            f"{folder}: {mirrored} of {len(stops)} pictures show the board mirrored: the camera's "
            f"driver flips "
            "its pictures, or the board was printed mirrored; put that right first"
        )
    if not sightings:
        raise UsageError(f"{folder}: no picture shows the board; is it the board of this file?")
    return tuple(sightings), tuple(blind)


def _picture(folder: Path, stem: str) -> Grey | None:
    for ending in _ENDINGS:
        path = folder / (stem + ending)
        if path.is_file():
            picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            if picture is None:
                raise UsageError(f"{path}: not readable as a picture")
            return np.asarray(picture, dtype=np.uint8)
    return None
