"""A calibration board as a page to print, exact to scale, with a bar to lay a ruler beside."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from cell.commission.boardfile import BoardConfig
from cell.errors import UsageError
from vision.boards import Board, charuco

PAPERS_MM: Final[dict[str, tuple[float, float]]] = {
    "A4": (210.0, 297.0),
    "A3": (297.0, 420.0),
    "A2": (420.0, 594.0),
    "A1": (594.0, 841.0),
    "A0": (841.0, 1189.0),
    "letter": (215.9, 279.4),
    "tabloid": (279.4, 431.8),
}
_EDGE_MM: Final = 6.0
"""What printers leave white."""
_QUIET_MM: Final = 4.0
"""White around the squares: markers and chessboards are found against it."""
_STRIP_MM: Final = 11.0
"""Room for the bar with its ticks and words."""
_OVERLAP_MM: Final = 0.03
"""White cells that touch overlap: viewers draw hairlines between shapes that only meet."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Page:
    """Where things go on the paper, mm from its upper left corner."""

    width_mm: float
    height_mm: float
    board_x_mm: float
    board_y_mm: float
    bar_mm: float
    bar_below: bool
    bar_x_mm: float
    bar_y_mm: float


def page(board: Board, paper: str) -> Page:
    """Lay a board on a paper, turned so that it fits.

    Raises
    ------
    UsageError
        The paper is too small, or there is none of that name.
    """
    sides = {name.lower(): sides for name, sides in PAPERS_MM.items()}.get(paper.lower())
    if sides is None:
        raise UsageError(f"no paper {paper!r}; one of {', '.join(PAPERS_MM)}")
    wide, high = (1e3 * side for side in board.size_m)
    short, long = sides
    around = 2 * (_EDGE_MM + _QUIET_MM)
    for width, height in ((long, short), (short, long)) if wide >= high else ((short, long), (long, short)):
        below = height - high - around >= _STRIP_MM and wide + around <= width
        beside = width - wide - around >= _STRIP_MM and high + around <= height
        if not (below or beside):
            continue
        if below:
            bar = _bar(width - 2 * (_EDGE_MM + 4.0))
            return Page(
                width_mm=width,
                height_mm=height,
                board_x_mm=(width - wide) / 2,
                board_y_mm=(height - _STRIP_MM - high) / 2,
                bar_mm=bar,
                bar_below=True,
                bar_x_mm=(width - bar) / 2,
                bar_y_mm=height - _EDGE_MM - _STRIP_MM / 2,
            )
        bar = _bar(height - 2 * (_EDGE_MM + 4.0))
        return Page(
            width_mm=width,
            height_mm=height,
            board_x_mm=(width - _STRIP_MM - wide) / 2,
            board_y_mm=(height - high) / 2,
            bar_mm=bar,
            bar_below=False,
            bar_x_mm=width - _EDGE_MM - _STRIP_MM / 2,
            bar_y_mm=(height - bar) / 2,
        )
    raise UsageError(
        f"{board.columns} x {board.rows} squares of {1e3 * board.pitch_m:g} mm and their bar do not fit on "
        f"{paper} ({short:g} x {long:g} mm); take fewer or smaller squares, or a larger paper"
    )


def _bar(room_mm: float) -> float:
    return min(200.0, math.floor(room_mm / 50.0) * 50.0) or 10.0 * math.floor(room_mm / 10.0)


def write(path: Path, config: BoardConfig, paper: str) -> Page:
    """Write the page as PDF.

    Raises
    ------
    UsageError
        It does not fit, or the file cannot be written.
    """
    board = config.board()
    where = page(board, paper)
    figure = Figure(figsize=(where.width_mm / 25.4, where.height_mm / 25.4))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_xlim(0.0, where.width_mm)
    axes.set_ylim(where.height_mm, 0.0)
    axes.axis("off")
    black, white = _shapes(board, where)
    for shapes, colour in ((black, "black"), (white, "white")):
        axes.add_collection(PatchCollection(shapes, facecolor=colour, edgecolor="none", linewidth=0))
    _draw_bar(axes, where)
    say = f"{config.words()} - print at 100 %, then measure the bar: {where.bar_mm:g} mm"
    if where.bar_below:
        axes.text(where.width_mm / 2, where.bar_y_mm + 4.6, say, ha="center", va="center", fontsize=6)
    else:
        axes.text(
            where.bar_x_mm + 4.6, where.height_mm / 2, say, ha="center", va="center", fontsize=6, rotation=90
        )
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # no date in it: the same board is the same file
        figure.savefig(path, format="pdf", metadata={"Creator": "mikado", "Title": say, "CreationDate": None})
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from error
    return where


def _shapes(board: Board, where: Page) -> tuple[list[Rectangle], list[Rectangle]]:
    """Black rectangles, and white ones to lay over them."""
    pitch = 1e3 * board.pitch_m
    left, top = where.board_x_mm, where.board_y_mm
    black, white = [], []
    marked = np.zeros((board.rows, board.columns), dtype=bool)
    if board.kind == "charuco":
        known = charuco(board)
        bits = int(board.dictionary[5]) + 2
        for corners, number in zip(known.getObjPoints(), np.asarray(known.getIds()).reshape(-1), strict=True):
            first = np.asarray(corners, dtype=np.float64)[0, :2] * 1e3
            column, row = int(first[0] // pitch), int(first[1] // pitch)
            marked[row, column] = True
            side = 1e3 * board.marker_m
            # from the square and not from OpenCV's single precision
            x = left + column * pitch + (pitch - side) / 2
            y = top + row * pitch + (pitch - side) / 2
            black.append(Rectangle((x, y), side, side))
            cells = np.asarray(cv2.aruco.generateImageMarker(known.getDictionary(), int(number), bits)) > 127
            cell = side / bits
            for j, i in zip(*np.nonzero(cells), strict=True):
                wide = cell + (_OVERLAP_MM if i + 1 < bits and cells[j, i + 1] else 0.0)
                high = cell + (_OVERLAP_MM if j + 1 < bits and cells[j + 1, i] else 0.0)
                white.append(Rectangle((x + i * cell, y + j * cell), wide, high))
        squares = ~marked
    else:
        squares = np.add.outer(np.arange(board.rows), np.arange(board.columns)) % 2 == 0
    for row, column in zip(*np.nonzero(squares), strict=True):
        black.append(Rectangle((left + column * pitch, top + row * pitch), pitch, pitch))
    return black, white


def _draw_bar(axes: Axes, where: Page) -> None:
    """A bar with a tick each 10 mm; its length is from the middle of one end tick to that of the other."""
    thin = 0.15
    shapes = []
    for k in range(round(where.bar_mm / 10) + 1):
        reach = 2.5 if k * 10 in (0, round(where.bar_mm)) else 1.2
        if where.bar_below:
            at = where.bar_x_mm + 10.0 * k
            shapes.append(Rectangle((at - thin / 2, where.bar_y_mm - reach), thin, 2 * reach))
        else:
            at = where.bar_y_mm + 10.0 * k
            shapes.append(Rectangle((where.bar_x_mm - reach, at - thin / 2), 2 * reach, thin))
    if where.bar_below:
        shapes.append(Rectangle((where.bar_x_mm, where.bar_y_mm - thin / 2), where.bar_mm, thin))
    else:
        shapes.append(Rectangle((where.bar_x_mm - thin / 2, where.bar_y_mm), thin, where.bar_mm))
    axes.add_collection(PatchCollection(shapes, facecolor="black", edgecolor="none", linewidth=0))
