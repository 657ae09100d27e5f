"""``mikado calibrate ...``: the board, the cameras, their files; what else is calibrated adds itself here."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cell.commands import calibrate_board, calibrate_cameras, hand_eye

if TYPE_CHECKING:
    from cell.commands import Commands


def add(commands: Commands) -> None:
    """Add the group; each kind adds its own parsers."""
    group = commands.add_parser("calibrate", help="print a board, calibrate the cameras")
    kinds = group.add_subparsers(dest="kind", required=True, metavar="WHAT")
    for add_kind in (calibrate_board.add, calibrate_cameras.add, hand_eye.add):
        add_kind(kinds)
