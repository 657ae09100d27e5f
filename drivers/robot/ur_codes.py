"""What the controller's numbers mean, as RTDE and the dashboard tell them.

Source: "Real-Time Data Exchange (RTDE) Guide" and "Dashboard Server e-Series", Universal Robots.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final

from drivers.types import SafetyMode


class Runtime(IntEnum):
    """``runtime_state``: the program on the controller."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


ROBOT_MODES: Final = {
    -1: "NO_CONTROLLER",
    0: "DISCONNECTED",
    1: "CONFIRM_SAFETY",
    2: "BOOTING",
    3: "POWER_OFF",
    4: "POWER_ON",
    5: "IDLE",
    6: "BACKDRIVE",
    7: "RUNNING",
    8: "UPDATING_FIRMWARE",
}
RUNNING: Final = 7

_SAFETY: Final = {
    1: SafetyMode.NORMAL,
    2: SafetyMode.REDUCED,
    3: SafetyMode.PROTECTIVE_STOP,
    5: SafetyMode.SAFEGUARD_STOP,
    6: SafetyMode.EMERGENCY_STOP,
    7: SafetyMode.EMERGENCY_STOP,
    12: SafetyMode.SAFEGUARD_STOP,
    13: SafetyMode.SAFEGUARD_STOP,
}
"""``safety_mode``; recovery 4, violation 8, fault 9 and what is not known here stay UNKNOWN."""

_BITS: Final = (
    (1 << 5 | 1 << 6 | 1 << 7, SafetyMode.EMERGENCY_STOP),
    (1 << 8 | 1 << 9, SafetyMode.UNKNOWN),
    (1 << 2, SafetyMode.PROTECTIVE_STOP),
    (1 << 4 | 1 << 11, SafetyMode.SAFEGUARD_STOP),
)

_STATUS: Final = {
    "NORMAL": SafetyMode.NORMAL,
    "REDUCED": SafetyMode.REDUCED,
    "PROTECTIVE_STOP": SafetyMode.PROTECTIVE_STOP,
    "SAFEGUARD_STOP": SafetyMode.SAFEGUARD_STOP,
    "AUTOMATIC_MODE_SAFEGUARD_STOP": SafetyMode.SAFEGUARD_STOP,
    "SYSTEM_THREE_POSITION_ENABLING_STOP": SafetyMode.SAFEGUARD_STOP,
    "SYSTEM_EMERGENCY_STOP": SafetyMode.EMERGENCY_STOP,
    "ROBOT_EMERGENCY_STOP": SafetyMode.EMERGENCY_STOP,
}


def safety_of(mode: int, bits: int) -> SafetyMode:
    """The safety state; where ``safety_mode`` and ``safety_status_bits`` differ, the worse one counts.

    >>> safety_of(1, 1).name, safety_of(1, 1 << 2).name, safety_of(99, 1).name
    ('NORMAL', 'PROTECTIVE_STOP', 'UNKNOWN')
    """
    told = _SAFETY.get(mode, SafetyMode.UNKNOWN)
    if told not in (SafetyMode.NORMAL, SafetyMode.REDUCED):
        return told
    return next((worse for mask, worse in _BITS if bits & mask), told)


def safety_of_status(word: str) -> SafetyMode:
    """The safety state of the dashboard's word for it.

    >>> safety_of_status("ROBOT_EMERGENCY_STOP").name, safety_of_status("VIOLATION").name
    ('EMERGENCY_STOP', 'UNKNOWN')
    """
    return _STATUS.get(word, SafetyMode.UNKNOWN)


def may_move(safety: SafetyMode) -> bool:
    """True where the arm's safety system lets it move."""
    return safety in (SafetyMode.NORMAL, SafetyMode.REDUCED)


def runtime_name(number: int) -> str:
    """A word for ``runtime_state``."""
    return Runtime(number).name if number in set(Runtime) else str(number)
