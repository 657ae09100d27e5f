"""A look at the controller before the arm may move: each thing that must be so, what was found, what to do.

Plain sockets with their own time limits, nothing changed on the controller: the library's constructors hang
where these say what is wrong. The driver refuses to open on the first wrong line; `mikado doctor` shows all.
"""

from __future__ import annotations

import math
import socket
from contextlib import suppress
from dataclasses import dataclass
from typing import Final

import numpy as np

from drivers.errors import (
    CommandRejected,
    DeviceTimeout,
    DeviceUnavailable,
    DriverError,
    NotInRemote,
    SafetyStop,
)
from drivers.robot.rtde import IN_USE, Connection, RtdeError
from drivers.robot.ur_codes import may_move, safety_of_status
from drivers.robot.ur_dashboard import Dashboard
from drivers.robot.ur_limits import Geometry, matrix_of, six_of
from drivers.robot.ur_stream import CONNECT_S, OUTPUT_INPUTS, Snapshot, UrStream
from drivers.settings import UrRobotSettings
from drivers.timing import Clock
from drivers.types import Check, Six, Three

SCRIPT_PORT: Final = 30003
ETHERNET_IP_PORT: Final = 44818
OLDEST: Final = (5, 6)
"""Older controllers do not tell their payload or whether they are in remote control."""
NO_DASHBOARD: Final = 10
UPPER_BROKEN: Final = (5, 23)
"""From here on ur-rtde 1.6.5 asks for the upper registers in its program and uses the lower ones itself."""
LOW_SLIDER: Final = 0.1
TCP_SEEN_M: Final = 0.006
TCP_SEEN_RAD: Final = 0.03
"""How well the tool can be told from joints and pose: real arms differ from the nominal one by 1 to 2 mm."""
TCP_TOLD_M: Final = 0.0005
TCP_TOLD_RAD: Final = 0.002
"""How well a tool the controller tells must agree with the configured one."""
PAYLOAD_KG: Final = 0.05
PAYLOAD_M: Final = 0.005
_HALF: Final = 24


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """One thing that was looked at, and what a driver raises for it."""

    check: Check
    error: DriverError | None = None


def checks(settings: UrRobotSettings, clock: Clock) -> tuple[Check, ...]:
    """Every line for a person; the arm is left as it was."""
    stream = UrStream("robot", clock, offset_of(settings), lambda _: None)
    try:
        return tuple(line.check for line in look("robot", settings, clock, stream))
    finally:
        stream.close()


def offset_of(settings: UrRobotSettings) -> int:
    """The first register of the half in use."""
    return _HALF if settings.registers == "upper" else 0


def look(name: str, settings: UrRobotSettings, clock: Clock, stream: UrStream) -> list[Line]:
    """All lines. Opens ``stream``, and leaves it open for its owner."""
    lines = _panel(name, settings, clock)
    if isinstance(lines[0].error, DeviceUnavailable | DeviceTimeout):
        return lines
    try:
        stream.open(settings.host)
        snapshot = stream.latest()
    except DriverError as error:
        return [*lines, _wrong("RTDE", error.detail, "see that port 30004 is not blocked", error)]
    lines.append(_good("RTDE", f"answers, controller {stream.version}"))
    lines.append(_registers(name, settings, clock))
    lines.append(_outputs(stream))
    lines.append(_script_port(name, settings))
    return [*lines, _slider(name, snapshot), *_tool(name, settings, snapshot)]


def _good(what: str, found: str) -> Line:
    return Line(check=Check(what=what, ok=True, found=found))


def _wrong(what: str, found: str, do: str, error: DriverError) -> Line:
    return Line(check=Check(what=what, ok=False, found=found, do=do), error=error)


def _rejected(name: str, what: str, found: str, do: str) -> Line:
    return _wrong(what, found, do, CommandRejected(name, f"{what}: {found}; {do}"))


# --------------------------------------------------------------------------- what the panel says


def _panel(name: str, settings: UrRobotSettings, clock: Clock) -> list[Line]:
    lines: list[Line] = []
    try:
        with Dashboard(name, settings.host, clock) as panel:
            lines.append(_good("controller", f"answers at {settings.host}"))
            lines.append(_version(name, settings, panel.version()))
            lines.append(_model(name, settings, panel))
            lines.append(_remote(name, panel.in_remote()))
            word, mode = panel.safety_status(), panel.robot_mode()
            safety = safety_of_status(word)
            lines.append(_safety(name, word))
            safe = may_move(safety)
            lines.append(_power(name, mode, safe))
            lines.append(_program(name, *panel.program_state(), safe))
    except (DeviceTimeout, DeviceUnavailable) as error:
        lost = _wrong("controller", error.detail, "check its power, its cable and robot.host", error)
        return [lost, *lines]
    except DriverError as error:
        lines.append(_wrong("dashboard", error.detail, "read the message on the panel", error))
    return lines


def _version(name: str, settings: UrRobotSettings, version: tuple[int, int, int]) -> Line:
    told = ".".join(str(part) for part in version)
    if version[0] >= NO_DASHBOARD:
        return _rejected(
            name, "PolyScope", f"{told} (PolyScope X)", "this driver is for PolyScope 5.6 to 5.x"
        )
    if version[:2] < OLDEST:
        return _rejected(name, "PolyScope", told, "update it to 5.6 or later")
    if settings.registers == "upper" and version[:2] >= UPPER_BROKEN:
        return _rejected(
            name,
            "PolyScope",
            f"{told} with robot.registers: upper",
            "ur-rtde cannot use the upper registers from 5.23 on; set robot.registers: lower",
        )
    return _good("PolyScope", told)


def _model(name: str, settings: UrRobotSettings, panel: Dashboard) -> Line:
    told = panel.robot_model().upper()
    # e-Series arms call themselves UR5, or UR5e, by version
    if told.rstrip("E") != settings.model.upper().rstrip("E"):
        return _rejected(name, "arm", told, f"correct robot.model ({settings.model}) or robot.host")
    return _good("arm", told)


def _remote(name: str, remote: bool) -> Line:
    if remote:
        return _good("control", "remote")
    do = "switch it to remote control at its panel (upper right corner)"
    return _wrong("control", "local", do, NotInRemote(name, f"in local control; {do}"))


_SAFETY_DO: Final = {
    "PROTECTIVE_STOP": "clear the cause at the arm, then reset",
    "SAFEGUARD_STOP": "close the guard, then reset",
    "AUTOMATIC_MODE_SAFEGUARD_STOP": "close the guard, then reset",
    "SYSTEM_EMERGENCY_STOP": "release the emergency stop of the system, then reset",
    "ROBOT_EMERGENCY_STOP": "release the emergency stop at the arm, then reset",
}


def _safety(name: str, word: str) -> Line:
    safety = safety_of_status(word)
    if may_move(safety):
        return _good("safety", word)
    return _wrong(
        "safety", word, _SAFETY_DO.get(word, "read the panel; restart safety"), SafetyStop(name, safety)
    )


def _power(name: str, mode: str, safe: bool) -> Line:
    if mode == "RUNNING":
        return _good("power", mode)
    do = "reset: it powers the arm on and releases the brakes"
    if not safe:  # said by the line above
        return Line(check=Check(what="power", ok=False, found=mode, do=do))
    return _rejected(name, "power", mode, do)


def _program(name: str, state: str, program: str, safe: bool) -> Line:
    found = f"{state} {program}".strip()
    if state == "STOPPED":
        return _good("program", found)
    if not safe:
        return Line(
            check=Check(
                what="program", ok=False, found=found, do="reset ends it; never press play: it goes on"
            )
        )
    return _rejected(name, "program", found, "a program is loaded on the controller: stop it at the panel")


# --------------------------------------------------------------------------- what RTDE says


def registers_in_use(host: str, clock: Clock, offset: int) -> tuple[str, ...]:
    """Input registers of one half that somebody holds. Asks for all 48, and gives them back at once."""
    names = [f"input_{kind}_register_{i + offset}" for kind in ("int", "double") for i in range(_HALF)]
    connection = Connection(clock.now)
    try:
        connection.open(host, CONNECT_S)
        return connection.inputs(names, CONNECT_S).missing(IN_USE)
    finally:
        connection.close()


def who_holds(held: tuple[str, ...], ethernet_ip: bool) -> str:
    """Who holds registers, as far as their pattern tells. A whole half is what a fieldbus adapter takes.

    >>> who_holds(("input_int_register_0",), False)
    'another RTDE client, or a MODBUS unit (input_int_register_0)'
    """
    if len(held) == 2 * _HALF:
        if ethernet_ip:
            return "the EtherNet/IP adapter (it answers on port 44818)"
        return "a fieldbus: PROFINET, or EtherNet/IP behind a firewall"
    few = ", ".join(held[:3]) + (f" and {len(held) - 3} more" if len(held) > 3 else "")
    return f"another RTDE client, or a MODBUS unit ({few})"


def _registers(name: str, settings: UrRobotSettings, clock: Clock) -> Line:
    offset = offset_of(settings)
    span = f"{offset}-{offset + _HALF - 1}"
    try:
        held = registers_in_use(settings.host, clock, offset)
    except (OSError, RtdeError) as error:
        unavailable = DeviceUnavailable(name, f"RTDE: {error}")
        return _wrong("registers", str(error), "see that port 30004 is not blocked", unavailable)
    used = (*(f"input_int_register_{i + offset}" for i in range(8)),)
    used += (*(f"input_double_register_{i + offset}" for i in range(18)),)
    in_the_way = tuple(register for register in used if register in held)
    if not in_the_way:
        return _good("registers", f"{span} are free")
    other = "lower" if settings.registers == "upper" else "upper"
    return _rejected(
        name,
        "registers",
        f"{span} are held by {who_holds(held, _answers(settings.host, ETHERNET_IP_PORT))}",
        f"disable it (Installation > Fieldbus), end the other client, or set robot.registers: {other}",
    )


def _answers(host: str, port: int) -> bool:
    with suppress(OSError), socket.create_connection((host, port), timeout=CONNECT_S / 2):
        return True
    return False


def _outputs(stream: UrStream) -> Line:
    held = stream.outputs_in_use()
    if not held:
        return _good("outputs", f"all {len(OUTPUT_INPUTS)} groups can be switched")
    # no error: a cell whose gripper is not on them does well without
    return Line(
        check=Check(
            what="outputs",
            ok=False,
            found=f"{', '.join(held)} held by another RTDE client or a fieldbus",
            do="end that client before using these outputs",
        )
    )


def _script_port(name: str, settings: UrRobotSettings) -> Line:
    if _answers(settings.host, SCRIPT_PORT):
        return _good("programs", f"port {SCRIPT_PORT} takes them")
    do = "enable it (Settings > Security > Services) and see that no firewall blocks it"
    error = DeviceUnavailable(name, f"port {SCRIPT_PORT} (control programs) does not answer; {do}")
    return _wrong("programs", f"port {SCRIPT_PORT} does not answer", do, error)


def _slider(name: str, snapshot: Snapshot) -> Line:
    found = f"{100 * snapshot.speed_fraction:.0f} %"
    if snapshot.speed_fraction < LOW_SLIDER:
        return _rejected(name, "speed slider", found, "raise it at the panel: moves would not end in time")
    return _good("speed slider", found)


# --------------------------------------------------------------------------- tool and payload


def _tool(name: str, settings: UrRobotSettings, snapshot: Snapshot) -> list[Line]:
    if settings.tool_from == "configuration":
        return [
            _good("tool", "set when the driver connects"),
            _good("payload", "set when the driver connects"),
        ]
    return [_tcp(name, settings, snapshot), payload_line(name, settings, snapshot)]


def _tcp(name: str, settings: UrRobotSettings, snapshot: Snapshot) -> Line:
    """By joints and pose; the driver asks again, and gets it exactly, when its program runs."""
    bare = Geometry(model=settings.model, tcp=(0.0,) * 6, box_min_m=(0.0,) * 3, box_max_m=(0.0,) * 3)
    flange = matrix_of(bare.tool_at(snapshot.q_rad))
    seen = six_of(np.asarray(np.linalg.inv(flange) @ matrix_of(snapshot.tool)))
    return tcp_line(name, settings, seen, TCP_SEEN_M, TCP_SEEN_RAD)


def tcp_line(name: str, settings: UrRobotSettings, found: Six, apart_m: float, apart_rad: float) -> Line:
    """Whether the active tool is the configured one."""
    turned = np.linalg.inv(matrix_of(settings.tcp_m_rad)) @ matrix_of(found)
    angle = math.hypot(*six_of(np.asarray(turned))[3:])
    told = f"[{', '.join(f'{v:.4f}' for v in found)}]"
    if math.dist(found[:3], settings.tcp_m_rad[:3]) <= apart_m and angle <= apart_rad:
        return _good("tool", told)
    return _rejected(
        name,
        "tool",
        f"{told} m, rad on the controller, {list(settings.tcp_m_rad)} in robot.tcp_m_rad",
        "set it in Installation > TCP, correct robot.tcp_m_rad, or set robot.tool_from: configuration",
    )


def payload_line(name: str, settings: UrRobotSettings, snapshot: Snapshot) -> Line:
    """Whether the active payload is the configured one."""
    kg, cog = snapshot.payload_kg, snapshot.payload_cog_m
    found = _payload_text(kg, cog)
    near_kg = abs(kg - settings.payload_kg) <= PAYLOAD_KG
    if near_kg and (kg == 0.0 or math.dist(cog, settings.payload_cog_m) <= PAYLOAD_M):
        return _good("payload", found)
    return _rejected(
        name,
        "payload",
        f"{found} on the controller, {_payload_text(settings.payload_kg, settings.payload_cog_m)} configured",
        "set it in Installation > Payload, correct robot.payload_kg and payload_cog_m, "
        "or set robot.tool_from: configuration",
    )


def _payload_text(kg: float, cog: Three) -> str:
    return f"{kg:.2f} kg at [{', '.join(f'{v:.3f}' for v in cog)}] m"
