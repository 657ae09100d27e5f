"""``mikado product teach``: one part of known length, seen by both cameras, becomes a product file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import yaml
from rich.console import Console

from cell import calibration
from cell.calibration import Calibration
from cell.errors import UsageError
from cell.products import PartConfig
from vision import stereo
from vision.binarize import in_band, propose_band
from vision.locate import locate
from vision.types import Bools, Candidate, Floats, Grey, PartModel, Plane, Refusal, Tuning

_TOLERANCE: Final = 0.04
"""Of the length: what `length_tolerance_m` is set to; parts of one product and the detector's error are "
"in it."""
_SEARCH: Final = 0.08
_THINNED: Final = 0.25
_OTHER: Final = 0.5
"""Something so long beside the part makes it unclear which is meant."""
_SAME_PLACE_M: Final = 0.008
_CHANGED_GREY: Final = 18.0
_THINNED_WIDTHS: Final = (-0.25, 1.3)
"""What thinning takes from either end of a part, in its widths: half of one, a little more or less."""
_WITHIN: Final = 0.03
"""The length the cameras measure may be off by this share: otherwise calibration or stated length is "
"wrong."""
_STRAIGHT: Final = 4.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shown:
    """A pair of pictures with one part, the pair of the empty tray if there is one, and who took them."""

    left: Grey
    right: Grey
    empty: tuple[Grey, Grey] | None
    known: Calibration
    table: Plane | None
    tuning: Tuning


@dataclass(frozen=True, slots=True, kw_only=True)
class Taught:
    """A product, and what was measured on the way: ``length_m`` by the cameras, ``thinned_m`` by thinning."""

    part: PartConfig
    length_m: float
    thinned_m: float | None


def teach(shown: Shown, length_m: float, code: int, name: str) -> Taught:
    """Learn width, band and end correction of a part whose length is known.

    Raises
    ------
    UsageError
        No part, several, one darker than the ground, or one whose measured length contradicts the stated one.
    """
    left, right = _without_tray(shown)
    diameter_m = _first_width_m(left, length_m)
    found: Candidate | None = None
    for _ in range(2):  # the first look knows the width roughly only
        part = PartModel(
            code=code,
            name=name,
            length_m=length_m,
            length_tolerance_m=_SEARCH * length_m,
            diameter_m=diameter_m,
        )
        found = _the_one(shown, left, right, part, replace(shown.tuning, method="default"))
        if np.isfinite(found.width_m) and 0 < found.width_m < length_m / 3:
            diameter_m = float(found.width_m)
    assert found is not None
    if abs(found.length_m / length_m - 1.0) > _WITHIN:
        raise UsageError(
            f"by the cameras the part is {1e3 * found.length_m:.1f} mm long, stated are "
            f"{1e3 * length_m:.1f} mm: "
            "measure it again, or calibrate the cameras again (is the pitch of the board right?)"
        )
    band = _band(shown, left, found, diameter_m)
    thinned = _thinned_m(shown, left, right, found, length_m, diameter_m, band)
    if thinned is not None:
        _refuse_other_length(length_m, thinned, diameter_m)
    config = PartConfig(
        code=code,
        name=name,
        length_m=round(length_m, 5),
        length_tolerance_m=round(_TOLERANCE * length_m, 5),
        diameter_m=round(diameter_m, 5),
        band=band,
        thinning_end_m=0.0 if thinned is None else round((length_m - thinned) / 2, 5),
    )
    return Taught(part=config, length_m=found.length_m, thinned_m=thinned)


def _refuse_other_length(length_m: float, thinned_m: float, diameter_m: float) -> None:
    """Raise `UsageError` where thinning leaves more of the part than it is long, or takes far too much.

    The detector lays a part of the stated length on what it sees; thinning knows nothing of it.
    """
    least, most = _THINNED_WIDTHS
    if not least * diameter_m <= (length_m - thinned_m) / 2 <= most * diameter_m:
        raise UsageError(
            f"thinning leaves {1e3 * thinned_m:.1f} mm of the part, which is {1e3 * diameter_m:.1f} mm "
            f"thick: stated are {1e3 * length_m:.1f} mm; measure it again, or calibrate the cameras again"
        )


def write(path: Path, taught: Taught, console: Console) -> int:
    """Write the product file and say what is in it; exit code 0."""
    part = taught.part
    values = part.model_dump(mode="json", exclude_none=True)
    text = "# Learned from one part: mikado product teach. Metres.\n" + yaml.safe_dump(
        values, sort_keys=False
    )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from error
    console.print(
        f"{path}: {part.name}, {1e3 * part.length_m:.1f} mm long (cameras: {1e3 * taught.length_m:.2f}), "
        f"{1e3 * part.diameter_m:.2f} mm thick, grey {part.band}",
        markup=False,
    )
    if taught.thinned_m is None:
        console.print("thinning: the published method does not find this part; its end correction stays 0")
    else:
        console.print(
            f"thinning: leaves {1e3 * taught.thinned_m:.2f} mm, {1e3 * part.thinning_end_m:.2f} mm from "
            "each end"
        )
    return 0


# ------------------------------------------------------------------------------ seeing it


def _without_tray(shown: Shown) -> tuple[Grey, Grey]:
    """The pictures with everything that was there before painted over by the grey of the ground beside what
    was put there."""
    if shown.empty is None:
        return shown.left, shown.right
    pictures: list[Grey] = []
    for now, before in zip((shown.left, shown.right), shown.empty, strict=True):
        if now.shape != before.shape:
            raise UsageError("the pictures of the empty tray differ in size from those with the part")
        changed = np.abs(now.astype(np.float64) - before) > _CHANGED_GREY
        near = cv2.dilate(changed.astype(np.uint8), np.ones((15, 15), np.uint8)) > 0
        if not near.any():
            raise UsageError("no part is seen: the pictures are those of the empty tray")
        pictures.append(np.where(near, now, np.uint8(np.median(before[near]))).astype(np.uint8))
    return pictures[0], pictures[1]


def _first_width_m(left: Grey, length_m: float) -> float:
    """Width of the longest bright thing, by its shape alone: area over length, times metres per pixel."""
    mask = in_band(left, propose_band(left)).astype(np.uint8)
    count, labels = cv2.connectedComponents(mask, connectivity=8)
    things: list[tuple[float, float]] = []
    for label in range(1, count):
        spots = np.argwhere(labels == label)
        if len(spots) < 40:
            continue
        _, sides, _ = cv2.minAreaRect(spots[:, ::-1].astype(np.float32))
        long = max(sides) + 1.0
        things.append((long, len(spots) / long))
    things.sort(reverse=True)
    if not things:
        raise UsageError(
            "no part is seen: nothing stands out brightly; more light, another ground, or pictures of the "
            "empty tray (--empty-left, --empty-right; with --config: mikado area empty --take)"
        )
    long, wide = things[0]
    if long < _STRAIGHT * wide:
        raise UsageError("no thin part is seen: the longest bright thing is nearly as wide as it is long")
    rivals = [thing for thing in things[1:] if thing[0] > _OTHER * long and thing[0] > _STRAIGHT * thing[1]]
    if rivals:
        raise UsageError(
            f"{1 + len(rivals)} long things are seen: leave one part in view, or give pictures of the "
            "empty tray (--empty-left, --empty-right; with --config: mikado area empty --take)"
        )
    return length_m * wide / long


def _the_one(shown: Shown, left: Grey, right: Grey, part: PartModel, tuning: Tuning) -> Candidate:
    """The only part the detector finds."""
    scene = locate(left, right, shown.known.stereo, part, tuning, shown.table)
    found = [c for c in scene.candidates if c.recognised]
    if len(found) == 1:
        return found[0]
    if not found:
        near = [c for c in scene.candidates if any(r.reason is Refusal.LENGTH for r in c.refusals)]
        told = "".join(f"; one of {1e3 * c.length_m:.1f} mm is seen" for c in near[:1])
        raise UsageError(
            f"no part of {1e3 * part.length_m:.1f} mm is found in both pictures{told}; is the length "
            "right, is it "
            "whole in both pictures, and is its distance within the depth range?"
        )
    raise UsageError(f"{len(found)} parts are found; leave one in view")


def _band(shown: Shown, left: Grey, found: Candidate, diameter_m: float) -> tuple[int, int]:
    """Grey values of the part in the left picture against the ground beside it."""
    ends, _ = stereo.project(np.stack([found.start, found.end]), shown.known.stereo)
    width_px = diameter_m * float(shown.known.stereo.left.matrix[0, 0]) / float(found.centre[2])
    on, beside = _strips(ends, width_px, left.shape)
    part, ground = float(np.percentile(left[on], 10)), float(np.percentile(left[beside], 90))
    if part <= ground + 5:
        raise UsageError(
            f"the part (grey {part:.0f}) does not stand out from the ground (grey {ground:.0f}); the "
            "detector needs "
            "parts brighter than what they lie on: more light from the side, or a darker tray"
        )
    return round((part + ground) / 2), 255


def _strips(ends: Floats, width_px: float, shape: tuple[int, ...]) -> tuple[Bools, Bools]:
    """(H, W) masks: the middle of the part, and the ground on both sides of it."""
    v, u = np.indices(shape[:2])
    way = ends[1] - ends[0]
    long = float(np.linalg.norm(way))
    x, y = u - ends[0, 0], v - ends[0, 1]
    along = (x * way[0] + y * way[1]) / long**2
    across = np.abs(x * way[1] - y * way[0]) / long
    middle = (along > 0.1) & (along < 0.9)
    on = middle & (across < 0.3 * width_px)
    beside = middle & (across > 1.5 * width_px) & (across < 4.0 * width_px)
    return on, beside


def _thinned_m(
    shown: Shown,
    left: Grey,
    right: Grey,
    found: Candidate,
    length_m: float,
    diameter_m: float,
    band: tuple[int, int],
) -> float | None:
    """How long the published method sees the part, None where it does not."""
    part = PartModel(
        code=1,
        name="taught",
        length_m=length_m,
        length_tolerance_m=_THINNED * length_m,
        diameter_m=diameter_m,
    )
    tuning = replace(shown.tuning, method="published", band=band)
    scene = locate(left, right, shown.known.stereo, part, tuning, shown.table)
    near = [c for c in scene.candidates if float(np.linalg.norm(c.centre - found.centre)) < _SAME_PLACE_M]
    return max((c.length_m for c in near), default=None)


# ------------------------------------------------------------------------------ where pictures come from


def from_files(
    pictures: tuple[Path, Path],
    empty: tuple[Path, Path] | None,
    calibration_path: Path,
    depth_m: tuple[float, float] | None,
) -> Shown:
    """Pictures of files. Raises `UsageError`, `CalibrationError`."""
    known = calibration.load(calibration_path)
    left, right = (_grey(path) for path in pictures)
    calibration.fit(known, left.shape[1], left.shape[0], str(pictures[0]))
    calibration.fit(known, right.shape[1], right.shape[0], str(pictures[1]))
    if depth_m is None and known.table is None:
        raise UsageError(
            f"{calibration_path} does not say where the table is; give the distance of the part from the "
            "left "
            "camera with --depth-m MIN MAX (metres)"
        )
    return Shown(
        left=left,
        right=right,
        empty=None if empty is None else (_grey(empty[0]), _grey(empty[1])),
        known=known,
        table=known.table,
        tuning=replace(Tuning(), depth_m=depth_m),
    )


def from_cameras(config_path: Path, empty: tuple[Path, Path] | None) -> Shown:
    """A look through the configured cameras, without the tray where the configuration has its empty pictures;
    nothing moves."""
    from cell.commission import look

    sight = look.from_cameras(config_path, None, None)
    greys = [
        np.asarray(p if p.ndim == 2 else cv2.cvtColor(p, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
        for p in (sight.left, sight.right)
    ]
    before = None if empty is None else (_grey(empty[0]), _grey(empty[1]))
    kept = sight.tuning.empty
    if before is None and kept is not None:
        before = (kept.left, kept.right)
    return Shown(
        left=greys[0],
        right=greys[1],
        empty=before,
        known=sight.known,
        table=sight.table,
        tuning=replace(sight.tuning, empty=None),
    )


def _grey(path: Path) -> Grey:
    if not path.is_file():
        raise UsageError(f"{path}: no such file")
    content = np.frombuffer(path.read_bytes() or b"\0", dtype=np.uint8)
    picture = cv2.imdecode(content, cv2.IMREAD_GRAYSCALE)
    if picture is None:
        raise UsageError(f"{path}: not a picture OpenCV can read (PNG, JPEG, BMP, TIFF ...)")
    return np.asarray(picture, dtype=np.uint8)
