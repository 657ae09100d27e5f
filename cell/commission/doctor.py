"""A look at everything before the cell runs: each thing that must be so, what was found, what to do.

Moves nothing and changes nothing, on the arm and on the gripper. The daemon must not run meanwhile: the arm's
controller gives its registers to one client only.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from rich.console import Console
from rich.markup import escape

from cell import config as configuration
from cell import places, wiring
from cell.config import CellConfig
from cell.errors import CalibrationError, ConfigError
from drivers.errors import DriverError
from drivers.factory import Factory
from drivers.timing import MonotonicClock
from drivers.types import Check

EXIT_GOOD = 0
EXIT_WRONG = 1


def doctor(path: Path, console: Console) -> int:
    """Print every line; 0 when all are good, 1 when one is not.

    Raises
    ------
    ConfigError
        The configuration cannot be read: nothing else can be looked at.
    """
    config = configuration.load(path)
    factory = Factory(MonotonicClock())
    wrong = 0
    for title, lines in (
        ("configuration", _configuration(config, path, factory)),
        (
            f"cameras ({config.cameras.left.driver})",
            factory.camera_checks(config.cameras.left, config.cameras.right),
        ),
        (f"arm ({config.robot.driver})", _arm(config, factory)),
        (f"gripper ({config.gripper.driver})", _gripper(config, factory)),
    ):
        console.print(f"[bold]{title}[/bold]")
        wrong += sum(not _told(line, console) for line in lines)
    if wrong:
        console.print(f"[red]{wrong} not as they must be[/red]")
        return EXIT_WRONG
    console.print("[green]all good[/green]")
    return EXIT_GOOD


def _told(line: Check, console: Console) -> bool:
    mark = "[green]good [/green]" if line.ok else "[red]WRONG[/red]"
    console.print(f"  {mark} {line.what:<22} {escape(line.found)}", highlight=False)
    if not line.ok and line.do:
        console.print(f"        {'':<22} -> {escape(line.do)}", highlight=False)
    return line.ok


def _configuration(config: CellConfig, path: Path, factory: Factory) -> Iterator[Check]:
    yield Check(what="file", ok=True, found=f"{path}: cell {config.name}, {len(config.parts)} part(s)")
    try:
        known = wiring.check(config, str(path))
    except (CalibrationError, ConfigError) as error:
        yield Check(
            what="calibration", ok=False, found=error.detail, do="calibrate these cameras, or correct the key"
        )
    else:
        yield Check(what="calibration", ok=True, found=f"{known.path} (units {known.units})")
        if known.base_from_camera is None:
            yield Check(
                what="hand-eye",
                ok=False,
                found="base_from_camera is missing",
                do="do the hand-eye calibration",
            )
    yield from places.checks(config, factory.kinematics(config.robot))


def _arm(config: CellConfig, factory: Factory) -> Iterator[Check]:
    lines = factory.robot_checks(config.robot)
    if not lines:
        yield Check(what="simulated", ok=True, found="nothing to look at")
    yield from lines


def _gripper(config: CellConfig, factory: Factory) -> Iterator[Check]:
    try:
        lines = factory.gripper_checks(config.gripper, config.robot)
    except DriverError as error:
        yield Check(what="pins", ok=False, found=error.detail, do="see the lines of the arm first")
        return
    if not lines:
        yield Check(what="simulated", ok=True, found="nothing to look at")
    yield from lines
