"""``mikado calibrate ...``: the board, the cameras, their files; what else is calibrated adds itself here."""

from __future__ import annotations

from typing import Final

from cell.commands import Commands, Group
from cell.commands import calibrate_board, calibrate_cameras

KINDS: Final[tuple[Group, ...]] = (calibrate_board.add, calibrate_cameras.add)
"""Each adds its parsers under ``mikado calibrate``."""


def add(commands: Commands) -> None:
    """Add the group."""
    group = commands.add_parser("calibrate", help="print a board, calibrate cameras and robot")
    kinds = group.add_subparsers(dest="kind", required=True, metavar="WHAT")
    for add_kind in KINDS:
        add_kind(kinds)
