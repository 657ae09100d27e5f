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

    verify = actions.add_parser(
        "verify", help="walk through the handshake with the PLC, or with the daemon as its PLC; moves nothing"
    )
    verify.add_argument("config", type=Path, nargs="?", metavar="CONFIG", help="its section plc is used")
    verify.add_argument("--host", help="instead of CONFIG: where the PLC (with --as-plc: the daemon) listens")
    verify.add_argument("--port", type=int, help="with --host (default: 502)")
    verify.add_argument(
        "--word-order", dest="order", choices=("big", "little"), help="with --host (default: big)"
    )
    verify.add_argument(
        "--as-plc",
        action="store_true",
        help="play the PLC against a running daemon that is the server; take the real PLC off the line first",
    )
    verify.add_argument("--orders", type=int, default=3, metavar="N", help="whole handshakes (default: 3)")
    verify.add_argument(
        "--wait-s", type=float, default=30.0, help="longest wait for what the other side has to do"
    )
    verify.add_argument(
        "--bits", action="store_true", help="wait until hold, abort and reset have been switched by hand"
    )
    verify.set_defaults(run=_verify)


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


def _verify(arguments: argparse.Namespace) -> int:
    from pydantic import ValidationError
    from rich.console import Console

    from cell import config
    from cell.commission.plc_verify import verify
    from cell.errors import UsageError
    from drivers.settings import ModbusPlcSettings, ModbusServerPlcSettings, PlcSettings

    if arguments.orders < 1 or not 0.0 < arguments.wait_s < 3600.0:
        raise UsageError("--orders is at least 1, --wait-s above 0 and below 3600")
    settings: PlcSettings
    if arguments.config is not None:
        given = [n for n in ("host", "port", "order") if getattr(arguments, n) is not None]
        if given:
            raise UsageError("give a CONFIG, or --host with --port and --word-order, not both")
        settings = config.load(arguments.config).plc
    elif arguments.host is not None:
        address = {
            "port": arguments.port if arguments.port is not None else 502,
            "word_order": arguments.order or "big",
        }
        try:
            if arguments.as_plc:
                settings = ModbusServerPlcSettings.model_validate(
                    {"driver": "modbus_server", "bind": arguments.host, "peers": [arguments.host], **address}
                )
            else:
                settings = ModbusPlcSettings.model_validate(
                    {"driver": "modbus", "host": arguments.host, **address}
                )
        except ValidationError as error:
            raise UsageError(f"--host, --port: {error.errors()[0]['msg']}") from error
    else:
        raise UsageError("plc verify needs a CONFIG, or --host")
    return verify(
        settings,
        as_plc=arguments.as_plc,
        orders=arguments.orders,
        wait_s=arguments.wait_s,
        bits=arguments.bits,
        console=Console(soft_wrap=True, highlight=False),
    )
