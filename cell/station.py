"""Everything one pick needs, built once by `cell.wiring` and handed to the cell thread."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum

from cell.config import (
    CamerasConfig,
    JawsConfig,
    LineConfig,
    MotionConfig,
    PartConfig,
    WorkspaceConfig,
    heap_of,
)
from cell.missed import MissedParts
from cell.mounting import Mounting, View
from cell.moved import MovedCheck
from cell.operation import OperationConfig
from cell.pattern import Places
from cell.pictures import PictureCheck
from cell.planning import Plan
from cell.prepared import Prepared
from cell.types import PickOrder
from drivers.interfaces import Gripper, Kinematics, Robot, StereoRig
from drivers.timing import Clock
from drivers.types import FramePair, JointMotion, LineMotion
from vision.types import Candidate, Scene, StereoModel, Tuning


class Stage(Enum):
    """Where a cycle is; `moving` ones have the arm in motion."""

    CLEAR = "clear"
    LOOK = "look"
    FIND = "find"
    PLAN = "plan"
    FETCH = "fetch"
    PLACE = "place"
    HOME = "home"
    GRIP = "grip"

    @property
    def moving(self) -> bool:
        """True where the arm moves."""
        return self in (Stage.CLEAR, Stage.FETCH, Stage.PLACE, Stage.HOME)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Look:
    """One look: the pair, what was found, what planning made of it. Handed to whoever draws or records.

    ``among``: what else was told apart in it; ``plans`` are for the part of the order only.
    """

    order: PickOrder
    part: PartConfig
    pair: FramePair
    scene: Scene
    plans: tuple[Plan, ...]
    view: View
    among: tuple[PartConfig, ...] = ()

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """Those that are, or nearly are, the part of the order."""
        return tuple(c for c in self.scene.candidates if c.part_code == self.part.code)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Station:
    """Devices, geometry and limits of one cell.

    ``mounting``: where the cameras are. ``progress`` is told each stage as it begins; ``looked`` gets each
    finished look.
    """

    rig: StereoRig
    robot: Robot
    kinematics: Kinematics
    gripper: Gripper
    stereo: StereoModel
    mounting: Mounting
    tuning: Tuning
    parts: tuple[PartConfig, ...]
    cameras: CamerasConfig
    workspace: WorkspaceConfig
    jaws: JawsConfig
    motion: MotionConfig
    clock: Clock
    pictures: PictureCheck
    missed: MissedParts
    progress: Callable[[Stage], None]
    looked: Callable[[Look], None]
    heaps: tuple[tuple[int, ...], ...] = ()
    operation: OperationConfig = field(default_factory=OperationConfig)
    places: Places = field(default_factory=Places)
    prepared: Prepared = field(default_factory=Prepared)
    moved: MovedCheck = field(default_factory=MovedCheck)

    def among(self, part: PartConfig) -> tuple[PartConfig, ...]:
        """What else lies in the heap of a product."""
        return heap_of(part, self.parts, self.heaps)

    def part(self, code: int) -> PartConfig | None:
        """The product of a code; 0 means the only one, where there is only one."""
        if code == 0 and len(self.parts) == 1:
            return self.parts[0]
        return next((part for part in self.parts if part.code == code), None)

    def joint_motion(self, speed_fraction: float) -> JointMotion:
        """The configured motion through joint space, slowed by the order."""
        m = self.motion.joints
        return JointMotion(
            speed_rad_s=m.speed_rad_s * speed_fraction,
            accel_rad_s2=m.accel_rad_s2,
            timeout_s=m.timeout_s / speed_fraction,
        )

    def travel(self, speed_fraction: float) -> LineMotion:
        """Lines in free space."""
        return _slowed(self.motion.travel, speed_fraction)

    def approach(self, speed_fraction: float) -> LineMotion:
        """Lines near parts."""
        return _slowed(self.motion.approach, speed_fraction)


def _slowed(line: LineConfig, speed_fraction: float) -> LineMotion:
    return LineMotion(
        speed_m_s=line.speed_m_s * speed_fraction,
        accel_m_s2=line.accel_m_s2,
        timeout_s=line.timeout_s / speed_fraction,
    )
