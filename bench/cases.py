"""A case: one stereo pair with what a detector may know of it, and the truth.

From rendered piles of our own, or from scene folders (the format of `mikado evaluate`) with a ``gt.json``.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from bench.scoring import PLATE, THIN, Crossing, TruePart, Truth
from cell import scenes
from cell.calibration import Calibration
from cell.evaluate import TOPOLOGY_TOLERANCE_M, TOPOLOGY_TOLERANCE_WIDTHS
from vision.colour import Colour
from vision.types import Floats, Grey, PartModel, Plane, StereoModel

Ids: TypeAlias = npt.NDArray[np.int32]
"""(H, W): number of the part that a pixel shows, counted from 1; 0 where there is none."""

PLATES = frozenset({"bracket", "spanner", "tee"})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """One pair. ``width_m``: how wide a part looks from above; ``shows``: which part a pixel shows, both
    views; ``colour_left`` the left picture in colour where it has any.
    """

    family: str
    name: str
    left: Grey
    right: Grey
    stereo: StereoModel
    table: Plane
    part: PartModel
    width_m: float
    truth: Truth
    shows: tuple[Ids, Ids]
    colour_left: Colour | None = None

    def changed(self, left: Grey, right: Grey, stereo: StereoModel | None = None) -> Case:
        """The same scene as other pictures, or as a worse calibration."""
        return replace(self, left=left, right=right, stereo=stereo or self.stereo)


def of_folder(folder: Path, only: tuple[str, ...] = ()) -> tuple[Case, ...]:
    """All scenes of a set that have a ground truth, by name.

    Raises
    ------
    UsageError, CalibrationError
        Nothing there, or something unreadable.
    """
    rigs: dict[str, Calibration] = {}
    cases = []
    for scene in scenes.find(folder, only):
        rig = rigs.setdefault(scene.rig, scenes.rig(scene))
        known = json.loads((scene.path / "gt.json").read_text(encoding="utf-8"))
        wanted = scenes.request(scene, 0.0)
        part = wanted.part
        if part.topology is not None:
            wide = max(TOPOLOGY_TOLERANCE_M, TOPOLOGY_TOLERANCE_WIDTHS * wanted.width_m)
            part = replace(part, length_tolerance_m=wide)
        if rig.table is None:
            raise ValueError(f"{rig.path}: table_plane_leftcam is missing")
        cases.append(
            Case(
                family=known["family"],
                name=scene.name,
                left=scenes.grey(scene, "left"),
                right=scenes.grey(scene, "right"),
                stereo=rig.stereo,
                table=rig.table,
                part=part,
                width_m=wanted.width_m,
                truth=truth_from(known, wanted.cls),
                shows=(_ids(scene.path / "ids_left.png", known), _ids(scene.path / "ids_right.png", known)),
                colour_left=scenes.colour(scene),
            )
        )
    return tuple(cases)


def truth_from(known: dict[str, Any], cls: str) -> Truth:  # a foreign file, read here and nowhere else
    """Ground truth as FORMAT.md describes it, millimetres, as our record."""
    parts = []
    place = {one["id"]: i for i, one in enumerate(known["objects"])}
    for one in known["objects"]:
        nodes = np.array([node["cam"] for node in one["nodes"]], np.float64).reshape(-1, 3) / 1000.0
        parts.append(
            TruePart(
                ends=_metres([one["p0_cam"], one["p1_cam"]]),
                edges=nodes[np.array(one["edges"], np.int64).reshape(-1, 2)],
                visible=float(min(one["visible"].values())),
                in_frame=bool(one["in_frame"]["left"] and one["in_frame"]["right"]),
                pickable=bool(one["pickable"]),
                free=bool(one.get("free", not one["covered_by"])),
                target=bool(one["target"]),
                alike=one["cls"] == cls,
                tolerance=PLATE if one["cls"] in PLATES else THIN,
            )
        )
    crossings = []
    for crossing in known["crossings"]:
        below = place[crossing["below"]]
        at = float("nan")
        if "point_cam" in crossing:
            start, end = parts[below].ends
            way = end - start
            at = float((_metres(crossing["point_cam"]) - start) @ way / (way @ way))
        crossings.append(Crossing(above=place[crossing["above"]], below=below, at=at))
    return Truth(parts=tuple(parts), crossings=tuple(crossings), negative=known["expected_picks"] == "none")


def _metres(millimetres: list[float] | list[list[float]]) -> Floats:
    return np.array(millimetres, np.float64) / 1000.0


def _ids(path: Path, known: dict[str, Any]) -> Ids:
    """The scene's own picture of ids (object id + 1, 250: other things) as places in our list, from 1."""
    pixels = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if pixels is None:
        raise ValueError(f"{path}: not a picture that can be read")
    place = np.zeros(256, np.int32)
    for i, one in enumerate(known["objects"], start=1):
        place[one["id"] + 1] = i
    return np.asarray(place[pixels], np.int32)
