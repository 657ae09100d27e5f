"""The arm sets out on the detector's first answer; the whole scene comes meanwhile, and has the last word."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace

import pytest

from cell import cycle
from cell.cycle import run_order
from cell.faults import VisionFailed
from cell.finding import Finding
from cell.missed import MissedParts
from cell.station import Stage
from cell.types import Outcome, PickResult
from drivers.errors import SafetyStop
from drivers.timing import StopRequested, StopToken
from drivers.types import JointAngles, PlcCommand, ResultCode, SafetyMode, ToolPose
from tests.fakes.clock import FakeClock
from tests.fakes.station import Bench, bench, in_base, order, scene, stick
from tests.unit.cell.scripted import FREE
from vision.published import Observer
from vision.types import Candidate, Crossing, Refusal, Refused, Scene

SECOND = stick((-0.04, -0.38, 0.022), (0.04, -0.38, 0.022))
COVERED = Refused(reason=Refusal.CROSSED, value=1.0, limit=0.0, unit="1")
WAIT_S = 20.0


def first(*candidates: Candidate) -> Scene:
    return replace(scene(*candidates), complete=False)


def over(whole: Scene, above: int, below: int) -> Scene:
    """The same scene with one candidate known to lie over another."""
    point = whole.candidates[above].centre
    crossing = Crossing(above=above, below=below, point=point, gap_m=0.001, sure=5.0)
    return replace(whole, crossings=(*whole.crossings, crossing))


class Detector:
    """Stands in for `locate`: tells its first answer, waits until the rest may come, then gives that."""

    def __init__(self, early: Scene | None, whole: Scene | Exception) -> None:
        self.early = early
        self.whole = whole
        self.may_end = threading.Event()

    def __call__(self, *_: object, observe: Observer, **__: object) -> Scene:
        observe("binarize", None)
        if self.early is not None:
            observe("first", self.early)
        assert self.may_end.wait(WAIT_S), "nobody let the rest of the scene come"
        observe("retrieve", None)
        if isinstance(self.whole, Exception):
            raise self.whole
        return self.whole

    def end(self) -> None:
        """Let the rest come, and be there."""
        self.may_end.set()
        for thread in threading.enumerate():
            if thread.name == "find":
                thread.join(WAIT_S)


@pytest.fixture
def cell() -> Bench:
    return bench().open()


@pytest.fixture
def use(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Detector]:
    def made(early: Scene | None, whole: Scene | Exception) -> Detector:
        detector = Detector(early, whole)
        monkeypatch.setattr(cycle, "locate", detector)
        return detector

    return made


def on_the_way(cell: Bench, action: Callable[[], None]) -> None:
    """Do something in the middle of the arm's third move: out of the view, above the part, near the part."""
    moves = cell.robot.move_s
    cell.clock.at(cell.clock.now() + 2.5 * moves, action)


def ran(cell: Bench, **changes: object) -> PickResult:
    return run_order(cell.station, order(**changes), StopToken(cell.clock))


def lines(cell: Bench) -> list[ToolPose]:
    return [target for target in cell.robot.targets if isinstance(target, ToolPose)]


def grasped_at(cell: Bench) -> list[float]:
    """The y of every place the hand went down to; the sticks lie along x."""
    lowest = cell.station.workspace.floor_z_m + 0.010
    return [round(pose.y, 3) for pose in lines(cell) if pose.z < lowest]


# ------------------------------------------------------------------------------ the first answer counts


def slow(cell: Bench, detector: Detector) -> PickResult:
    """Run an order whose detector gives the whole scene only when the hand waits above the part."""
    told: list[Stage] = []

    def tell(stage: Stage) -> None:
        told.append(stage)
        cell.station.progress(stage)
        if stage is Stage.FIND and told.count(stage) == 2:
            assert told[-2] is Stage.FETCH
            assert len(lines(cell)) == 2, "over the part, then near it"
            assert grasped_at(cell) == []
            detector.may_end.set()

    return run_order(replace(cell.station, progress=tell), order(), StopToken(cell.clock))


def test_the_arm_sets_out_at_once_and_the_hand_waits_above_the_part_for_the_rest(
    cell: Bench, use: Callable[..., Detector]
) -> None:
    result = slow(cell, use(first(FREE), scene(FREE, SECOND)))
    assert (result.code, result.outcome) == (ResultCode.OK, Outcome.PICKED)
    assert grasped_at(cell) == [-0.45]
    assert [target for target in cell.robot.targets if isinstance(target, JointAngles)]


def test_the_whole_scene_is_what_is_reported_drawn_and_counted(
    cell: Bench, use: Callable[..., Detector]
) -> None:
    whole = scene(FREE, SECOND, stick((-0.04, -0.52, 0.022), (0.04, -0.52, 0.022), refusals=(COVERED,)))
    result = slow(cell, use(first(FREE), whole))
    assert result.seen == 3
    assert result.refused == {"CROSSED": 1}
    (look,) = cell.looks
    assert look.scene is whole
    assert {"find.first", "find.retrieve"} <= set(result.durations_s)
    assert cell.stages[:7] == [
        Stage.CLEAR, Stage.LOOK, Stage.FIND, Stage.PLAN, Stage.FETCH, Stage.FIND, Stage.FETCH,
    ]  # fmt: skip
    assert cell.stages[-1] is Stage.PLACE


def test_the_jaws_go_down_where_the_whole_scene_has_room_for_them(
    cell: Bench, use: Callable[..., Detector]
) -> None:
    # one lies under the middle, where the first answer, which did not know of it, would have gripped
    under = ((0.0, -0.49, 0.0185), (0.0, -0.41, 0.0185))
    on_the_way(cell, use(first(FREE), scene(FREE, loose_m=[under])).end)
    assert ran(cell).outcome is Outcome.PICKED
    (grasp,) = (pose for pose in lines(cell) if pose.z < cell.station.workspace.floor_z_m + 0.010)
    jaws = cell.station.jaws
    assert abs(grasp.x) > jaws.width_m / 2
    before = lines(cell)[lines(cell).index(grasp) - 1]
    assert (before.x, before.y) == pytest.approx((grasp.x, grasp.y)), "straight down"


def test_a_whole_scene_that_agrees_on_the_way_changes_nothing(
    cell: Bench, use: Callable[..., Detector]
) -> None:
    seen_again = stick((0.0405, -0.4502, 0.0222), (-0.0398, -0.4501, 0.0222))
    on_the_way(cell, use(first(FREE), scene(SECOND, seen_again)).end)
    assert ran(cell).outcome is Outcome.PICKED
    assert grasped_at(cell) == [-0.45]


def test_what_lay_over_it_from_the_beginning_is_no_contradiction(
    cell: Bench, use: Callable[..., Detector]
) -> None:
    across = stick((0.035, -0.50, 0.026), (0.035, -0.42, 0.026))
    early = replace(over(scene(FREE, across), above=1, below=0), complete=False)
    on_the_way(cell, use(early, over(scene(FREE, across), above=1, below=0)).end)
    assert ran(cell).outcome is Outcome.PICKED
    assert grasped_at(cell) == [-0.45]


# ------------------------------------------------------------------------------ it is taken back


@pytest.mark.parametrize(
    "whole",
    [
        scene(SECOND),
        scene(SECOND, replace(FREE, refusals=(COVERED,))),
        over(scene(SECOND, FREE), above=0, below=1),
        scene(SECOND, FREE, loose_m=[((-0.06, -0.441, 0.03), (0.06, -0.441, 0.03)),
                                     ((-0.06, -0.459, 0.03), (0.06, -0.459, 0.03))]),
    ],
    ids=["not there", "covered", "something lies over it", "no room for the jaws"],
)  # fmt: skip
def test_a_whole_scene_that_disagrees_in_time_replaces_the_pick(
    cell: Bench, use: Callable[..., Detector], whole: Scene
) -> None:
    on_the_way(cell, use(first(FREE), whole).end)
    result = ran(cell)
    assert result.outcome is Outcome.PICKED
    assert result.pose is not None
    assert result.pose.y == pytest.approx(in_base(SECOND.centre)[1], abs=0.001)
    assert grasped_at(cell) == [-0.38]
    up, above, again = lines(cell)[:3]
    assert up == again, "straight up, the way it came"
    assert above.z < up.z
    assert len(cell.looks) == 1


def test_when_nothing_is_left_the_hand_goes_up_and_the_order_says_so(
    cell: Bench, use: Callable[..., Detector]
) -> None:
    on_the_way(cell, use(first(FREE), scene()).end)
    result = ran(cell)
    assert result.code is ResultCode.NO_PART_FOUND
    assert grasped_at(cell) == []
    assert lines(cell)[-1].z >= cell.station.workspace.travel_z_m
    assert "grasp" not in cell.gripper.calls


# ------------------------------------------------------------------------------ no early pick


def waits_for_the_whole(cell: Bench, detector: Detector, **changes: object) -> PickResult:
    """Run an order whose arm may not leave its place above the cameras' view before the whole is there."""
    told: list[Stage] = []

    def tell(stage: Stage) -> None:
        told.append(stage)
        if stage is Stage.FIND and told.count(stage) == 2:
            assert lines(cell) == []
            detector.may_end.set()

    station = replace(cell.station, progress=tell)
    return run_order(station, order(**changes), StopToken(cell.clock))


def test_a_first_answer_without_a_pick_waits(cell: Bench, use: Callable[..., Detector]) -> None:
    assert waits_for_the_whole(cell, use(first(), scene(SECOND))).outcome is Outcome.PICKED
    assert grasped_at(cell) == [-0.38]


def test_a_covered_part_is_never_taken_early(cell: Bench, use: Callable[..., Detector]) -> None:
    covered = replace(FREE, refusals=(COVERED,))
    assert cell.station.workspace.take_covered
    waits_for_the_whole(cell, use(first(covered), scene(covered, SECOND)))
    assert grasped_at(cell) == [-0.38]


def test_a_grip_that_would_hold_two_waits(cell: Bench, use: Callable[..., Detector]) -> None:
    beside = ((-0.06, -0.4545, 0.022), (0.06, -0.4545, 0.022))
    doubtful = replace(scene(FREE, loose_m=[beside]), complete=False)
    waits_for_the_whole(cell, use(doubtful, scene(SECOND)))
    assert grasped_at(cell) == [-0.38]


def test_a_part_that_was_missed_lately_waits(cell: Bench, use: Callable[..., Detector]) -> None:
    missed = MissedParts()
    missed.remember(ToolPose(x=0.0, y=-0.45, z=0.02, rx=0.0, ry=0.0, rz=0.0), in_base(FREE.centre))
    bench_with = replace(cell, station=replace(cell.station, missed=missed))
    waits_for_the_whole(bench_with, use(first(FREE), scene(FREE, SECOND)))
    assert grasped_at(cell) == [-0.38]


@pytest.mark.parametrize("changes", [{"command": PlcCommand.VISION_ONLY}, {"dry_run": True}], ids=str)
def test_who_only_looks_wants_to_see_everything(
    cell: Bench, use: Callable[..., Detector], changes: dict[str, object]
) -> None:
    result = waits_for_the_whole(cell, use(first(FREE), scene(FREE, SECOND)), **changes)
    assert (result.code, result.seen) == (ResultCode.OK, 2)


# ------------------------------------------------------------------------------ errors and stops


def test_an_error_in_the_second_half_ends_the_pick_above_the_part(
    cell: Bench, use: Callable[..., Detector]
) -> None:
    on_the_way(cell, use(first(FREE), ValueError("no such strand")).end)
    with pytest.raises(VisionFailed, match="ValueError: no such strand"):
        ran(cell)
    assert grasped_at(cell) == []
    assert cell.looks == []


def test_an_error_nobody_foresaw_comes_as_it_is(cell: Bench, use: Callable[..., Detector]) -> None:
    use(None, KeyError("depth")).may_end.set()
    with pytest.raises(KeyError, match="depth"):
        ran(cell)


def test_a_stop_while_the_scene_is_explained_ends_order_and_detector(
    cell: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    stop = StopToken(cell.clock)
    ended: list[str] = []

    def endless(*_: object, observe: Observer, **__: object) -> Scene:
        stop.stop("abort by the PLC")
        try:
            for _turn in range(5_000_000):
                observe("explain", None)
        except Exception as error:
            ended.append(type(error).__name__)
            raise
        raise AssertionError("nobody ended it")

    monkeypatch.setattr(cycle, "locate", endless)
    with pytest.raises(StopRequested, match="abort by the PLC"):
        run_order(cell.station, order(), stop)
    assert ended == ["_Abandoned"]
    assert lines(cell) == []
    assert not any(thread.name == "find" for thread in threading.enumerate())


def test_an_arm_that_is_stopped_on_its_way_leaves_no_detector_behind(
    cell: Bench, use: Callable[..., Detector]
) -> None:
    detector = use(first(FREE), scene(FREE))
    cell.robot.faults[2] = SafetyStop("robot", SafetyMode.PROTECTIVE_STOP)
    on_the_way(cell, detector.may_end.set)
    cell.clock.at(cell.clock.now() + 1.5 * cell.robot.move_s, detector.may_end.set)
    with pytest.raises(SafetyStop):
        ran(cell)
    assert not any(thread.name == "find" for thread in threading.enumerate())


def test_a_first_answer_that_says_it_is_complete_is_not_one() -> None:
    whole = scene(FREE, SECOND)

    def find(observe: Observer) -> Scene:
        observe("first", scene(FREE))
        return whole

    token = StopToken(FakeClock())
    with Finding(find, lambda *_: None) as finding:
        assert finding.first(token) is whole
        assert finding.ended
        assert finding.whole(token) is whole
