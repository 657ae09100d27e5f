"""The simulated cell on a loopback port: requests to `Controller` calls, and back.

Three kinds of clients share the port: eyes, arm and jaws (`drivers.sim.devices`), or in their place a
simulated controller that drives the arm; and whoever wants to watch or upset the cell (status, truth,
faults). Every request gets one answer: ``ok`` true with values, or false with ``kind`` (rejected, timeout,
bad_request) and ``detail``.
"""

from __future__ import annotations

import itertools
import socket
import socketserver

from drivers.sim.arm import Refused
from drivers.sim.board import BoardPlace
from drivers.sim.controller import Controller, Drive
from drivers.sim.eyes import EYES, CameraFault, Silent
from drivers.sim.protocol import Json, Message, ProtocolError, receive, send
from drivers.types import JointAngles, RobotState, SafetyMode, ToolPose

CAMERA_FAULTS = {
    "camera_ok": CameraFault.NONE,
    "camera_freeze": CameraFault.FREEZE,
    "camera_black": CameraFault.BLACK,
    "camera_saturate": CameraFault.SATURATE,
    "camera_slow": CameraFault.SLOW,
    "camera_silent": CameraFault.SILENT,
}
SAFETY_FAULTS = {
    "protective_stop": SafetyMode.PROTECTIVE_STOP,
    "safeguard_stop": SafetyMode.SAFEGUARD_STOP,
    "emergency_stop": SafetyMode.EMERGENCY_STOP,
    "safety_ok": SafetyMode.NORMAL,
}
OTHER_FAULTS = ("drop_next", "miss_next", "robot_frozen", "robot_ok")
FAULTS = (*OTHER_FAULTS, *CAMERA_FAULTS, *SAFETY_FAULTS)
SLOW_S = 1.5
LONGEST_GRAB_S = 60.0


def upset(controller: Controller, name: str, eye: str | None = None, seconds: float = SLOW_S) -> None:
    """Bring about one of `FAULTS`; ``eye`` None means both. `ProtocolError` for an unknown one."""
    if eye is not None and eye not in EYES:
        raise ProtocolError(f"there is no eye {eye!r}")
    if name in CAMERA_FAULTS:
        for each in EYES if eye is None else (eye,):
            controller.eyes.set_fault(each, CAMERA_FAULTS[name], seconds)
    elif name in SAFETY_FAULTS:
        controller.stop_for_safety(SAFETY_FAULTS[name])
    elif name == "drop_next":
        controller.spoil_next(drop=True)
    elif name == "miss_next":
        controller.spoil_next(miss=True)
    elif name in ("robot_frozen", "robot_ok"):
        controller.freeze_robot(name == "robot_frozen")
    else:
        raise ProtocolError(f"no fault {name!r}; there are {', '.join(FAULTS)}")


def state_values(state: RobotState) -> dict[str, Json]:
    """A robot state as plain values."""
    return {
        "safety": state.safety.value,
        "powered": state.powered,
        "program_running": state.program_running,
        "tool": list(state.tool.six()),
        "q_rad": list(state.joints.q_rad),
        "moving": state.moving,
        "speed_fraction": state.speed_fraction,
        "controller_time_s": state.controller_time_s,
        "read_at": state.read_at,
    }


def status_values(controller: Controller) -> dict[str, Json]:
    """What an onlooker may count."""
    world, snapshot = controller.peek()
    events: list[Json] = list(world.events[-50:])
    return {
        "in_tray": len(snapshot.lying),
        "holding": snapshot.held is not None,
        "grip": world.grip.value,
        "arm_moving": world.arm.moving,
        "safety": world.arm.safety.value,
        "motions": world.arm.motions_started,
        "lease_halts": controller.lease_halts,
        "time_s": world.time_s,
        "events": events,
        **{name: world.counts[name] for name in COUNTS},
    }


COUNTS = ("in_box", "lost", "dropped", "fell_back", "collisions", "grasps", "misses", "pulled_from_under")


def truth_values(controller: Controller) -> dict[str, Json]:
    """Where every stick in the tray really is, axis ends in the base frame, metres; and the board."""
    _, snapshot = controller.peek()
    sticks: list[Json] = []
    for stick in snapshot.lying:
        ends: list[Json] = [[float(v) for v in end] for end in stick.ends]
        sticks.append({"number": stick.number, "ends_m": ends, "diameter_m": stick.diameter_m})
    board: Json = None if snapshot.base_from_board is None else snapshot.base_from_board.tolist()
    return {"sticks": sticks, "base_from_board": board}


def answer(controller: Controller, client: int, request: Message) -> Message:
    """One request to one answer. `ProtocolError` when it is not understood."""
    match request.text("op"):
        case "grab":
            return _grab(controller, request)
        case "status":
            return Message(values={"ok": True, **status_values(controller)})
        case "truth":
            return Message(values={"ok": True, **truth_values(controller)})
        case "fault":
            eye = request.text("eye") if request.has("eye") else None
            seconds = request.number("seconds") if request.has("seconds") else SLOW_S
            upset(controller, request.text("name"), eye, seconds)
        case "add_sticks":
            controller.add_sticks(max(0, min(200, request.whole("count"))))
        case "board":
            try:
                controller.show_board(BoardPlace(request.text("place")))
            except ValueError as error:
                raise ProtocolError(str(error)) from error
        case "set_input":
            controller.set_input(request.whole("pin"), request.flag("on"))
        case "set_output":
            controller.set_output(request.whole("pin"), request.flag("on"))
        case "read_input":
            return Message(values={"ok": True, "on": controller.read_input(request.whole("pin"))})
        case "jaws":
            controller.begin_jaws(request.flag("close"))
        case "grip":
            return Message(values={"ok": True, "grip": controller.grip().value})
        case operation:
            return _robot(controller, client, operation, request)
    return Message(values={"ok": True})


def _grab(controller: Controller, request: Message) -> Message:
    eye = request.text("eye")
    if eye not in EYES:
        raise ProtocolError(f"there is no eye {eye!r}")
    timeout_s = min(request.number("timeout_s"), LONGEST_GRAB_S)
    shot = controller.eyes.grab(eye, request.number("newer_than"), timeout_s)
    height, width, _ = shot.pixels.shape
    values: dict[str, Json] = {
        "ok": True,
        "width": width,
        "height": height,
        "captured_at": shot.captured_at,
        "sequence": shot.sequence,
    }
    return Message(values=values, payload=shot.pixels.tobytes())


def _robot(controller: Controller, client: int, operation: str, request: Message) -> Message:
    match operation:
        case "take_control":
            controller.take_control(client)
        case "drop_control":
            controller.drop_control(client)
        case "state":
            return Message(values={"ok": True, **state_values(controller.robot_state())})
        case "poll":
            motion, state = controller.poll(client)
            return Message(values={"ok": True, "motion": motion.value, **state_values(state)})
        case "move_line":
            target = ToolPose.of(request.six("target"))
            controller.move_line(client, target, request.number("speed"), request.number("accel"))
        case "move_joints":
            joints = JointAngles(q_rad=request.six("target"))
            controller.move_joints(client, joints, request.number("speed"), request.number("accel"))
        case "drive":
            return _drive(controller, client, request)
        case "halt":
            controller.halt()
        case "recover":
            controller.recover()
        case "reachable":
            target = ToolPose.of(request.six("target"))
            return Message(values={"ok": True, "reachable": controller.reachable(target)})
        case _:
            raise ProtocolError(f"no operation {operation!r}")
    return Message(values={"ok": True})


def _drive(controller: Controller, client: int, request: Message) -> Message:
    try:
        safety = SafetyMode(request.text("safety"))
    except ValueError as error:
        raise ProtocolError(f"no safety mode {request.text('safety')!r}") from error
    drive = Drive(
        q_rad=request.six("q_rad"),
        moving=request.flag("moving"),
        safety=safety,
        outputs=request.whole("outputs"),
    )
    driven = controller.drive(client, drive)
    asked = "" if driven.asked is None else driven.asked.value
    return Message(values={"ok": True, "inputs": driven.inputs, "asked": asked})


class _Handler(socketserver.BaseRequestHandler):
    server: Service
    request: socket.socket

    def handle(self) -> None:
        client = next(self.server.numbers)
        self.request.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        try:
            while (request := receive(self.request)) is not None:
                send(self.request, self._answered(client, request))
        except (OSError, ProtocolError):
            return  # the client is gone or talks another language; its connection ends here
        finally:
            self.server.controller.drop_control(client)

    def _answered(self, client: int, request: Message) -> Message:
        try:
            return answer(self.server.controller, client, request)
        except Refused as error:
            return Message(values={"ok": False, "kind": "rejected", "detail": str(error)})
        except Silent as error:
            return Message(values={"ok": False, "kind": "timeout", "detail": str(error)})
        except ProtocolError as error:
            return Message(values={"ok": False, "kind": "bad_request", "detail": str(error)})


class Service(socketserver.ThreadingTCPServer):
    """The listening port of one controller; a thread per client."""

    daemon_threads = True
    block_on_close = False
    allow_reuse_address = True

    def __init__(self, controller: Controller, host: str, port: int) -> None:
        self.controller = controller
        self.numbers = itertools.count(1)
        super().__init__((host, port), _Handler)

    @property
    def port(self) -> int:
        """The port it listens on."""
        return int(self.server_address[1])
