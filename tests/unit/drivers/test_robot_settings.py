"""Settings of a UR arm: what cannot be meant is refused with the key, the number and what is wrong."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from pydantic import ValidationError

from cell import config
from cell.errors import ConfigError
from drivers.settings import UrRobotSettings

SHIPPED = Path(__file__).parents[3] / "configs" / "ur5e-webcams" / "cell.yaml"
GOOD: dict[str, object] = {
    "driver": "ur",
    "host": "192.0.2.10",
    "model": "UR5e",
    "tcp_m_rad": (0.0, 0.0, 0.165, 0.0, 0.0, 0.0),
    "payload_kg": 0.9,
    "payload_cog_m": (0.0, 0.0, 0.05),
    "tool_box_min_m": (-0.5, -0.8, 0.0),
    "tool_box_max_m": (0.5, -0.2, 0.6),
}


def test_the_good_settings_are_good_and_the_tool_is_checked_by_default() -> None:
    assert UrRobotSettings.model_validate(GOOD).tool_from == "installation"


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("host", "", "at least 1 character"),
        ("model", "UR7", "'UR3e', 'UR5e' or 'UR10e'"),
        ("tcp_m_rad", (0.0, 0.0, 165.0, 0.0, 0.0, 0.0), "over 1 m from the flange; give metres"),
        ("tcp_m_rad", (0.0, 0.0, 0.165, 0.0, 0.0, 90.0), "rotation over 2 pi; give radians"),
        ("tcp_m_rad", (0.0, 0.0, 0.165), "Field required"),
        ("payload_kg", 7.0, "payload_kg 7: a UR5e carries 5 kg"),
        ("payload_kg", float("nan"), "finite"),
        ("payload_cog_m", (0.0, 0.0, 50.0), "over 1 m; give metres"),
        ("tool_box_min_m", (0.5, -0.8, 0.0), "tool box is empty along x"),
        ("tool_box_max_m", (0.5, -0.2, 600.0), "is beyond what a UR5e with this tool can reach"),
        ("registers", "middle", "'lower' or 'upper'"),
        ("first_speed_fraction", 1.5, "less than or equal to 1"),
        ("stop_line_m_s2", 0.0, "greater than 0"),
    ],
)
def test_what_cannot_be_meant_is_refused(key: str, value: object, said: str) -> None:
    with pytest.raises(ValidationError) as caught:
        UrRobotSettings.model_validate(GOOD | {key: value})
    assert said in str(caught.value)


def test_a_workspace_beyond_the_tool_box_is_refused_before_the_arm_refuses_each_grasp(tmp_path: Path) -> None:
    data = yaml.safe_load(SHIPPED.read_text(encoding="utf-8"))
    data["robot"]["tool_box_max_m"][1] = data["workspace"]["box_max_m"][1] - 0.01
    path = tmp_path / "cell.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"along y .* goes beyond robot\.tool_box_min_m"):
        config.load(path)
