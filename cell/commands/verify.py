"""``mikado verify touch``: the arm touches points the cameras measured. Moves the arm, each descent asked."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from cell.errors import UsageError

if TYPE_CHECKING:
    from cell.commands import Commands


def add(commands: Commands) -> None:
    """Add the group."""
    group = commands.add_parser("verify", help="is what was calibrated true? Touch test")
    kinds = group.add_subparsers(dest="kind", required=True, metavar="WHAT")
    parser = kinds.add_parser("touch", help="the arm touches measured points; pass or fail, history kept")
    parser.add_argument("config", type=Path, metavar="CONFIG")
    parser.add_argument(
        "--board", type=Path, required=True, metavar="YAML", help="lies flat in the pick area"
    )
    parser.add_argument("--points", type=int, default=5, help="how many (default and at least 5)")
    parser.add_argument("--tolerance-mm", type=float, help="default: commissioning.touch_tolerance_m")
    parser.add_argument("--hover-mm", type=float, default=30.0, help="height of the first stop (default 30)")
    parser.add_argument(
        "--gap-mm", type=float, default=0.5, help="the tip stops above the point (default 0.5)"
    )
    parser.add_argument("--yes", action="store_true", help="do not ask before each descent")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Touch."""
    from rich.console import Console

    from cell import config as configuration
    from cell.commission import boardfile, touch
    from cell.commission.arm import SlowArm, halted_by_ctrl_c
    from cell.commission.questions import ask, line
    from drivers.factory import Factory
    from drivers.timing import MonotonicClock, StopRequested

    console = Console(soft_wrap=True, highlight=False)
    config = configuration.load(arguments.config)
    board = boardfile.load(arguments.board).board()
    for name in ("hover_mm", "gap_mm", "tolerance_mm"):
        value = getattr(arguments, name)
        if value is not None and not 0 < value < 200:
            raise UsageError(f"--{name.replace('_', '-')} {value}: millimetres above 0 and below 200")
    if arguments.gap_mm >= arguments.hover_mm:
        raise UsageError(f"--gap-mm {arguments.gap_mm} is not below --hover-mm {arguments.hover_mm}")
    wish = touch.Wish(
        count=arguments.points,
        hover_m=1e-3 * arguments.hover_mm,
        gap_m=1e-3 * arguments.gap_mm,
        tolerance_m=config.commissioning.touch_tolerance_m
        if arguments.tolerance_mm is None
        else 1e-3 * arguments.tolerance_mm,
    )
    clock = MonotonicClock()
    factory = Factory(clock)
    rig = factory.rig(config.cameras.left, config.cameras.right, config.cameras.max_skew_s)
    robot = factory.robot("robot", config.robot)
    gripper = factory.gripper("gripper", config.gripper, robot)
    try:
        rig.open()
        robot.open()
        gripper.open()
        with halted_by_ctrl_c(clock) as stop:
            points = touch.points_of(config, rig, board, wish.count, clock.now())
            if not (arguments.yes or ask("The jaws close, then the arm moves. Is its way free?")):
                return touch.EXIT_FAILED
            gripper.grasp(stop=stop)
            arm = SlowArm(robot=robot, stop=stop)
            go = (lambda _text: True) if arguments.yes else ask
            touched = touch.touch(config, arm, points, wish, go, line, console)
    except StopRequested as error:
        raise UsageError(f"{error}; the arm was halted") from error
    finally:
        gripper.close()
        robot.close()
        rig.close()
    return touch.conclude(config, touched, wish, console)
