"""The reference of the empty tray in a cell: read, refused, compared, and what an order comes to with it."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from structlog.testing import capture_logs

from cell import calibration, config, cycle, empty_tray
from cell.cycle import run_order
from cell.errors import ConfigError
from cell.missed import MissedParts
from cell.pictures import PictureCheck
from cell.planning import Plan, PlanRefusal, plan_picks
from cell.reaching import anywhere
from cell.types import Outcome
from drivers.timing import StopToken
from drivers.types import Pixels
from tests.fakes.station import DATA, bench, drawn, order, scene
from tests.reference.looks import ROD
from tests.reference.sticks import TABLE, Stick, lying, pair, rig
from tests.unit.cell.test_pictures import pair as frames_of
from tests.unit.cell.test_planning import DIAMETER_M, JAWS, TOOL_AT_REST, WORKSPACE
from vision.locate import locate
from vision.stereo import project
from vision.transforms import apply, invert, make
from vision.types import EmptyTray, Scene, Tuning

BASE_FROM_CAMERA = make(np.diag([1.0, -1.0, -1.0]), np.array([0.0, -0.45, WORKSPACE.floor_z_m + 0.4]))
"""Of the drawn table: straight down on the middle of the workspace."""
KNOWN = calibration.load(DATA / "calibration.json")


def reference(sticks: list[Stick], seed: int) -> EmptyTray:
    left, right = pair(sticks, seed=seed)
    return EmptyTray(left=left, right=right)


def with_reference(folder: Path, left: Pixels | None, right: Pixels | None) -> Path:
    for name in ("cell.yaml", "calibration.json"):
        shutil.copy(DATA / name, folder)
    data = yaml.safe_load((folder / "cell.yaml").read_text(encoding="utf-8"))
    data["files"]["empty_tray"] = "empty"
    (folder / "cell.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")
    (folder / "empty").mkdir()
    for name, picture in zip(empty_tray.NAMES, (left, right), strict=True):
        if picture is not None:
            assert cv2.imwrite(str(folder / "empty" / name), picture)
    return folder / "cell.yaml"


# ------------------------------------------------------------------------------ reading it


def test_the_pictures_beside_the_configuration_are_the_detectors(tmp_path: Path) -> None:
    left, right = drawn("left", 1)[0], drawn("right", 1)[0]
    tuning = empty_tray.tuning_of(config.load(with_reference(tmp_path, left, right)))
    assert tuning.empty is not None
    assert np.array_equal(tuning.empty.left, left)
    assert np.array_equal(tuning.empty.right, right)
    assert empty_tray.tuning_of(config.load(DATA / "cell.yaml")).empty is None


@pytest.mark.parametrize(
    ("right", "said"),
    [
        (None, r"empty/right\.png: files\.empty_tray: cannot be read: No such file .*--take"),
        (
            np.zeros((20, 30), np.uint8),
            r"right\.png: files\.empty_tray: the picture is 30x20, the cameras give",
        ),
    ],
)
def test_a_reference_that_is_missing_or_of_other_cameras_is_named(
    tmp_path: Path, right: Pixels | None, said: str
) -> None:
    path = with_reference(tmp_path, drawn("left", 1)[0], right)
    with pytest.raises(ConfigError, match=said):
        empty_tray.load(config.load(path))


def test_what_is_no_picture_is_named(tmp_path: Path) -> None:
    path = with_reference(tmp_path, drawn("left", 1)[0], None)
    (tmp_path / "empty" / "right.png").write_text("nothing of the kind")
    with pytest.raises(ConfigError, match=r"right\.png: files\.empty_tray: not a picture"):
        empty_tray.load(config.load(path))


def test_cameras_on_the_arm_have_no_one_empty_tray(tmp_path: Path) -> None:
    path = with_reference(tmp_path, None, None)
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    data["cameras"]["mount"] = "tool"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    with pytest.raises(ConfigError, match="cameras on the arm see the tray from elsewhere"):
        config.load(path)


# ------------------------------------------------------------------------------ a grip


def plan_of(stick: Stick, seen: Scene) -> Plan:
    plans = plan_picks(
        seen, BASE_FROM_CAMERA, WORKSPACE, JAWS, DIAMETER_M, TOOL_AT_REST, MissedParts(), anywhere
    )
    middle = (stick.start + stick.end) / 2
    return min(plans, key=lambda plan: float(np.linalg.norm(plan.candidate.centre - middle)))


def test_bars_of_the_tray_block_a_grip_without_the_reference_and_do_not_with_it() -> None:
    stick = lying(0.0, 0.0, 0)
    bars = [lying(0.0, y, 0) for y in (-0.018, -0.012, 0.012, 0.018)]
    left, right = pair([stick, *bars], seed=1)

    without = plan_of(stick, locate(left, right, rig(), ROD, Tuning(), TABLE))
    assert [why.reason for why in without.refused] == [PlanRefusal.CLEARANCE]

    seen = locate(left, right, rig(), ROD, Tuning(empty=reference(bars, 2)), TABLE)
    assert len(seen.candidates) == 1
    assert plan_of(stick, seen).pick is not None


# ------------------------------------------------------------------------------ what is foreign


def dark_thing(picture: Pixels, u: int, v: int, side_px: int) -> Pixels:
    changed = picture.copy()
    changed[v - side_px // 2 : v + side_px // 2, u - side_px // 2 : u + side_px // 2] = 10
    return changed


def test_a_thing_in_the_tray_has_a_place_and_a_size_and_one_beside_it_none() -> None:
    now, empty = pair([], seed=1, table_grey=90.0)[0], reference([], 2)
    empty = replace(empty, left=pair([], seed=2, table_grey=90.0)[0])

    def spots(picture: Pixels) -> tuple[empty_tray.Foreign, ...]:
        return empty_tray.foreign(picture, empty, rig().left, TABLE, BASE_FROM_CAMERA, WORKSPACE)

    assert spots(now) == ()
    here = spots(dark_thing(dark_thing(now, 420, 200, 30), 300, 260, 10))
    assert [round(1e3 * spot.x_m) for spot in here] == [70, -14]
    assert [round(1e3 * spot.y_m) for spot in here] == [-422, -464]
    assert here[0].area_m2 == pytest.approx((30 * 0.4 / 570) ** 2, rel=0.2)  # smoothing makes it wider
    beyond = 240 + int(570 * 0.15 / 0.4)
    assert spots(dark_thing(now, 320, beyond, 16)) == ()


def test_an_empty_look_is_no_empty_bin_while_something_lies_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """The detector knows bright thin parts; a dark tool left in the tray is nothing to it."""
    monkeypatch.setattr(cycle, "locate", lambda *_, **__: scene())
    left, right = (drawn(name, 1, seed=50)[0] for name in ("left", "right"))
    base = KNOWN.base_from_camera
    assert base is not None
    middle = apply(invert(base), np.array([[0.0, -0.45, WORKSPACE.floor_z_m]]))
    u, v = (round(float(x)) for x in project(middle, KNOWN.stereo)[0][0])
    outcomes = []
    for thing in (False, True):
        made = bench(pictures=2).open()
        made.station = replace(
            made.station, tuning=replace(made.station.tuning, empty=EmptyTray(left=left, right=right))
        )
        if thing:
            made.left.answers = [
                dark_thing(answer, u, v, 60) if isinstance(answer, np.ndarray) else answer
                for answer in made.left.answers
            ]
        outcomes.append(run_order(made.station, order(), StopToken(made.clock)).outcome)
    assert outcomes == [Outcome.BIN_EMPTY, Outcome.NOTHING_GRASPABLE]


def test_a_reference_that_does_not_suit_is_remarked_and_logged_once() -> None:
    left, right = drawn("left", 4), drawn("right", 4)
    check = PictureCheck(EmptyTray(left=left[3], right=right[3][:, ::-1].copy()))
    with capture_logs() as logs:
        check.check(frames_of(left[0], right[0]))
        assert [remark.split(":")[0] for remark in check.remarks] == ["camera.right"]
        check.check(frames_of(left[1], right[1]))
        assert len(check.remarks) == 1
    assert [(line["event"], line["cameras"]) for line in logs] == [("empty_tray_left_out", ("camera.right",))]
