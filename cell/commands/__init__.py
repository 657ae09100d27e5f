"""Groups of sub-commands, a module each: ``mikado plc ...``, ``mikado camera ...``.

A module has ``add(commands)``, which adds its parsers and gives each its function by
``parser.set_defaults(run=function)``; the function takes the arguments and returns the exit code. It imports
what it needs when it runs: the other commands must not wait for it.
"""

from __future__ import annotations

import argparse
from typing import Final, Protocol

from cell.commands import area, calibrate, drift, forecast, product, verify


class Commands(Protocol):
    """Where a group adds its parsers; made by `argparse.ArgumentParser.add_subparsers`."""

    def add_parser(self, name: str, *, help: str) -> argparse.ArgumentParser: ...


class Group(Protocol):
    """What a module here offers: it adds its parsers."""

    def __call__(self, commands: Commands) -> None: ...


GROUPS: Final[tuple[Group, ...]] = (
    calibrate.add,
    verify.add,
    area.add,
    drift.add,
    forecast.add,
    product.add,
)
