"""Packages of the primary, secondary and real-time interfaces (ports 30001 to 30003), as far as clients of
the script ports need them: who the controller is, its state, and the real-time package.

Layouts as in UR's client interface description; fields nobody here can know are zero.
"""

from __future__ import annotations

import struct

from drivers.sim.ur_codes import RobotMode, Runtime, Safety
from drivers.sim.ur_core import Core

_ROBOT_STATE, _ROBOT_MESSAGE = 16, 20
_ROBOT_MODE_DATA = 0
_VERSION_MESSAGE = 3
_NO_TIME = (1 << 64) - 1
_MODE = struct.Struct(">IBQ7?BBdddB")
_REAL_TIME_BYTES = 1220
_REAL_TIME_DOUBLES = (_REAL_TIME_BYTES - 4) // 8
_REAL_TIME = struct.Struct(f">I{_REAL_TIME_DOUBLES}d")


def version_message(core: Core) -> bytes:
    """Told once to every primary and secondary client."""
    major, minor, bugfix = core.version
    name, date = b"URControl", b"01-01-2024, 00:00:00"
    body = struct.pack(">QbBB", _NO_TIME, -2, _VERSION_MESSAGE, len(name)) + name
    body += struct.pack(">BBII", major, minor, bugfix, 0) + date
    return struct.pack(">IB", 5 + len(body), _ROBOT_MESSAGE) + body


def robot_state(core: Core) -> bytes:
    """A robot state package with robot mode data."""
    on = core.mode in (RobotMode.POWER_ON, RobotMode.IDLE, RobotMode.RUNNING)
    mode = (
        _MODE.pack(
            _MODE.size + 1,
            _ROBOT_MODE_DATA,
            int(1e6 * core.time_s),
            True,  # connected
            True,  # a real robot, as far as clients care
            on,
            core.safety in (Safety.SYSTEM_EMERGENCY_STOP, Safety.ROBOT_EMERGENCY_STOP),
            core.safety is Safety.PROTECTIVE_STOP,
            core.runtime in (Runtime.PLAYING, Runtime.RESUMING),
            core.runtime in (Runtime.PAUSED, Runtime.PAUSING),
            max(0, int(core.mode)),
            0,
            core.arm.slider,
            core.arm.fraction,
            1.0,
            0,
        )
        + b"\x00"
    )
    return struct.pack(">IB", 5 + len(mode), _ROBOT_STATE) + mode


def real_time_package(core: Core) -> bytes:
    """The package port 30003 sends each cycle: 1220 bytes, PolyScope 5.10 and later."""
    arm, doubles = core.arm, [0.0] * _REAL_TIME_DOUBLES
    doubles[0] = core.time_s
    doubles[1:7] = doubles[31:37] = arm.q
    doubles[7:13] = doubles[37:43] = arm.qd
    doubles[55:61] = doubles[73:79] = arm.pose
    doubles[61:67] = doubles[79:85] = arm.tool_speed
    doubles[85] = float(core.io.inputs)
    doubles[94] = float(core.mode)
    doubles[101] = float(core.safety)
    doubles[117] = arm.fraction
    doubles[130] = float(core.io.outputs)
    doubles[131] = float(core.runtime)
    return _REAL_TIME.pack(_REAL_TIME_BYTES, *doubles)
