"""Scene folders: stereo pairs with a calibration and a request, as the detector's records.

A set has ``rigs/<rig>.json`` and ``scenes/<scene>/`` with ``left.png``, ``right.png`` and ``request.json``.
Files are in millimetres; everything leaves in metres. Ground truth beside them is never read.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, TypeAlias

import cv2
import numpy as np

from cell.calibration import Calibration, load
from cell.colours import WORDS, in_colour
from cell.errors import UsageError
from drivers.types import Pixels
from vision.types import ColourRange, Floats, Grey, NodeKind, Outline, PartModel, Topology, read_only

Json: TypeAlias = "dict[str, Json] | list[Json] | str | float | int | bool | None"

MM: Final = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneFolder:
    """One scene on disk. ``name`` of its folder, ``rig`` of its calibration."""

    path: Path
    name: str
    rig: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """What the scene asks for.

    ``cls`` is the class word of the scene's own vocabulary, ``width_m`` how wide the part looks from above.
    """

    cls: str
    part: PartModel
    width_m: float


def find(scenes_dir: Path, only: tuple[str, ...] = ()) -> tuple[SceneFolder, ...]:
    """The scenes of a folder, by name; of the set's folder or of its ``scenes`` folder.

    Raises
    ------
    UsageError
        No scenes there, or a name in ``only`` that is not among them.
    """
    root = scenes_dir / "scenes" if (scenes_dir / "scenes").is_dir() else scenes_dir
    requests = sorted(root.glob("*/request.json"))
    if not requests:
        raise UsageError(f"{scenes_dir}: no scenes here (folders with left.png, right.png and request.json)")
    names = [path.parent.name for path in requests]
    unknown = sorted(set(only) - set(names))
    if unknown:
        raise UsageError(f"{scenes_dir}: no scene named {', '.join(unknown)}")
    return tuple(
        SceneFolder(path=path.parent, name=path.parent.name, rig=_text(_read(path), "rig", path))
        for path in requests
        if not only or path.parent.name in only
    )


def rig(scene: SceneFolder) -> Calibration:
    """The calibration of a scene's rig.

    Raises
    ------
    CalibrationError
        Missing or unusable.
    """
    return load(scene.path.parent.parent / "rigs" / f"{scene.rig}.json")


def request(scene: SceneFolder, length_tolerance_m: float) -> Request:
    """What a scene asks for, as a product.

    Raises
    ------
    UsageError
        The request cannot be read, a field is missing or of a wrong kind, or its colour is an unknown word.
    """
    path = scene.path / "request.json"
    fields = _member(_read(path), "request", path)
    cls = _text(fields, "cls", path)
    thickness = "diameter_mm" if "diameter_mm" in fields else "thickness_mm"
    part = PartModel(
        code=1,
        name=cls,
        length_m=_number(fields, "length_mm", path) * MM,
        length_tolerance_m=length_tolerance_m,
        diameter_m=_number(fields, thickness, path) * MM,
        topology=_topology(fields, path) if "nodes_model" in fields else None,
        colour=_colour_range(fields, path),
    )
    dims = fields.get("dims")
    if not isinstance(dims, dict) or "w" not in dims or part.topology is None:
        return Request(cls=cls, part=part, width_m=part.diameter_m)
    part = replace(part, outline=_outline(dims, part.topology, path))
    return Request(cls=cls, part=part, width_m=_number(dims, "w", path) * MM)


def grey(scene: SceneFolder, side: str) -> Grey:
    """A picture of a scene, ``left`` or ``right``, as (H, W) grey.

    Raises
    ------
    UsageError
        It cannot be read.
    """
    path = scene.path / f"{side}.png"
    pixels = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if pixels is None:
        raise UsageError(f"{path}: not a picture that can be read")
    return np.asarray(pixels, np.uint8)


def colour(scene: SceneFolder) -> Pixels | None:
    """The left picture of a scene as (H, W, 3) BGR; None when it is grey.

    Raises
    ------
    UsageError
        It cannot be read.
    """
    path = scene.path / "left.png"
    pixels = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if pixels is None:
        raise UsageError(f"{path}: not a picture that can be read")
    return in_colour(np.asarray(pixels, np.uint8))


def _colour_range(fields: dict[str, Json], path: Path) -> ColourRange | None:
    if fields.get("colour") is None:
        return None
    word = _text(fields, "colour", path)
    if word not in WORDS:
        raise UsageError(f"{path}: colour {word!r} is not known; use one of {', '.join(WORDS)}")
    return WORDS[word]


def _topology(fields: dict[str, Json], path: Path) -> Topology:
    nodes = fields["nodes_model"]
    edges, axis = fields.get("edges_model"), fields.get("axis_model")
    if not isinstance(nodes, list) or not isinstance(edges, list) or not isinstance(axis, list):
        raise UsageError(f"{path}: nodes_model, edges_model and axis_model must be lists")
    points, kinds = [], []
    try:
        for node in nodes:
            if not isinstance(node, dict):
                raise ValueError("a node must have p and type")
            points.append(np.asarray(node.get("p"), np.float64).reshape(3) * MM)
            kinds.append(NodeKind(node.get("type")))
        pairs = np.asarray(edges, np.int64).reshape(-1, 2)
        first, second = (int(n) for n in np.asarray(axis, np.int64).reshape(2))
    except (TypeError, ValueError) as error:
        raise UsageError(f"{path}: the product's graph cannot be read: {error}") from error
    used = [*pairs.reshape(-1).tolist(), first, second]
    if min(used) < 0 or max(used) >= len(points):
        raise UsageError(f"{path}: the product's graph names a node it does not have")
    return Topology(
        points=read_only(np.array(points)),
        kinds=tuple(kinds),
        edges=read_only(pairs),
        axis=(first, second),
    )


def _outline(dims: dict[str, Json], topology: Topology, path: Path) -> Outline:
    """The edge of a flat part: a spanner where the dimensions name its ring, otherwise bars with holes."""
    width = _number(dims, "w", path) * MM
    points = topology.points[:, :2]
    loops = [n for n, kind in enumerate(topology.kinds) if kind is NodeKind.LOOP_CENTRE]
    bars = []
    if "ro" in dims:
        ring, inner, head = (_number(dims, key, path) * MM for key in ("ro", "ri", "head"))
        jaws = [n for n, kind in enumerate(topology.kinds) if kind is NodeKind.END]
        if len(loops) != 1 or len(jaws) != 2:
            raise UsageError(f"{path}: a spanner has one loop centre and two ends")
        loop = points[loops[0]]
        handle = points[next(n for n in topology.axis if n != loops[0])] - loop
        reach = _number(dims, "L", path) * MM - ring - head
        middle = loop + reach * handle / np.linalg.norm(handle)
        mouth = points[jaws].mean(axis=0) - middle
        mouth = mouth / np.linalg.norm(mouth)
        return _flat(
            [np.stack([middle, loop])],
            width,
            discs=[[*loop, ring], [*middle, head]],
            holes=[[*loop, inner]],
            slots=[[*middle, *mouth, _number(dims, "gap", path) * MM]],
        )
    for a, b in topology.edges.tolist():
        way = (points[b] - points[a]) / np.linalg.norm(points[b] - points[a])
        # the nodes are those of the ideal skeleton, which ends half a width before a square face
        first, last = (0.0 if topology.kinds[n] is NodeKind.JUNCTION else 0.5 * width for n in (a, b))
        bars.append(np.stack([points[a] - first * way, points[b] + last * way]))
    radius = _number(dims, "hole", path) * MM if loops else 0.0
    return _flat(bars, width, discs=[], holes=[[*points[n], radius] for n in loops], slots=[])


def _flat(
    bars: list[Floats],
    width_m: float,
    *,
    discs: list[list[float]],
    holes: list[list[float]],
    slots: list[list[float]],
) -> Outline:
    return Outline(
        bars=read_only(np.array(bars, np.float64)),
        bar_width_m=read_only(np.full(len(bars), width_m)),
        discs=read_only(np.array(discs, np.float64).reshape(-1, 3)),
        holes=read_only(np.array(holes, np.float64).reshape(-1, 3)),
        slots=read_only(np.array(slots, np.float64).reshape(-1, 5)),
    )


def _read(path: Path) -> dict[str, Json]:
    try:
        found: Json = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(f"{path}: cannot be read: {error}") from error
    if not isinstance(found, dict):
        raise UsageError(f"{path}: must hold named fields")
    return found


def _member(fields: dict[str, Json], key: str, path: Path) -> dict[str, Json]:
    found = fields.get(key)
    if not isinstance(found, dict):
        raise UsageError(f"{path}: {key} is missing")
    return found


def _text(fields: dict[str, Json], key: str, path: Path) -> str:
    found = fields.get(key)
    if not isinstance(found, str):
        raise UsageError(f"{path}: {key} is missing or not a text")
    return found


def _number(fields: dict[str, Json], key: str, path: Path) -> float:
    found = fields.get(key)
    if isinstance(found, bool) or not isinstance(found, int | float) or found <= 0:
        raise UsageError(f"{path}: {key} is missing or not a positive number")
    return float(found)
