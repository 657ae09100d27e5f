"""What the cell's report takes from the arm's state."""

from __future__ import annotations

from typing import Final

from drivers.types import RobotState, SafetyMode, Six

_AT_HOME_RAD: Final = 0.01
_UR_SAFETY: Final[dict[SafetyMode, int]] = {
    SafetyMode.UNKNOWN: 0,
    SafetyMode.NORMAL: 1,
    SafetyMode.REDUCED: 2,
    SafetyMode.PROTECTIVE_STOP: 3,
    SafetyMode.SAFEGUARD_STOP: 5,
    SafetyMode.EMERGENCY_STOP: 7,
}
"""The arm maker's numbers, which PLC programs for this arm already know."""


def robot_fields(state: RobotState) -> dict[str, object]:
    """The fields of a report that the arm's state gives."""
    return {
        "robot_link": True,
        "program_running": state.program_running,
        "remote_control": state.powered,  # the arm takes our commands
        "emergency_stop": state.safety is SafetyMode.EMERGENCY_STOP,
        "protective_stop": state.safety is SafetyMode.PROTECTIVE_STOP,
        "safeguard_stop": state.safety is SafetyMode.SAFEGUARD_STOP,
        "safety_mode": _UR_SAFETY[state.safety],
    }


def at(state: RobotState, q_rad: Six) -> bool:
    """True when the arm stands still at these joint angles."""
    near = all(abs(q - wanted) < _AT_HOME_RAD for q, wanted in zip(state.joints.q_rad, q_rad, strict=True))
    return near and not state.moving
