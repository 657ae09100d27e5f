"""The dashboard server of the simulated UR controller: a line in, the exact answer out.

Answers as UR's dashboard documentation and URCL's table of expected answers give them.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from drivers.sim.ur_codes import RobotMode, Runtime
from drivers.sim.ur_core import Core

BANNER = "Connected: Universal Robots Dashboard Server"
NOT_IN_LOCAL = (
    "Command is not allowed due to safety reasons, please switch robot to Remote Control mode "
    "and reconnect to port 29999"
)
UNLOCK_TOO_EARLY = (
    "Cannot unlock protective stop until 5s after occurrence. "
    "Always inspect cause of protective stop before unlocking"
)
GOODBYE = {"quit": "Disconnected", "shutdown": "Shutting down"}
"""Lines after which the connection is closed, and their answers."""
PROGRAMS = "/programs/"


def _program_state(core: Core) -> str:
    match core.runtime:
        case Runtime.PLAYING | Runtime.RESUMING:
            word = "PLAYING"
        case Runtime.PAUSED | Runtime.PAUSING:
            word = "PAUSED"
        case _:
            word = "STOPPED"
    return f"{word} {core.loaded or '<unnamed>'}"


class Dashboard:
    """The dashboard, one for all its connections."""

    def __init__(self, core: Core, files: frozenset[str] = frozenset({"default.urp"})) -> None:
        self._core, self._files = core, files
        self._operational_mode = "NONE"
        self._questions: dict[str, Callable[[], str]] = {
            "running": lambda: f"Program running: {str(core.runtime is Runtime.PLAYING).lower()}",
            "robotmode": lambda: f"Robotmode: {core.mode.name}",
            "safetymode": lambda: f"Safetymode: {core.safety.name}",
            "safetystatus": lambda: f"Safetystatus: {core.safety.name}",
            "programstate": lambda: _program_state(core),
            "get loaded program": lambda: (
                f"Loaded program: {PROGRAMS}{core.loaded}" if core.loaded else "No program loaded"
            ),
            "polyscopeversion": lambda: f"URSoftware {self._version()} (Jan 01 2024)",
            "version": self._version,
            "is in remote control": lambda: str(core.remote).lower(),
            "get serial number": lambda: core.setup.serial,
            "get robot model": lambda: core.setup.model.rstrip("e"),
            "get operational mode": lambda: self._operational_mode,
            "isprogramsaved": lambda: f"true {core.loaded or '<unnamed>'}",
            "savelog": lambda: "Log saved to disk",
            "close popup": lambda: "closing popup",
            "close safety popup": lambda: "closing safety popup",
            "clear operational mode": lambda: self._operational(
                "NONE", "No longer controlling the operational mode. Current operational mode: 'NONE'."
            ),
            "help": lambda: "Supported commands: " + ", ".join(sorted((*self._questions, *self._orders))),
        }
        self._orders: dict[str, Callable[[], str]] = {
            "power on": lambda: self._did(core.power_on, "Powering on"),
            "power off": lambda: self._did(core.power_off, "Powering off"),
            "brake release": lambda: self._did(core.brake_release, "Brake releasing"),
            "restart safety": lambda: self._did(core.restart_safety, "Restarting safety"),
            "play": lambda: "Starting program" if core.play() else "Failed to execute: play",
            "pause": lambda: "Pausing program" if core.pause() else "Failed to execute: pause",
            "stop": self._stop,
            "unlock protective stop": lambda: (
                "Protective stop releasing" if core.unlock() else UNLOCK_TOO_EARLY
            ),
        }

    def answer(self, line: str) -> str:
        """What the server says to one line; the line break is the caller's."""
        words = " ".join(line.split())
        small = words.lower()
        self._core.counts["dashboard_commands"] += 1
        if small in GOODBYE:
            return GOODBYE[small]
        if small in self._questions:
            return self._questions[small]()
        if small in self._orders:
            if not self._core.remote:
                return NOT_IN_LOCAL
            if small in ("play", "stop", "pause", "unlock protective stop"):
                self._core.counts[f"dashboard_{small.split()[0]}"] += 1
            return self._orders[small]()
        return self._with_text(words)

    def _with_text(self, words: str) -> str:
        verb, _, text = words.partition(" ")
        match verb.lower():
            case "load":
                return NOT_IN_LOCAL if not self._core.remote else self._load(text)
            case "popup":
                return "showing popup"
            case "addtolog" if text:
                self._core.note(f"addToLog {text}")
                return "Added log message"
        wanted = re.fullmatch(r"set operational mode (manual|automatic)", words.lower())
        if wanted is not None:
            mode = wanted.group(1).upper()
            return self._operational(mode, f"Operational mode '{mode}' is set")
        return f"could not understand: '{words}'"

    def _version(self) -> str:
        return ".".join(map(str, self._core.version)) + ".0"

    def _operational(self, mode: str, said: str) -> str:
        self._operational_mode = mode
        return said

    @staticmethod
    def _did(act: Callable[[], None], said: str) -> str:
        act()
        return said

    def _stop(self) -> str:
        if self._core.mode is not RobotMode.RUNNING and self._core.runtime is Runtime.STOPPED:
            return "Failed to execute: stop"
        self._core.stop_program("dashboard")
        return "Stopped"

    def _load(self, name: str) -> str:
        if name not in self._files:
            return f"File not found: {name}"
        self._core.stop_program("another program was loaded")
        self._core.loaded = name
        return f"Loading program: {PROGRAMS}{name}"
