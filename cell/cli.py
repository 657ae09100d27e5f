"""The command ``mikado``: sub-commands and exit codes; no logic.

Exit codes: 0 done, 1 failed, 2 usage, 78 configuration or calibration unusable.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Final, NoReturn, TypeVar

from rich.console import Console

from cell import logs, origin
from cell.commands import GROUPS
from cell.errors import CalibrationError, ConfigError, JournalError, UsageError

Number = TypeVar("Number", int, float)

EXIT_FAILED: Final = 1
EXIT_USAGE: Final = 2
EXIT_CONFIG: Final = 78
EXIT_INTERRUPTED: Final = 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; errors a person can act on become one line and an exit code."""
    arguments = parser().parse_args(argv)
    try:
        origin.check()
    except origin.ForeignPackage as error:
        return _fail(error, EXIT_FAILED)
    # only now: what `origin` has just refused could not even be imported
    from cell.faults import PictureUnusable
    from drivers.errors import DriverError

    try:
        return _run(arguments)
    except (ConfigError, CalibrationError) as error:
        return _fail(error, EXIT_CONFIG)
    except UsageError as error:
        return _fail(error, EXIT_USAGE)
    except PictureUnusable as error:
        return _fail(f"{error}; check the camera, its light and its exposure", EXIT_USAGE)
    except (DriverError, JournalError) as error:
        return _fail(error, EXIT_FAILED)
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED


def _fail(error: Exception | str, code: int) -> int:
    sys.stderr.write(f"mikado: {error}\n")
    return code


def _run(arguments: argparse.Namespace) -> int:
    # each command imports what it needs: `mikado check` must not wait for the detector to load
    command: str = arguments.command
    if command == "run":
        from cell import daemon

        logs.setup(as_json=True if arguments.json else None)
        return daemon.run(arguments.config, arguments.last_good)
    if command == "check":
        return _check(arguments.config, arguments.keep)
    if command == "doctor":
        from cell.commission.doctor import doctor

        return doctor(arguments.config, Console(soft_wrap=True, highlight=False))
    if command == "look":
        return _look(arguments)
    if command == "evaluate":
        from cell.evaluate import evaluate

        only, among = tuple(arguments.only), tuple(arguments.among)
        evaluate(arguments.scenes, arguments.out, arguments.method, only, among)
        return 0
    if command == "demo":
        from cell.demo import Wish, demo

        ur = arguments.driver == "ur"
        return demo(
            Wish(
                config=arguments.config,
                out=arguments.out,
                driver=arguments.driver,
                plc=arguments.plc,
                sticks=arguments.sticks,
                seed=arguments.seed,
                speed=arguments.speed or (1.0 if ur else 4.0),
                deadline_s=arguments.deadline_s,
            )
        )
    run: Callable[[argparse.Namespace], int] = arguments.run
    return run(arguments)


def _check(path: Path, keep: Path | None) -> int:
    from cell import config, wiring

    loaded = config.load(path)
    known = wiring.check(loaded, str(path))
    if keep is not None:
        from cell import last_good

        last_good.keep(path, keep)
    Console(soft_wrap=True).print(
        f"{path}: good. Cell {loaded.name}, {len(loaded.parts)} part(s); calibration {known.path} "
        f"(units {known.units}).",
        highlight=False,
    )
    return 0


def _look(arguments: argparse.Namespace) -> int:
    from cell.commission import look
    from vision.types import Tuning

    files = {
        "--left": arguments.left,
        "--right": arguments.right,
        "--calibration": arguments.calibration,
        "--product": arguments.product,
    }
    missing = [name for name, value in files.items() if value is None]
    if arguments.config is not None:
        given = [name for name in files if name not in missing]
        if given:
            raise UsageError(f"--config looks through its own cameras; leave out {', '.join(given)}")
        sight = look.from_cameras(arguments.config, arguments.part, arguments.method)
    elif missing:
        raise UsageError(f"look needs {', '.join(missing)} (or --config FILE for the configured cameras)")
    else:
        tuning = replace(
            Tuning(),
            method=arguments.method or "default",
            band=_pair(arguments.band, "--band"),
            depth_m=_pair(arguments.depth_m, "--depth-m"),
        )
        product, *among = arguments.product
        sight = look.from_files(
            arguments.left, arguments.right, arguments.calibration, product, tuning, tuple(among)
        )
    return look.look(sight, arguments.out, Console())


def _pair(values: list[Number] | None, name: str) -> tuple[Number, Number] | None:
    if values is None:
        return None
    if values[0] >= values[1]:
        raise UsageError(f"{name}: min {values[0]} is not below max {values[1]}")
    return values[0], values[1]


def _grey_value(text: str) -> int:
    value = int(text)
    if not 0 <= value <= 255:
        raise argparse.ArgumentTypeError(f"{value} is not a grey value 0..255")
    return value


def _positive(text: str) -> float:
    value = float(text)
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is not a number above 0")
    return value


class _Parser(argparse.ArgumentParser):
    """What is wrong with a command line goes on one line, like every other error."""

    def error(self, message: str) -> NoReturn:
        self.exit(EXIT_USAGE, f"{self.prog}: {message}; see {self.prog} --help\n")


def parser() -> argparse.ArgumentParser:
    """The whole command line."""
    root = _Parser(
        prog="mikado",
        description="Robot cell controller that picks thin parts out of disorder. Not a safety device.",
    )
    root.add_argument("--version", action="version", version=_version())
    commands = root.add_subparsers(dest="command", required=True, metavar="COMMAND")

    run = commands.add_parser("run", help="the daemon: picks on the orders of the PLC")
    run.add_argument("config", type=Path, metavar="CONFIG")
    run.add_argument("--json", action="store_true", help="log JSON even on a terminal")

    run.add_argument(
        "--last-good",
        type=Path,
        metavar="FILE",
        help="keep a good CONFIG here, and start with this one when CONFIG cannot be used (with an alarm)",
    )

    check = commands.add_parser("check", help="check a configuration and its calibration; opens no device")
    check.add_argument("config", type=Path, metavar="CONFIG")

    check.add_argument("--keep", type=Path, metavar="FILE", help="copy it here when it is good")

    doctor = commands.add_parser(
        "doctor", help="look at configuration, arm and gripper before the cell runs; moves nothing"
    )
    doctor.add_argument("config", type=Path, metavar="CONFIG")

    look = commands.add_parser("look", help="one look without motion: overlay PNG and JSON")
    look.add_argument("--left", type=Path, metavar="PICTURE")
    look.add_argument("--right", type=Path, metavar="PICTURE")
    look.add_argument(
        "--calibration", type=Path, metavar="FILE", help="OpenCV YAML or JSON, or Mikado's JSON"
    )
    look.add_argument(
        "--product",
        type=Path,
        nargs="+",
        metavar="FILE",
        help="YAML: code, name, length_m, ...; of several the first is asked for, the others may lie there",
    )
    look.add_argument("--config", type=Path, metavar="FILE", help="look through the configured cameras")
    look.add_argument(
        "--part", type=int, metavar="CODE", help="with --config: which part (default: the first)"
    )
    look.add_argument("--method", choices=("default", "published"))
    look.add_argument(
        "--band", type=_grey_value, nargs=2, metavar=("MIN", "MAX"), help="grey values of parts"
    )
    look.add_argument(
        "--depth-m", type=_positive, nargs=2, metavar=("MIN", "MAX"), help="distance of the parts, metres"
    )
    look.add_argument("--out", type=Path, default=Path("look-out"), metavar="DIR")

    evaluate = commands.add_parser("evaluate", help="run the detector over scene folders with ground truth")
    evaluate.add_argument("scenes", type=Path, metavar="SCENES")
    evaluate.add_argument("--out", type=Path, required=True, metavar="RESULTS")
    evaluate.add_argument("--method", choices=("default", "published"), default="default")
    evaluate.add_argument("--only", nargs="+", default=[], metavar="SCENE")
    evaluate.add_argument(
        "--among",
        type=Path,
        nargs="+",
        default=[],
        metavar="FILE",
        help="product files: what may lie there besides what a scene asks for",
    )

    demo = commands.add_parser("demo", help="daemon, simulated cell and simulated PLC: empties a tray")
    demo.add_argument("--config", type=Path, default=Path("configs/demo/cell.yaml"), metavar="FILE")
    demo.add_argument("--out", type=Path, default=Path("demo-out"), metavar="DIR")
    demo.add_argument("--sticks", type=int, default=12)
    demo.add_argument("--seed", type=int, default=4)
    demo.add_argument(
        "--driver",
        choices=("ur", "sim"),
        default="ur",
        help="ur: the arm's driver against a simulated controller; sim: the simulated cell's own arm",
    )
    demo.add_argument(
        "--plc",
        choices=("server", "client"),
        default="server",
        help="the PLC's role on Modbus TCP; server: the cell polls it; client: it polls the cell",
    )
    demo.add_argument(
        "--speed", type=_positive, help="simulated seconds per second (default: 1 with ur, 4 with sim)"
    )
    demo.add_argument("--deadline-s", type=_positive, default=240.0)
    for add in GROUPS:
        add(commands)
    return root


def _version() -> str:
    try:
        return f"mikado {metadata.version('mikado-cell')}"
    except metadata.PackageNotFoundError:
        return "mikado (not installed)"


if __name__ == "__main__":
    sys.exit(main())
