"""Bent objects in one picture: whole strands through crossings, as ordered sub-pixel curves.

The skeleton graph gives the pieces between crossings; at each crossing the pieces that bend least in
going on are one strand (`tracing_arms`, `tracing_crossings`), and the curves are put together from them
(`tracing_curves`).
Strands of any number and shape, any number of arms at a crossing, ends that touch other strands. Two ends
that touch at a corner are one strand with a corner, as a bent part is. Strands that touch along a bend may
be exchanged there, and in heaps so dense that most of a mask is crossings much of it belongs to none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vision.net import radii_px
from vision.tracing_arms import arms_of, edge_radii, trims
from vision.tracing_crossings import crossings
from vision.tracing_curves import assemble, bodies, spread
from vision.types import Bools, Floats, Graph, Ints, Mask, Paths, read_only

LABEL_RADII = 3.0
"""Foreground farther from every strand than this belongs to none."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curves:
    """Strands of one picture, in columns; raw pixels.

    ``points`` (K, 2) px, the curves one after the other, about a pixel from point to point;
    ``starts`` (S + 1,) where each begins; ``bridged`` (K,) True where a curve goes through a crossing and
    its points are drawn between its arms, not measured; ``closed`` (S,) True for a ring, whose last point
    is a step from its first; ``radius_px`` (S,) half the width.
    """

    points: Floats
    starts: Ints
    bridged: Bools
    closed: Bools
    radius_px: Floats

    def __len__(self) -> int:
        return len(self.starts) - 1

    @property
    def lines(self) -> Paths:
        """S arrays (K, 2) px."""
        return Paths(self.points, self.starts)

    @property
    def length_px(self) -> Floats:
        """(S,) length along each curve."""
        lengths = [float(np.hypot(*np.diff(line, axis=0).T).sum()) for line in self.lines]
        return np.array(lengths, np.float64)


def trace_curves(mask: Mask, graph: Graph) -> Curves:
    """Whole strands, bent or straight, through their crossings.

    Parameters
    ----------
    mask : (H, W) bool
        Foreground.
    graph : Graph
        Of the mask's skeleton, without spurs (``prune(graph, spur_px, mask)``).

    Returns
    -------
    Curves
        In the order of their first edges.
    """
    mask = np.ascontiguousarray(mask)
    flat = graph.flat_paths
    median, mean = edge_radii(mask, flat.pixels, flat.starts)
    node_radius = radii_px(mask, graph.points)
    spoilt = trims(graph.edges, graph.degree, graph.lengths_px, node_radius, median)
    arms = arms_of(flat.pixels, flat.starts, graph.lengths_px, spoilt, median)
    _, goes_on, within = crossings(mask, graph.edges, graph.degree, graph.lengths_px, median, mean, arms)
    inner, begin = bodies(mask, flat.pixels, flat.starts, within, spoilt, median)
    points, bridged, starts, closed, radius = assemble(
        mask, graph.edges, graph.degree, within, median, goes_on, inner, begin
    )
    return Curves(
        points=read_only(points),
        starts=read_only(starts),
        bridged=read_only(bridged),
        closed=read_only(closed),
        radius_px=read_only(radius),
    )


def label(mask: Mask, curves: Curves) -> npt.NDArray[np.int32]:
    """The strand of each foreground pixel: the one whose curve is nearest.

    Returns
    -------
    (H, W) int32
        -1 for background and for foreground that is far from every strand.
    """
    owner = np.repeat(np.arange(len(curves)), np.diff(curves.starts))
    return spread(np.ascontiguousarray(mask), curves.points, owner, LABEL_RADII * curves.radius_px)
