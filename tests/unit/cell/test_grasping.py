"""`mikado product grasp`: where a part is gripped is in its file, drawn, and what the planner does."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from cell import config
from cell.cli import main
from cell.missed import MissedParts
from cell.planning import plan_picks
from cell.products import GraspConfig
from cell.reaching import anywhere
from tests.fakes.station import scene, stick
from tests.unit.cell.test_planning import BASE_FROM_CAMERA, DIAMETER_M, JAWS, TOOL_AT_REST, WORKSPACE, lying

ROOT = Path(__file__).parents[3]
DEMO = ROOT / "configs" / "demo" / "cell.yaml"


@pytest.fixture
def product(tmp_path: Path) -> Path:
    shutil.copy(ROOT / "configs" / "parts" / "stick-100.yaml", tmp_path / "stick.yaml")
    return tmp_path / "stick.yaml"


def grasp(product: Path, *words: str) -> int:
    return main(["product", "grasp", str(product), "--config", str(DEMO), *words])


def test_the_grasp_is_in_the_product_file_and_drawn(product: Path, tmp_path: Path) -> None:
    preview = tmp_path / "grasp.png"

    assert grasp(product, "--from-middle-mm", "20", "--slack-mm", "6", "--preview", str(preview)) == 0
    assert grasp(product, "--approach-mm", "45") == 0

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
        (("--approach-mm", "0"), "greater than 0"),
    ],
)
def test_a_grasp_that_cannot_be_is_refused_and_the_file_stays(
    product: Path, words: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = product.read_text(encoding="utf-8")

    assert grasp(product, *words) == 2

    assert said in capsys.readouterr().err
    assert product.read_text(encoding="utf-8") == before


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
