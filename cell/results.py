"""What an order came to, in the words of the journal and the PLC."""

from __future__ import annotations

from typing import Final

from cell import frames
from cell.emptiness import is_empty
from cell.empty_tray import foreign
from cell.planning import PlanRefusal, PlanRefused
from cell.station import Look, Station
from cell.types import Outcome, Pick, PickOrder, PickResult
from drivers.types import PlcCommand, ResultCode

UNREACHABLE: Final = frozenset(
    {
        PlanRefusal.WORKSPACE,
        PlanRefusal.REACH,
        PlanRefusal.JOINT,
        PlanRefusal.SINGULARITY,
        PlanRefusal.POSTURE,
    }
)
"""Reasons that lie in where a part is, not in what lies around it."""
_SPECK_SHARE: Final = 0.5
"""A spot that the empty tray has not and that is smaller than this share of a part's area is dirt."""


def plain(
    order: PickOrder,
    code: ResultCode,
    *,
    outcome: Outcome = Outcome.NONE,
    detail: int = 0,
    quantity: int = 0,
) -> PickResult:
    """A result of an order that looked at nothing."""
    return PickResult(
        request_id=order.request_id, code=code, outcome=outcome, detail=detail, quantity=quantity
    )


def nothing_to_pick(station: Station, order: PickOrder, look: Look, refused: list[PlanRefused]) -> PickResult:
    """Empty, or parts that cannot be had: the detail tells the two apart."""
    empty = is_empty(
        look.scene,
        look.part.length_m,
        station.stereo,
        look.view.table,
        look.view.base_from_camera,
        station.workspace,
    )
    if empty and station.tuning.empty is not None:
        spots = foreign(
            frames.grey_of(look.pair.left),
            station.tuning.empty,
            station.stereo.left,
            look.view.table,
            look.view.base_from_camera,
            station.workspace,
        )
        empty = not spots or spots[0].area_m2 < _SPECK_SHARE * look.part.length_m * look.part.diameter_m
    outcome = Outcome.BIN_EMPTY if empty else Outcome.NOTHING_GRASPABLE
    reasons = {why.reason for why in refused}
    code = ResultCode.NO_PART_FOUND
    if reasons & {PlanRefusal.CLEARANCE}:
        code = ResultCode.COLLISION
    elif reasons & UNREACHABLE:
        code = ResultCode.UNREACHABLE
    return PickResult(
        request_id=order.request_id,
        code=code,
        outcome=outcome,
        detail=int(outcome),
        part_type=look.part.code,
        seen=len(look.candidates),
        refused=_counts(look, refused),
    )


def report(
    order: PickOrder,
    look: Look,
    pick: Pick,
    refused: list[PlanRefused],
    code: ResultCode,
    outcome: Outcome,
) -> PickResult:
    """A result of a look that gave a pick."""
    only_looked = order.command is PlcCommand.VISION_ONLY
    graspable = sum(plan.pick is not None for plan in look.plans)
    return PickResult(
        request_id=order.request_id,
        code=code,
        outcome=outcome,
        detail=int(outcome),
        quantity=graspable if only_looked else int(outcome is Outcome.PICKED),
        part_type=look.part.code,
        confidence=pick.score,
        pose=pick.grasp,
        seen=len(look.candidates),
        refused=_counts(look, refused),
    )


def _counts(look: Look, refused: list[PlanRefused]) -> dict[str, int]:
    counts: dict[str, int] = {}
    names = [why.reason.name for c in look.candidates for why in c.refusals]
    for name in [*names, *(why.reason.name for why in refused)]:
        counts[name] = counts.get(name, 0) + 1
    return counts
