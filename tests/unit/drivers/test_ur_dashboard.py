"""The dashboard's answers, to the letter."""

from __future__ import annotations

import pytest

from drivers.sim.ur_codes import RobotMode, Runtime, Safety
from drivers.sim.ur_core import Core, Setup
from drivers.sim.ur_dashboard import NOT_IN_LOCAL, UNLOCK_TOO_EARLY, Dashboard

SMALL = "def small():\n\tsleep(10)\nend"


@pytest.fixture
def core() -> Core:
    return Core(Setup(model="UR10e", polyscope=(5, 12, 3), serial="20231234567"))


@pytest.fixture
def dashboard(core: Core) -> Dashboard:
    return Dashboard(core)


def steps(core: Core, seconds: float) -> None:
    for _ in range(round(seconds / 0.002)):
        core.step()


@pytest.mark.parametrize(
    ("line", "wanted"),
    [
        ("robotmode", "Robotmode: RUNNING"),
        ("safetystatus", "Safetystatus: NORMAL"),
        ("safetymode", "Safetymode: NORMAL"),
        ("running", "Program running: false"),
        ("programState", "STOPPED <unnamed>"),
        ("PolyscopeVersion", "URSoftware 5.12.3.0 (Jan 01 2024)"),
        ("version", "5.12.3.0"),
        ("is in remote control", "true"),
        ("get serial number", "20231234567"),
        ("get robot model", "UR10"),
        ("get loaded program", "No program loaded"),
        ("get operational mode", "NONE"),
        ("play", "Failed to execute: play"),
        ("pause", "Failed to execute: pause"),
        ("stop", "Stopped"),
        ("load nothing.urp", "File not found: nothing.urp"),
        ("load default.urp", "Loading program: /programs/default.urp"),
        ("popup hello there", "showing popup"),
        ("close popup", "closing popup"),
        ("close safety popup", "closing safety popup"),
        ("addToLog hello", "Added log message"),
        ("saveLog", "Log saved to disk"),
        ("isProgramSaved", "true <unnamed>"),
        ("set operational mode manual", "Operational mode 'MANUAL' is set"),
        ("quit", "Disconnected"),
        ("shutdown", "Shutting down"),
        ("  ROBOTMODE  ", "Robotmode: RUNNING"),
        ("make coffee", "could not understand: 'make coffee'"),
    ],
)
def test_answers(dashboard: Dashboard, line: str, wanted: str) -> None:
    assert dashboard.answer(line) == wanted


def test_a_program_is_stopped_paused_and_played(dashboard: Dashboard, core: Core) -> None:
    core.upload(SMALL)
    steps(core, 0.1)
    assert dashboard.answer("running") == "Program running: true"
    assert dashboard.answer("programState") == "PLAYING <unnamed>"
    assert dashboard.answer("pause") == "Pausing program"
    steps(core, 0.2)
    assert dashboard.answer("programState") == "PAUSED <unnamed>"
    assert dashboard.answer("play") == "Starting program"
    steps(core, 0.1)
    assert dashboard.answer("running") == "Program running: true"
    assert dashboard.answer("stop") == "Stopped"
    steps(core, 0.1)
    assert dashboard.answer("programState") == "STOPPED <unnamed>"


def test_a_loaded_program_can_be_played(dashboard: Dashboard, core: Core) -> None:
    dashboard.answer("load default.urp")
    assert dashboard.answer("get loaded program") == "Loaded program: /programs/default.urp"
    assert dashboard.answer("play") == "Starting program"
    assert dashboard.answer("programState") == "PLAYING default.urp"


def test_a_protective_stop_is_unlocked_after_5_s_and_not_before(dashboard: Dashboard, core: Core) -> None:
    core.protective_stop("test")
    assert dashboard.answer("safetystatus") == "Safetystatus: PROTECTIVE_STOP"
    assert dashboard.answer("unlock protective stop") == UNLOCK_TOO_EARLY
    steps(core, 5.1)
    assert dashboard.answer("unlock protective stop") == "Protective stop releasing"
    assert core.safety is Safety.NORMAL


def test_power_goes_through_its_states(dashboard: Dashboard, core: Core) -> None:
    assert dashboard.answer("power off") == "Powering off"
    assert dashboard.answer("robotmode") == "Robotmode: POWER_OFF"
    assert dashboard.answer("stop") == "Failed to execute: stop"
    assert dashboard.answer("power on") == "Powering on"
    steps(core, 1.2)
    assert dashboard.answer("robotmode") == "Robotmode: IDLE"
    assert dashboard.answer("brake release") == "Brake releasing"
    steps(core, 0.7)
    assert core.mode is RobotMode.RUNNING


def test_after_a_violation_the_safety_is_restarted(dashboard: Dashboard, core: Core) -> None:
    core.safety = Safety.VIOLATION
    assert dashboard.answer("restart safety") == "Restarting safety"
    assert (core.safety, core.mode) == (Safety.NORMAL, RobotMode.POWER_OFF)


@pytest.mark.parametrize(
    "line",
    ["power on", "power off", "brake release", "play", "stop", "pause", "load default.urp", "restart safety"],
)
def test_in_local_control_nothing_is_done(dashboard: Dashboard, core: Core, line: str) -> None:
    core.upload(SMALL)
    steps(core, 0.1)
    core.remote = False
    assert dashboard.answer(line) == NOT_IN_LOCAL
    assert (core.runtime, core.mode) == (Runtime.PLAYING, RobotMode.RUNNING)
    assert dashboard.answer("is in remote control") == "false"
    assert dashboard.answer("robotmode") == "Robotmode: RUNNING"
