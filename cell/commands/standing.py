"""``mikado state`` and ``mikado alarms``: how the cell stands, and what a person says to its alarms."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cell.commands import Commands


def add(commands: Commands) -> None:
    """Add both."""
    state = commands.add_parser(
        "state", help="how the cell stands: state, alarms, devices, times and counters; reads a file only"
    )
    state.add_argument("config", type=Path, metavar="CONFIG")
    state.add_argument("--json", action="store_true", help="the whole document")
    state.set_defaults(run=_state)
    alarms = commands.add_parser(
        "alarms", help="acknowledge an alarm, or shelve it for a while; the daemon takes it within a second"
    )
    alarms.add_argument("config", type=Path, metavar="CONFIG")
    what = alarms.add_mutually_exclusive_group(required=True)
    what.add_argument("--acknowledge", metavar="CODE", help="an alarm's code, or 'all'")
    what.add_argument("--shelve", type=int, metavar="CODE", help="not shown for --minutes")
    what.add_argument("--unshelve", type=int, metavar="CODE", help="shown again")
    alarms.add_argument("--minutes", type=float, default=60.0, help="how long it is shelved, 480 at most")
    alarms.set_defaults(run=_alarms)


def _state(arguments: argparse.Namespace) -> int:
    import json

    from rich.console import Console

    from cell import config, standing

    document = standing.read(config.load(arguments.config).files.state_folder)
    if arguments.json:
        Console(soft_wrap=True, highlight=False, markup=False).print(json.dumps(document, indent=1))
        return 0
    console = Console(soft_wrap=True, highlight=False, markup=False)
    console.print(f"{document['state']} in {document['mode']}, as of {document['written_at']}")
    for line in _lines(document):
        console.print(line)
    return 0


def _lines(document: dict[str, object]) -> list[str]:
    lines: list[str] = []
    found = document.get("alarms")
    alarms = found if isinstance(found, list) else []
    lines += [
        f"  alarm {a['code']} {a['name']} ({a['priority']}, {a['state']}): {a['detail']}; {a['action']}"
        for a in alarms
    ] or ["  no alarms"]
    devices = document.get("devices")
    if isinstance(devices, dict):
        lines.append("  devices: " + ", ".join(f"{name} {health}" for name, health in devices.items()))
    figures = document.get("figures")
    if isinstance(figures, dict):
        lines.append(
            f"  since {figures['since']}: {figures['produced']} produced, {figures['failed']} failed"
        )
        first = figures.get("first_out")
        if isinstance(first, dict):
            lines.append(f"  last stop: {first['code']} {first['name']} at {first['at']}: {first['detail']}")
        for mode, states in figures["seconds"].items():
            spent = ", ".join(f"{state} {seconds:.0f} s" for state, seconds in sorted(states.items()))
            lines.append(f"  {mode}: {spent}")
    oee = document.get("oee")
    if isinstance(oee, dict):
        lines.append("  today: " + ", ".join(f"{name} {value:.1%}" for name, value in oee.items()))
    return lines


def _alarms(arguments: argparse.Namespace) -> int:
    from cell import config, standing
    from cell.alarm_table import alarm_of
    from cell.errors import UsageError

    if arguments.acknowledge is not None:
        do, number = "acknowledge", arguments.acknowledge
    else:
        do = "shelve" if arguments.shelve is not None else "unshelve"
        number = arguments.shelve if do == "shelve" else arguments.unshelve
    try:
        code = None if number == "all" else int(alarm_of(int(number)))
    except ValueError as error:
        raise UsageError(
            f"{number} is not the code of an alarm; `mikado state` shows those that stand"
        ) from error
    folder = config.load(arguments.config).files.state_folder
    standing.ask(folder, {"do": do, "code": code, "for_s": arguments.minutes * 60.0})
    return 0
