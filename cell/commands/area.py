"""``mikado area ...``: the pick area and its heights, and how the tray looks when empty."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from cell.errors import UsageError

if TYPE_CHECKING:
    from cell.commands import Commands


def add(commands: Commands) -> None:
    """Add the group."""
    group = commands.add_parser("area", help="teach the pick area and its heights")
    kinds = group.add_subparsers(dest="kind", required=True, metavar="WHAT")
    teach = kinds.add_parser(
        "teach", help="pick area into the configuration, by touching or by picture points"
    )
    teach.add_argument("config", type=Path, metavar="CONFIG")
    how = teach.add_mutually_exclusive_group(required=True)
    how.add_argument("--touch", type=int, metavar="N", help="lead the tips by hand to N corners of the floor")
    how.add_argument(
        "--pixels", nargs="+", metavar="U,V", help="corners in the raw left picture, on the floor"
    )
    how.add_argument(
        "--picture", type=Path, metavar="PNG", help="only write the picture with a grid to read off"
    )
    teach.add_argument(
        "--height-mm", type=float, help="how high parts lie above the floor (default: as it was)"
    )
    teach.add_argument("--margin-mm", type=float, default=0.0, help="keep this far inside of the points")
    teach.set_defaults(run=run_teach)

    empty = kinds.add_parser(
        "empty",
        help="does anything lie in the tray that its empty pictures do not show? --take takes them, with the "
        "arm at workspace.watch_q_rad; without it nothing moves",
    )
    empty.add_argument("config", type=Path, metavar="CONFIG")
    empty.add_argument("--take", action="store_true", help="the tray is empty now: keep its pictures")
    empty.add_argument(
        "--sure", action="store_true", help="with --take: what looks like a part belongs to the tray"
    )
    empty.add_argument(
        "--yes", action="store_true", help="with --take: do not ask before the arm goes to watch_q_rad"
    )
    empty.set_defaults(run=run_empty)


def run_empty(arguments: argparse.Namespace) -> int:
    """Take or compare pictures of the empty tray."""
    from rich.console import Console

    from cell import config as configuration
    from cell.commission import area_empty
    from drivers.timing import MonotonicClock

    console = Console(soft_wrap=True, highlight=False)
    config = configuration.load(arguments.config)
    if config.cameras.mount != "fixed":
        raise UsageError("area empty is for fixed cameras: on the arm they see the tray from elsewhere")
    if arguments.take:
        from cell.commission.questions import ask

        clock = MonotonicClock()
        area_empty.out_of_view(config, clock, (lambda _text: True) if arguments.yes else ask)
        return area_empty.take(arguments.config, config, clock, sure=arguments.sure, console=console)
    if arguments.sure or arguments.yes:
        raise UsageError("--sure and --yes go with --take")
    return area_empty.compare(arguments.config, config, MonotonicClock(), console)


def run_teach(arguments: argparse.Namespace) -> int:
    """Teach the area."""
    from rich.console import Console

    from cell import config as configuration
    from cell.commission import area
    from drivers.timing import MonotonicClock

    console = Console(soft_wrap=True, highlight=False)
    config = configuration.load(arguments.config)
    clock = MonotonicClock()
    if arguments.picture is not None:
        area.gridded(area.look(config, clock), arguments.picture, console)
        return 0
    heights = config.workspace.box_max_m[2] - config.workspace.floor_z_m
    if arguments.height_mm is not None:
        if not 1 <= arguments.height_mm <= 500:
            raise UsageError(f"--height-mm {arguments.height_mm}: from 1 to 500 millimetres above the floor")
        heights = 1e-3 * arguments.height_mm
    if arguments.touch is not None:
        from cell.commission.arm import LedArm, halted_by_ctrl_c
        from cell.commission.questions import line
        from drivers.factory import Factory
        from drivers.timing import StopRequested

        robot = Factory(clock).watched_arm("robot", config.robot)
        robot.open()
        try:
            with halted_by_ctrl_c(clock) as stop:
                arm = LedArm(robot=robot, stop=stop)
                points = area.led_points(arm, arguments.touch, config.jaws.tip_beyond_tool_m, line)
        except StopRequested as error:
            raise UsageError(str(error)) from error
        finally:
            robot.close()
    else:
        pixels = [_pixel(text) for text in arguments.pixels]
        points = area.picture_points(config, pixels, config.workspace.floor_z_m)
    code = area.write_area(
        arguments.config,
        config,
        points,
        heights,
        floor=arguments.touch is not None,
        margin_m=1e-3 * arguments.margin_mm,
    )
    now = configuration.load(arguments.config).workspace
    low, high = (tuple(round(1e3 * v, 1) for v in corner) for corner in (now.box_min_m, now.box_max_m))
    console.print(
        f"{arguments.config}: pick area {low} to {high} mm, floor at {1e3 * now.floor_z_m:.1f} mm, "
        f"robot's base; "
        f"the file as it was: {arguments.config}.old"
    )
    return code


def _pixel(text: str) -> tuple[float, float]:
    try:
        u, v = (float(part) for part in text.split(","))
    except ValueError:
        raise UsageError(f"--pixels {text}: two numbers are expected, as in 120,85") from None
    return u, v
