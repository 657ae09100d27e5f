"""The simulated cell as a process of its own.

``python -m drivers.sim.cell --world configs/demo/world.yaml --port 0 [--speed 4] [--seed 7] [--sticks 12]
[--faults drop_next,camera_black:left] [--board hand]`` serves eyes, arm, jaws and onlookers on one loopback
port. The first line on standard output tells the port; SIGTERM ends it, and the last line is what the world
counted. With ``--calibration-out FILE`` it writes the calibration that belongs to the world and ends.
"""

from __future__ import annotations

import argparse
import json
import sys
import threading
from contextlib import suppress
from pathlib import Path

import yaml
from pydantic import ValidationError

from drivers.sim import arguments
from drivers.sim.board import BoardPlace
from drivers.sim.controller import Controller
from drivers.sim.layout import WorldLayout
from drivers.sim.optics import calibration_text, eyes
from drivers.sim.process import ending_signals
from drivers.sim.protocol import ProtocolError
from drivers.sim.service import FAULTS, Service, status_values, upset
from drivers.sim.world import World
from drivers.timing import MonotonicClock

TICK_S = 0.004
"""Real time between two steps of the world when nobody asks for anything."""


class BadWorldFile(Exception):
    """The world file cannot be read or does not make sense."""


def load_world(path: Path) -> WorldLayout:
    """Read and check a world file; `BadWorldFile` says what is wrong with which key."""
    try:
        content: object = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadWorldFile(f"{path}: {error.strerror}") from error
    except yaml.YAMLError as error:
        raise BadWorldFile(f"{path}: not YAML: {error}") from error
    try:
        return WorldLayout.model_validate(content)
    except ValidationError as error:
        lines = [".".join(str(part) for part in e["loc"]) + ": " + e["msg"] for e in error.errors()]
        raise BadWorldFile(f"{path}: " + "; ".join(lines)) from error


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = arguments.Parser(prog="python -m drivers.sim.cell", description="The simulated cell.")
    parser.add_argument("--world", type=Path, required=True, metavar="FILE")
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=arguments.port, default=0, help="0: any free one")
    parser.add_argument("--speed", type=arguments.positive, default=1.0, help="simulated seconds per second")
    parser.add_argument("--seed", type=int, help="of the pile; default: the world file's")
    parser.add_argument("--sticks", type=arguments.count, help="how many; default: the world file's")
    parser.add_argument(
        "--faults", default="", metavar="NAME[:EYE],...", help="from the start: " + ", ".join(FAULTS)
    )
    parser.add_argument(
        "--board",
        choices=[place.value for place in BoardPlace],
        default=BoardPlace.NOWHERE.value,
        help="a calibration board: in the hand, in the tray, or waved: held before the cameras, still for a "
        "while here and there",
    )
    parser.add_argument("--calibration-out", type=Path, metavar="FILE")
    return parser.parse_args(argv)


def _run_clock(controller: Controller, ended: threading.Event) -> None:
    while not ended.wait(TICK_S):
        controller.advance()


def main(argv: list[str] | None = None) -> int:
    """Exit codes: 0 asked to end or file written, 2 wrong arguments, 78 unusable world file."""
    options = _arguments(argv)
    try:
        layout = load_world(options.world)
        if options.calibration_out is not None:
            options.calibration_out.write_text(calibration_text(layout.cameras, layout.arm), encoding="utf-8")
            return 0
        world = World(layout, seed=options.seed, count=options.sticks)
        world.board = BoardPlace(options.board)
    except (BadWorldFile, ValueError) as error:
        sys.stderr.write(f"{error}\n")
        return 78
    refused = arguments.refusal(options.host, options.port)
    if refused is not None:
        sys.stderr.write(f"simulated cell: {refused}\n")
        return arguments.EXIT_USAGE
    asked_to_end = ending_signals()
    seed = layout.seed if options.seed is None else options.seed
    controller = Controller(world, MonotonicClock(), options.speed, eyes(layout.cameras), seed)
    try:
        for fault in filter(None, options.faults.split(",")):
            name, _, eye = fault.partition(":")
            upset(controller, name, eye or None)
    except ProtocolError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    ended = threading.Event()
    with Service(controller, options.host, options.port) as service:
        threads = (
            threading.Thread(target=service.serve_forever, kwargs={"poll_interval": 0.05}),
            threading.Thread(target=_run_clock, args=(controller, ended)),
        )
        for thread in threads:
            thread.start()
        sys.stdout.write(json.dumps({"event": "listening", "port": service.port}) + "\n")
        sys.stdout.flush()
        asked_to_end.recv(1)
        ended.set()
        service.shutdown()
        for thread in threads:
            thread.join()
        with suppress(BrokenPipeError):  # whoever started it may be gone already
            sys.stdout.write(json.dumps({"event": "ended", **status_values(controller)}) + "\n")
            sys.stdout.flush()
    asked_to_end.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
