"""`mikado product grasp`: where a part is gripped is in its file, drawn, and what the planner does."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from cell import config, frames
from cell.cli import main
from cell.missed import MissedParts
from cell.planning import Plan, PlanRefusal, plan_picks
from cell.products import GraspConfig
from cell.reaching import anywhere
from tests.fakes.station import scene, stick
from tests.unit.cell.test_planning import (
    BASE_FROM_CAMERA,
    DIAMETER_M,
    JAWS,
    LYING_Z,
    TOOL_AT_REST,
    WORKSPACE,
    lying,
)
from vision import transforms

ROOT = Path(__file__).parents[3]
DEMO = ROOT / "configs" / "demo" / "cell.yaml"


@pytest.fixture
def product(tmp_path: Path) -> Path:
    shutil.copy(ROOT / "configs" / "parts" / "stick-100.yaml", tmp_path / "stick.yaml")
    return tmp_path / "stick.yaml"


@pytest.fixture
def own(tmp_path: Path) -> Path:
    shutil.copy(DEMO, tmp_path / "cell.yaml")
    return tmp_path / "cell.yaml"


def grasp(product: Path, own: Path, *words: str) -> int:
    return main(["product", "grasp", str(product), "--config", str(own), *words])


def test_the_grasp_is_in_the_product_file_and_drawn(product: Path, own: Path, tmp_path: Path) -> None:
    preview = tmp_path / "grasp.png"

    assert grasp(product, own, "--from-middle-mm", "20", "--slack-mm", "6", "--preview", str(preview)) == 0
    assert grasp(product, own, "--approach-mm", "45") == 0

    part = config.load_part(product)
    assert part.grasp == GraspConfig(from_middle_m=0.02, slack_m=0.006, approach_height_m=0.045)
    picture = cv2.imread(str(preview))
    assert picture is not None
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 20


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--from-middle-mm", "49"), "reach over the part's end; at most 46 mm"),
        (("--from-middle-mm", "60"), "beyond the end"),
        (("--approach-mm", "0"), "approach_height_m 0.0: Input should be greater than 0"),
        (
            ("--free-rotation-deg", "60"),
            "free_rotation_rad 1.0472: Input should be less than or equal to 0.8",
        ),
        (("--finger-width-mm", "0"), "width_m 0.0: Input should be greater than 0"),
        (("--opening-mm", "3.5"), "the part is 3.8 mm thick, the jaws of"),
        (("--opening-mm", "12", "--from-middle-mm", "60"), "beyond the end"),
    ],
)
def test_a_grasp_that_cannot_be_is_refused_and_the_file_stays(
    product: Path, own: Path, words: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before, cell_before = product.read_text(encoding="utf-8"), own.read_text(encoding="utf-8")

    assert grasp(product, own, *words) == 2

    assert said in capsys.readouterr().err
    assert product.read_text(encoding="utf-8") == before
    assert own.read_text(encoding="utf-8") == cell_before


def test_jaws_a_part_of_the_cell_does_not_fit_are_refused_with_the_file(
    product: Path, own: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The product fits, another one of the configuration does not."""
    own.write_text(own.read_text().replace("diameter_m: 0.0038", "diameter_m: 0.009"), encoding="utf-8")
    before = own.read_text(encoding="utf-8")

    assert grasp(product, own, "--opening-mm", "8", "--from-middle-mm", "10") == 78

    said = capsys.readouterr().err
    assert f"{own}: not changed" in said
    assert "does not fit" in said
    assert own.read_text(encoding="utf-8") == before
    assert config.load_part(product).grasp is None
    assert not own.with_name("cell.yaml.new").exists()


def test_the_jaws_are_in_the_configuration_and_comments_stay(product: Path, own: Path) -> None:
    words = ("--opening-mm", "25", "--finger-width-mm", "6", "--finger-thickness-mm", "3")
    assert grasp(product, own, *words, "--free-rotation-deg", "30") == 0

    jaws = config.load(own).jaws
    assert (jaws.opening_m, jaws.width_m, jaws.thickness_m) == (0.025, 0.006, 0.003)
    assert jaws.depth_m == config.load(DEMO).jaws.depth_m
    assert "# along the part" in own.read_text(encoding="utf-8")
    wanted = config.load_part(product).grasp
    assert wanted is not None
    assert wanted.free_rotation_rad == pytest.approx(0.5236)
    assert "# along its axis" in product.read_text(encoding="utf-8")


def test_the_preview_shows_how_far_the_hand_may_lean(product: Path, own: Path, tmp_path: Path) -> None:
    fingers = []
    for degrees in ("0", "30"):
        preview = tmp_path / f"{degrees}.png"
        assert grasp(product, own, "--free-rotation-deg", degrees, "--preview", str(preview)) == 0
        picture = cv2.imread(str(preview))
        assert picture is not None
        blue = picture[..., 0].astype(int) - picture[..., 2]
        fingers.append(int((blue > 20).sum()))
    assert fingers[1] > 1.2 * fingers[0]


@pytest.mark.parametrize(
    ("wanted", "from_middle_m", "above_m"),
    [
        (None, 0.0, WORKSPACE.approach_height_m),
        (GraspConfig(from_middle_m=0.02, approach_height_m=0.035), 0.02, 0.035),
    ],
)
def test_the_planner_grips_where_the_product_says(
    wanted: GraspConfig | None, from_middle_m: float, above_m: float
) -> None:
    assert BASE_FROM_CAMERA is not None

    plan = plan_picks(
        scene(stick(*lying(0.03, -0.45, 0.4))), BASE_FROM_CAMERA, WORKSPACE, JAWS, DIAMETER_M, TOOL_AT_REST,
        MissedParts(), anywhere, grasp=wanted,
    )[0]  # fmt: skip

    pick = plan.pick
    assert pick is not None
    assert np.hypot(pick.grasp.x - 0.03, pick.grasp.y + 0.45) == pytest.approx(from_middle_m, abs=1e-6)
    assert pick.approach.z - pick.grasp.z == pytest.approx(above_m)


def test_the_part_is_lifted_as_high_as_the_product_says() -> None:
    assert BASE_FROM_CAMERA is not None
    high = WORKSPACE.travel_z_m + 0.1

    plan = plan_picks(
        scene(stick(*lying(0.03, -0.45, 0.4))), BASE_FROM_CAMERA, WORKSPACE, JAWS, DIAMETER_M, TOOL_AT_REST,
        MissedParts(), anywhere, grasp=GraspConfig(retreat_height_m=high),
    )[0]  # fmt: skip

    assert plan.pick is not None
    assert plan.pick.retreat.z - plan.pick.grasp.z == pytest.approx(high)


# ------------------------------------------------------------------------------ leaning


BARS_M = (-0.018, -0.012, 0.012, 0.018)
"""Bars along a part, 20 mm above it: whichever way the hand stands aside, one is in a finger's way down."""


def planned(free_rotation_rad: float, z: float = 0.05) -> Plan:
    assert BASE_FROM_CAMERA is not None
    bars = [((-0.08, -0.45 + side, z + 0.02), (0.08, -0.45 + side, z + 0.02)) for side in BARS_M]
    return plan_picks(
        scene(stick(*lying(0.0, -0.45, 0.0, z=z)), loose_m=bars), BASE_FROM_CAMERA, WORKSPACE, JAWS,
        DIAMETER_M, TOOL_AT_REST, MissedParts(), anywhere,
        grasp=GraspConfig(free_rotation_rad=free_rotation_rad),
    )[0]  # fmt: skip


def test_a_hand_that_may_lean_finds_room_where_straight_down_has_none() -> None:
    assert planned(0.0).refused[0].reason is PlanRefusal.CLEARANCE

    pick = planned(0.6).pick

    assert pick is not None
    hand = frames.transform_of(pick.grasp)
    lean = math.acos(-hand.rotation[2, 2])
    assert 0.1 < lean <= 0.6 + 1e-9
    # about the part's axis: the jaws still close across it, and it still lies between them
    assert hand.rotation[:, 0] @ [1.0, 0.0, 0.0] == pytest.approx(0.0, abs=1e-9)
    at = transforms.apply(transforms.invert(hand), np.array([pick.grasp.x, -0.45, 0.05]))
    assert abs(at[0]) < (JAWS.opening_m - DIAMETER_M) / 2
    assert at[2] == pytest.approx(-JAWS.below_axis_m)
    # in and out along the hand's own direction, as high as ever
    for pose in (pick.approach, pick.retreat):
        way = np.array(pick.grasp.six()[:3]) - np.array(pose.six()[:3])
        np.testing.assert_allclose(way / np.linalg.norm(way), hand.rotation[:, 2], atol=1e-9)
        np.testing.assert_allclose(pose.six()[3:], pick.grasp.six()[3:])
    assert pick.retreat.z == pytest.approx(WORKSPACE.travel_z_m)


def test_a_small_lean_is_not_enough_and_said_so() -> None:
    assert planned(0.05).refused[0].reason is PlanRefusal.CLEARANCE


def test_a_hand_does_not_lean_into_the_floor() -> None:
    """The lower finger would have to go below it."""
    plan = planned(0.6, z=LYING_Z)
    assert plan.pick is None


def test_a_hand_that_has_room_does_not_lean() -> None:
    assert BASE_FROM_CAMERA is not None
    alone = scene(stick(*lying(0.0, -0.45, 0.3)))
    picks = [
        plan_picks(
            alone, BASE_FROM_CAMERA, WORKSPACE, JAWS, DIAMETER_M, TOOL_AT_REST, MissedParts(), anywhere,
            grasp=wanted,
        )[0].pick
        for wanted in (None, GraspConfig(free_rotation_rad=0.8))
    ]  # fmt: skip
    assert picks[0] is not None
    assert picks[1] is not None
    assert picks[0].grasp == picks[1].grasp
