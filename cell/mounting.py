"""Where the cameras stood when a picture was taken: beside the arm for good, or on it, where it was then.

A pose of the arm belongs to a picture only if the arm stood still from before the exposure until after it:
what it says of itself and when a picture was exposed are known to some milliseconds, in which a moving arm
goes further than a part is thick.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from cell import calibration, frames
from cell.calibration import Calibration
from cell.errors import CalibrationError
from cell.faults import PictureUnusable
from cell.moved import Standing
from drivers.errors import DeviceTimeout, StaleData
from drivers.interfaces import Robot, StereoRig
from drivers.timing import Clock
from drivers.types import FramePair, RobotState
from vision import transforms
from vision.types import Plane, Transform

STILL_M: Final = 2e-4
STILL_RAD: Final = 5e-4
"""An arm that stands wanders less than this; at half a metre both come to a quarter of a millimetre."""
_NEWS_S: Final = 0.5
"""An arm tells where it is more often than this."""
_ASK_S: Final = 0.002


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """Cameras and table at one look. ``base_from_camera``: raw left camera to robot base; ``table`` in the
    left camera frame."""

    base_from_camera: Transform
    table: Plane


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mounting:
    """What carries the cameras. ``carrier_from_camera``: raw left camera to the robot's base or, ``on_arm``,
    to the tool's frame."""

    known: Calibration
    on_arm: bool
    carrier_from_camera: Transform
    floor_z_m: float
    height_m: tuple[float, float]

    @staticmethod
    def of(
        known: Calibration, mount: Literal["fixed", "tool"], floor_z_m: float, height_m: tuple[float, float]
    ) -> Mounting:
        """Raises `CalibrationError` where the calibration does not say where the cameras are."""
        on_arm = mount == "tool"
        carrier = known.tool_from_camera if on_arm else known.base_from_camera
        if carrier is None:
            key, other = ("tool_from_camera", "base_from_camera")[:: 1 if on_arm else -1]
            has = known.base_from_camera if on_arm else known.tool_from_camera
            instead = "" if has is None else f" (it has {other}: is cameras.mount: {mount} right?)"
            raise CalibrationError(f"{known.path}: {key} is missing; do the hand-eye calibration{instead}")
        return Mounting(
            known=known, on_arm=on_arm, carrier_from_camera=carrier, floor_z_m=floor_z_m, height_m=height_m
        )

    def view(self, base_from_tool: Transform) -> View:
        """What the cameras see from where the arm is; of fixed ones, from anywhere."""
        base = self.carrier_from_camera
        if self.on_arm:
            base = transforms.compose(base_from_tool, base)
        return View(base_from_camera=base, table=calibration.floor_plane(base, self.floor_z_m))

    def standing(self, view: View) -> Standing:
        """For the check of their rows. Raises `CalibrationError` when the camera does not look down."""
        return Standing.of(self.known, view.table, self.height_m)


def stirred(before: RobotState, after: RobotState) -> str | None:
    """How far an arm moved between two states, in words; None when it stood still."""
    first, last = frames.transform_of(before.tool), frames.transform_of(after.tool)
    way_m = float(np.linalg.norm(last.translation - first.translation))
    turn_rad = transforms.rotation_distance_rad(first.rotation, last.rotation)
    if not (before.moving or after.moving) and way_m <= STILL_M and turn_rad <= STILL_RAD:
        return None
    return f"{1e3 * way_m:.2f} mm and {1e3 * turn_rad:.2f} mrad"


def grab_from_arm(
    rig: StereoRig, robot: Robot, newer_than: float, timeout_s: float, clock: Clock
) -> tuple[FramePair, Transform]:
    """A pair, and ``base_from_tool`` at the instant of its exposure; again while the arm still sways.

    Raises
    ------
    PictureUnusable
        The arm moved while pictures were exposed, until the time was over.
    DriverError
        As cameras and arm; `StaleData` when the arm gives no news.
    """
    until = clock.now() + timeout_s
    moved: str | None = None
    while True:
        before = robot.state()
        try:
            pair = rig.grab_pair(
                newer_than=max(newer_than, before.read_at), timeout_s=max(0.0, until - clock.now())
            )
        except DeviceTimeout:
            if moved is None:
                raise
            raise PictureUnusable(
                f"{rig.name}: the arm that carries the cameras moved by {moved} while pictures were taken "
                f"(allowed {1e3 * STILL_M:g} mm and {1e3 * STILL_RAD:g} mrad); cameras on the arm are for an "
                "arm that stands"
            ) from None
        after = _state_since(robot, clock.now(), clock)
        moved = stirred(before, after)
        if moved is None:
            return pair, frames.transform_of(after.tool)


def _state_since(robot: Robot, since: float, clock: Clock) -> RobotState:
    """What the arm says after an instant: what was read before it may be older than the picture."""
    pause = threading.Event()
    state = robot.state()
    while state.read_at < since:
        if clock.now() - since > _NEWS_S:
            raise StaleData(robot.name, f"no news of where it is for {clock.now() - state.read_at:.2f} s")
        clock.wait(pause, _ASK_S)
        state = robot.state()
    return state
