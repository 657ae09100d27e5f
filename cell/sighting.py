"""A look: a pair of pictures taken with a clear view."""

from __future__ import annotations

from cell import frames
from cell.pictures import require_colour
from cell.sight import Sight
from cell.stages import Times
from cell.station import Stage, Station
from cell.stopwatch import StageTimes
from cell.types import PickOrder


def look(station: Station, order: PickOrder, clear_at: float, times: Times) -> Sight:
    """A pair exposed after ``clear_at``, checked; raises as the cameras and `PictureUnusable`."""
    part = station.part(order.part_code)
    assert part is not None, "checked before the arm moved"
    among = station.among(part)
    with times.stage(station, Stage.LOOK):
        pair = station.rig.grab_pair(newer_than=clear_at, timeout_s=station.cameras.look_timeout_s)
        left, right = station.pictures.check(pair)
        told = next((one for one in (part, *among) if one.colour is not None), None)
        colour = None if told is None else require_colour(pair.left, told.name)
    return Sight(
        order=order,
        part=part,
        among=among,
        pair=pair,
        left=left,
        right=right,
        colour=colour,
        tool=frames.transform_of(station.robot.state().tool),
        watch=StageTimes(station.clock),
    )
