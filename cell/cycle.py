"""One order from acceptance to result: look, find, plan, fetch, report. Reads from top to bottom."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from typing import assert_never

from cell import frames
from cell.config import PartConfig
from cell.finding import Finding, confirmed
from cell.logs import logger
from cell.pictures import require_colour
from cell.planning import Plan, PlanRefusal, PlanRefused, plan_picks
from cell.reaching import reach_of
from cell.results import nothing_to_pick, plain, report
from cell.station import Look, Stage, Station
from cell.stopwatch import StageTimes
from cell.types import Outcome, Pick, PickOrder, PickResult
from drivers.timing import StopToken
from drivers.types import FramePair, Grip, JointAngles, Pixels, PlcCommand, ResultCode
from vision import transforms
from vision.locate import locate
from vision.published import Observer
from vision.types import Candidate, Floats, Grey, Scene, Transform

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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Sight:
    """What one look has to go on: the pair and its pictures, and where the tool was when they were taken."""

    order: PickOrder
    part: PartConfig
    among: tuple[PartConfig, ...]
    pair: FramePair
    left: Grey
    right: Grey
    colour: Pixels | None
    tool: Transform
    watch: StageTimes


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
            return plain(order, ResultCode.OK)
        case PlcCommand.HOME:
            _home(station, order, stop, times)
            return plain(order, ResultCode.OK)
        case PlcCommand.GRIPPER_OPEN:
            with times.stage(station, Stage.GRIP):
                station.gripper.release(stop=stop)
            return plain(order, ResultCode.OK)
        case PlcCommand.GRIPPER_CLOSE:
            if order.dry_run:
                return plain(order, ResultCode.OK)
            with times.stage(station, Stage.GRIP):
                held = station.gripper.grasp(stop=stop)
            return plain(order, ResultCode.OK, detail=int(held is Grip.HOLDING))
        case PlcCommand.PLACE:
            held = station.gripper.grip()
            if held is not Grip.HOLDING:
                return plain(order, ResultCode.PART_LOST, outcome=Outcome.MISSED)
            if _place(station, order, stop, times) is not ResultCode.OK:
                return plain(order, ResultCode.PART_LOST, outcome=Outcome.MISSED)
            # not PICKED: the part was counted by the order that picked it
            return plain(order, ResultCode.OK, quantity=1)
        case PlcCommand.VISION_ONLY | PlcCommand.PICK | PlcCommand.PICK_AND_PLACE:
            return _pick_with_attempts(station, order, stop, times)
        case PlcCommand.RETRACT | PlcCommand.LOAD_RECIPE | PlcCommand.RECOVER:
            return plain(order, ResultCode.UNKNOWN_COMMAND)
        case _:
            assert_never(order.command)


def _pick_with_attempts(station: Station, order: PickOrder, stop: StopToken, times: Times) -> PickResult:
    if station.part(order.part_code) is None:
        return plain(order, ResultCode.BAD_PARAMETER, detail=order.part_code)
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
    """One look and one pick. The arm sets out on the first certain answer; the rest follows."""
    clear_at = _move_clear(station, order, stop, times)
    sight = _look(station, order, clear_at, times)
    station.missed.new_look()
    with Finding(partial(_find, station, sight), sight.watch) as finding:
        with times.stage(station, Stage.FIND):
            first = finding.first(stop)
        early = _early_pick(station, sight, first, times)
        code = None if early is None else _fetch_early(station, sight, early, first, finding, stop, times)
        look = _whole_look(station, sight, finding, stop, times)
    station.looked(look)
    if early is not None and code is not None:
        return _fetched(station, order, look, early, _refused(look), code, stop, times)
    chosen, unreachable = _choose(station, look.plans)
    refused = [*_refused(look), *unreachable]
    if chosen is None:
        return nothing_to_pick(station, order, look, refused)
    if order.command is PlcCommand.VISION_ONLY:
        return report(order, look, chosen, refused, ResultCode.OK, Outcome.NONE)
    if order.dry_run:
        _hover(station, chosen, order, stop, times)
        return report(order, look, chosen, refused, ResultCode.OK, Outcome.NONE)
    with times.stage(station, Stage.FETCH):
        _reach(station, chosen, order, stop)
        code = _grip(station, chosen, order, stop)
    return _fetched(station, order, look, chosen, refused, code, stop, times)


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


def _look(station: Station, order: PickOrder, clear_at: float, times: Times) -> _Sight:
    part = station.part(order.part_code)
    assert part is not None, "checked before the arm moved"
    among = station.among(part)
    with times.stage(station, Stage.LOOK):
        pair = station.rig.grab_pair(newer_than=clear_at, timeout_s=station.cameras.look_timeout_s)
        left, right = station.pictures.check(pair)
        told = next((one for one in (part, *among) if one.colour is not None), None)
        colour = None if told is None else require_colour(pair.left, told.name)
    return _Sight(
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


def _find(station: Station, sight: _Sight, observe: Observer) -> Scene:
    return locate(
        sight.left,
        sight.right,
        station.stereo,
        sight.part.model(),
        sight.part.tuned(station.tuning),
        station.table,
        observe=observe,
        colour_left=sight.colour,
        among=tuple(part.model() for part in sight.among),
    )


def _plans(station: Station, sight: _Sight, scene: Scene) -> tuple[Plan, ...]:
    return plan_picks(
        scene,
        station.base_from_camera,
        station.workspace,
        station.jaws,
        sight.part.diameter_m,
        sight.tool,
        station.missed,
        reach_of(station.kinematics, station.robot.state().joints),
        sight.part.code,
        max(part.diameter_m for part in (sight.part, *sight.among)),
        sight.part.grasp,
    )


def _early_pick(station: Station, sight: _Sight, first: Scene, times: Times) -> Pick | None:
    """A pick of the first answer that leaves nothing to be wished for; None: wait for the whole scene."""
    fetches = sight.order.command in (PlcCommand.PICK, PlcCommand.PICK_AND_PLACE)
    if first.complete or not fetches or sight.order.dry_run:
        return None
    with times.stage(station, Stage.PLAN):
        pick, _ = _choose(station, _plans(station, sight, first))
    if pick is None or not pick.candidate.offered or not pick.gap_free:
        return None
    return None if station.missed.part(_middle(station, pick.candidate)) else pick


def _fetch_early(
    station: Station,
    sight: _Sight,
    early: Pick,
    first: Scene,
    finding: Finding,
    stop: StopToken,
    times: Times,
) -> ResultCode | None:
    """Fetch what the first answer gave; None when the whole scene took it back before the hand went down."""
    with times.stage(station, Stage.FETCH):
        _reach(station, early, sight.order, stop)
        if finding.ended:
            whole = finding.whole(stop)
            plans = _plans(station, sight, whole)
            if not confirmed(early.candidate, first, whole, plans, sight.part.diameter_m):
                log.warning("early_pick_withdrawn", request_id=sight.order.request_id)
                station.robot.move_line(early.retreat, station.travel(sight.order.speed_fraction), stop)
                return None
        return _grip(station, early, sight.order, stop)


def _whole_look(station: Station, sight: _Sight, finding: Finding, stop: StopToken, times: Times) -> Look:
    """The look with everything in it; waits for the rest of the scene where an early pick was quicker."""
    if not finding.ended:
        with times.stage(station, Stage.FIND):
            finding.whole(stop)
    scene = finding.whole(stop)
    for name, seconds in sight.watch.durations_s.items():
        times.add(f"find.{name}", seconds)
    with times.stage(station, Stage.PLAN):
        plans = _plans(station, sight, scene)
    log.info(
        "look_finished",
        request_id=sight.order.request_id,
        part=sight.part.code,
        seen=len(scene.candidates),
        offered=len(scene.offered),
        find_s=times.spent_s[Stage.FIND.value],
    )
    return Look(
        order=sight.order, part=sight.part, pair=sight.pair, scene=scene, plans=plans, among=sight.among
    )


def _refused(look: Look) -> list[PlanRefused]:
    return [why for plan in look.plans for why in plan.refused]


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


def _reach(station: Station, pick: Pick, order: PickOrder, stop: StopToken) -> None:
    """Above the part, with an open hand."""
    travel = station.travel(order.speed_fraction)
    station.gripper.release(stop=stop)
    station.robot.move_line(pick.retreat, travel, stop)  # same pose: above the part, at travel height
    station.robot.move_line(pick.approach, travel, stop)


def _grip(station: Station, pick: Pick, order: PickOrder, stop: StopToken) -> ResultCode:
    """Down, grip, up."""
    robot, gripper, approach = station.robot, station.gripper, station.approach(order.speed_fraction)
    robot.move_line(pick.grasp, approach, stop)
    held = gripper.grasp(stop=stop)
    log.info("grip_closed", request_id=order.request_id, grip=held.value)
    robot.move_line(pick.retreat, approach, stop)
    if held is not Grip.HOLDING:
        gripper.release(stop=stop)
        return ResultCode.GRIP_FAILED
    still = gripper.grip()
    log.info("grip_after_retreat", request_id=order.request_id, grip=still.value)
    if still is not Grip.HOLDING:
        gripper.release(stop=stop)
        return ResultCode.PART_LOST
    return ResultCode.OK


def _fetched(
    station: Station,
    order: PickOrder,
    look: Look,
    pick: Pick,
    refused: list[PlanRefused],
    code: ResultCode,
    stop: StopToken,
    times: Times,
) -> PickResult:
    """Into the drop place where the order says so; a part that is not in the hand is remembered."""
    if code is ResultCode.OK and order.command is PlcCommand.PICK_AND_PLACE:
        code = _place(station, order, stop, times)
    if code is not ResultCode.OK:
        station.missed.remember(pick.grasp, _middle(station, pick.candidate))
        return report(order, look, pick, refused, code, Outcome.MISSED)
    return report(order, look, pick, refused, code, Outcome.PICKED)


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


def _timed(result: PickResult, took_s: float, times: Times) -> PickResult:
    return replace(result, took_s=round(took_s, 4), durations_s=dict(times.spent_s))
