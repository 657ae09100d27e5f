"""``mikado plc``: what a PLC programmer needs from us."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, cast, get_args

if TYPE_CHECKING:
    from cell.commands import Commands


def add(commands: Commands) -> None:
    """``plc export`` and ``plc verify``."""
    plc = commands.add_parser("plc", help="declarations for PLC programs; a test of the connection")
    actions = plc.add_subparsers(dest="action", required=True, metavar="ACTION")

    export = actions.add_parser("export", help="the register map as declarations for a PLC program")
    export.add_argument(
        "--dialect",
        required=True,
        choices=("siemens-scl", "codesys", "rockwell-csv"),
        help="siemens-scl: external source for TIA Portal; codesys: types for CODESYS and TwinCAT; "
        "rockwell-csv: tag list for Studio 5000",
    )
    export.add_argument(
        "--word-order",
        choices=("big", "little"),
        default="big",
        help="as plc.word_order in the cell's file (default: big, the high word first)",
    )
    export.add_argument("--out", type=Path, required=True, metavar="FILE")
    export.set_defaults(run=_export)


def _export(arguments: argparse.Namespace) -> int:
    from cell.errors import UsageError
    from drivers.plc_codec import WordOrder
    from drivers.plc_declarations import Dialect, declarations

    assert arguments.dialect in get_args(Dialect)
    text = declarations(cast(Dialect, arguments.dialect), cast(WordOrder, arguments.word_order))
    out: Path = arguments.out
    try:
        out.write_text(text, encoding="utf-8", newline="")
    except OSError as error:
        raise UsageError(f"--out {out}: cannot be written: {error.strerror}") from error
    return 0
