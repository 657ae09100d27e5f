"""Straight pieces of a skeleton graph: where the graph says that parts lie."""

from __future__ import annotations

import numpy as np

from vision.canvas import Canvas, points_through_grid
from vision.jit import compiled
from vision.types import Floats, Graph, Ints

CORNER_WIDTHS = 0.3
TRIM_WIDTHS = 0.6
LEAST_WIDTHS = 1.5
"""In part widths: a path is cut where it leaves its chord by this; this much is cut off at either end, where
skeletons bend into junctions and corners; shorter pieces are left out."""


def straight_pieces(graph: Graph, width_px: float) -> Floats:
    """(K, 2, 2) px ends of the straight runs of all edges, cut at corners (Douglas and Peucker 1973)."""
    flat = graph.flat_paths
    return _straight(flat.pixels, flat.starts, width_px, max(1.2, CORNER_WIDTHS * width_px))


def on_canvas_lines(pieces: Floats, on: Canvas, side: int, row_shift_px: float) -> Floats:
    """(K, 4) middle and unit direction on the canvas of pieces (K, 2, 2) in raw pixels."""
    ends = points_through_grid(on.from_raw[side], pieces.reshape(-1, 2)).reshape(-1, 2, 2)
    ends[..., 1] += row_shift_px
    way = ends[:, 1] - ends[:, 0]
    size = np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
    return np.concatenate([ends.mean(axis=1), way / size], axis=1)


@compiled
def _straight(pixels: Floats, starts: Ints, width_px: float, corner_px: float) -> Floats:
    """The runs of all paths ``pixels[starts[k] : starts[k + 1]]`` that stay within ``corner_px`` of their
    chord, trimmed, in order."""
    trim, least = TRIM_WIDTHS * width_px, LEAST_WIDTHS * width_px
    found = np.empty((len(pixels), 2, 2))
    count = 0
    waiting = np.empty((len(pixels) + 1, 2), np.int64)
    for path in range(len(starts) - 1):
        if starts[path + 1] - starts[path] < least:
            continue
        waiting[0, 0], waiting[0, 1] = starts[path], starts[path + 1] - 1
        left = 1
        while left > 0:
            left -= 1
            first, last = waiting[left, 0], waiting[left, 1]
            if last - first < 2:
                continue
            ax, ay = pixels[first, 0], pixels[first, 1]
            dx, dy = pixels[last, 0] - ax, pixels[last, 1] - ay
            size = np.hypot(dx, dy)
            worst, most = first, -1.0
            for k in range(first, last + 1):
                x, y = pixels[k, 0] - ax, pixels[k, 1] - ay
                off = abs(x * dy - y * dx) if size > 1e-9 else x * x + y * y
                if off > most:
                    worst, most = k, off
            most = most / size if size > 1e-9 else np.sqrt(most)
            if most > corner_px:
                waiting[left, 0], waiting[left, 1] = worst, last
                waiting[left + 1, 0], waiting[left + 1, 1] = first, worst
                left += 2
            elif size - 2 * trim >= least:
                ux, uy = dx / size, dy / size
                found[count, 0, 0], found[count, 0, 1] = ax + trim * ux, ay + trim * uy
                found[count, 1, 0], found[count, 1, 1] = ax + dx - trim * ux, ay + dy - trim * uy
                count += 1
    return found[:count].copy()
