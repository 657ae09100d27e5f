"""Cameras that ride on the arm of the simulated cell: parts are picked by what they saw, and a picture of a
moving arm is refused. Real processes, in real time."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest

from cell import calibration, config, wiring
from cell.faults import PictureUnusable
from cell.frames import grey_of
from cell.mounting import grab_from_arm
from drivers.camera_settings import SimCameraSettings
from drivers.factory import Factory
from drivers.interfaces import StereoRig
from drivers.settings import SimRobotSettings
from drivers.sim.devices import Link
from drivers.sim.geometry import Floats
from drivers.sim.robot import SimRobot
from drivers.timing import MonotonicClock, StopRequested, StopToken
from drivers.types import JointAngles, JointMotion
from tests.fakes.simcell import ROOT, SimCell, sim_cell
from vision import transforms
from vision.locate import locate

CLOCK = MonotonicClock()
FOLDER = ROOT / "configs" / "demo-on-arm"
CONFIG = config.load(FOLDER / "cell.yaml")
KNOWN = calibration.load(FOLDER / "calibration.json")
WATCH = JointAngles(q_rad=CONFIG.workspace.watch_q_rad)
FAST = JointMotion(speed_rad_s=2.0, accel_rad_s2=4.0, timeout_s=20.0)
SLOW = JointMotion(speed_rad_s=0.02, accel_rad_s2=1.0, timeout_s=60.0)
LOOK_S = 20.0
NEAR_M = 0.002


def test_parts_are_picked_by_cameras_on_the_arm(tmp_path: Path) -> None:
    done = subprocess.run(
        [
            *(sys.executable, "-m", "cell", "demo", "--config", str(FOLDER / "cell.yaml"), "--sticks", "2"),
            *("--seed", "7", "--driver", "sim", "--speed", "2", "--out", str(tmp_path)),
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    told = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert (told["in_box"], told["picked"], told["handshake_errors"]) == (2, 2, [])


@contextmanager
def devices(cell: SimCell) -> Iterator[tuple[StereoRig, SimRobot, SimRobot]]:
    """The rig, who moves the arm, and who only asks it."""
    left, right = (
        SimCameraSettings.model_validate(
            {"driver": "sim", "port": cell.port, "eye": eye, "width_px": 640, "height_px": 480}
        )
        for eye in ("left", "right")
    )
    settings = SimRobotSettings(driver="sim", port=cell.port)
    rig = Factory(CLOCK).rig(left, right, CONFIG.cameras.max_skew_s)
    mover, asker = SimRobot("robot", settings, CLOCK), SimRobot("robot", settings, CLOCK)
    asker._link = Link("robot", settings.host, settings.port, CLOCK)  # one that does not take control
    opened = []
    try:
        for device in (rig, mover, asker):
            device.open()
            opened.append(device)
        yield rig, mover, asker
    finally:
        for device in reversed(opened):
            device.close()


@contextmanager
def moving(mover: SimRobot, q_rad: tuple[float, ...]) -> Iterator[None]:
    """The arm goes there slowly, and has come to rest when the context ends."""
    token = StopToken(CLOCK)

    def go() -> None:
        with suppress(StopRequested):
            mover.move_joints(JointAngles(q_rad=q_rad), SLOW, token)  # type: ignore[arg-type]  # six

    thread = threading.Thread(target=go)
    thread.start()
    try:
        yield
    finally:
        token.stop("enough")
        thread.join()


def truth(cell: SimCell) -> Floats:
    """(N, 2, 3) m ends of the sticks, base frame."""
    sticks = cell.ask("truth").values["sticks"]
    assert isinstance(sticks, list)
    return np.array([stick["ends_m"] for stick in sticks if isinstance(stick, dict)])


def test_a_moving_arm_is_refused_and_one_that_stands_anywhere_gives_the_pose_of_its_picture() -> None:
    q = WATCH.q_rad
    elsewhere = (q[0] + 0.5, q[1] + 0.3, *q[2:])
    with sim_cell("--sticks", "2", "--seed", "7", world=FOLDER / "world.yaml") as cell:
        with devices(cell) as (rig, mover, asker):
            mover.move_joints(WATCH, FAST, StopToken(CLOCK))
            # the eyes have not been there yet, which takes them a while
            _, before = grab_from_arm(rig, asker, CLOCK.now(), LOOK_S, CLOCK)
            with (
                moving(mover, elsewhere),
                pytest.raises(
                    PictureUnusable, match=r"the arm that carries the cameras moved by \d+\.\d\d mm"
                ),
            ):
                grab_from_arm(rig, asker, CLOCK.now(), LOOK_S / 3, CLOCK)
            # wherever it came to rest
            pair, tool = grab_from_arm(rig, asker, CLOCK.now(), LOOK_S, CLOCK)
        ends = truth(cell)
    assert np.linalg.norm(tool.translation - before.translation) > 0.002, "it did not move at all"
    view = wiring.mounting_of(CONFIG, KNOWN).view(tool)
    part = CONFIG.parts[0]
    tuning = part.tuned(CONFIG.tuning.tuning())
    scene = locate(grey_of(pair.left), grey_of(pair.right), KNOWN.stereo, part.model(), tuning, view.table)
    found = [transforms.apply(view.base_from_camera, np.stack([c.start, c.end])) for c in scene.recognised]
    for stick in ends:
        ways = [np.linalg.norm(one - stick, axis=1).max() for f in found for one in (f, f[::-1])]
        assert min(ways, default=1.0) < NEAR_M
