"""The unmodified ur-rtde in a process of its own: ``python ur_library.py STORY HOST [ARGUMENT ...]``.

Each story prints one JSON line. It ends by `os._exit`, because the library's destructors may hang or abort.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable
from typing import Any

from dashboard_client import DashboardClient
from rtde_control import RTDEControlInterface
from rtde_io import RTDEIOInterface
from rtde_receive import RTDEReceiveInterface

Told = dict[str, Any]


def _shifted(pose: list[float], dz: float) -> list[float]:
    return [pose[0], pose[1], pose[2] + dz, *pose[3:]]


def _error(a: list[float], b: list[float]) -> float:
    return max(abs(x - y) for x, y in zip(a, b, strict=True))


def _wait_over(control: RTDEControlInterface) -> None:
    while control.getAsyncOperationProgressEx().isAsyncOperationRunning():
        time.sleep(0.002)


def tour(host: str) -> Told:
    """Everything the driver uses, and more."""
    told: Told = {}
    dashboard = DashboardClient(host)
    dashboard.connect()
    told["dashboard"] = [
        dashboard.robotmode(),
        dashboard.safetystatus(),
        dashboard.polyscopeVersion(),
        dashboard.isInRemoteControl(),
        dashboard.getSerialNumber(),
    ]
    receive = RTDEReceiveInterface(host)
    control = RTDEControlInterface(host)
    io = RTDEIOInterface(host)
    start = receive.getActualTCPPose()
    began = time.monotonic()
    told["line"] = control.moveL(_shifted(start, 0.1), 0.25, 1.2)
    told["line_s"] = time.monotonic() - began
    time.sleep(0.02)
    told["line_error"] = _error(receive.getActualTCPPose(), _shifted(start, 0.1))
    q = receive.getActualQ()
    goal = [q[0] + 0.3, *q[1:]]
    before = control.getAsyncOperationProgressEx().operationId()
    began = time.monotonic()
    told["async"] = control.moveJ(goal, 1.0, 2.0, True)
    told["async_s"] = time.monotonic() - began
    told["operation"] = control.getAsyncOperationProgressEx().operationId() - before
    _wait_over(control)
    time.sleep(0.02)
    told["async_error"] = _error(receive.getActualQ(), goal)
    z = receive.getActualTCPPose()[2]
    control.moveL(_shifted(receive.getActualTCPPose(), -0.2), 0.1, 1.2, True)
    time.sleep(0.5)
    began = time.monotonic()
    control.stopL(2.0)
    told["stop_s"] = time.monotonic() - began
    time.sleep(0.02)
    told["stopped_after_m"] = z - receive.getActualTCPPose()[2]
    told["path"] = control.moveJ([[*goal, 1.0, 2.0, 0.0], [*q, 1.0, 2.0, 0.0]])
    time.sleep(0.02)
    told["path_error"] = _error(receive.getActualQ(), q)
    told["ik_error"] = _error(control.getInverseKinematics(_shifted(start, 0.1), q), q)
    told["has_solution"] = [
        control.getInverseKinematicsHasSolution(start),
        control.getInverseKinematicsHasSolution([3.0, *start[1:]]),
    ]
    told["limits"] = [
        control.isPoseWithinSafetyLimits(start),
        control.isJointsWithinSafetyLimits([0.0, 0.0, 4.0, 0.0, 0.0, 0.0]),
    ]
    time.sleep(0.2)
    told["steady"] = control.isSteady()
    control.setTcp([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    told["tcp"] = control.getTCPOffset()
    told["payload"] = [control.setPayload(0.9, [0.0, 0.0, 0.05])]
    told["custom"] = control.sendCustomScriptFunction("LAMP", "set_standard_digital_out(3, True)\n")
    io.setStandardDigitalOut(0, True)
    io.setToolDigitalOut(1, True)
    io.setSpeedSlider(0.5)
    time.sleep(0.1)
    told["payload"].append(receive.getPayload())
    told["outputs"] = receive.getActualDigitalOutputBits()
    told["slider"] = receive.getTargetSpeedFraction()
    told["upload"] = [control.reuploadScript()]
    time.sleep(0.3)
    told["upload"].append(control.isProgramRunning())
    told["after"] = control.moveJ(q, 1.0, 2.0)
    return told


def connect(host: str, flags: str = "1") -> Told:
    """Control alone: connect, say whether the program runs, move 2 cm."""
    try:
        control = RTDEControlInterface(host, 500.0, int(flags))
    except RuntimeError as error:
        return {"error": str(error)}
    receive = RTDEReceiveInterface(host, 125.0)
    return {"moved": control.moveL(_shifted(receive.getActualTCPPose(), 0.02), 0.25, 1.2)}


def later(host: str) -> Told:
    """Whether the program still runs half a second after connecting."""
    control = RTDEControlInterface(host)
    time.sleep(0.5)
    return {"running": control.isProgramRunning()}


def blocking(host: str) -> Told:
    """A blocking line of 0.3 m, how it ended, and what a second one says."""
    control, receive = RTDEControlInterface(host), RTDEReceiveInterface(host)
    start = receive.getActualTCPPose()
    first = control.moveL(_shifted(start, 0.25), 0.25, 1.2)
    began = time.monotonic()
    second = control.moveL(start, 0.25, 1.2)
    return {"first": first, "second": second, "second_s": time.monotonic() - began}


def watched(host: str) -> Told:
    """A slow line under the watchdog, fed until somebody kills this process."""
    control, receive = RTDEControlInterface(host), RTDEReceiveInterface(host)
    control.setWatchdog(10.0)
    control.moveL(_shifted(receive.getActualTCPPose(), 0.25), 0.05, 1.2, True)
    while True:
        control.kickWatchdog()
        time.sleep(0.02)


def pick(host: str, above: str, below: str) -> Told:
    """Jaws over a stick (joint angles, then a pose), closed, and up again; what the confirm input says."""
    control, receive, io = RTDEControlInterface(host), RTDEReceiveInterface(host), RTDEIOInterface(host)
    told: Told = {"held": [bool(receive.getActualDigitalInputBits() & 1)]}
    up, down = json.loads(above), json.loads(below)
    q = control.getInverseKinematics(up, receive.getActualQ())
    told["moved"] = [control.moveJ(q, 2.0, 3.0), control.moveL(down, 0.1, 0.5)]
    io.setStandardDigitalOut(0, True)
    ends_at = time.monotonic() + 3.0
    while not receive.getActualDigitalInputBits() & 1 and time.monotonic() < ends_at:
        time.sleep(0.005)
    told["held"].append(bool(receive.getActualDigitalInputBits() & 1))
    told["moved"].append(control.moveL(up, 0.3, 1.0))
    told["held"].append(bool(receive.getActualDigitalInputBits() & 1))
    return told


STORIES: dict[str, Callable[..., Told]] = {
    "tour": tour,
    "connect": connect,
    "later": later,
    "blocking": blocking,
    "watched": watched,
    "pick": pick,
}

if __name__ == "__main__":
    sys.stdout.write(json.dumps(STORIES[sys.argv[1]](*sys.argv[2:])) + "\n")
    sys.stdout.flush()
    os._exit(0)
