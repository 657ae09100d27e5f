"""One order from acceptance to result: look, find, plan, fetch, report. Reads from top to bottom."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import assert_never

from cell import frames
from cell.faults import PictureUnusable
from cell.finding import Finding, confirmed
from cell.logs import logger
from cell.motions import home, hover, lift, move_clear, place
from cell.mounting import View
from cell.planning import Plan, PlanRefusal, PlanRefused, plan_picks
from cell.reaching import reach_of
from cell.results import nothing_to_pick, plain, report
from cell.sight import Sight
from cell.sighting import look
from cell.stages import Times
from cell.station import Look, Stage, Station
from cell.types import Outcome, Pick, PickOrder, PickResult
from drivers.errors import DriverError
from drivers.timing import StopToken
from drivers.types import Grip, PlcCommand, ResultCode
from vision import transforms
from vision.locate import locate
from vision.published import Observer
from vision.types import Candidate, Floats, Scene

log = logger("cycle")


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
    if order.command not in (PlcCommand.PICK, PlcCommand.PICK_AND_PLACE, PlcCommand.PING):
        station.prepared.drop()
    result = _dispatch(station, order, stop, times)
    return _timed(result, station.clock.now() - began_at, times)


def _dispatch(station: Station, order: PickOrder, stop: StopToken, times: Times) -> PickResult:
    match order.command:
        case PlcCommand.PING:
            return plain(order, ResultCode.OK)
        case PlcCommand.HOME:
            home(station, order, stop, times)
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
            if not station.places.any_free:
                return plain(order, ResultCode.PLACE_BLOCKED)
            held = station.gripper.grip()
            if held is not Grip.HOLDING:
                return plain(order, ResultCode.PART_LOST, outcome=Outcome.MISSED)
            if place(station, order, stop, times) is not ResultCode.OK:
                return plain(order, ResultCode.PART_LOST, outcome=Outcome.MISSED)
            # not PICKED: the part was counted by the order that picked it
            return plain(order, ResultCode.OK, quantity=1)
        case PlcCommand.VISION_ONLY | PlcCommand.PICK | PlcCommand.PICK_AND_PLACE:
            return _pick_with_attempts(station, order, stop, times)
        case PlcCommand.RETRACT | PlcCommand.LOAD_RECIPE | PlcCommand.RECOVER | PlcCommand.SET_MODE:
            return plain(order, ResultCode.UNKNOWN_COMMAND)
        case _:
            assert_never(order.command)


def _pick_with_attempts(station: Station, order: PickOrder, stop: StopToken, times: Times) -> PickResult:
    if station.part(order.part_code) is None:
        return plain(order, ResultCode.BAD_PARAMETER, detail=order.part_code)
    fetches = order.command is not PlcCommand.VISION_ONLY and not order.dry_run
    if fetches and order.command is PlcCommand.PICK_AND_PLACE and not station.places.any_free:
        return plain(order, ResultCode.PLACE_BLOCKED)
    if fetches and station.gripper.grip() is Grip.HOLDING:
        # left over from an order that was cut short; it must be out of the hand before the next
        log.warning("part_found_in_gripper", request_id=order.request_id)
        if place(station, order, stop, times) is ResultCode.PLACE_BLOCKED:
            return plain(order, ResultCode.PLACE_BLOCKED)
    for attempt in range(1, order.max_attempts + 1):
        result = run_cycle(station, order, stop, times)
        if result.outcome is not Outcome.MISSED or attempt == order.max_attempts:
            return result
        log.warning("pick_retried", request_id=order.request_id, attempt=attempt, code=result.code.name)
    raise AssertionError("max_attempts is at least 1, checked by the handshake")


def run_cycle(station: Station, order: PickOrder, stop: StopToken, times: Times) -> PickResult:
    """One look and one pick. The arm sets out on the first certain answer; the rest follows."""
    sight, search = _prepared(station, order, stop, times) or _fresh(station, order, stop, times)
    station.missed.new_look()
    with search as finding:
        with times.stage(station, Stage.FIND):
            first = finding.first(stop)
        early = _early_pick(station, sight, first, times)
        fetched = None if early is None else _fetch_early(station, sight, early, first, finding, stop, times)
        seen = _whole_look(station, sight, finding, stop, times)
    station.looked(seen)
    if fetched is not None:
        pick, code = fetched
        return _fetched(station, order, seen, pick, _refused(seen), code, stop, times)
    chosen, unreachable = _choose(station, seen.view, seen.plans)
    refused = [*_refused(seen), *unreachable]
    if chosen is None:
        return nothing_to_pick(station, order, seen, refused)
    if order.command is PlcCommand.VISION_ONLY:
        return report(order, seen, chosen, refused, ResultCode.OK, Outcome.NONE)
    if order.dry_run:
        hover(station, chosen, order, stop, times)
        return report(order, seen, chosen, refused, ResultCode.OK, Outcome.NONE)
    with times.stage(station, Stage.FETCH):
        _reach(station, chosen, order, stop)
        code = _grip(station, chosen, order, stop)
    return _fetched(station, order, seen, chosen, refused, code, stop, times)


# --------------------------------------------------------------------------- look, find, plan


def _fresh(station: Station, order: PickOrder, stop: StopToken, times: Times) -> tuple[Sight, Finding]:
    """Out of the way, and a picture taken from then on."""
    clear_at = move_clear(station, order, stop, times)
    sight = look(station, order, clear_at, times)
    return sight, Finding(partial(_find, station, sight), sight.watch)


def _prepared(
    station: Station, order: PickOrder, stop: StopToken, times: Times
) -> tuple[Sight, Finding] | None:
    """The sight that was taken on the way to the place, where it may still be used."""
    ready = station.prepared.take(order, station.operation.strategy.prepared_max_age_s, station.clock.now())
    if ready is None:
        return None
    log.info("prepared_look_used", request_id=order.request_id)
    with times.stage(station, Stage.CLEAR):
        lift(station, order, stop)
    now = frames.transform_of(station.robot.state().tool)
    return replace(ready.sight, order=order, tool=now), ready.finding


def _prepare(station: Station, order: PickOrder, times: Times) -> None:
    """The arm has just passed the point from which on it is out of both pictures: look, and begin to search.

    What goes wrong here is left to the next order, which looks again: a part is in the hand.
    """
    clear_at = station.clock.now()
    try:
        sight = look(station, order, clear_at, times)
    except (DriverError, PictureUnusable) as error:
        log.warning("look_while_placing_failed", request_id=order.request_id, detail=str(error))
        return
    finding = Finding(partial(_find, station, sight), sight.watch)
    station.prepared.begin(sight, finding, clear_at)


def _at_clear(station: Station, order: PickOrder, times: Times) -> Callable[[], None] | None:
    """What is done on the way to the place: nothing, or the next look."""
    if not station.operation.strategy.look_while_placing:
        return None
    return partial(_prepare, station, order, times)


def _find(station: Station, sight: Sight, observe: Observer) -> Scene:
    """The whole scene; in the thread of the search, while the arm may be on its way."""
    scene = locate(
        sight.left,
        sight.right,
        station.stereo,
        sight.part.model(),
        sight.part.tuned(station.tuning),
        sight.view.table,
        observe=observe,
        colour_left=sight.colour,
        among=tuple(part.model() for part in sight.among),
    )
    station.moved.check(
        scene,
        (sight.left, sight.right),
        f"{sight.pair.left.camera}, {sight.pair.right.camera}",
        partial(station.mounting.standing, sight.view),
    )
    return scene


def _plans(station: Station, sight: Sight, scene: Scene) -> tuple[Plan, ...]:
    return plan_picks(
        scene,
        sight.view.base_from_camera,
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


def _early_pick(station: Station, sight: Sight, first: Scene, times: Times) -> Pick | None:
    """A pick of the first answer that leaves nothing to be wished for; None: wait for the whole scene."""
    fetches = sight.order.command in (PlcCommand.PICK, PlcCommand.PICK_AND_PLACE)
    if first.complete or not fetches or sight.order.dry_run:
        return None
    with times.stage(station, Stage.PLAN):
        pick, _ = _choose(station, sight.view, _plans(station, sight, first))
    if pick is None or not pick.candidate.offered or not pick.gap_free:
        return None
    return None if station.missed.part(_middle(sight.view, pick.candidate)) else pick


def _fetch_early(
    station: Station,
    sight: Sight,
    early: Pick,
    first: Scene,
    finding: Finding,
    stop: StopToken,
    times: Times,
) -> tuple[Pick, ResultCode] | None:
    """Set out for what the first answer gave, and pick it as the whole scene has it, which alone knows where
    the jaws have room. None when that took it back before the hand went down."""
    order = sight.order
    with times.stage(station, Stage.FETCH):
        _reach(station, early, order, stop)
    if not finding.ended:
        with times.stage(station, Stage.FIND):
            finding.whole(stop)
    with times.stage(station, Stage.FETCH):
        whole = finding.whole(stop)
        again = confirmed(early.candidate, first, whole, _plans(station, sight, whole), sight.part.diameter_m)
        pick = None if again is None else _choose(station, sight.view, (again,))[0]
        travel = station.travel(order.speed_fraction)
        if pick is None:
            log.warning("early_pick_withdrawn", request_id=order.request_id)
            station.robot.move_line(early.retreat, travel, stop)
            return None
        if pick.approach != early.approach:
            station.robot.move_line(pick.approach, travel, stop)
        return pick, _grip(station, pick, order, stop)


def _whole_look(station: Station, sight: Sight, finding: Finding, stop: StopToken, times: Times) -> Look:
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
        skew_s=round(sight.pair.skew_s, 5),
    )
    return Look(
        order=sight.order,
        part=sight.part,
        pair=sight.pair,
        scene=scene,
        plans=plans,
        view=sight.view,
        among=sight.among,
    )


def _refused(look: Look) -> list[PlanRefused]:
    return [why for plan in look.plans for why in plan.refused]


def _choose(station: Station, view: View, plans: tuple[Plan, ...]) -> tuple[Pick | None, list[PlanRefused]]:
    """The first pick the arm can reach, and a refusal for each before it that it cannot.

    A part on which a grip failed lately comes last: the same picture gives the same mistake.
    """
    refused: list[PlanRefused] = []
    for plan in sorted(plans, key=lambda p: station.missed.part(_middle(view, p.candidate))):
        if plan.pick is None:
            continue
        if all(
            station.robot.reachable(pose) for pose in (plan.pick.retreat, plan.pick.approach, plan.pick.grasp)
        ):
            return plan.pick, refused
        refused.append(PlanRefused(reason=PlanRefusal.REACH, value=0.0, limit=1.0, unit="1"))
    return None, refused


def _middle(view: View, candidate: Candidate) -> Floats:
    """(3,) m of a candidate's middle in the base frame."""
    return transforms.apply(view.base_from_camera, candidate.centre)


# --------------------------------------------------------------------------- fetch and place


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
        code = place(station, order, stop, times, _at_clear(station, order, times))
    if code is not ResultCode.OK:
        station.prepared.drop()  # the part may lie anywhere now
        station.missed.remember(pick.grasp, _middle(look.view, pick.candidate))
        return report(order, look, pick, refused, code, Outcome.MISSED)
    return report(order, look, pick, refused, code, Outcome.PICKED)


def _timed(result: PickResult, took_s: float, times: Times) -> PickResult:
    return replace(result, took_s=round(took_s, 4), durations_s=dict(times.spent_s))
