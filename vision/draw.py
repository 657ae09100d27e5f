"""What the detector saw, drawn over the left picture for a person.

Everything in space is projected back into the raw picture, so a wrong calibration shows as lines beside the
parts. Returns a new picture, writes nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from vision.stereo import project, rectification, unrectify_points
from vision.types import Candidate, Crossing, Floats, Grey, PartModel, Refusal, Refused, Scene, StereoModel

Picture: TypeAlias = npt.NDArray[np.uint8]
"""(H, W, 3) uint8 BGR."""
Colour: TypeAlias = tuple[int, int, int]
Box: TypeAlias = tuple[int, int, int, int]
"""Left, top, right, bottom in drawn pixels."""

SCALE: Final = 2
LEGEND_PX: Final = 30
DIM: Final = 0.72
"""The picture is darkened so that thin lines over bright parts can be seen."""
SAMPLES: Final = 17
NAMED: Final = 12
"""Offered parts that get their length written; the rest only their rank, or the picture drowns in text."""
REFUSED_NAMED: Final = 8

GREEN: Final = (90, 220, 60)
BRIGHT: Final = (120, 255, 120)
ORANGE: Final = (40, 150, 255)
RED: Final = (70, 70, 235)
BLUE: Final = (255, 150, 60)
NODE: Final = (255, 200, 60)
WHITE: Final = (245, 245, 245)
DARK: Final = (25, 25, 25)
FONT: Final = cv2.FONT_HERSHEY_SIMPLEX

SHORT: Final[dict[Refusal, str]] = {
    Refusal.LENGTH: "length",
    Refusal.DEPTH: "depth",
    Refusal.TILT: "tilt",
    Refusal.CROSSED: "covered",
    Refusal.LOW_SCORE: "score",
    Refusal.AMBIGUOUS: "ambiguous",
    Refusal.TOPOLOGY: "shape",
    Refusal.EDGE: "at border",
    Refusal.WIDTH: "width",
    Refusal.DUPLICATE: "duplicate",
    Refusal.UNMATCHED: "one view",
    Refusal.FLANKS: "one flank",
    Refusal.BENT: "bent",
    Refusal.COLOUR: "colour",
    Refusal.VAGUE: "vague",
    Refusal.ROWS: "rows off",
}
WITHOUT_NUMBER: Final = frozenset({Refusal.DUPLICATE, Refusal.EDGE, Refusal.UNMATCHED})
ABOUT_SIZE: Final = frozenset({Refusal.LENGTH, Refusal.WIDTH, Refusal.TOPOLOGY, Refusal.DEPTH, Refusal.TILT})


SURE: Final = 1.0
"""An order that is known to fewer standard deviations is shown as a doubt."""
BRIDGE_PX: Final = 8
RAIL_PX: Final = 6
"""Half the length of a bridge's rails, and how far beside the upper line they run, in drawn pixels."""
RING_PX: Final = 6

SHIFT: Final = 4
"""Lines are drawn to a sixteenth of a pixel, or slightly tilted ones show steps."""
REACHES_PX: Final = (4, 12, 24, 40, 60, 84, 112)
SIDES: Final = ((1, -1), (1, 1), (-1, -1), (-1, 1), (0, -1), (0, 1), (1, 0), (-1, 0))
COVERED_COST: Final = 0.5
"""What a pixel of a drawn line under a label costs, in pixels of distance from the part."""
REFUSED_MOST: Final = 90.0
"""A label of a refused part that only finds dearer places is left out."""


@dataclass(frozen=True, slots=True)
class _Label:
    """Text in a box, with a line to the place it speaks of."""

    text: str
    box: Box
    at: tuple[int, int]
    colour: Colour
    size: float
    first: bool


@dataclass(slots=True)
class _Sheet:
    """The picture being drawn, where lines are (as `cv2.integral` sums them), and the labels so far."""

    pixels: Picture
    lines: npt.NDArray[np.int32]
    labels: list[_Label] = field(default_factory=list)

    def covered(self, box: Box) -> int:
        """How many pixels of lines a box would hide."""
        left, top, right, bottom = box
        corners = self.lines[[bottom, bottom, top, top], [right, left, right, left]].astype(np.int64)
        return int(corners @ [1, -1, -1, 1])


def draw(
    picture_left: Grey | Picture,
    scene: Scene,
    stereo_model: StereoModel,
    part: PartModel,
    among: tuple[PartModel, ...] = (),
) -> Picture:
    """Overlay of a scene on the raw left picture.

    Offered candidates are green with their rank, the first ones with their length in mm, the first of all
    brighter; parts of other products are blue with their name; refused ones are thin, orange when size or
    place is wrong and red otherwise, the first few with the reason and its number. A part that lies over
    another has two short rails there, as bridges have on maps; where the order is not certain there is a
    small ring. Dots are nodes of the left graph. A line below the picture says what was done, a second one
    that the rows of the pictures had to be corrected.

    Parameters
    ----------
    picture_left : (H, W) or (H, W, 3) uint8
        Raw left picture, grey or BGR; not changed.
    scene, stereo_model, part, among
        What was found in it, with which cameras, looking for what, and what else may lie there.

    Returns
    -------
    (2 H + legend, 2 W, 3) uint8 BGR

    Raises
    ------
    ValueError
        Not such a picture, or not of the calibrated size.
    """
    camera = stereo_model.left
    if picture_left.dtype != np.uint8 or picture_left.shape[:2] != (camera.height_px, camera.width_px):
        raise ValueError(
            f"the left picture must be uint8 of {camera.width_px} x {camera.height_px}, "
            f"not {picture_left.dtype} {picture_left.shape}"
        )
    picture = _ground(picture_left)
    busy = np.zeros(picture.shape[:2], np.uint8)
    nodes = _nodes_px(scene, stereo_model)
    for u, v in _drawn(nodes[np.isfinite(nodes).all(axis=1)]).tolist():
        cv2.circle(picture, (u, v), 3 << SHIFT, NODE, -1, cv2.LINE_AA, SHIFT)
    products = {one.code: one for one in among}
    others = [c for c in scene.recognised if c.part_code in products]
    mine = [c for c in scene.candidates if not any(c is other for other in others)]
    refused = [c for c in mine if not c.offered]
    for candidate in reversed(refused):
        paths = _paths(candidate, part, stereo_model)
        cv2.polylines(picture, paths, False, _refused_colour(candidate), 1, cv2.LINE_AA, SHIFT)
    for candidate in others:
        paths = _paths(candidate, products[candidate.part_code], stereo_model)
        _outline(picture, paths, BLUE, first=False)
        cv2.polylines(busy, paths, False, 1, 6, cv2.LINE_8, SHIFT)
    ranks = list(enumerate((c for c in mine if c.offered), start=1))
    for rank, candidate in reversed(ranks):
        paths = _paths(candidate, part, stereo_model)
        _outline(picture, paths, BRIGHT if rank == 1 else GREEN, rank == 1)
        cv2.polylines(busy, paths, False, 1, 6, cv2.LINE_8, SHIFT)
    for crossing in scene.crossings:
        _bridge(picture, crossing, scene, stereo_model)
    sheet = _Sheet(pixels=picture, lines=np.asarray(cv2.integral(busy), np.int32))
    for rank, candidate in ranks:
        text = f"{rank}  {candidate.length_m * 1e3:.1f} mm" if rank <= NAMED else f"{rank}"
        colour = BRIGHT if rank == 1 else GREEN
        size = 0.55 if rank <= NAMED else 0.45
        _label(sheet, text, _anchors(candidate, stereo_model), colour, size, first=rank == 1)
    for candidate in others:
        text = products[candidate.part_code].name
        _label(sheet, text, _anchors(candidate, stereo_model), BLUE, 0.42, most=REFUSED_MOST)
    for candidate in refused[:REFUSED_NAMED]:
        text = refusal_text(candidate.refusals[0])
        anchors, colour = _anchors(candidate, stereo_model), _refused_colour(candidate)
        _label(sheet, text, anchors, colour, 0.42, most=REFUSED_MOST)
    _write(sheet.pixels, sheet.labels)
    counts = (len(ranks), len(refused), len(others))
    return np.concatenate([sheet.pixels, _legend(scene, part, counts, sheet.pixels.shape[1])])


def refusal_text(refused: Refused) -> str:
    """A reason in a few letters with its number, in millimetres and degrees.

    Examples
    --------
    >>> refusal_text(Refused(reason=Refusal.LENGTH, value=0.1124, limit=0.104, unit="m"))
    'length 112.4 > 104.0 mm'
    """
    if refused.reason in WITHOUT_NUMBER:
        return SHORT[refused.reason]
    if refused.reason is Refusal.CROSSED and refused.unit == "1":
        return f"{refused.value:.0f} over it"  # a number beside "by" would read as that of a part
    if refused.reason is Refusal.COLOUR and refused.unit == "rad":
        hue, nearest = np.degrees([refused.value, refused.limit])
        return f"hue {hue:.0f}, not {nearest:.0f} deg"
    scale, unit, digits = {
        "m": (1e3, " mm", 1),
        "rad": (float(np.degrees(1.0)), " deg", 0),
        "px": (1.0, " px", 1),
        "1": (1.0, "", 2),
    }[refused.unit]
    sign = ">" if refused.value > refused.limit else "<"
    value, limit = refused.value * scale, refused.limit * scale
    return f"{SHORT[refused.reason]} {value:.{digits}f} {sign} {limit:.{digits}f}{unit}"


def _ground(picture: Grey | Picture) -> Picture:
    colour = cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR) if picture.ndim == 2 else picture
    larger = cv2.resize(colour, None, fx=SCALE, fy=SCALE, interpolation=cv2.INTER_CUBIC)
    return np.asarray(np.rint(larger * DIM), np.uint8)


def _drawn(pixels: Floats) -> npt.NDArray[np.int32]:
    """Raw pixels (N, 2) in the enlarged picture, in the drawing functions' fractions of a pixel."""
    return np.asarray(np.rint(((pixels + 0.5) * SCALE - 0.5) * (1 << SHIFT)), np.int32)


def _nodes_px(scene: Scene, stereo_model: StereoModel) -> Floats:
    points = scene.left.graph.points
    if scene.method == "published":
        return unrectify_points(points, rectification(stereo_model), "left")
    return points


def _paths(candidate: Candidate, part: PartModel, stereo_model: StereoModel) -> list[npt.NDArray[np.int32]]:
    """The part's segments as polylines; many points each, because lenses bend lines."""
    if part.topology is None or len(candidate.nodes) != len(part.topology.points):
        ends = [(candidate.start, candidate.end)]
    else:
        ends = [(candidate.nodes[a], candidate.nodes[b]) for a, b in part.topology.edges.tolist()]
    along = np.linspace(0.0, 1.0, SAMPLES)[:, None]
    paths = [project(a + along * (b - a), stereo_model)[0] for a, b in ends]
    return [_drawn(path) for path in paths if np.isfinite(path).all()]


def _anchors(candidate: Candidate, stereo_model: StereoModel) -> list[tuple[int, int]]:
    """Places on a part where its label may hang: near both ends, and the middle."""
    along = np.array([[0.12], [0.88], [0.5]])
    points = candidate.start + along * (candidate.end - candidate.start)
    pixels = project(points, stereo_model)[0]
    if not np.isfinite(pixels).all():
        return []
    return [(u >> SHIFT, v >> SHIFT) for u, v in _drawn(pixels).tolist()]


def _outline(picture: Picture, paths: list[npt.NDArray[np.int32]], colour: Colour, first: bool) -> None:
    width = 3 if first else 2
    cv2.polylines(picture, paths, False, DARK, width + 2, cv2.LINE_AA, SHIFT)
    cv2.polylines(picture, paths, False, colour, width, cv2.LINE_AA, SHIFT)
    for path in paths:
        for u, v in (path[0].tolist(), path[-1].tolist()):
            cv2.circle(picture, (u, v), (width + 2) << SHIFT, DARK, -1, cv2.LINE_AA, SHIFT)
            cv2.circle(picture, (u, v), (width + 1) << SHIFT, colour, -1, cv2.LINE_AA, SHIFT)


def _bridge(picture: Picture, crossing: Crossing, scene: Scene, stereo_model: StereoModel) -> None:
    """Two rails along the upper part, as bridges are drawn on maps; a ring where the order is in doubt."""
    upper = scene.candidates[crossing.above]
    along = project(crossing.point + np.array([[-1e-3], [0.0], [1e-3]]) * upper.axis, stereo_model)[0]
    if not np.isfinite(along).all():
        return
    first, middle, last = along
    if crossing.sure < SURE:
        (at,) = _drawn(middle[None]).tolist()
        cv2.circle(picture, at, RING_PX << SHIFT, WHITE, 1, cv2.LINE_AA, SHIFT)
        return
    way = (last - first) / max(float(np.linalg.norm(last - first)), 1e-9)
    aside = np.array([-way[1], way[0]]) * RAIL_PX / SCALE
    rails = middle + np.array([[-1.0], [1.0]]) * way * (BRIDGE_PX / SCALE)
    for side in (-aside, aside):
        cv2.polylines(picture, [_drawn(rails + side)], False, DARK, 3, cv2.LINE_AA, SHIFT)
        cv2.polylines(picture, [_drawn(rails + side)], False, WHITE, 1, cv2.LINE_AA, SHIFT)


def _refused_colour(candidate: Candidate) -> Colour:
    return ORANGE if candidate.refusals[0].reason in ABOUT_SIZE else RED


def _label(
    sheet: _Sheet,
    text: str,
    anchors: list[tuple[int, int]],
    colour: Colour,
    size: float,
    *,
    first: bool = False,
    most: float = np.inf,
) -> None:
    """Text on a plate near the part, hiding no other text and few lines; none if that costs too much."""
    (width, height), _ = cv2.getTextSize(text, FONT, size, 1)
    rows, columns = sheet.pixels.shape[:2]
    best: tuple[float, Box, tuple[int, int]] | None = None
    for at in anchors:
        for reach in REACHES_PX:
            for side in SIDES:
                box = _beside(at, side, reach, width + 8, height + 8)
                inside = box[0] >= 0 and box[1] >= 0 and box[2] < columns and box[3] < rows
                if not inside or any(_overlap(box, other.box) for other in sheet.labels):
                    continue
                cost = reach + COVERED_COST * sheet.covered(box)
                if cost <= most and (best is None or cost < best[0]):
                    best = (cost, box, at)
    if best is None:
        return
    _, box, at = best
    sheet.labels.append(_Label(text=text, box=box, at=at, colour=colour, size=size, first=first))


def _write(picture: Picture, labels: list[_Label]) -> None:
    """All leading lines first, so that none runs over a text."""
    for label in labels:
        (u, v), (left, top, right, bottom) = label.at, label.box
        corner = (min(max(u, left), right), min(max(v, top), bottom))
        cv2.line(picture, label.at, corner, label.colour, 1, cv2.LINE_AA)
    for label in labels:
        left, top, right, bottom = label.box
        under = picture[top:bottom, left:right]
        shade = np.array(label.colour if label.first else DARK, np.float64)
        under[:] = np.rint(0.2 * under + 0.8 * shade).astype(np.uint8)
        ink = DARK if label.first else label.colour
        cv2.putText(picture, label.text, (left + 4, bottom - 5), FONT, label.size, ink, 1, cv2.LINE_AA)


def _beside(at: tuple[int, int], side: tuple[int, int], reach: int, width: int, height: int) -> Box:
    """A box of a size, ``reach`` away from a point to one of the `SIDES`."""
    across, down = side
    left = at[0] + across * (reach + 6) - (0 if across > 0 else width if across < 0 else width // 2)
    top = at[1] + down * (reach + 6) - (0 if down > 0 else height if down < 0 else height // 2)
    return left, top, left + width, top + height


def _overlap(one: Box, other: Box) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def _legend(scene: Scene, part: PartModel, counts: tuple[int, int, int], width: int) -> Picture:
    nodes = "/".join(str(len(view.graph.points)) for view in (scene.left, scene.right))
    bands = "/".join(f"{low}-{high}" for low, high in (scene.left.band, scene.right.band))
    offered, refused, others = counts
    links = (
        f"{len(scene.matches.left)} matched"
        if scene.method == "published"
        else (f"{len(scene.crossings)} crossings")
    )
    done = (
        f"{scene.method}   {part.name} {part.length_m * 1e3:.0f} mm   {offered} offered, "
        f"{refused} refused{f', {others} of other products' if others else ''}   nodes {nodes}, {links}   "
        f"band {bands}"
    )
    lines = [(done, WHITE)]
    if scene.row_offset_px:
        off = f"rows of the right picture {scene.row_offset_px:+.2f} px off and corrected"
        said = f"{off}: calibrate the cameras again"
        lines.append((said, ORANGE))
    strip = np.full((LEGEND_PX * len(lines), width, 3), DARK, np.uint8)
    for row, (text, colour) in enumerate(lines):
        (long, _), _ = cv2.getTextSize(text, FONT, 0.5, 1)
        size = 0.5 * min(1.0, (width - 16) / max(1, long))
        cv2.putText(strip, text, (8, 20 + LEGEND_PX * row), FONT, size, colour, 1, cv2.LINE_AA)
    return strip
