"""``mikado camera list`` and ``mikado camera aim``: which cameras there are, and what they see while one
turns lens, lamp and stand."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from cell.commands import Commands
    from cell.config import CellConfig
    from cell.moved import Standing
    from drivers.interfaces import Camera
    from drivers.types import FoundCamera, Frame

_OK: Final = 0
_NONE_FOUND: Final = 1


def add(commands: Commands) -> None:
    """Add the group."""
    group = commands.add_parser("camera", help="find cameras, aim them").add_subparsers(
        dest="camera_command", required=True, metavar="COMMAND"
    )
    listing = group.add_parser("list", help="the cameras that can be seen from here, and what they offer")
    listing.add_argument("--controls", action="store_true", help="also their controls with range")
    listing.set_defaults(run=_list)
    aiming = group.add_parser(
        "aim", help="sharpness, exposure, width of a part in pixels, again and again; nothing moves"
    )
    aiming.add_argument("config", type=Path, metavar="CONFIG")
    aiming.add_argument("--side", choices=("left", "right"), help="one camera only (usual: both)")
    aiming.add_argument("--times", type=_count, metavar="N", help="this many lines (usual: until Ctrl-C)")
    aiming.add_argument("--every-s", type=_seconds, default=0.5, metavar="S", help="between lines (0.5)")
    aiming.set_defaults(run=_aim)


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text}: at least 1")
    return value


def _seconds(text: str) -> float:
    value = float(text)
    if not 0.0 <= value <= 60.0:
        raise argparse.ArgumentTypeError(f"{text}: 0 to 60 s")
    return value


def _list(arguments: argparse.Namespace) -> int:
    from rich.console import Console

    from drivers.factory import Factory
    from drivers.timing import MonotonicClock

    console = Console(highlight=False, soft_wrap=True, markup=False)
    cameras, not_asked = Factory(MonotonicClock()).cameras_found()
    for camera in cameras:
        console.print(_entry(camera, controls=arguments.controls))
    if not cameras:
        console.print(
            "no camera found. Webcams: plugged in, and the module uvcvideo loaded? (lsusb; modprobe uvcvideo)"
        )
        if not not_asked:
            console.print(
                "GigE Vision cameras: power, cable, and an address in the network of this machine's port?"
            )
    for line in not_asked:
        console.print(line)
    if not cameras:
        return _NONE_FOUND
    return _OK


def _entry(camera: FoundCamera, *, controls: bool) -> str:
    lines = [f"driver: {camera.driver}, {camera.key}: {camera.device}"]
    lines += [f"  also {name}" for name in camera.also]
    if camera.problem:
        lines.append(f"  {camera.problem}")
    if camera.model:
        lines.append(f"  {camera.model}")
    lines += [f"  {one}" for one in camera.formats]
    lines += [f"  {one}" for one in camera.controls] if controls else []
    return "\n".join(lines)


def _aim(arguments: argparse.Namespace) -> int:
    from rich.console import Console

    from cell import config as configuration
    from cell import wiring
    from drivers.factory import Factory
    from drivers.timing import MonotonicClock, StopToken

    console = Console(highlight=False, soft_wrap=True, markup=False)
    config = configuration.load(arguments.config)
    known = wiring.check(config, str(arguments.config))
    clock = MonotonicClock()
    factory = Factory(clock)
    standing = wiring.standing_now(config, known, factory)
    width_px = config.parts[0].diameter_m * standing.rect.focal_px / (sum(standing.depth_m) / 2)
    of_side = {"left": config.cameras.left, "right": config.cameras.right}
    sides = ("left", "right") if arguments.side is None else (arguments.side,)
    cameras = [factory.camera(f"camera.{side}", of_side[side]) for side in sides]
    token = StopToken(clock)
    opened: list[Camera] = []
    try:
        for camera in cameras:
            camera.open()
            opened.append(camera)
        console.print(f"a part should be {width_px:.1f} px wide by the calibration; Ctrl-C ends")
        done = 0
        while arguments.times is None or done < arguments.times:
            if done:
                token.wait(arguments.every_s)
            asked_at = clock.now()
            frames = [one.grab(newer_than=asked_at, timeout_s=_limit_s(config)) for one in cameras]
            for line in _lines(frames, width_px, standing):
                console.print(line)
            done += 1
    except KeyboardInterrupt:
        return _OK
    finally:
        for camera in opened:
            camera.close()
    return _OK


def _limit_s(config: CellConfig) -> float:
    return config.cameras.look_timeout_s


def _lines(frames: list[Frame], width_px: float, standing: Standing) -> list[str]:
    from cell.aiming import aim
    from cell.frames import grey_of

    greys = [grey_of(frame) for frame in frames]
    lines = [
        f"{frame.camera.removeprefix('camera.'):>5}  {aim(grey, width_px).text()}"
        for frame, grey in zip(frames, greys, strict=True)
    ]
    if len(greys) == 2:
        rows = standing.row_residual(greys[0], greys[1])
        off = f"{rows.px:+.1f} px ({rows.points} of {rows.tried} places)" if rows.known else "not to be told"
        lines.append(f" both  rows off {off}")
    return lines
