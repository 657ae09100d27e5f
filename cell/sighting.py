"""A look: a pair of pictures taken with a clear view."""

from __future__ import annotations

from cell import frames
from cell.errors import CalibrationError
from cell.faults import PictureUnusable
from cell.mounting import View, grab_from_arm
from cell.pictures import require_colour
from cell.sight import Sight
from cell.stages import Times
from cell.station import Stage, Station
from cell.stopwatch import StageTimes
from cell.types import PickOrder
from drivers.types import FramePair
from vision.types import Transform


def look(station: Station, order: PickOrder, clear_at: float, times: Times) -> Sight:
    """A pair exposed after ``clear_at``, checked; raises as the cameras and `PictureUnusable`."""
    part = station.part(order.part_code)
    assert part is not None, "checked before the arm moved"
    among = station.among(part)
    with times.stage(station, Stage.LOOK):
        pair, tool = _taken(station, clear_at)
        view = station.mounting.view(tool)
        if station.mounting.on_arm:
            _stand(station, view)
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
        tool=tool,
        view=view,
        watch=StageTimes(station.clock),
    )


def _taken(station: Station, clear_at: float) -> tuple[FramePair, Transform]:
    """A pair, and where the tool was at its exposure; of fixed cameras, where it is now."""
    timeout_s = station.cameras.look_timeout_s
    if station.mounting.on_arm:
        return grab_from_arm(station.rig, station.robot, clear_at, timeout_s, station.clock)
    pair = station.rig.grab_pair(newer_than=clear_at, timeout_s=timeout_s)
    return pair, frames.transform_of(station.robot.state().tool)


def _stand(station: Station, view: View) -> None:
    """Raise `PictureUnusable` where the cameras look past the table from here."""
    try:
        station.mounting.standing(view)
    except CalibrationError as error:
        raise PictureUnusable(
            f"the cameras on the arm do not see the parts from where it stands: {error.detail}; correct "
            "workspace.watch_q_rad"
        ) from error
