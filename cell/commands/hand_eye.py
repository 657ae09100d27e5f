"""``mikado calibrate hand-eye``: where the cameras are, told by a board and the arm. May move the arm."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from cell.errors import UsageError

if TYPE_CHECKING:
    from rich.console import Console

    from cell.commands import Commands
    from cell.commission.session import Stop
    from drivers.interfaces import WatchedArm
    from vision.boards import Board
    from vision.handeye import Mount


def add(commands: Commands) -> None:
    """Add the parser."""
    parser = commands.add_parser(
        "hand-eye",
        help="where the cameras are: from a folder, or live (the arm moves slowly, each pose asked)",
    )
    parser.add_argument("--board", type=Path, required=True, metavar="YAML", help="the board file")
    parser.add_argument(
        "--calibration", type=Path, metavar="JSON", help="of the cameras; default: the config's"
    )
    parser.add_argument("--mount", choices=("fixed", "tool"), help="cameras beside the robot, or on the arm")
    parser.add_argument("--config", type=Path, metavar="FILE", help="live: the configured cameras and arm")
    parser.add_argument("--images", type=Path, metavar="DIR", help="pictures left_NAME and right_NAME")
    parser.add_argument(
        "--poses", type=Path, metavar="JSON", help="where the arm was (default: DIR/poses.json)"
    )
    how = parser.add_mutually_exclusive_group()
    how.add_argument("--dome", type=int, metavar="N", help="live: N poses about where the arm is now")
    how.add_argument("--routine", type=Path, metavar="JSON", help="live: the poses of an earlier session")
    how.add_argument("--free", type=int, metavar="N", help="live: a person leads the arm to N poses")
    parser.add_argument("--tilt-deg", type=float, default=25.0, help="dome: largest tilt (default 25)")
    parser.add_argument("--shift-mm", type=float, default=25.0, help="dome: largest shift (default 25)")
    parser.add_argument(
        "--pivot-mm",
        type=float,
        nargs=3,
        metavar=("X", "Y", "Z"),
        help="dome: the board's middle, tool frame",
    )
    parser.add_argument(
        "--start-mm",
        type=float,
        nargs=3,
        metavar=("X", "Y", "Z"),
        help="dome: go there first, tool straight down (robot's base; asked); default: where the arm is",
    )
    parser.add_argument("--yes", action="store_true", help="live: do not ask before each pose")
    parser.add_argument("--save", type=Path, metavar="DIR", help="live: folder for pictures and poses")
    parser.add_argument("--capture-only", action="store_true", help="live: take the session, solve nothing")
    parser.add_argument("--drop", nargs="+", default=[], metavar="NAME", help="poses to leave out")
    parser.add_argument(
        "--distance-mm", type=float, help="pick area before the left camera (default: the board)"
    )
    parser.add_argument("--plot", type=Path, metavar="PNG", help="the poses as a picture")
    parser.add_argument("--out", type=Path, metavar="JSON", help="write here instead of into the calibration")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Calibrate."""
    from rich.console import Console

    from cell.commission import boardfile, hand_eye, session

    console = Console(soft_wrap=True, highlight=False)
    live = arguments.dome is not None or arguments.routine is not None or arguments.free is not None
    if live == (arguments.images is not None):
        raise UsageError("give --images DIR, or one of --dome N, --routine FILE, --free N with --config FILE")
    board = boardfile.load(arguments.board).board()
    mount, calibration, tool = _configured(arguments)
    if live:
        stops = _live(arguments, board, mount, console)
        folder: Path = arguments.save
    else:
        folder = arguments.images
        stops = session.read(arguments.poses or folder / session.POSES)
    if arguments.capture_only:
        return 0
    if calibration is None:
        raise UsageError("which calibration? --calibration FILE, or --config FILE")
    sightings, blind = session.seen_in(folder, stops, board)
    if blind:
        console.print(f"no board seen at {', '.join(blind)}")
    wish = hand_eye.Wish(
        calibration=calibration,
        mount=mount,
        drop=tuple(arguments.drop),
        distance_m=None if arguments.distance_mm is None else 1e-3 * arguments.distance_mm,
        out=arguments.out,
        plot=arguments.plot,
        tool=tool,
    )
    return hand_eye.conclude(sightings, wish, console)


def _configured(arguments: argparse.Namespace) -> tuple[Mount, Path | None, str]:
    """Mounting, calibration file and active tool, by the command line or else the configuration."""
    mount: Mount | None = arguments.mount
    calibration: Path | None = arguments.calibration
    tool = "as the poses file has it"
    if arguments.config is not None:
        from cell import config as configuration

        config = configuration.load(arguments.config)
        mount = mount or config.cameras.mount
        calibration = calibration or config.files.calibration
        tool = str(getattr(config.robot, "tcp_m_rad", "the arm's own"))
    if mount is None:
        raise UsageError(
            "where are the cameras? --mount fixed (beside the robot) or --mount tool (on the arm)"
        )
    return mount, calibration, tool


def _live(arguments: argparse.Namespace, board: Board, mount: Mount, console: Console) -> tuple[Stop, ...]:
    import numpy as np

    from cell import config as configuration
    from cell.commission import capture, session
    from cell.commission.arm import PATIENCE_S, LedArm, SlowArm, halted_by_ctrl_c
    from cell.commission.dome import dome
    from cell.commission.questions import ask
    from cell.frames import transform_of
    from drivers.factory import Factory
    from drivers.timing import MonotonicClock, StopRequested

    if arguments.config is None or arguments.save is None:
        raise UsageError("live: --config FILE and --save DIR are needed")
    count = arguments.dome or arguments.free or 1
    if count < 1:
        raise UsageError(f"{count} poses: at least one; 15 are advised")
    config = configuration.load(arguments.config)
    clock = MonotonicClock()
    factory = Factory(clock)
    rig = factory.rig(config.cameras.left, config.cameras.right, config.cameras.max_skew_s)
    led = arguments.free is not None
    robot: WatchedArm
    if led:
        robot = factory.watched_arm("robot", config.robot)  # a control program would hold it against the hand
    else:
        robot = moved = factory.robot("robot", config.robot)
    try:
        rig.open()
        robot.open()
        with halted_by_ctrl_c(clock) as stop:
            taking = capture.Taking(
                arm=LedArm(robot=robot, stop=stop) if led else SlowArm(robot=moved, stop=stop),
                rig=rig,
                board=board,
                folder=arguments.save,
                look_timeout_s=max(config.cameras.look_timeout_s, PATIENCE_S),
                ask=(lambda _text: True) if arguments.yes else ask,
                say=lambda text: console.print(text, markup=False),
            )
            if arguments.routine is not None:
                return capture.again(taking, session.read(arguments.routine))
            if led:
                return capture.led(taking, count)
            if arguments.start_mm is not None:
                capture.begin(taking, np.array(arguments.start_mm) * 1e-3)
            pivot = arguments.pivot_mm or ([0.0, 0.0, 0.0] if mount == "fixed" else [0.0, 0.0, 300.0])
            poses = dome(
                transform_of(robot.state().tool),
                count,
                float(np.deg2rad(arguments.tilt_deg)),
                1e-3 * arguments.shift_mm,
                (1e-3 * pivot[0], 1e-3 * pivot[1], 1e-3 * pivot[2]),
            )
            return capture.generated(taking, poses)
    except StopRequested as error:
        raise UsageError(f"{error}; the arm was halted") from error
    finally:
        robot.close()
        rig.close()
