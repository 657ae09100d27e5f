"""Straight pieces of a skeleton graph: where the graph says that parts lie."""

from __future__ import annotations

import numpy as np

from vision.canvas import Canvas, points_through_grid
from vision.types import Floats, Graph

CORNER_WIDTHS = 0.3
TRIM_WIDTHS = 0.6
LEAST_WIDTHS = 1.5
"""In part widths: a path is cut where it leaves its chord by this; this much is cut off at either end, where
skeletons bend into junctions and corners; shorter pieces are left out."""


def straight_pieces(graph: Graph, width_px: float) -> Floats:
    """(K, 2, 2) px ends of the straight runs of all edges, cut at corners (Douglas and Peucker 1973)."""
    pieces = []
    trim, least = TRIM_WIDTHS * width_px, LEAST_WIDTHS * width_px
    for path in graph.paths:
        if len(path) < least:
            continue
        for first, last in _runs(path, max(1.2, CORNER_WIDTHS * width_px)):
            a, b = path[first], path[last]
            length = float(np.hypot(*(b - a)))
            if length - 2 * trim < least:
                continue
            along = (b - a) / length
            pieces.append(np.stack([a + trim * along, b - trim * along]))
    return np.array(pieces, np.float64).reshape(-1, 2, 2)


def on_canvas_lines(pieces: Floats, on: Canvas, side: int, row_shift_px: float) -> Floats:
    """(K, 4) middle and unit direction on the canvas of pieces (K, 2, 2) in raw pixels."""
    ends = points_through_grid(on.from_raw[side], pieces.reshape(-1, 2)).reshape(-1, 2, 2)
    ends[..., 1] += row_shift_px
    way = ends[:, 1] - ends[:, 0]
    size = np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
    return np.concatenate([ends.mean(axis=1), way / size], axis=1)


def _runs(path: Floats, corner_px: float) -> list[tuple[int, int]]:
    """First and last index of each run that stays within ``corner_px`` of its chord, in order."""
    found: list[tuple[int, int]] = []
    waiting = [(0, len(path) - 1)]
    while waiting:
        first, last = waiting.pop()
        if last - first < 2:
            continue
        chord = path[last] - path[first]
        size = float(np.hypot(*chord))
        away = path[first : last + 1] - path[first]
        if size > 1e-9:
            off = np.abs(away[:, 0] * chord[1] - away[:, 1] * chord[0]) / size
        else:
            off = np.hypot(away[:, 0], away[:, 1])
        worst = int(np.argmax(off))
        if off[worst] <= corner_px:
            found.append((first, last))
        else:
            waiting += [(first + worst, last), (first, first + worst)]
    return found
