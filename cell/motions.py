"""Ways of the arm other than the grip itself: out of view, over a part, to the place, home."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from cell import frames
from cell.stages import Times
from cell.station import Stage, Station
from cell.types import Pick, PickOrder
from drivers.timing import StopToken
from drivers.types import Grip, JointAngles, ResultCode


def move_clear(station: Station, order: PickOrder, stop: StopToken, times: Times) -> float:
    """Out of the cameras' view; the instant from which a picture may be used."""
    with times.stage(station, Stage.CLEAR):
        lift(station, order, stop)
        watch = JointAngles(q_rad=station.workspace.watch_q_rad)
        station.robot.move_joints(watch, station.joint_motion(order.speed_fraction), stop)
    return station.clock.now()


def lift(station: Station, order: PickOrder, stop: StopToken) -> None:
    """Straight up first when the tool is low: an order may have been cut short among the parts."""
    tool = station.robot.state().tool
    if tool.z < station.workspace.travel_z_m - 1e-3:
        target = frames.raised(tool, station.workspace.travel_z_m)
        station.robot.move_line(target, station.approach(order.speed_fraction), stop)


def hover(station: Station, pick: Pick, order: PickOrder, stop: StopToken, times: Times) -> None:
    """Dry run: to the configured height over the grasp and up again, without gripping."""
    with times.stage(station, Stage.FETCH):
        height = station.operation.modes.hover_height_m
        over = pick.approach if height is None else frames.raised(pick.grasp, pick.grasp.z + height)
        for pose in (pick.retreat, over, pick.retreat):
            station.robot.move_line(pose, station.travel(order.speed_fraction), stop)


def place(
    station: Station,
    order: PickOrder,
    stop: StopToken,
    times: Times,
    at_clear: Callable[[], None] | None = None,
) -> ResultCode:
    """Over the next place of the pattern, and let go; PART_LOST when the hand is empty on arrival.

    ``at_clear`` is called on the way, where the arm has left both pictures. The place is taken, durably,
    before the arm goes there: after a power cut it is rather left empty than used twice. A dry run keeps the
    hand shut.
    """
    place_at = (0.0, 0.0) if order.dry_run else station.places.take()
    if place_at is None:
        return ResultCode.PLACE_BLOCKED
    with times.stage(station, Stage.PLACE):
        lift(station, order, stop)
        clear = station.operation.strategy.clear_q_rad
        if at_clear is not None and clear is not None:
            station.robot.move_joints(
                JointAngles(q_rad=clear), station.joint_motion(order.speed_fraction), stop
            )
            at_clear()
        drop = JointAngles(q_rad=station.workspace.drop_q_rad)
        station.robot.move_joints(drop, station.joint_motion(order.speed_fraction), stop)
        if place_at != (0.0, 0.0):
            over = station.robot.state().tool
            over = replace(over, x=over.x + place_at[0], y=over.y + place_at[1])
            station.robot.move_line(over, station.travel(order.speed_fraction), stop)
        if order.dry_run:
            return ResultCode.OK
        arrived_with = station.gripper.grip()
        station.gripper.release(stop=stop)
    return ResultCode.OK if arrived_with is Grip.HOLDING else ResultCode.PART_LOST


def home(station: Station, order: PickOrder, stop: StopToken, times: Times) -> None:
    with times.stage(station, Stage.HOME):
        lift(station, order, stop)
        watch = JointAngles(q_rad=station.workspace.watch_q_rad)
        station.robot.move_joints(watch, station.joint_motion(order.speed_fraction), stop)
