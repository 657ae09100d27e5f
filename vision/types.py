"""Records of the detector: what passes between its stages.

Metres, radians, pixels ``(u, v)`` with u to the right and v down, pixel centres at whole
coordinates. Frames: "left camera" is the raw (not rectified) left camera, x right, y down, z
forward. Records that hold arrays compare by identity; their arrays are read-only.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import Enum
from itertools import pairwise
from typing import Any, Literal, TypeAlias, overload

import numpy as np
import numpy.typing as npt

Floats: TypeAlias = npt.NDArray[np.float64]
Ints: TypeAlias = npt.NDArray[np.int64]
Bools: TypeAlias = npt.NDArray[np.bool_]
Grey: TypeAlias = npt.NDArray[np.uint8]
"""(H, W) uint8 grey picture."""
Mask: TypeAlias = npt.NDArray[np.bool_]
"""(H, W) bool, True = foreground."""
Skeleton: TypeAlias = npt.NDArray[np.bool_]
"""(H, W) bool, one pixel wide."""

Method: TypeAlias = Literal["published", "default"]


def read_only(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The same array, closed for writing; used where a record is made."""
    array.setflags(write=False)
    return array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Transform:
    """A rigid motion, named ``a_from_b``: coordinates in b go in, coordinates in a come out.

    ``rotation`` (3, 3), ``translation`` (3,) m.
    """

    rotation: Floats
    translation: Floats


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraModel:
    """Pinhole with OpenCV's distortion.

    ``matrix`` (3, 3) px; ``distortion`` (k,) as k1, k2, p1, p2[, k3 ...].
    """

    matrix: Floats
    distortion: Floats
    width_px: int
    height_px: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StereoModel:
    """Two calibrated cameras; ``right_from_left`` in metres; ``rms_px`` NaN if unknown."""

    left: CameraModel
    right: CameraModel
    right_from_left: Transform
    rms_px: float = float("nan")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plane:
    """The table: ``normal @ x + offset_m`` is the height of x above it.

    ``normal`` (3,) unit, pointing from the table towards the cameras, left camera frame.
    """

    normal: Floats
    offset_m: float


class Paths(Sequence[Floats]):
    """Curves that lie one after the other in one array: ``pixels[starts[k] : starts[k + 1]]``.

    A tuple of arrays to whoever reads it; each is a view made when it is asked for.
    """

    __slots__ = ("pixels", "starts")

    def __init__(self, pixels: Floats, starts: Ints) -> None:
        self.pixels = pixels
        self.starts = starts

    def __len__(self) -> int:
        return len(self.starts) - 1

    @overload
    def __getitem__(self, item: int) -> Floats: ...
    @overload
    def __getitem__(self, item: slice) -> tuple[Floats, ...]: ...
    def __getitem__(self, item: int | slice) -> Floats | tuple[Floats, ...]:
        if isinstance(item, slice):
            return tuple(self[k] for k in range(*item.indices(len(self))))
        k = item + len(self) if item < 0 else item
        if not 0 <= k < len(self):
            raise IndexError(f"no path {item} of {len(self)}")
        return self.pixels[self.starts[k] : self.starts[k + 1]]

    def __iter__(self) -> Iterator[Floats]:
        return (self.pixels[a:b] for a, b in pairwise(self.starts.tolist()))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Graph:
    """A skeleton as a graph, in columns.

    ``points`` (N, 2) px; ``degree`` (N,) number of edge ends at a node (a loop counts twice);
    ``component`` (N,) connected component; ``edges`` (M, 2) node indices (equal for a loop);
    ``lengths_px`` (M,) length along the path; ``paths`` M arrays (K, 2) px from the first node of
    the edge to the second, both node points included; the same as one array is ``flat_paths``.
    A node of degree 1 is an end point, of degree >= 3 a junction; degree 2 only closes loops,
    degree 0 is a single pixel (or an isolated blob's skeleton).
    """

    points: Floats
    degree: Ints
    component: Ints
    edges: Ints
    lengths_px: Floats
    paths: Sequence[Floats]

    @property
    def flat_paths(self) -> Paths:
        """The paths over one array of all their points; no copy for what `vision.graph` made."""
        if isinstance(self.paths, Paths):
            return self.paths
        counts = np.array([0, *(len(path) for path in self.paths)], np.int64)
        joined = np.concatenate([np.zeros((0, 2)), *self.paths])
        return Paths(read_only(joined), read_only(np.cumsum(counts)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Matches:
    """Which node (or strand) of the left picture is which of the right one.

    ``left``, ``right`` (P,) indices; ``cost_px`` (P,) what the pair costs in pixels of
    disagreement; ``unmatched`` and ``ambiguous`` count left items.
    """

    left: Ints
    right: Ints
    cost_px: Floats
    unmatched: int
    ambiguous: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Segments3D:
    """Straight pieces in space, left camera frame.

    ``start``, ``end`` (S, 3) m; ``edge`` (S,) index of the left edge or strand each came from
    (-1: none, e.g. a couple of nodes without an edge); ``residual_px`` (S,) disagreement of the
    two views.
    """

    start: Floats
    end: Floats
    edge: Ints
    residual_px: Floats


class NodeKind(Enum):
    """What a node of a part's own graph is."""

    END = "end"
    JUNCTION = "junction"
    CORNER = "corner"
    LOOP_CENTRE = "loop_centre"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Topology:
    """The graph of a part with several segments, in the part's own frame.

    ``points`` (N, 3) m; ``kinds`` N; ``edges`` (M, 2) node indices; ``axis`` the two nodes whose
    line is the part's main axis.
    """

    points: Floats
    kinds: tuple[NodeKind, ...]
    edges: Ints
    axis: tuple[int, int]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outline:
    """The edge of a flat part seen from above: solids joined, then holes and slots taken out; metres, in
    the plane of the part's own frame.

    ``bars`` (B, 2, 2) centre lines from face to face, ``bar_width_m`` (B,); ``discs``, ``holes`` (D, 3)
    x, y, radius; ``slots`` (S, 5) x, y of the middle of the round bottom, unit direction to the open end,
    width.
    """

    bars: Floats
    bar_width_m: Floats
    discs: Floats
    holes: Floats
    slots: Floats


@dataclass(frozen=True, slots=True, kw_only=True)
class ColourRange:
    """Which colours count: hue in degrees, [low, high], over 0 where low > high; saturation and value
    0..1."""

    hue_deg: tuple[float, float] = (0.0, 360.0)
    saturation: tuple[float, float] = (0.0, 1.0)
    value: tuple[float, float] = (0.0, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class PartModel:
    """A product as the detector knows it. Without ``topology`` it is a straight stick.

    ``diameter_m`` is the thickness of a flat part; ``outline`` its edge, None for round rods along the
    edges of the topology. ``thinning_end_m``: by how much thinning takes from each end of a stick, which the
    published method has no other way to know (learned by `mikado product teach`).
    """

    code: int
    name: str
    length_m: float
    length_tolerance_m: float
    diameter_m: float
    topology: Topology | None = None
    outline: Outline | None = None
    colour: ColourRange | None = None
    thinning_end_m: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EmptyTray:
    """Raw grey pictures (H, W) uint8 of the empty tray, by the cameras and from the place of the look."""

    left: Grey
    right: Grey


@dataclass(frozen=True, slots=True, kw_only=True)
class Tuning:
    """The gates of the stages. Lengths in pixels are at the picture's own scale.

    Attributes
    ----------
    method
        ``published`` is the method of the paper, ``default`` the project's own.
    band
        Grey values [min, max] that count as part; None: proposed from the histogram's shape.
    spur_px
        Branches of the skeleton shorter than this are removed with their end node.
    depth_m
        Distance from the left camera, [min, max]; None: from the table plane and ``height_m``.
    height_m
        Height above the table a point of a part may have, [min, max].
    epipolar_px
        How far two matching points may be apart across the epipolar line.
    angle_rad
        Published method: the optional threshold on the angle to the two referents. None: without.
    max_tilt_rad
        Steepest angle between a part's axis and the table (or picture plane) that may be picked.
    min_score
        Candidates below are refused, 0..1.
    length_2d
        Published method: measure length in 2-D, parallel to the table (section 3.3).
    empty
        The tray without parts: what looks as it did there is not looked at. None: everything is.
    """

    method: Method = "default"
    band: tuple[int, int] | None = None
    spur_px: float = 8.0
    depth_m: tuple[float, float] | None = None
    height_m: tuple[float, float] = (-0.005, 0.060)
    epipolar_px: float = 2.0
    angle_rad: float | None = None
    max_tilt_rad: float = 0.7
    min_score: float = 0.3
    length_2d: bool = False
    empty: EmptyTray | None = None


class Refusal(Enum):
    """Why a candidate is not offered. Values are what a person reads."""

    LENGTH = "length does not fit the product"
    DEPTH = "outside the depth range"
    TILT = "too steep"
    CROSSED = "another part lies over it"
    LOW_SCORE = "score too low"
    AMBIGUOUS = "several readings fit"
    TOPOLOGY = "graph does not fit the product"
    EDGE = "touches the border of the picture"
    WIDTH = "width does not fit the product"
    DUPLICATE = "shares its picture with a better one"
    UNMATCHED = "seen by one camera only"
    FLANKS = "its two flanks are not seen together"
    BENT = "not straight"
    COLOUR = "another colour"
    VAGUE = "its place is not known well enough"
    ROWS = "the rows of the two pictures do not agree"


_PASSING = frozenset({Refusal.CROSSED, Refusal.TILT, Refusal.VAGUE})
"""Reasons against picking a part now; that it is the product is settled."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Refused:
    """One reason with its number: ``value`` against ``limit``, both in ``unit``.

    Units are SI or ``px``, ``1`` for a plain number; people are shown millimetres and degrees.
    """

    reason: Refusal
    value: float
    limit: float
    unit: Literal["m", "rad", "px", "1"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidate:
    """A part found in both views, offered or refused.

    ``start``, ``end``, ``centre`` (3,) m and ``axis`` (3,) unit from start to end, left camera
    frame; ``nodes`` (K, 3) m in the order of the part's topology, for a stick its two ends.
    ``refusals`` is empty for an offered one. ``sigma_m`` standard deviation of the centre in its worst
    direction (nearly always depth), ``sigma_rad`` of the axis; ``width_m`` how thick its edges have it; NaN
    where the method does not tell.
    """

    part_code: int
    start: Floats
    end: Floats
    centre: Floats
    axis: Floats
    length_m: float
    nodes: Floats
    score: float
    residual_px: float
    refusals: tuple[Refused, ...] = ()
    sigma_m: float = float("nan")
    sigma_rad: float = float("nan")
    width_m: float = float("nan")

    @property
    def offered(self) -> bool:
        """True when no stage refused it."""
        return not self.refusals

    @property
    def recognised(self) -> bool:
        """True when it is the product, though it may be covered or too steep to be had now."""
        return all(refused.reason in _PASSING for refused in self.refusals)


class PictureFlaw(Enum):
    """What makes a picture unusable. Values are what a person reads."""

    BLACK = "black"
    SATURATED = "saturated"
    FLAT = "without contrast"
    UNCHANGING = "bit for bit the same as the one before"
    BLURRED = "blurred"


@dataclass(frozen=True, slots=True, kw_only=True)
class Unusable:
    """One flaw with its number: share, grey value or px ``value`` against ``limit``."""

    flaw: PictureFlaw
    value: float
    limit: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """What one picture gave: grey (rectified for the published method), mask, skeleton, graph."""

    grey: Grey
    mask: Mask
    skeleton: Skeleton
    graph: Graph
    band: tuple[int, int]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Crossing:
    """Where one candidate lies over another in the picture.

    ``above``, ``below`` places in ``Scene.candidates``; ``point`` (3,) m on the upper axis; ``gap_m`` between
    the surfaces along the ray, negative where they seem to touch; ``sure`` how certain the order is, in
    standard deviations.
    """

    above: int
    below: int
    point: Floats
    gap_m: float
    sure: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """Everything one look gave. ``candidates`` best first, refused ones after the offered ones.

    ``crossings`` which candidate lies on which; ``row_offset_px`` what the rows of the right picture were
    found to be off by, and corrected for; ``rows_seen_px`` the same however little it is, NaN where too few
    ends were seen to tell, and ``rows_sigma_px`` its standard deviation; ``complete`` False for a first
    answer whose rest is still being explained.
    """

    method: Method
    candidates: tuple[Candidate, ...]
    segments: Segments3D
    left: View
    right: View
    matches: Matches
    durations_s: dict[str, float] = field(default_factory=dict)
    crossings: tuple[Crossing, ...] = ()
    row_offset_px: float = 0.0
    rows_seen_px: float = float("nan")
    rows_sigma_px: float = float("nan")
    complete: bool = True

    @property
    def offered(self) -> tuple[Candidate, ...]:
        """Candidates nobody refused, best first."""
        return tuple(c for c in self.candidates if c.offered)

    @property
    def recognised(self) -> tuple[Candidate, ...]:
        """All that are the product: the offered ones, then those only covered or too steep."""
        return (*self.offered, *(c for c in self.candidates if c.recognised and not c.offered))
