"""After a stop by the safety system: what software may clear, once a person has said that the cause is gone.

`recover` is called on an explicit reset only. It never says ``play`` to the controller: the program on it is
the old one, and would go on with the old motion. It is stopped, the stop is released, and a fresh program
starts from where the arm stands.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Final

import structlog

from drivers.errors import CommandRejected, DeviceTimeout, NotInRemote
from drivers.robot.ur_codes import may_move, safety_of_status
from drivers.robot.ur_dashboard import Dashboard
from drivers.timing import Clock
from drivers.types import SafetyMode

UNLOCK_AFTER_S: Final = 5.2
"""The controller refuses to release a protective stop earlier than 5 s after it."""
UNLOCK_S: Final = 3.0
POWER_S: Final = 20.0
STOPPED_S: Final = 2.0
_POLL_S: Final = 0.1
_NEVER: Final = threading.Event()

log = structlog.get_logger()


def recover(name: str, panel: Dashboard, clock: Clock, ours: bool, stopped_at: float | None) -> bool:
    """Bring the controller to where a fresh program may start; True when something had to be cleared.

    ``ours``: the program on the controller is this driver's, also while it plays. ``stopped_at`` is when the
    protective stop was first seen; None when that is not known.

    Raises
    ------
    CommandRejected, NotInRemote
        What only a person can clear.
    DeviceTimeout, DeviceUnavailable
    """
    if not panel.in_remote():
        raise NotInRemote(name, "in local control: switch it to remote control at its panel")
    cleared = False
    word = panel.safety_status()
    safety = safety_of_status(word)
    match safety:
        case SafetyMode.EMERGENCY_STOP:
            raise CommandRejected(name, f"{word}: release the emergency stop first")
        case SafetyMode.SAFEGUARD_STOP:
            raise CommandRejected(name, f"{word}: close the guard first")
        case SafetyMode.UNKNOWN:
            raise CommandRejected(name, f"{word}: only a person at the panel can clear this (restart safety)")
        case SafetyMode.PROTECTIVE_STOP:
            _stop_program(name, panel, clock, ours)  # before the stop is released: nothing may go on then
            _unlock(name, panel, clock, stopped_at)
            cleared = True
        case SafetyMode.NORMAL | SafetyMode.REDUCED:
            pass
    _stop_program(name, panel, clock, ours)
    return _power(name, panel, clock) or cleared


def _wait_for(clock: Clock, within_s: float, reached: Callable[[], bool]) -> bool:
    until = clock.now() + within_s
    while not reached():
        if clock.now() >= until:
            return False
        clock.wait(_NEVER, _POLL_S)
    return True


def _stop_program(name: str, panel: Dashboard, clock: Clock, ours: bool) -> None:
    state, program = panel.program_state()
    if state == "STOPPED":
        return
    if state == "PLAYING" and not ours:
        raise CommandRejected(name, f"program {program} runs on the controller: stop it at the panel")
    panel.stop()
    if not _wait_for(clock, STOPPED_S, lambda: panel.program_state()[0] == "STOPPED"):
        raise DeviceTimeout(name, f"program {program} did not stop within {STOPPED_S:.0f} s")
    log.info("robot_program_stopped", device=name, program=program, was=state)


def _unlock(name: str, panel: Dashboard, clock: Clock, stopped_at: float | None) -> None:
    left_s = UNLOCK_AFTER_S if stopped_at is None else stopped_at + UNLOCK_AFTER_S - clock.now()
    until = clock.now() + left_s
    while clock.now() < until:
        clock.wait(_NEVER, _POLL_S)
    panel.close_popups()
    panel.unlock()
    if not _wait_for(clock, UNLOCK_S, lambda: may_move(safety_of_status(panel.safety_status()))):
        raise DeviceTimeout(name, f"protective stop not released within {UNLOCK_S:.0f} s")
    log.info("robot_protective_stop_released", device=name)


def _power(name: str, panel: Dashboard, clock: Clock) -> bool:
    """Power on and release the brakes, step by step; True when anything had to be done."""
    if panel.robot_mode() == "RUNNING":
        return False
    panel.close_popups()
    until = clock.now() + POWER_S
    asked = ""
    while (mode := panel.robot_mode()) != "RUNNING":
        if clock.now() >= until:
            raise DeviceTimeout(name, f"arm is {mode}, not RUNNING, {POWER_S:.0f} s after power on")
        if mode != asked and mode == "POWER_OFF":
            panel.power_on()
            asked = mode
        elif mode != asked and mode == "IDLE":
            panel.release_brakes()
            asked = mode
        clock.wait(_NEVER, _POLL_S)
    log.info("robot_powered", device=name)
    return True
