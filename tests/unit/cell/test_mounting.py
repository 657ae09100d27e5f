"""Cameras on the arm: the same parts are picked wherever the arm looks from, and never by a pose that was not
the one of the exposure."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cell import calibration, config, cycle, frames
from cell.errors import CalibrationError
from cell.faults import PictureUnusable
from cell.mounting import STILL_M, STILL_RAD, Mounting, grab_from_arm, stirred
from cell.types import PickResult
from drivers.errors import StaleData
from drivers.timing import StopToken
from drivers.types import FramePair, PlcCommand, ResultCode, RobotState, ToolPose
from tests.fakes.station import DATA, Bench, bench, order, scene, stick
from vision import transforms
from vision.types import Scene, Transform

KNOWN = calibration.load(DATA / "calibration.json")
FLOOR_Z_M = 0.02
HEIGHT_M = (-0.005, 0.06)
LOOKS = [
    ToolPose(x=0.30, y=-0.30, z=0.30, rx=3.14159, ry=0.0, rz=0.0),
    ToolPose(x=-0.10, y=-0.55, z=0.42, rx=2.1, ry=-2.2, rz=0.1),
    ToolPose(x=0.05, y=-0.40, z=0.38, rx=0.2, ry=3.0, rz=-0.3),
]


def on_arm(tool: ToolPose) -> Mounting:
    """Cameras on an arm that, with the tool there, see what the fixed ones of the test data see."""
    assert KNOWN.base_from_camera is not None
    carried = transforms.compose(transforms.invert(frames.transform_of(tool)), KNOWN.base_from_camera)
    return Mounting.of(replace(KNOWN, tool_from_camera=carried), "tool", FLOOR_Z_M, HEIGHT_M)


def carried(made: Bench, looks_from: ToolPose, monkeypatch: pytest.MonkeyPatch, *scenes: Scene) -> Bench:
    """A cell whose arm carries the cameras and is at ``looks_from`` when it has gone to watch."""
    made.station = replace(made.station, mounting=on_arm(looks_from))
    made.robot.tool = looks_from  # the double does not work joints out: this is where the watch joints are
    answers = list(scenes)
    monkeypatch.setattr(cycle, "locate", lambda *_, **__: answers.pop(0) if answers else scenes[-1])
    return made.open()


def ran(made: Bench, **changes: object) -> PickResult:
    return cycle.run_order(made.station, order(**changes), StopToken(made.clock))


@pytest.mark.parametrize("tool", LOOKS)
def test_table_and_camera_of_a_look_go_with_the_arm(tool: ToolPose) -> None:
    fixed = Mounting.of(KNOWN, "fixed", FLOOR_Z_M, HEIGHT_M).view(frames.transform_of(tool))
    view = on_arm(tool).view(frames.transform_of(tool))
    np.testing.assert_allclose(view.base_from_camera.rotation, fixed.base_from_camera.rotation, atol=1e-12)
    np.testing.assert_allclose(
        view.base_from_camera.translation, fixed.base_from_camera.translation, atol=1e-12
    )
    # 50 mm higher, the table is 50 mm farther away, and looked at from the same side
    higher = on_arm(tool).view(frames.transform_of(frames.raised(tool, tool.z + 0.05)))
    assert higher.table.offset_m == pytest.approx(view.table.offset_m + 0.05)
    np.testing.assert_allclose(higher.table.normal, view.table.normal, atol=1e-12)
    # a point on the table is on it from anywhere
    turned = on_arm(tool).view(
        frames.transform_of(replace(tool, x=tool.x + 0.1, rx=tool.rx * 0.97, ry=tool.ry * 0.97))
    )
    point = transforms.apply(transforms.invert(turned.base_from_camera), np.array([0.03, -0.42, FLOOR_Z_M]))
    assert float(turned.table.normal @ point) + turned.table.offset_m == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("looks_from", LOOKS)
def test_the_same_part_is_gripped_wherever_the_arm_looks_from(
    looks_from: ToolPose, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = scene(stick((-0.04, -0.45, 0.022), (0.04, -0.45, 0.022)))
    beside = bench()
    monkeypatch.setattr(cycle, "locate", lambda *_, **__: seen)
    beside.robot.tool = looks_from
    beside.open()
    ran(beside)
    expected = beside.robot.targets
    made = carried(bench(), looks_from, monkeypatch, seen)
    result = ran(made)
    assert result.code is ResultCode.OK
    got = made.robot.targets
    assert len(got) == len(expected)
    for one, other in zip(got, expected, strict=True):
        if isinstance(one, ToolPose):
            assert isinstance(other, ToolPose)
            # as transforms: half a turn has two rotation vectors
            here, there = frames.transform_of(one), frames.transform_of(other)
            np.testing.assert_allclose(here.translation, there.translation, atol=1e-9)
            assert transforms.rotation_distance_rad(here.rotation, there.rotation) < 1e-6
        else:
            assert one == other


def test_a_look_from_elsewhere_moves_the_grip_by_as_much(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is the same in the picture lies elsewhere when the arm looks from elsewhere."""
    there = ToolPose(x=LOOKS[0].x + 0.02, y=LOOKS[0].y - 0.01, z=0.30, rx=3.14159, ry=0.0, rz=0.0)
    seen = scene(stick((-0.04, -0.45, 0.022), (0.04, -0.45, 0.022)))
    grips = []
    for tool in (LOOKS[0], there):
        made = bench()
        made.station = replace(made.station, mounting=on_arm(LOOKS[0]))
        made.robot.tool = tool
        monkeypatch.setattr(cycle, "locate", lambda *_, **__: seen)
        made.open()
        assert ran(made, command=PlcCommand.VISION_ONLY).code is ResultCode.OK
        (look,) = made.looks
        pick = look.plans[0].pick
        assert pick is not None
        grips.append(np.array(pick.grasp.six()))
    np.testing.assert_allclose(grips[1] - grips[0], [0.02, -0.01, 0.0, 0.0, 0.0, 0.0], atol=1e-9)


class Swaying:
    """An arm that is a little elsewhere each time it is asked, until it has come to rest."""

    def __init__(self, made: Bench, places: Sequence[ToolPose], moving: Sequence[bool] = ()) -> None:
        self.name = "robot"
        self._made = made
        self._places = list(places)
        self._moving = list(moving)
        self.late_s = 0.0

    def state(self) -> RobotState:
        tool = self._places.pop(0) if len(self._places) > 1 else self._places[0]
        moving = self._moving.pop(0) if self._moving else False
        state = replace(self._made.robot.state(), tool=tool, moving=moving)
        return replace(state, read_at=state.read_at - self.late_s)


def grabbed(made: Bench, arm: Swaying, timeout_s: float = 1.0) -> tuple[FramePair, Transform]:
    return grab_from_arm(made.rig, arm, made.clock.now(), timeout_s, made.clock)  # type: ignore[arg-type]


def test_an_arm_that_sways_is_waited_for() -> None:
    made = bench(pictures=3).open()
    rest = LOOKS[0]
    swayed = replace(rest, x=rest.x + 2.0 * STILL_M)
    first, second = replace(rest, rx=rest.rx - 2.0 * STILL_RAD), rest
    pair, tool = grabbed(made, Swaying(made, [swayed, first, first, second, rest, rest]))
    assert pair.left.sequence == 3
    np.testing.assert_allclose(tool.translation, [rest.x, rest.y, rest.z])


def test_an_arm_that_says_it_moves_is_not_believed_to_stand() -> None:
    made = bench(pictures=2).open()
    pair, _ = grabbed(made, Swaying(made, [LOOKS[0]], [True, False]))
    assert pair.left.sequence == 2


def test_pictures_of_a_moving_arm_are_refused_with_how_far_it_went() -> None:
    made = bench(pictures=2).open()
    moved = replace(LOOKS[0], x=LOOKS[0].x + 0.0013)
    with pytest.raises(PictureUnusable, match=r"moved by 1\.30 mm and 0\.00 mrad .*allowed 0\.2 mm"):
        grabbed(made, Swaying(made, [LOOKS[0], moved, LOOKS[0], moved]), timeout_s=0.2)


def test_a_pose_older_than_the_picture_is_not_taken_for_its_own() -> None:
    made = bench(pictures=1).open()
    arm = Swaying(made, [LOOKS[0]])
    arm.late_s = 3600.0
    with pytest.raises(StaleData, match="robot: no news of where it is"):
        grabbed(made, arm)


def test_a_little_wandering_is_standing() -> None:
    state = bench().open().robot.state()
    near = replace(state.tool, x=state.tool.x + 0.5 * STILL_M)
    assert stirred(state, replace(state, tool=near)) is None


def test_a_look_at_the_sky_is_refused_with_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    made = carried(bench(), LOOKS[0], monkeypatch, scene())
    made.robot.tool = replace(LOOKS[0], rx=0.01)
    with pytest.raises(PictureUnusable, match=r"correct workspace\.watch_q_rad"):
        ran(made)


def written(tmp_path: Path, **changes: object) -> Path:
    fields = json.loads((DATA / "calibration.json").read_text())
    for key, value in changes.items():
        fields.pop(key, None)
        if value is not None:
            fields[key] = value
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(fields))
    return path


def test_the_calibration_has_to_say_how_the_arm_carries_the_cameras(tmp_path: Path) -> None:
    pose = np.eye(4)
    pose[:3, 3] = [0.03, 0.09, -0.06]
    held = calibration.load(written(tmp_path, base_from_camera=None, tool_from_camera=pose.tolist()))
    mounting = Mounting.of(held, "tool", FLOOR_Z_M, HEIGHT_M)
    np.testing.assert_allclose(mounting.carrier_from_camera.translation, pose[:3, 3])
    with pytest.raises(CalibrationError, match=r"base_from_camera is missing.*it has tool_from_camera"):
        Mounting.of(held, "fixed", FLOOR_Z_M, HEIGHT_M)
    with pytest.raises(CalibrationError, match=r"tool_from_camera is missing.*it has base_from_camera"):
        Mounting.of(KNOWN, "tool", FLOOR_Z_M, HEIGHT_M)
    pose[3, 0] = 1.0
    with pytest.raises(CalibrationError, match="last row of T_tool_cam"):
        calibration.load(written(tmp_path, tool_from_camera=pose.tolist()))


def test_a_configuration_with_cameras_on_the_arm_is_taken(tmp_path: Path) -> None:
    text = (DATA / "cell.yaml").read_text().replace("mount: fixed", "mount: tool")
    for name in ("left.png", "right.png", "calibration.json"):
        (tmp_path / name).write_bytes((DATA / name).read_bytes())
    path = tmp_path / "cell.yaml"
    path.write_text(text)
    assert config.load(path).cameras.mount == "tool"
