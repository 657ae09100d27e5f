"""A cell of scripted doubles on a hand-turned clock, and scenes written by hand in the robot's base frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, TypeAlias

import cv2
import numpy as np

from cell import calibration, config, wiring
from cell.missed import MissedParts
from cell.pictures import PictureCheck
from cell.station import Look, Stage, Station
from cell.types import PickOrder
from drivers.camera.pair import TwoCameraRig
from drivers.interfaces import Device
from drivers.types import Pixels, PlcCommand, ToolPose
from tests.fakes.camera import FakeCamera
from tests.fakes.clock import FakeClock
from tests.fakes.gripper import FakeGripper
from tests.fakes.robot import FakeKinematics, FakeRobot
from vision import transforms
from vision.types import Candidate, Floats, Graph, Matches, Refused, Scene, Segments3D, View

DATA: Final = Path(__file__).parents[1] / "data"
ORIGIN: Final = ToolPose(x=0.0, y=0.0, z=0.0, rx=0.0, ry=0.0, rz=0.0)
ORDER: Final = PickOrder(
    request_id=7,
    command=PlcCommand.PICK_AND_PLACE,
    part_code=1,
    source_id=0,
    destination_id=0,
    max_attempts=1,
    speed_fraction=1.0,
    pose=ORIGIN,
    dry_run=False,
    received_at=0.0,
)
Point: TypeAlias = tuple[float, float, float]


@dataclass(slots=True, kw_only=True)
class Bench:
    """A station with its doubles. ``stages`` and ``looks`` fill as orders run."""

    clock: FakeClock
    robot: FakeRobot
    kinematics: FakeKinematics
    gripper: FakeGripper
    left: FakeCamera
    right: FakeCamera
    rig: TwoCameraRig
    station: Station
    stages: list[Stage]
    looks: list[Look]

    @property
    def devices(self) -> tuple[Device, ...]:
        """In the order in which they are opened."""
        return (self.rig, self.robot, self.gripper)

    def open(self) -> Bench:
        """With every device open."""
        for device in self.devices:
            device.open()
        return self

    def pictures(self, count: int) -> None:
        """Let the cameras have this many more pairs of the drawn scene, each with its own noise."""
        for camera, name in ((self.left, "left"), (self.right, "right")):
            camera.answers.extend(drawn(name, count, seed=len(camera.answers)))


def drawn(name: str, count: int, seed: int = 0) -> list[Pixels]:
    """``count`` pictures of the drawn scene as a living camera gives them, no two the same."""
    read = cv2.imread(str(DATA / f"{name}.png"), cv2.IMREAD_GRAYSCALE)
    assert read is not None
    rng = np.random.default_rng(seed)
    pictures: list[Pixels] = []
    for _ in range(count):
        noisy = read.astype(np.int16) + rng.integers(-1, 2, read.shape)
        pictures.append(np.clip(noisy, 0, 255).astype(np.uint8))
    return pictures


def bench(pictures: int = 1) -> Bench:
    """A cell with ``pictures`` pairs to look at; nothing is open yet."""
    clock = FakeClock()
    settings = config.load(DATA / "cell.yaml")
    known = calibration.load(settings.files.calibration)
    assert known.base_from_camera is not None
    # negative: exposed a moment after they were asked for, as by a camera that runs freely
    left = FakeCamera("camera.left", clock, age_s=-0.01)
    right = FakeCamera("camera.right", clock, age_s=-0.01)
    stages: list[Stage] = []
    looks: list[Look] = []
    robot = FakeRobot("robot", clock)
    gripper = FakeGripper("gripper")
    kinematics = FakeKinematics()
    rig = TwoCameraRig(left, right, settings.cameras.max_skew_s, clock)
    made = Bench(
        clock=clock,
        robot=robot,
        kinematics=kinematics,
        gripper=gripper,
        left=left,
        right=right,
        rig=rig,
        station=Station(
            rig=rig,
            robot=robot,
            kinematics=kinematics,
            gripper=gripper,
            stereo=known.stereo,
            mounting=wiring.mounting_of(settings, known),
            tuning=settings.tuning.tuning(),
            parts=settings.parts,
            cameras=settings.cameras,
            workspace=settings.workspace,
            jaws=settings.jaws,
            motion=settings.motion,
            clock=clock,
            pictures=PictureCheck(),
            missed=MissedParts(),
            progress=stages.append,
            looked=looks.append,
        ),
        stages=stages,
        looks=looks,
    )
    made.pictures(pictures)
    return made


def order(**changes: object) -> PickOrder:
    """The usual order with some fields changed."""
    return replace(ORDER, **changes)  # type: ignore[arg-type]  # names of its fields


def stick(
    start_m: Sequence[float], end_m: Sequence[float], refusals: tuple[Refused, ...] = (), score: float = 0.9
) -> Candidate:
    """A candidate from its two ends in the robot's base frame."""
    base = calibration.load(DATA / "calibration.json").base_from_camera
    assert base is not None
    start, end = transforms.apply(transforms.invert(base), np.array([start_m, end_m], dtype=np.float64))
    length = float(np.linalg.norm(end - start))
    return Candidate(
        part_code=1,
        start=start,
        end=end,
        centre=(start + end) / 2,
        axis=(end - start) / length,
        length_m=length,
        nodes=np.stack([start, end]),
        score=score,
        residual_px=0.1,
        refusals=refusals,
    )


def scene(*candidates: Candidate, loose_m: Sequence[tuple[Point, Point]] = ()) -> Scene:
    """What a look gave: candidates, each with its segment, and loose segments (base frame) beside them."""
    base = calibration.load(DATA / "calibration.json").base_from_camera
    assert base is not None
    loose = transforms.apply(transforms.invert(base), np.array(list(loose_m)).reshape(-1, 2, 3))
    starts = [c.start for c in candidates] + [pair[0] for pair in loose]
    ends = [c.end for c in candidates] + [pair[1] for pair in loose]
    count = len(starts)
    return Scene(
        method="default",
        candidates=candidates,
        segments=Segments3D(
            start=np.array(starts).reshape(-1, 3),
            end=np.array(ends).reshape(-1, 3),
            edge=np.full(count, -1, dtype=np.int64),
            residual_px=np.zeros(count),
        ),
        left=_nothing(),
        right=_nothing(),
        matches=Matches(
            left=np.zeros(0, np.int64),
            right=np.zeros(0, np.int64),
            cost_px=np.zeros(0),
            unmatched=0,
            ambiguous=0,
        ),
    )


def _nothing() -> View:
    none = np.zeros((4, 4), dtype=np.bool_)
    return View(
        grey=np.zeros((4, 4), dtype=np.uint8),
        mask=none,
        skeleton=none,
        graph=Graph(
            points=np.zeros((0, 2)),
            degree=np.zeros(0, np.int64),
            component=np.zeros(0, np.int64),
            edges=np.zeros((0, 2), np.int64),
            lengths_px=np.zeros(0),
            paths=(),
        ),
        band=(0, 255),
    )


def in_base(point_m: Floats) -> Floats:
    """A point of the left camera frame in the robot's base frame."""
    base = calibration.load(DATA / "calibration.json").base_from_camera
    assert base is not None
    return transforms.apply(base, point_m)
