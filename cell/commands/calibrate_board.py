"""``mikado calibrate board``: a board to print, and the ruler's word on it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Final

from cell.errors import UsageError

if TYPE_CHECKING:
    from cell.commands import Commands

_PITCH_MM: Final = 20.0


def add(commands: Commands) -> None:
    """Add the parser."""
    board = commands.add_parser("board", help="a calibration board as PDF, with a bar to measure")
    board.add_argument("--kind", choices=("charuco", "chessboard"), default="charuco")
    board.add_argument("--paper", default="A4", help="A4 (default), A3, A2, A1, A0, letter, tabloid")
    board.add_argument("--columns", type=int, default=12, help="squares across (default 12)")
    board.add_argument("--rows", type=int, default=9, help="squares down (default 9)")
    board.add_argument("--pitch-mm", type=float, help=f"side of a square (default {_PITCH_MM:g})")
    board.add_argument("--marker-mm", type=float, help="side of a marker (default 0.75 of a square)")
    board.add_argument("--dictionary", help="marker family (default DICT_4X4_100, or larger where needed)")
    board.add_argument("--out", type=Path, metavar="PDF", help="the page; its board file goes beside it")
    board.add_argument(
        "--board", type=Path, metavar="YAML", help="a board that was printed before (with --measured-bar-mm)"
    )
    board.add_argument("--measured-bar-mm", type=float, help="length of the printed bar: corrects the pitch")
    board.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Print a board, or record what its bar measures."""
    from rich.console import Console

    from cell.commission import printing

    console = Console(soft_wrap=True, highlight=False)
    if arguments.board is not None:
        if arguments.out is not None or arguments.measured_bar_mm is None:
            raise UsageError("--board takes --measured-bar-mm only; leave it out to print a board")
        return printing.measured(arguments.board, arguments.measured_bar_mm, console)
    if arguments.out is None:
        raise UsageError("where shall the board go? --out board.pdf")
    wish = printing.Wish(
        kind=arguments.kind,
        columns=arguments.columns,
        rows=arguments.rows,
        pitch_mm=arguments.pitch_mm or _PITCH_MM,
        marker_mm=arguments.marker_mm,
        dictionary=arguments.dictionary,
        paper=arguments.paper,
        measured_bar_mm=arguments.measured_bar_mm,
    )
    return printing.print_board(wish, arguments.out, console)
