"""Numbers a UR controller uses for its states, as UR's RTDE guide lists them."""

from __future__ import annotations

from enum import IntEnum


class Runtime(IntEnum):
    """``runtime_state``: what the program does."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


class RobotMode(IntEnum):
    """``robot_mode``: power and brakes."""

    NO_CONTROLLER = -1
    DISCONNECTED = 0
    CONFIRM_SAFETY = 1
    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    BACKDRIVE = 6
    RUNNING = 7


class Safety(IntEnum):
    """``safety_mode``; the names are those the dashboard answers ``safetystatus`` with."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9


STOPPED_FOR_SAFETY = frozenset(
    {
        Safety.PROTECTIVE_STOP,
        Safety.SAFEGUARD_STOP,
        Safety.SYSTEM_EMERGENCY_STOP,
        Safety.ROBOT_EMERGENCY_STOP,
        Safety.VIOLATION,
        Safety.FAULT,
    }
)

_SAFETY_BITS = {
    Safety.NORMAL: 1 << 0,
    Safety.REDUCED: 1 << 1,
    Safety.PROTECTIVE_STOP: 1 << 2 | 1 << 10,
    Safety.RECOVERY: 1 << 3,
    Safety.SAFEGUARD_STOP: 1 << 4 | 1 << 10,
    Safety.SYSTEM_EMERGENCY_STOP: 1 << 5 | 1 << 7 | 1 << 10,
    Safety.ROBOT_EMERGENCY_STOP: 1 << 6 | 1 << 7 | 1 << 10,
    Safety.VIOLATION: 1 << 8 | 1 << 10,
    Safety.FAULT: 1 << 9 | 1 << 10,
}


def safety_status_bits(safety: Safety) -> int:
    """``safety_status_bits`` of a safety mode."""
    return _SAFETY_BITS[safety]


def robot_status_bits(mode: RobotMode, runtime: Runtime) -> int:
    """``robot_status_bits``: 0 power on, 1 program running, 2 teach button, 3 power button."""
    powered = mode in (RobotMode.POWER_ON, RobotMode.IDLE, RobotMode.BACKDRIVE, RobotMode.RUNNING)
    return int(powered) | int(runtime is Runtime.PLAYING) << 1
