"""One order from acceptance to result: look, find, plan, fetch, report. Reads from top to bottom."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import assert_never

from cell import frames
from cell.emptiness import is_empty
from cell.faults import VisionFailed
from cell.logs import logger
from cell.pictures import require_colour
from cell.planning import Plan, PlanRefusal, PlanRefused, plan_picks
from cell.station import Look, Stage, Station
from cell.stopwatch import StageTimes
from cell.types import Outcome, Pick, PickOrder, PickResult
from drivers.timing import StopToken
from drivers.types import Grip, JointAngles, PlcCommand, ResultCode
from vision import transforms
from vision.locate import locate
from vision.types import Candidate, Floats

log = logger("cycle")


@dataclass(slots=True)
class Times:
    """Seconds by stage of one order; a stage that comes twice adds up."""

    spent_s: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, station: Station, stage: Stage) -> Iterator[None]:
        """Time a stage and tell the station that it began."""
        station.progress(stage)
        began_at = station.clock.now()
        try:
            yield
        finally:
            self.add(stage.value, station.clock.now() - began_at)

    def add(self, name: str, seconds: float) -> None:
        """Count time for a stage."""
        self.spent_s[name] = round(self.spent_s.get(name, 0.0) + seconds, 4)


def run_order(station: Station, order: PickOrder, stop: StopToken) -> PickResult:
    """Carry out one accepted order.

    Raises
    ------
    StopRequested
        The token fired; the arm has been halted.
    DriverError, PictureUnusable, VisionFailed
        What the loop makes a fault of.
    """
    began_at = station.clock.now()
    times = Times()
    result = _dispatch(station, order, stop, times)
    return _timed(result, station.clock.now() - began_at, times)


def _dispatch(station: Station, order: PickOrder, stop: StopToken, times: Times) -> PickResult:
    match order.command:
        case PlcCommand.PING:
            return _plain(order, ResultCode.OK)
        case PlcCommand.HOME:
            _home(station, order, stop, times)
            return _plain(order, ResultCode.OK)
        case PlcCommand.GRIPPER_OPEN:
            with times.stage(station, Stage.GRIP):
                station.gripper.release(stop=stop)
            return _plain(order, ResultCode.OK)
        case PlcCommand.GRIPPER_CLOSE:
            if order.dry_run:
                return _plain(order, ResultCode.OK)
            with times.stage(station, Stage.GRIP):
                held = station.gripper.grasp(stop=stop)
            return _plain(order, ResultCode.OK, detail=int(held is Grip.HOLDING))
        case PlcCommand.PLACE:
            held = station.gripper.grip()
            if held is not Grip.HOLDING:
                return _plain(order, ResultCode.PART_LOST, outcome=Outcome.MISSED)
            if _place(station, order, stop, times) is not ResultCode.OK:
                return _plain(order, ResultCode.PART_LOST, outcome=Outcome.MISSED)
            # not PICKED: the part was counted by the order that picked it
            return _plain(order, ResultCode.OK, quantity=1)
        case PlcCommand.VISION_ONLY | PlcCommand.PICK | PlcCommand.PICK_AND_PLACE:
            return _pick_with_attempts(station, order, stop, times)
        case PlcCommand.RETRACT | PlcCommand.LOAD_RECIPE | PlcCommand.RECOVER:
            return _plain(order, ResultCode.UNKNOWN_COMMAND)
        case _:
            assert_never(order.command)


def _pick_with_attempts(station: Station, order: PickOrder, stop: StopToken, times: Times) -> PickResult:
    if station.part(order.part_code) is None:
        return _plain(order, ResultCode.BAD_PARAMETER, detail=order.part_code)
    if order.command is not PlcCommand.VISION_ONLY and station.gripper.grip() is Grip.HOLDING:
        # left over from an order that was cut short; it must be out of the hand before the next
        log.warning("part_found_in_gripper", request_id=order.request_id)
        _place(station, order, stop, times)
    for attempt in range(1, order.max_attempts + 1):
        result = run_cycle(station, order, stop, times)
        if result.outcome is not Outcome.MISSED or attempt == order.max_attempts:
            return result
        log.warning("pick_retried", request_id=order.request_id, attempt=attempt, code=result.code.name)
    raise AssertionError("max_attempts is at least 1, checked by the handshake")


def run_cycle(station: Station, order: PickOrder, stop: StopToken, times: Times) -> PickResult:
    """One look and one pick."""
    clear_at = _move_clear(station, order, stop, times)
    look = _look(station, order, clear_at, times)
    station.missed.new_look()
    chosen, unreachable = _choose(station, look.plans)
    refused = [*(why for plan in look.plans for why in plan.refused), *unreachable]
    station.looked(look)
    if chosen is None:
        return _nothing_to_pick(station, order, look, refused)
    if order.command is PlcCommand.VISION_ONLY:
        return _report(order, look, chosen, refused, ResultCode.OK, Outcome.NONE)
    if order.dry_run:
        _hover(station, chosen, order, stop, times)
        return _report(order, look, chosen, refused, ResultCode.OK, Outcome.NONE)
    code = _fetch(station, chosen, order, stop, times)
    if code is not ResultCode.OK:
        station.missed.remember(chosen.grasp, _middle(station, chosen.candidate))
        return _report(order, look, chosen, refused, code, Outcome.MISSED)
    return _report(order, look, chosen, refused, code, Outcome.PICKED)


# --------------------------------------------------------------------------- look, find, plan


def _move_clear(station: Station, order: PickOrder, stop: StopToken, times: Times) -> float:
    """Out of the cameras' view; the instant from which a picture may be used."""
    with times.stage(station, Stage.CLEAR):
        _lift(station, order, stop)
        watch = JointAngles(q_rad=station.workspace.watch_q_rad)
        station.robot.move_joints(watch, station.joint_motion(order.speed_fraction), stop)
    return station.clock.now()


def _lift(station: Station, order: PickOrder, stop: StopToken) -> None:
    """Straight up first when the tool is low: an order may have been cut short among the parts."""
    tool = station.robot.state().tool
    if tool.z < station.workspace.travel_z_m - 1e-3:
        target = frames.raised(tool, station.workspace.travel_z_m)
        station.robot.move_line(target, station.approach(order.speed_fraction), stop)


def _look(station: Station, order: PickOrder, clear_at: float, times: Times) -> Look:
    part = station.part(order.part_code)
    assert part is not None, "checked before the arm moved"
    with times.stage(station, Stage.LOOK):
        pair = station.rig.grab_pair(newer_than=clear_at, timeout_s=station.cameras.look_timeout_s)
        left, right = station.pictures.check(pair)
        colour = None if part.colour is None else require_colour(pair.left, part.name)
    with times.stage(station, Stage.FIND):
        watch = StageTimes(station.clock)
        try:
            scene = locate(
                left,
                right,
                station.stereo,
                part.model(),
                station.tuning,
                station.table,
                observe=watch,
                colour_left=colour,
            )
        except (ValueError, ArithmeticError, IndexError, RuntimeError) as error:
            raise VisionFailed(f"{type(error).__name__}: {error}") from error
    for name, seconds in watch.durations_s.items():
        times.add(f"find.{name}", seconds)
    with times.stage(station, Stage.PLAN):
        plans = plan_picks(
            scene,
            station.base_from_camera,
            station.workspace,
            station.jaws,
            part.diameter_m,
            frames.transform_of(station.robot.state().tool),
            station.missed,
        )
    log.info(
        "look_finished",
        request_id=order.request_id,
        seen=len(scene.candidates),
        offered=len(scene.offered),
        find_s=times.spent_s[Stage.FIND.value],
    )
    return Look(order=order, part=part, pair=pair, scene=scene, plans=plans)


def _choose(station: Station, plans: tuple[Plan, ...]) -> tuple[Pick | None, list[PlanRefused]]:
    """The first pick the arm can reach, and a refusal for each before it that it cannot.

    A part on which a grip failed lately comes last: the same picture gives the same mistake.
    """
    refused: list[PlanRefused] = []
    for plan in sorted(plans, key=lambda p: station.missed.part(_middle(station, p.candidate))):
        if plan.pick is None:
            continue
        if all(
            station.robot.reachable(pose) for pose in (plan.pick.retreat, plan.pick.approach, plan.pick.grasp)
        ):
            return plan.pick, refused
        refused.append(PlanRefused(reason=PlanRefusal.REACH, value=0.0, limit=1.0, unit="1"))
    return None, refused


def _middle(station: Station, candidate: Candidate) -> Floats:
    """(3,) m of a candidate's middle in the base frame."""
    return transforms.apply(station.base_from_camera, candidate.centre)


# --------------------------------------------------------------------------- fetch and place


def _hover(station: Station, pick: Pick, order: PickOrder, stop: StopToken, times: Times) -> None:
    """Dry run: to the approach pose and up again, without gripping."""
    with times.stage(station, Stage.FETCH):
        for pose in (pick.retreat, pick.approach, pick.retreat):
            station.robot.move_line(pose, station.travel(order.speed_fraction), stop)


def _fetch(station: Station, pick: Pick, order: PickOrder, stop: StopToken, times: Times) -> ResultCode:
    """Down, grip, up; and into the drop place where the order says so."""
    robot, gripper = station.robot, station.gripper
    travel, approach = station.travel(order.speed_fraction), station.approach(order.speed_fraction)
    with times.stage(station, Stage.FETCH):
        gripper.release(stop=stop)
        robot.move_line(pick.retreat, travel, stop)  # same pose: above the part, at travel height
        robot.move_line(pick.approach, travel, stop)
        robot.move_line(pick.grasp, approach, stop)
        held = gripper.grasp(stop=stop)
        log.info("grip_closed", request_id=order.request_id, grip=held.value)
        robot.move_line(pick.retreat, approach, stop)
        if held is not Grip.HOLDING:
            gripper.release(stop=stop)
            return ResultCode.GRIP_FAILED
        if gripper.grip() is not Grip.HOLDING:
            gripper.release(stop=stop)
            return ResultCode.PART_LOST
    if order.command is PlcCommand.PICK_AND_PLACE:
        return _place(station, order, stop, times)
    return ResultCode.OK


def _place(station: Station, order: PickOrder, stop: StopToken, times: Times) -> ResultCode:
    """Over the drop place, and let go; PART_LOST when the hand is empty on arrival."""
    with times.stage(station, Stage.PLACE):
        _lift(station, order, stop)
        drop = JointAngles(q_rad=station.workspace.drop_q_rad)
        station.robot.move_joints(drop, station.joint_motion(order.speed_fraction), stop)
        arrived_with = station.gripper.grip()
        station.gripper.release(stop=stop)
    return ResultCode.OK if arrived_with is Grip.HOLDING else ResultCode.PART_LOST


def _home(station: Station, order: PickOrder, stop: StopToken, times: Times) -> None:
    with times.stage(station, Stage.HOME):
        _lift(station, order, stop)
        watch = JointAngles(q_rad=station.workspace.watch_q_rad)
        station.robot.move_joints(watch, station.joint_motion(order.speed_fraction), stop)


# --------------------------------------------------------------------------- results


def _plain(
    order: PickOrder,
    code: ResultCode,
    *,
    outcome: Outcome = Outcome.NONE,
    detail: int = 0,
    quantity: int = 0,
) -> PickResult:
    return PickResult(
        request_id=order.request_id, code=code, outcome=outcome, detail=detail, quantity=quantity
    )


def _nothing_to_pick(
    station: Station, order: PickOrder, look: Look, refused: list[PlanRefused]
) -> PickResult:
    """Empty, or parts that cannot be had: the detail tells the two apart."""
    empty = is_empty(
        look.scene,
        look.part.length_m,
        station.stereo,
        station.table,
        station.base_from_camera,
        station.workspace,
    )
    outcome = Outcome.BIN_EMPTY if empty else Outcome.NOTHING_GRASPABLE
    reasons = {why.reason for why in refused}
    code = ResultCode.NO_PART_FOUND
    if reasons & {PlanRefusal.CLEARANCE}:
        code = ResultCode.COLLISION
    elif reasons & {PlanRefusal.REACH, PlanRefusal.WORKSPACE}:
        code = ResultCode.UNREACHABLE
    return PickResult(
        request_id=order.request_id,
        code=code,
        outcome=outcome,
        detail=int(outcome),
        part_type=look.part.code,
        seen=len(look.scene.candidates),
        refused=_counts(look, refused),
    )


def _report(
    order: PickOrder,
    look: Look,
    pick: Pick,
    refused: list[PlanRefused],
    code: ResultCode,
    outcome: Outcome,
) -> PickResult:
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
        seen=len(look.scene.candidates),
        refused=_counts(look, refused),
    )


def _counts(look: Look, refused: list[PlanRefused]) -> dict[str, int]:
    counts: dict[str, int] = {}
    names = [why.reason.name for c in look.scene.candidates for why in c.refusals]
    for name in [*names, *(why.reason.name for why in refused)]:
        counts[name] = counts.get(name, 0) + 1
    return counts


def _timed(result: PickResult, took_s: float, times: Times) -> PickResult:
    return replace(result, took_s=round(took_s, 4), durations_s=dict(times.spent_s))
