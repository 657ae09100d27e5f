"""``mikado area teach``: the pick area and its heights, by touching or in a picture. Moves nothing."""

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
        from cell.commission.arm import SlowArm, halted_by_ctrl_c
        from cell.commission.questions import line
        from drivers.factory import Factory
        from drivers.timing import StopRequested

        robot = Factory(clock).robot("robot", config.robot)
        robot.open()
        try:
            with halted_by_ctrl_c(clock) as stop:
                arm = SlowArm(robot=robot, stop=stop)
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
