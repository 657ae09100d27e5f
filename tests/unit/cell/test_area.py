"""The pick area: taught into a configuration whose comments stay."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cell import config, yamledit
from cell.commission import area
from cell.errors import ConfigError, UsageError
from tests.fakes.simcell import ROOT

DEMO = ROOT / "configs" / "demo"


@pytest.fixture
def own(tmp_path: Path) -> Path:
    for name in ("cell.yaml", "calibration.json"):
        (tmp_path / name).write_bytes((DEMO / name).read_bytes())
    return tmp_path / "cell.yaml"


def test_touched_corners_make_box_and_floor_and_comments_stay(own: Path) -> None:
    points = np.array([[-0.1, -0.5, 0.0212], [0.1, -0.5, 0.0208], [0.1, -0.4, 0.021], [-0.1, -0.4, 0.021]])
    area.write_area(own, config.load(own), points, 0.06, floor=True, margin_m=0.005)
    space = config.load(own).workspace
    assert space.box_min_m == pytest.approx((-0.095, -0.495, 0.019))
    assert space.box_max_m == pytest.approx((0.095, -0.405, 0.081))
    assert space.floor_z_m == pytest.approx(0.021)
    assert "# along the part" in own.read_text()
    assert own.with_name("cell.yaml.old").read_bytes() == (DEMO / "cell.yaml").read_bytes()


def test_points_in_the_picture_land_on_the_floor(own: Path) -> None:
    points = area.picture_points(config.load(own), [(320.0, 240.0), (100.0, 100.0), (500.0, 380.0)], 0.02)
    assert points[:, 2] == pytest.approx([0.02] * 3)
    assert abs(points[0, 1] + 0.45) < 0.03


def test_what_cannot_be_an_area_is_refused_and_nothing_is_written(own: Path) -> None:
    before = own.read_bytes()
    line = np.array([[0.0, 0.0, 0.02], [0.1, 0.0, 0.02], [0.2, 0.0, 0.02]])
    with pytest.raises(UsageError, match="one line"):
        area.write_area(own, config.load(own), line, 0.06, floor=False, margin_m=0.0)
    far = np.array([[2.0, 0.0, 0.02], [3.0, 0.0, 0.02], [2.0, 1.0, 0.02]])
    with pytest.raises(ConfigError, match="reach"):
        area.write_area(own, config.load(own), far, 0.06, floor=False, margin_m=0.0)
    assert own.read_bytes() == before


def test_a_key_and_a_section_that_are_not_there_are_added(own: Path) -> None:
    own.write_text(yamledit.replaced(own, "commissioning", {"touch_history": "touched.jsonl"}))
    assert config.load(own).commissioning.touch_history == own.parent / "touched.jsonl"
    own.write_text(yamledit.replaced(own, "commissioning", {"touch_tolerance_m": "0.002"}))
    assert config.load(own).commissioning.touch_tolerance_m == 0.002
