"""``mikado forecast``: how exact a camera pair will be, before lenses are bought."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from cell.errors import UsageError

if TYPE_CHECKING:
    from cell.commands import Commands
    from vision.forecast import Pair


def add(commands: Commands) -> None:
    """Add the parser."""
    parser = commands.add_parser("forecast", help="expected errors of a camera pair, from geometry alone")
    known = parser.add_argument_group("a pair that is calibrated")
    known.add_argument("--config", type=Path, metavar="FILE")
    known.add_argument("--calibration", type=Path, metavar="FILE")
    wish = parser.add_argument_group("a pair that is not bought yet")
    wish.add_argument("--baseline-mm", type=float, help="distance of the lenses")
    wish.add_argument("--focal-px", type=float)
    wish.add_argument("--lens-mm", type=float, help="focal length of the lens, with --pixel-um")
    wish.add_argument("--pixel-um", type=float, help="size of a pixel, with --lens-mm")
    wish.add_argument("--size-px", type=int, nargs=2, metavar=("W", "H"), default=None)
    parser.add_argument("--distance-mm", type=float, required=True, help="from the cameras to the parts")
    parser.add_argument("--width-mm", type=float, required=True, help="thickness of a part")
    parser.add_argument(
        "--line-px", type=float, help="how exactly a part's middle line is seen (default: measured, see docs)"
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Print the forecast."""
    from rich.console import Console
    from rich.table import Table

    from vision.forecast import ENOUGH_PX, GOOD_PX, LINE_PX, forecast

    console = Console(soft_wrap=True, highlight=False)
    for name in ("distance_mm", "width_mm", "line_px"):
        value = getattr(arguments, name)
        if value is not None and not 0 < value < math.inf:
            raise UsageError(f"--{name.replace('_', '-')} {value:g}: a number above 0 is expected")
    line_px = LINE_PX if arguments.line_px is None else arguments.line_px
    pair = _pair(arguments)
    distance_m, part_m = arguments.distance_mm / 1e3, arguments.width_mm / 1e3
    try:
        told = {
            angle: forecast(pair, distance_m, part_m, math.radians(angle), line_px) for angle in (90, 45, 15)
        }
    except ValueError as error:
        raise UsageError(str(error)) from error
    first = told[90]
    console.print(
        f"focal length {pair.focal_px:.0f} px, baseline {1e3 * pair.baseline_m:.1f} mm, "
        f"{pair.width_px} x {pair.height_px} px, at {arguments.distance_mm:g} mm: both see "
        f"{1e3 * first.view_m[0]:.0f} x {1e3 * first.view_m[1]:.0f} mm; a pixel is "
        f"{1e3 * first.pixel_m:.3f} mm, one px of disparity {1e3 * first.depth_per_px_m:.2f} mm of depth"
    )
    table = Table(
        "part's angle to the baseline", "depth mm", "aside, middle mm", "aside, corner mm",
        title=f"expected error, one standard deviation (middle line seen to {line_px:g} px)",
    )  # fmt: skip
    for angle, one in told.items():
        table.add_row(
            f"{angle}°" + (" or flatter" if angle == 15 else ""),
            f"{1e3 * one.depth_m[1, 1]:.3f}",
            f"{1e3 * one.lateral_m[1, 1]:.3f}",
            f"{1e3 * one.lateral_m[0, 0]:.3f}",
        )
    console.print(table)
    judged = "good" if first.part_px >= GOOD_PX else "enough" if first.part_px >= ENOUGH_PX else "TOO FEW"
    console.print(
        f"{first.part_px:.1f} px across a part of {arguments.width_mm:g} mm: {judged} "
        f"(at least {ENOUGH_PX:g}, better {GOOD_PX:g})"
    )
    console.print("What the calibration has wrong comes on top: a touch test shows it.")
    return 0


def _pair(arguments: argparse.Namespace) -> Pair:
    from cell import calibration
    from cell import config as configuration
    from vision.forecast import Pair

    wished = ("baseline_mm", "focal_px", "lens_mm", "pixel_um", "size_px")
    given = [name for name in wished if getattr(arguments, name) is not None]
    files = [f for f in (arguments.config, arguments.calibration) if f is not None]
    if len(files) > 1 or (files and given):
        raise UsageError("give one of --config, --calibration, or the numbers of a pair (--baseline-mm ...)")
    if files:
        path = arguments.calibration
        if path is None:
            path = configuration.load(arguments.config).files.calibration
        stereo = calibration.load(path).stereo
        return Pair(
            focal_px=float((stereo.left.matrix[0, 0] + stereo.right.matrix[0, 0]) / 2),
            baseline_m=float((stereo.right_from_left.translation**2).sum() ** 0.5),
            width_px=stereo.left.width_px,
            height_px=stereo.left.height_px,
        )
    if arguments.baseline_mm is None or arguments.size_px is None:
        raise UsageError(
            "a pair needs --baseline-mm, --size-px W H, and --focal-px or --lens-mm and --pixel-um"
        )
    focal = arguments.focal_px
    if focal is None:
        if arguments.lens_mm is None or arguments.pixel_um is None:
            raise UsageError("how long is the lens? --focal-px, or --lens-mm and --pixel-um")
        if arguments.pixel_um <= 0:
            raise UsageError(f"--pixel-um {arguments.pixel_um:g}: a number above 0 is expected")
        focal = 1e3 * arguments.lens_mm / arguments.pixel_um
    try:
        return Pair(
            focal_px=focal,
            baseline_m=arguments.baseline_mm / 1e3,
            width_px=arguments.size_px[0],
            height_px=arguments.size_px[1],
        )
    except ValueError as error:
        raise UsageError(str(error)) from error
