"""Modes (PackML unit modes): what may be ordered in each, and how an order is carried out in it.

Production 1, maintenance 2, manual 3 as in OMAC's PackTags; dry run 4 is one of the numbers left to the user.
"""

from __future__ import annotations

from dataclasses import replace
from enum import IntEnum
from typing import Final

from cell.operation import ModesConfig
from cell.types import PickOrder
from drivers.types import PlcCommand


class Mode(IntEnum):
    """PackML unit modes."""

    PRODUCTION = 1
    MAINTENANCE = 2
    MANUAL = 3
    DRY_RUN = 4


_FETCHING: Final = frozenset({PlcCommand.PICK, PlcCommand.PICK_AND_PLACE})
REFUSED: Final[dict[Mode, frozenset[PlcCommand]]] = {
    Mode.PRODUCTION: frozenset(),
    Mode.MAINTENANCE: frozenset(),
    Mode.MANUAL: _FETCHING,
    Mode.DRY_RUN: frozenset(),
}
"""Manual is step by step: nothing that strings steps together."""


def as_run(order: PickOrder, mode: Mode, settings: ModesConfig) -> PickOrder:
    """The order as it is carried out in this mode: slow in maintenance, without a grip in a dry run."""
    match mode:
        case Mode.DRY_RUN:
            return replace(order, dry_run=True)
        case Mode.MAINTENANCE | Mode.MANUAL:
            most = settings.maintenance_speed_percent / 100.0
            return replace(order, speed_fraction=min(order.speed_fraction, most))
        case Mode.PRODUCTION:
            return order
