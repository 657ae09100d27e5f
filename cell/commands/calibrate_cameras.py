"""``mikado calibrate cameras``, and calibrations of OpenCV in and out."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from cell.errors import UsageError

if TYPE_CHECKING:
    from cell.commands import Commands


def add(commands: Commands) -> None:
    """Add the parsers."""
    cameras = commands.add_parser(
        "cameras", help="calibrate both cameras from views of a board; moves nothing"
    )
    cameras.add_argument("--board", type=Path, required=True, metavar="YAML", help="the board file")
    cameras.add_argument("--images", type=Path, metavar="DIR", help="pictures left* and right* of a folder")
    cameras.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        help="the configured cameras: looks through them, or (with --images) they took the pictures",
    )
    cameras.add_argument("--out", type=Path, required=True, metavar="JSON", help="the calibration file")
    cameras.add_argument("--plot", type=Path, metavar="PNG", help="coverage, tilts and errors as a picture")
    cameras.add_argument("--opencv", type=Path, metavar="YAML", help="the result as an OpenCV file too")
    cameras.add_argument("--drop-worst", type=int, default=0, metavar="N", help="leave out the N worst views")
    cameras.add_argument(
        "--baseline-mm", type=float, help="distance of the lenses by a ruler: a check of the board's pitch"
    )
    cameras.add_argument("--no-k3", action="store_true", help="keep the third radial coefficient at 0")
    cameras.add_argument("--views", type=int, default=20, help="live: stop at so many (default 20)")
    cameras.add_argument("--save", type=Path, metavar="DIR", help="live: keep the pictures that were used")
    cameras.add_argument(
        "--deadline-s", type=float, default=600.0, help="live: calibrate with what there is (default 600)"
    )
    cameras.set_defaults(run=run)

    export = commands.add_parser("export", help="a calibration file as OpenCV's YAML")
    export.add_argument("calibration", type=Path, metavar="JSON")
    export.add_argument("out", type=Path, metavar="YAML")
    export.set_defaults(run=run_export)

    bring = commands.add_parser("import", help="an OpenCV calibration as a calibration file")
    bring.add_argument("source", type=Path, metavar="YAML")
    bring.add_argument("out", type=Path, metavar="JSON")
    bring.set_defaults(run=run_import)


def run(arguments: argparse.Namespace) -> int:
    """Calibrate the cameras."""
    from rich.console import Console

    from cell import config as configuration
    from cell.commission import boardfile, calibrate_cameras, camera_views
    from cell.identity import identities

    console = Console(soft_wrap=True, highlight=False)
    if arguments.images is None and arguments.config is None:
        raise UsageError("give --images DIR with pictures, or --config FILE to look through its cameras")
    if arguments.drop_worst < 0:
        raise UsageError(f"--drop-worst {arguments.drop_worst}: how many views to leave out, 0 or more")
    if arguments.out.suffix.lower() != ".json":
        raise UsageError(f"{arguments.out}: calibration files are JSON; let the name end in .json")
    board = boardfile.load(arguments.board)
    config = None if arguments.config is None else configuration.load(arguments.config)
    if arguments.images is not None:
        collected = camera_views.from_folder(arguments.images, board.board())
    else:
        from cell.commission import live_views

        assert config is not None
        wish = live_views.Wish(views=arguments.views, save=arguments.save, deadline_s=arguments.deadline_s)
        collected = live_views.capture(config.cameras, board.board(), wish, console)
    order = calibrate_cameras.Order(
        out=arguments.out,
        plot=arguments.plot,
        opencv=arguments.opencv,
        drop_worst=arguments.drop_worst,
        baseline_m=None if arguments.baseline_mm is None else arguments.baseline_mm / 1e3,
        cameras=None if config is None else identities(config.cameras),
        with_k3=not arguments.no_k3,
    )
    return calibrate_cameras.run(collected, board, order, console)


def run_export(arguments: argparse.Namespace) -> int:
    """Mikado's file to OpenCV's."""
    from rich.console import Console

    from cell.commission.calibrate_cameras import export

    return export(arguments.calibration, arguments.out, Console(soft_wrap=True, highlight=False))


def run_import(arguments: argparse.Namespace) -> int:
    """OpenCV's file to Mikado's."""
    from rich.console import Console

    from cell.commission.calibrate_cameras import import_opencv

    return import_opencv(arguments.source, arguments.out, Console(soft_wrap=True, highlight=False))
